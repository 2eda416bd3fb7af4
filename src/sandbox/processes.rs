//! Finds, counts and ends processes by what `/proc` tells of them.

use std::collections::HashSet;
use std::ffi::OsStr;
use std::fs::File;
use std::io::Read;
use std::os::unix::ffi::OsStrExt;
use std::thread::sleep;
use std::time::Duration;

use rustix::process::{Pid, PidfdFlags, Signal, getpid, kill_process, pidfd_open, pidfd_send_signal};

/// The variable in the environment of a run that names its scratch folder. Children inherit it, so it finds what a run
/// leaves behind, even where a wrapper has put a process between or an orphan has got another parent.
pub const MARK: &str = "MESHMEND_SCRATCH";

/// Most of an environment that is read; ours is a few hundred bytes.
const MOST_ENVIRONMENT: u64 = 1 << 20;
/// Rounds of search; a killed process stays visible until its memory is gone.
const ROUNDS: u32 = 500;
const PAUSE: Duration = Duration::from_millis(4);

/// Kills every process that carries the mark `scratch` or that of a folder in it, and returns when none is left, with
/// those that there were. Without /proc there is nothing to search, and what a run left is then up to the script, which dies with
/// its parent.
pub fn end_strays(scratch: &OsStr) -> HashSet<Pid> {
    let entry = [MARK.as_bytes(), b"=", scratch.as_bytes()].concat();
    until_none(|| kill_marked(&entry))
}

/// Kills every descendant of a running child of ours, in other sessions and without the mark too, and leaves the child itself
/// stopped. Gives those that there were.
pub fn end_descendants(child: Pid) -> HashSet<Pid> {
    // So that it starts no more meanwhile. Its id is its own until it is reaped.
    let _ = kill_process(child, Signal::STOP);
    until_none(|| {
        let family = descendants(child);
        for &(id, started) in &family {
            kill_found(id, || Process::read(id).is_some_and(|process| process.started == started));
        }
        family.into_iter().map(|(id, _)| id).collect()
    })
}

/// Kills, round by round, until a round finds no process. Gives all that were found.
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

/// Kills a process if it still is the one that was found: its id may be given to another process between the look and the signal, a
/// handle may not.
fn kill_found(id: Pid, is_same: impl Fn() -> bool) {
    match pidfd_open(id, PidfdFlags::empty()) {
        Ok(handle) => {
            if is_same() {
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

/// How many processes and threads a process group has.
#[must_use]
pub fn count_group(group: Pid) -> u64 {
    let group = group.as_raw_nonzero().get();
    processes()
        .filter_map(Process::read)
        .filter(|process| process.group == group && !process.ended)
        .map(|process| process.threads)
        .sum()
}

/// What `/proc` tells of a process.
struct Process {
    parent: i32,
    group: i32,
    threads: u64,
    /// When it started, which tells it from a later one with the same id.
    started: u64,
    ended: bool,
}

impl Process {
    fn read(id: Pid) -> Option<Self> {
        let stat = std::fs::read(format!("/proc/{}/stat", id.as_raw_nonzero())).ok()?;
        // The name in brackets may hold anything.
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

/// The processes below another that have not ended, each with the time of its start.
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

/// Kills the processes that carry a mark, and gives them.
fn kill_marked(entry: &[u8]) -> Vec<Pid> {
    let found: Vec<Pid> = processes().filter(|&id| id != getpid() && is_marked(id, entry)).collect();
    found.iter().for_each(|&id| kill_found(id, || is_marked(id, entry)));
    found
}

/// A process of another user, or one that has ended, has no environment that could be read.
fn is_marked(id: Pid, entry: &[u8]) -> bool {
    let mut environment = Vec::new();
    let path = format!("/proc/{}/environ", id.as_raw_nonzero());
    let read = File::open(path).and_then(|file| file.take(MOST_ENVIRONMENT).read_to_end(&mut environment));
    let names_it = |variable: &[u8]| variable.strip_prefix(entry).is_some_and(|rest| matches!(rest, [] | [b'/', ..]));
    read.is_ok() && environment.split(|&byte| byte == 0).any(names_it)
}
