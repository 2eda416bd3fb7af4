//! The sandbox around a job: a process enters it before it touches a stranger's bytes, and whatever it starts is in there too.
//!
//! Three layers, each of which holds without the others, and each of which a kernel or a container may refuse:
//!
//! ```text
//! namespaces (no network, no capabilities, a count of processes) -> Landlock (files, signals) -> seccomp (system calls)
//! ```
//!
//! What is refused is told, not hidden: [`Trial`] enters the sandbox and tries what must fail, and [`Protections`] says what came of it.
//! [`processes`] finds and ends what a run leaves behind where no layer holds it back.

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

/// One wall.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Protection {
    /// Whether it held when the service started and tried it.
    pub enforced: bool,
    /// What it is made of.
    pub mechanisms: Vec<String>,
    /// What is missing and what would give it, or what a person should know.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub detail: Option<String>,
}

/// The walls around each job's processes, as they were tried.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Protections {
    /// No connection leads out, not even to this machine.
    pub network: Protection,
    /// Files outside the job's own folder can't be written, and only those of programs can be read.
    pub files: Protection,
    /// Calls that no job needs are refused, leaving the process group among them.
    pub system_calls: Protection,
    /// Processes outside can't be signalled.
    pub signals: Protection,
    /// No more processes and threads than `max_processes`.
    pub processes: Protection,
}

/// What holds each job's processes, and what they may use.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SandboxStatus {
    /// What the service was told to do where a wall can't be had.
    pub mode: SandboxMode,
    /// The walls.
    #[serde(flatten)]
    pub protections: Protections,
    /// Most processes and threads of a job.
    pub max_processes: u64,
    /// Most address space of each process, in bytes.
    pub memory_bytes: u64,
    /// Most that a job may write into its folder, in bytes.
    pub scratch_bytes: u64,
    /// Largest file, in bytes.
    pub file_bytes: u64,
}

impl Protection {
    fn missing(detail: impl Into<String>) -> Self {
        Self { enforced: false, mechanisms: Vec::new(), detail: Some(detail.into()) }
    }

    /// A wall that held although these layers of it are missing.
    fn held(mechanisms: Vec<String>, missing: Vec<String>) -> Self {
        Self {
            enforced: true,
            mechanisms,
            detail: (!missing.is_empty()).then(|| format!("without more: {}", missing.join("; "))),
        }
    }
}

impl Protections {
    /// No walls.
    fn none() -> Self {
        let off = Protection::missing("switched off by --sandbox off");
        Self {
            network: off.clone(),
            files: off.clone(),
            system_calls: off.clone(),
            signals: off.clone(),
            processes: off,
        }
    }

    /// Each wall with its name.
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

/// What to try from within a sandbox. Whoever sets it listens, and keeps a file where none may be read.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Trial {
    /// Where somebody listens.
    pub listener: SocketAddr,
    /// A folder outside, with a file [`SECRET`](Self::SECRET) in it.
    pub outside: PathBuf,
}

impl Trial {
    /// The file to be read.
    pub const SECRET: &str = "secret";

    /// Enters the sandbox with `folder` to write, tries what must fail in there, and says what did. The process is of no use
    /// for anything else afterwards.
    ///
    /// # Errors
    /// Where the sandbox can't be entered, or where `folder` can't be written from within.
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
            // The last, since it leaves no process to spare.
            processes: process_count(&layers),
        })
    }

    fn network(&self, layers: &Layers) -> Protection {
        let Layers { network_namespace, seccomp, .. } = layers;
        if TcpStream::connect_timeout(&self.listener, Duration::from_secs(5)).is_ok() {
            return Protection::missing(told([network_namespace, seccomp], "a connection could be made"));
        }
        let layers = [("network namespace", network_namespace), ("seccomp", seccomp)];
        let mechanisms: Vec<String> =
            layers.iter().filter(|(_, it)| it.is_ok()).map(|(name, _)| (*name).to_owned()).collect();
        let missing: Vec<String> = layers.iter().filter_map(|(_, it)| it.as_ref().err().cloned()).collect();
        if mechanisms.is_empty() {
            Protection::missing(missing.join("; "))
        } else {
            Protection::held(mechanisms, missing)
        }
    }

    fn files(&self, layers: &Layers) -> Protection {
        let by = match &layers.landlock {
            Ok(by) => by.clone(),
            Err(why) => return Protection::missing(why),
        };
        let outside = self.outside.display();
        if fs::read(self.outside.join(Self::SECRET)).is_ok() {
            Protection::missing(format!("{outside} can be read; it lies in a folder that programs need"))
        } else if fs::write(self.outside.join("written"), "").is_ok() {
            Protection::missing(format!("{outside} can be written"))
        } else {
            Protection::held(vec![by], layers.seccomp.as_ref().err().cloned().into_iter().collect())
        }
    }
}

/// Why layers are missing, or that they don't do their work.
fn told<T, const N: usize>(layers: [&Result<T, String>; N], otherwise: &str) -> String {
    let missing: Vec<&str> = layers.iter().filter_map(|it| it.as_ref().err().map(String::as_str)).collect();
    if missing.is_empty() { otherwise.to_owned() } else { missing.join("; ") }
}

fn system_calls(layers: &Layers) -> Protection {
    // Nothing else refuses a process to stay the leader of the group that it leads.
    match setpgid(None, None) {
        Err(Errno::PERM) if layers.seccomp.is_ok() => Protection::held(vec!["seccomp".to_owned()], Vec::new()),
        _ => Protection::missing(told([&layers.seccomp], "a system call that should be refused was not")),
    }
}

fn signals() -> Protection {
    match getppid().map(test_kill_process) {
        Some(Err(Errno::PERM)) => Protection::held(vec!["landlock".to_owned()], Vec::new()),
        _ => {
            Protection::missing("processes of the same user can be signalled; Landlock of Linux 6.12 keeps them apart")
        }
    }
}

fn process_count(layers: &Layers) -> Protection {
    if let Err(why) = &layers.process_count {
        return Protection::missing(why);
    }
    let one_more = Resource::NPROC.set(1, 1).map(|()| std::thread::Builder::new().spawn(|| ()));
    match one_more {
        Ok(Err(_)) => Protection::held(vec!["user namespace".to_owned()], Vec::new()),
        _ => Protection::missing("the kernel does not keep to the limit"),
    }
}
