//! Settings of the C library's allocator for processes that work on one model.
//!
//! By default, glibc returns large freed blocks to the kernel at once. A repair allocates and frees arrays of the size of the model
//! all the time, so a sixth of its time would go into page faults on fresh memory.

use std::env;
use std::path::Path;

/// The environment variable with the settings. Only glibc reads it, and only at the start of a process.
pub const VARIABLE: &str = "GLIBC_TUNABLES";

/// Keeps freed memory for later allocations, in one arena for all threads, and grows the heap by 4 MiB at a time.
pub const KEEP_FREED_MEMORY: &str = "glibc.malloc.mmap_threshold=1073741824:glibc.malloc.trim_threshold=1099511627776:\
                                     glibc.malloc.arena_max=1:glibc.malloc.top_pad=4194304";

/// Bytes of input from which the settings save more time than a restart takes.
const LARGE: u64 = 16 << 20;

/// Starts this process again with [`KEEP_FREED_MEMORY`] if `input` is large and the environment has no such settings. Returns where
/// nothing is gained or the restart fails. To be called before the process has read anything or started threads.
pub fn restart_for_large_input(input: &Path) {
    let is_large = input.metadata().is_ok_and(|metadata| metadata.is_file() && metadata.len() >= LARGE);
    if !is_large || !cfg!(target_env = "gnu") || env::var_os(VARIABLE).is_some() {
        return;
    }
    #[cfg(unix)]
    if let Ok(program) = env::current_exe() {
        use std::os::unix::process::CommandExt;
        // Returns only if the restart failed; the work then goes on without the settings.
        let _ =
            std::process::Command::new(program).args(env::args_os().skip(1)).env(VARIABLE, KEEP_FREED_MEMORY).exec();
    }
}
