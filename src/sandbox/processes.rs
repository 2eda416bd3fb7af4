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
    let mut strays = HashSet::new();
    for _ in 0..ROUNDS {
        let found = kill_marked(&entry);
        if found.is_empty() {
            break;
        }
        strays.extend(found);
        sleep(PAUSE);
    }
    strays
}

/// Kills every descendant of a running child of ours, in other sessions and without the mark too, and leaves the child itself
/// stopped. Gives those that there were.
pub fn end_descendants(child: Pid) -> HashSet<Pid> {
    // So that it starts no more meanwhile. Its id is its own until it is reaped.
    let _ = kill_process(child, Signal::STOP);
    let mut ended = HashSet::new();
    for _ in 0..ROUNDS {
        let family = descendants(child);
        if family.is_empty() {
            break;
        }
        ended.extend(family.iter().map(|(id, _)| *id));
        for (id, started) in family {
            // The id may be given to another process between the look and the signal; a handle may not.
            match pidfd_open(id, PidfdFlags::empty()) {
                Ok(handle) if Process::read(id).is_some_and(|it| it.started == started) => {
                    let _ = pidfd_send_signal(handle, Signal::KILL);
                }
                Err(rustix::io::Errno::NOSYS) => {
                    let _ = kill_process(id, Signal::KILL);
                }
                _ => {}
            }
        }
        sleep(PAUSE);
    }
    ended
}

/// How many processes and threads a process group has.
#[must_use]
pub fn count_group(group: Pid) -> u64 {
    let group = group.as_raw_nonzero().get();
    processes().filter_map(Process::read).filter(|it| it.group == group && !it.ended).map(|it| it.threads).sum()
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
        for (id, it) in all.iter().filter(|(_, it)| it.parent == parent) {
            next.push(id.as_raw_nonzero().get());
            if !it.ended {
                family.push((*id, it.started));
            }
        }
    }
    family
}

fn processes() -> impl Iterator<Item = Pid> {
    let entries = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok().and_then(Pid::from_raw))
}

/// Gives those that there were.
fn kill_marked(entry: &[u8]) -> Vec<Pid> {
    let mut found = Vec::new();
    for id in processes().filter(|&id| id != getpid()) {
        if !is_marked(id, entry) {
            continue;
        }
        found.push(id);
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
