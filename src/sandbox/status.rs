use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::SandboxMode;

/// One wall.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Protection {
    /// Whether it held when the service started and tried it.
    pub in_force: bool,
    /// What it is made of.
    pub by: Vec<String>,
    /// What is missing and what would give it, or what a person should know.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub detail: Option<String>,
}

/// The walls around each job's processes, as they were tried.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Walls {
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
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct SandboxStatus {
    /// What the service was told to do where a wall can't be had.
    pub mode: SandboxMode,
    /// The walls.
    #[serde(flatten)]
    pub walls: Walls,
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
    pub(super) fn missing(detail: impl Into<String>) -> Self {
        Self { in_force: false, by: Vec::new(), detail: Some(detail.into()) }
    }

    /// A wall that held although these layers of it are missing.
    pub(super) fn held(by: Vec<String>, missing: Vec<String>) -> Self {
        Self {
            in_force: true,
            by,
            detail: (!missing.is_empty()).then(|| format!("without more: {}", missing.join("; "))),
        }
    }
}

impl Walls {
    /// No walls.
    pub(super) fn none() -> Self {
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
