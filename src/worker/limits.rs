use std::io;
use std::time::Duration;

use rlimit::Resource;
use serde::{Deserialize, Serialize};

/// Most files that a process may have open.
const OPEN_FILES: u64 = 1024;

/// What one job's child process, and each process it starts, may use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProcessLimits {
    /// Address space, in bytes.
    pub memory_bytes: u64,
    /// Largest file it may write, in bytes.
    pub file_bytes: u64,
    /// Processor time.
    pub cpu: Duration,
}

impl ProcessLimits {
    /// Puts the limits on the calling process; what it starts inherits them.
    ///
    /// # Errors
    /// When the operating system refuses.
    pub fn apply(&self) -> io::Result<()> {
        Self::lower(Resource::AS, self.memory_bytes)?;
        Self::lower(Resource::FSIZE, self.file_bytes)?;
        Self::lower(Resource::CPU, self.cpu.as_secs().max(1))?;
        Self::lower(Resource::NOFILE, OPEN_FILES)?;
        Self::lower(Resource::CORE, 0)
    }

    /// Sets soft and hard limit, never above the hard limit that is there already.
    fn lower(resource: Resource, value: u64) -> io::Result<()> {
        let (_, hard) = resource.get()?;
        let value = value.min(hard);
        resource.set(value, value)
    }
}
