//! Finds, counts and ends processes by the data in `/proc`.

use std::collections::HashSet;
use std::ffi::OsStr;
use std::fs::File;
use std::io::Read;
use std::os::unix::ffi::OsStrExt;
use std::thread::sleep;
use std::time::Duration;

use rustix::process::{Pid, PidfdFlags, Signal, getpid, kill_process, pidfd_open, pidfd_send_signal};

/// The environment variable that names a run's scratch folder. Children inherit the variable, so it identifies the processes
/// that a run leaves behind, even those started by a wrapper or adopted by another parent.
pub const MARK: &str = "MESHMEND_SCRATCH";

/// The most bytes of a process's environment that are read. Our own environments have a few hundred bytes.
const MAX_ENVIRONMENT: u64 = 1 << 20;
/// The most rounds of a search. A killed process stays visible until its memory is freed.
const ROUNDS: u32 = 500;
/// The pause between two rounds.
const PAUSE: Duration = Duration::from_millis(4);

/// Kills every process whose [`MARK`] is `scratch` or a folder in it, until none is left. Returns the killed processes. Without
/// `/proc` it finds none; the script then relies on dying with its parent.
pub fn end_strays(scratch: &OsStr) -> HashSet<Pid> {
    let entry = [MARK.as_bytes(), b"=", scratch.as_bytes()].concat();
    until_none(|| kill_marked(&entry))
}

/// Kills every descendant of a running child of this process, also those in other sessions and without the [`MARK`]. Leaves the
/// child itself stopped. Returns the killed processes.
pub fn end_descendants(child: Pid) -> HashSet<Pid> {
    // A stopped child starts no more processes. Its id stays valid until the child is reaped.
    let _ = kill_process(child, Signal::STOP);
    until_none(|| {
        let family = descendants(child);
        for &(id, started) in &family {
            kill_found(id, || Process::read(id).is_some_and(|process| process.started == started));
        }
        family.into_iter().map(|(id, _)| id).collect()
    })
}

/// Repeats `kill_round` until a round finds no process. Returns all that were found.
fn until_none(mut kill_round: impl FnMut() -> Vec<Pid>) -> HashSet<Pid> {
    let mut all = HashSet::new();
    for _ in 0..ROUNDS {
        let found = kill_round();
        if found.is_empty() {
            break;
        }
        all.extend(found);
        sleep(PAUSE);
    }
    all
}

/// Kills a process if `is_same` confirms that it is the one that was found. Its id may pass to another process between the search
/// and the signal; a pidfd can't.
fn kill_found(id: Pid, is_same: impl Fn() -> bool) {
    match pidfd_open(id, PidfdFlags::empty()) {
        Ok(handle) => {
            if is_same() {
                // Fails only if the process has just ended.
                let _ = pidfd_send_signal(handle, Signal::KILL);
            }
        }
        Err(rustix::io::Errno::NOSYS) => {
            let _ = kill_process(id, Signal::KILL);
        }
        Err(_) => {}
    }
}

/// The number of processes and threads of a process group.
#[must_use]
pub fn count_group(group: Pid) -> u64 {
    let group = group.as_raw_nonzero().get();
    processes()
        .filter_map(Process::read)
        .filter(|process| process.group == group && !process.ended)
        .map(|process| process.threads)
        .sum()
}

/// The data on a process in `/proc`.
struct Process {
    parent: i32,
    group: i32,
    threads: u64,
    /// The start time, which distinguishes the process from a later one with the same id.
    started: u64,
    ended: bool,
}

impl Process {
    fn read(id: Pid) -> Option<Self> {
        let stat = std::fs::read(format!("/proc/{}/stat", id.as_raw_nonzero())).ok()?;
        // The process name in parentheses may contain any byte.
        let end = stat.iter().rposition(|&byte| byte == b')')?;
        let fields = std::str::from_utf8(stat.get(end + 1..)?).ok()?;
        let mut fields = fields.split_ascii_whitespace();
        let ended = matches!(fields.next()?, "Z" | "X");
        let parent = fields.next()?.parse().ok()?;
        let group = fields.next()?.parse().ok()?;
        let threads = fields.nth(14)?.parse().ok()?;
        Some(Self { parent, group, threads, started: fields.nth(1)?.parse().ok()?, ended })
    }
}

/// The running descendants of a process, each with its start time.
fn descendants(of: Pid) -> Vec<(Pid, u64)> {
    let all: Vec<(Pid, Process)> = processes().filter_map(|id| Some((id, Process::read(id)?))).collect();
    let (mut family, mut next) = (Vec::new(), vec![of.as_raw_nonzero().get()]);
    while let Some(parent) = next.pop() {
        for (id, process) in all.iter().filter(|(_, process)| process.parent == parent) {
            next.push(id.as_raw_nonzero().get());
            if !process.ended {
                family.push((*id, process.started));
            }
        }
    }
    family
}

fn processes() -> impl Iterator<Item = Pid> {
    let entries = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok().and_then(Pid::from_raw))
}

/// Kills the processes whose environment has `entry`, and returns them.
fn kill_marked(entry: &[u8]) -> Vec<Pid> {
    let found: Vec<Pid> = processes().filter(|&id| id != getpid() && is_marked(id, entry)).collect();
    found.iter().for_each(|&id| kill_found(id, || is_marked(id, entry)));
    found
}

/// Whether a process's environment has `entry`. The environments of other users' processes and of ended ones can't be read.
fn is_marked(id: Pid, entry: &[u8]) -> bool {
    let mut environment = Vec::new();
    let path = format!("/proc/{}/environ", id.as_raw_nonzero());
    let read = File::open(path).and_then(|file| file.take(MAX_ENVIRONMENT).read_to_end(&mut environment));
    let is_entry = |variable: &[u8]| variable.strip_prefix(entry).is_some_and(|rest| matches!(rest, [] | [b'/', ..]));
    read.is_ok() && environment.split(|&byte| byte == 0).any(is_entry)
}
