//! The sandbox of a job. A process enters it before it reads untrusted bytes, and all processes that it starts are inside too.
//!
//! It has three layers. Each works without the others, and a kernel or a container may refuse each:
//!
//! ```text
//! namespaces (no network, no capabilities, a limit on processes) -> Landlock (files, signals) -> seccomp (system calls)
//! ```
//!
//! The service reports missing protections: [`Trial`] enters the sandbox and tries the actions that must fail, and
//! [`Protections`] has the results. [`processes`] finds and ends processes that a run leaves behind where no layer confines them.

mod layers;
pub mod processes;
mod seccomp;

use std::fs;
use std::io;
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::time::Duration;

use rlimit::Resource;
use rustix::io::Errno;
use rustix::process::{getppid, setpgid, test_kill_process};
use serde::{Deserialize, Serialize};

use layers::Layers;
pub use layers::{Sandbox, SandboxMode};

/// One protection of the sandbox, as the trial at the start of the service found it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Protection {
    /// Whether the protection held in the trial.
    pub enforced: bool,
    /// The mechanisms that provide it.
    pub mechanisms: Vec<String>,
    /// The missing mechanism and how to enable it, or other advice.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub detail: Option<String>,
}

/// The protections around each job's processes, as the trial at the start of the service found them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Protections {
    /// A job can't make connections, not even to this machine.
    pub network: Protection,
    /// A job can write only in its own folder, and read only the files of programs.
    pub files: Protection,
    /// A job can't make system calls that it does not need. Leaving its process group is one of them.
    pub system_calls: Protection,
    /// A job can't send signals to other processes.
    pub signals: Protection,
    /// A job can't have more than `max_processes` processes and threads.
    pub processes: Protection,
}

/// The sandbox of each job: its protections, and the resource limits of a job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SandboxStatus {
    /// What the service does where a protection is not available.
    pub mode: SandboxMode,
    /// The protections.
    #[serde(flatten)]
    pub protections: Protections,
    /// The most processes and threads of a job.
    pub max_processes: u64,
    /// The most address space of each process, in bytes.
    pub memory_bytes: u64,
    /// The most bytes that a job may write into its folder.
    pub scratch_bytes: u64,
    /// The largest file that a job may write, in bytes.
    pub file_bytes: u64,
}

impl Protection {
    /// A protection that did not hold.
    fn missing(detail: impl Into<String>) -> Self {
        Self { enforced: false, mechanisms: Vec::new(), detail: Some(detail.into()) }
    }

    /// A protection that held although layers of it are missing.
    fn held(mechanisms: Vec<String>, missing: Vec<String>) -> Self {
        Self {
            enforced: true,
            mechanisms,
            detail: (!missing.is_empty()).then(|| format!("not all mechanisms are available: {}", missing.join("; "))),
        }
    }
}

impl Protections {
    /// The protections of the mode `off`: none.
    fn none() -> Self {
        let off = Protection::missing("disabled by --sandbox off");
        Self {
            network: off.clone(),
            files: off.clone(),
            system_calls: off.clone(),
            signals: off.clone(),
            processes: off,
        }
    }

    /// Each protection with its name.
    #[must_use]
    pub fn named(&self) -> [(&'static str, &Protection); 5] {
        let Self { network, files, system_calls, signals, processes } = self;
        [
            ("network", network),
            ("files", files),
            ("system calls", system_calls),
            ("signals", signals),
            ("processes", processes),
        ]
    }
}

/// A trial of the sandbox: actions that must fail inside. The caller listens at an address, and keeps a file that must not be
/// readable.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Trial {
    /// The address of the caller's listener.
    pub listener: SocketAddr,
    /// A folder outside the sandbox, with a file [`SECRET`](Self::SECRET).
    pub outside: PathBuf,
}

impl Trial {
    /// The name of the file that must not be readable.
    pub const SECRET: &str = "secret";

    /// Enters the sandbox with `folder` as the writable folder, tries the actions, and reports which protections held. The process
    /// can do no other work afterwards.
    ///
    /// # Errors
    /// When the sandbox can't be entered, or `folder` can't be written inside.
    pub fn run(&self, sandbox: &Sandbox, folder: &Path) -> io::Result<Protections> {
        let Some(layers) = sandbox.enter_layers(folder)? else { return Ok(Protections::none()) };
        let inside = folder.join("written");
        fs::write(&inside, "inside")?;
        fs::remove_file(&inside)?;
        Ok(Protections {
            network: self.network(&layers),
            files: self.files(&layers),
            system_calls: system_calls(&layers),
            signals: signals(),
            // The process limit comes last, since its trial leaves no process to spare.
            processes: process_count(&layers),
        })
    }

    fn network(&self, layers: &Layers) -> Protection {
        let Layers { network_namespace, seccomp, .. } = layers;
        if TcpStream::connect_timeout(&self.listener, Duration::from_secs(5)).is_ok() {
            let reason = missing_layers([network_namespace, seccomp], "a connection could be made");
            return Protection::missing(reason);
        }
        let layers = [("network namespace", network_namespace), ("seccomp", seccomp)];
        let mechanisms: Vec<String> =
            layers.iter().filter(|(_, layer)| layer.is_ok()).map(|(name, _)| (*name).to_owned()).collect();
        let missing: Vec<String> = layers.iter().filter_map(|(_, layer)| layer.as_ref().err().cloned()).collect();
        if mechanisms.is_empty() {
            Protection::missing(missing.join("; "))
        } else {
            Protection::held(mechanisms, missing)
        }
    }

    fn files(&self, layers: &Layers) -> Protection {
        let mechanism = match &layers.landlock {
            Ok(mechanism) => mechanism.clone(),
            Err(reason) => return Protection::missing(reason),
        };
        let outside = self.outside.display();
        if fs::read(self.outside.join(Self::SECRET)).is_ok() {
            Protection::missing(format!("{outside} can be read; move it out of the folders that programs need"))
        } else if fs::write(self.outside.join("written"), "").is_ok() {
            Protection::missing(format!("{outside} can be written"))
        } else {
            Protection::held(vec![mechanism], layers.seccomp.as_ref().err().cloned().into_iter().collect())
        }
    }
}

/// Why layers are missing; `otherwise` if none is missing but the protection did not hold.
fn missing_layers<T, const N: usize>(layers: [&Result<T, String>; N], otherwise: &str) -> String {
    let missing: Vec<&str> = layers.iter().filter_map(|layer| layer.as_ref().err().map(String::as_str)).collect();
    if missing.is_empty() { otherwise.to_owned() } else { missing.join("; ") }
}

fn system_calls(layers: &Layers) -> Protection {
    // Without the filter, a process may always set itself as the leader of the group that it already leads.
    match setpgid(None, None) {
        Err(Errno::PERM) if layers.seccomp.is_ok() => Protection::held(vec!["seccomp".to_owned()], Vec::new()),
        _ => Protection::missing(missing_layers([&layers.seccomp], "a forbidden system call was not refused")),
    }
}

fn signals() -> Protection {
    match getppid().map(test_kill_process) {
        Some(Err(Errno::PERM)) => Protection::held(vec!["landlock".to_owned()], Vec::new()),
        _ => Protection::missing(
            "a job can signal processes of the same user; Landlock of Linux 6.12 or later prevents that",
        ),
    }
}

fn process_count(layers: &Layers) -> Protection {
    if let Err(reason) = &layers.process_count {
        return Protection::missing(reason);
    }
    let one_more = Resource::NPROC.set(1, 1).map(|()| std::thread::Builder::new().spawn(|| ()));
    match one_more {
        Ok(Err(_)) => Protection::held(vec!["user namespace".to_owned()], Vec::new()),
        _ => Protection::missing("the kernel does not enforce the limit on processes"),
    }
}
