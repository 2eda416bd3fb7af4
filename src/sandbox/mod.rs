//! The walls around a job: a process puts itself in before it touches a stranger's bytes, and whatever it starts is in there too.
//!
//! Three layers, each of which holds without the others, and each of which a kernel or a container may refuse:
//!
//! ```text
//! namespaces (no network, no capabilities, a count of processes) -> Landlock (files, signals) -> seccomp (system calls)
//! ```
//!
//! What is refused is told, not hidden: [`Trial`] enters the sandbox and tries what must fail, and [`Walls`] says what came of it.
//! [`processes`] finds and ends what a run leaves behind where no wall holds it back.

mod calls;
mod files;
mod namespaces;
pub mod processes;
mod status;
mod trial;

use std::io;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

pub use status::{Protection, SandboxStatus, Walls};
pub use trial::Trial;

/// What to do where the kernel can't give every wall.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SandboxMode {
    /// Use what there is.
    #[default]
    Auto,
    /// Run nothing where the network or the files are open.
    Require,
    /// No walls; for debugging.
    Off,
}

/// A sandbox for the calling process and all that it starts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sandbox {
    /// What to do where a wall can't be had.
    pub mode: SandboxMode,
    /// Files and folders to read, and to start programs from, beside those of the system.
    pub readable: Vec<PathBuf>,
    /// Most processes and threads, where a user namespace counts them.
    pub max_processes: u64,
}

/// What came of each layer: how it is called, or why it is not there.
#[derive(Debug)]
struct Layers {
    network_namespace: Result<(), String>,
    process_count: Result<(), String>,
    landlock: Result<String, String>,
    seccomp: Result<(), String>,
}

impl Sandbox {
    /// Enters the sandbox, in which `folder` can be written and nothing else. There is no way out.
    ///
    /// # Errors
    /// When the process has more than one thread, since only the calling one would be inside, and where a wall is missing that is
    /// required.
    pub fn enter(&self, folder: &std::path::Path) -> io::Result<()> {
        self.enter_layers(folder).map(drop)
    }

    fn enter_layers(&self, folder: &std::path::Path) -> io::Result<Option<Layers>> {
        if self.mode == SandboxMode::Off {
            return Ok(None);
        }
        let threads = std::fs::read_dir("/proc/self/task")?.count();
        if threads != 1 {
            return Err(io::Error::other(format!("a sandbox is for a process of one thread; this one has {threads}")));
        }
        rustix::thread::set_no_new_privs(true)?;
        let (network_namespace, process_count) = namespaces::enter(self.max_processes);
        namespaces::drop_capabilities()?;
        let landlock = files::restrict(&self.readable, folder);
        let seccomp = calls::deny();
        let layers = Layers { network_namespace, process_count, landlock, seccomp };
        if self.mode == SandboxMode::Require
            && let Some(missing) = layers.missing()
        {
            return Err(io::Error::other(missing));
        }
        Ok(Some(layers))
    }
}

impl Layers {
    /// Why the network or the files are open.
    fn missing(&self) -> Option<String> {
        match (&self.network_namespace, &self.seccomp, &self.landlock) {
            (Err(namespace), Err(seccomp), _) => Some(format!("the network is open: {namespace}; {seccomp}")),
            (.., Err(landlock)) => Some(format!("the files are open: {landlock}")),
            _ => None,
        }
    }
}
