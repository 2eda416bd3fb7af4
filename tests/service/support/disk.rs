//! Small disks that tests fill.

use std::fs;
use std::path::{Path, PathBuf};

use crate::server::Program;

/// The data folder as the program sees it: the program has mounted a small disk there, in its own mount namespace.
pub fn disk(program: &Program, data: &Path) -> PathBuf {
    Path::new("/proc").join(program.pid().to_string()).join("root").join(data.strip_prefix("/").expect("absolute"))
}

/// Fills a disk until `free` bytes are left.
pub fn fill(disk: &Path, free: u64) -> PathBuf {
    let filler = disk.join("filler");
    let available = rustix::fs::statvfs(disk).map(|disk| disk.f_bavail * disk.f_frsize).expect("a disk");
    match fs::write(&filler, vec![0; usize::try_from(available.saturating_sub(free)).expect("small")]) {
        // The program may have written something since.
        Err(error) if error.kind() == std::io::ErrorKind::StorageFull => {}
        written => written.expect("a file"),
    }
    filler
}

/// Whether the program has a file open that waits to be sent to a bucket.
pub fn has_spool_open(program: &Program) -> bool {
    let open = fs::read_dir(format!("/proc/{}/fd", program.pid())).into_iter().flatten().flatten();
    let mut open = open.filter_map(|file| fs::read_link(file.path()).ok());
    open.any(|file| file.to_string_lossy().contains("/spool/"))
}
