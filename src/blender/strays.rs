use std::ffi::OsStr;
use std::fs::File;
use std::io::Read;
use std::os::unix::ffi::OsStrExt;
use std::thread::sleep;
use std::time::Duration;

use rustix::process::{Pid, PidfdFlags, Signal, getpid, kill_process, pidfd_open, pidfd_send_signal};

/// The variable in the environment of a run that names its scratch folder. Children inherit it, so it finds what a run
/// leaves behind, even where a wrapper has put a process between or an orphan has got another parent.
pub(super) const MARK: &str = "MESHMEND_SCRATCH";

/// Most of an environment that is read; ours is a few hundred bytes.
const MOST_ENVIRONMENT: u64 = 1 << 20;
/// Rounds of search; a killed process stays visible until its memory is gone.
const ROUNDS: u32 = 500;
const PAUSE: Duration = Duration::from_millis(4);

/// Kills every process that carries the mark `scratch`, and returns when none is left. Without /proc there is nothing
/// to search, and what a run left is then up to the script, which dies with its parent.
pub(super) fn end_strays(scratch: &OsStr) {
    let entry = [MARK.as_bytes(), b"=", scratch.as_bytes()].concat();
    for _ in 0..ROUNDS {
        if !kill_marked(&entry) {
            return;
        }
        sleep(PAUSE);
    }
}

/// Whether there was any.
fn kill_marked(entry: &[u8]) -> bool {
    let Ok(processes) = std::fs::read_dir("/proc") else { return false };
    let mut any = false;
    for process in processes.flatten() {
        let id = process.file_name().to_str().and_then(|name| name.parse().ok()).and_then(Pid::from_raw);
        let Some(id) = id.filter(|&id| id != getpid()) else { continue };
        if !is_marked(id, entry) {
            continue;
        }
        any = true;
        // The id may be given to another process between the look and the signal; a handle may not.
        match pidfd_open(id, PidfdFlags::empty()) {
            Ok(handle) => {
                if is_marked(id, entry) {
                    // Fails only where the process has just ended.
                    let _ = pidfd_send_signal(handle, Signal::KILL);
                }
            }
            Err(rustix::io::Errno::NOSYS) => {
                let _ = kill_process(id, Signal::KILL);
            }
            Err(_) => {}
        }
    }
    any
}

/// A process of another user, or one that has ended, has no environment that could be read.
fn is_marked(id: Pid, entry: &[u8]) -> bool {
    let mut environment = Vec::new();
    let path = format!("/proc/{}/environ", id.as_raw_nonzero());
    let read = File::open(path).and_then(|file| file.take(MOST_ENVIRONMENT).read_to_end(&mut environment));
    read.is_ok() && environment.split(|&byte| byte == 0).any(|variable| variable == entry)
}
