use std::io::{self, Read};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process_group};

use crate::sandbox::processes::{MARK, end_descendants, end_strays};

/// Time between looks at a running process.
const PAUSE: Duration = Duration::from_millis(20);
/// Most output that is passed on, in bytes; the rest is read and dropped, so that the process never blocks on it.
const MOST_OUTPUT: u64 = 256 << 10;
/// More that is passed on only in lines that begin with [`ERROR`]: they tell why it failed.
const MOST_ERRORS: u64 = 16 << 10;
/// Longer lines are cut in pieces.
const MOST_LINE: usize = 4096;
/// How the script begins a line that tells why it failed.
pub(super) const ERROR: &str = "meshmend-error: ";
/// Time that the pipes may stay open after everything that was started has ended.
const PIPES_CLOSE: Duration = Duration::from_secs(2);

/// Gives `command` an environment of its own, in which every user profile lies in `scratch`, with `scratch` as the
/// working folder. What stays is `PATH`, and `LD_LIBRARY_PATH`, which some installations need to start at all.
pub(super) fn isolate(command: &mut Command, scratch: &Path) {
    command.env_clear().current_dir(scratch).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let path = std::env::var_os("PATH").unwrap_or_else(|| "/usr/local/bin:/usr/bin:/bin".into());
    command.env("PATH", path).env(MARK, scratch);
    if let Some(libraries) = std::env::var_os("LD_LIBRARY_PATH") {
        command.env("LD_LIBRARY_PATH", libraries);
    }
    for variable in [
        "HOME",
        "TMPDIR",
        "TEMP",
        "XDG_CONFIG_HOME",
        "XDG_CACHE_HOME",
        "XDG_DATA_HOME",
        "XDG_STATE_HOME",
        "XDG_RUNTIME_DIR",
        "BLENDER_USER_RESOURCES",
        "BLENDER_USER_CONFIG",
        "BLENDER_USER_SCRIPTS",
        "BLENDER_USER_DATAFILES",
        "BLENDER_USER_EXTENSIONS",
    ] {
        command.env(variable, scratch);
    }
    command.env("LC_ALL", "C.UTF-8").env("PYTHONDONTWRITEBYTECODE", "1").env("PYTHONNOUSERSITE", "1");
}

/// Runs an isolated command to its end, passes its lines of output to `line`, and asks `watch` every 20 ms whether it
/// may go on. Returns how it ended, or what `watch` said; then neither the process nor any of its children lives.
///
/// `own_group` starts it as leader of its own process group. Otherwise it stays in the caller's, so that who kills
/// that group kills it too.
///
/// # Errors
/// The operating system's, where the process could not be started.
pub(super) fn run<S>(
    command: &mut Command,
    scratch: &Path,
    own_group: bool,
    line: &mut dyn FnMut(&str),
    watch: &mut dyn FnMut() -> Result<(), S>,
) -> io::Result<Result<ExitStatus, S>> {
    if own_group {
        command.process_group(0);
    }
    let mut child = start(command)?;
    let lines = drain(&mut child);
    let ended = loop {
        match child.try_wait() {
            Ok(Some(status)) => break Ok(status),
            Ok(None) => {}
            Err(error) => {
                kill(&mut child, scratch, own_group);
                return Err(error);
            }
        }
        lines.try_iter().for_each(|text| line(&text));
        if let Err(stop) = watch() {
            break Err(stop);
        }
        thread::sleep(PAUSE);
    };
    kill(&mut child, scratch, own_group);
    // Ends when both pipes are closed; a process that has hidden from us could hold them open.
    while let Ok(text) = lines.recv_timeout(PIPES_CLOSE) {
        line(&text);
    }
    Ok(ended)
}

/// Starts the process. A program that is still open for writing elsewhere (it was just installed, or a fork of this
/// very process holds it for a moment) is tried again.
fn start(command: &mut Command) -> io::Result<Child> {
    let mut tries = 0;
    loop {
        match command.spawn() {
            Err(error) if error.kind() == io::ErrorKind::ExecutableFileBusy && tries < 10 => {
                tries += 1;
                thread::sleep(PAUSE);
            }
            other => return other,
        }
    }
}

/// Kills and reaps the process and whatever it started: by descent, by group, and by the mark that they carry.
fn kill(child: &mut Child, scratch: &Path, own_group: bool) {
    // Before the process is gone, since its children get another parent then.
    if let Some(id) = i32::try_from(child.id()).ok().and_then(Pid::from_raw)
        && matches!(child.try_wait(), Ok(None))
    {
        end_descendants(id);
    }
    // Before the leader is reaped: afterwards its id, and with it the group's, could be another's.
    if own_group
        && let Ok(id) = i32::try_from(child.id())
        && matches!(child.try_wait(), Ok(None))
    {
        // Fails only where the group has ended.
        let _ = Pid::from_raw(id).map(|id| kill_process_group(id, Signal::KILL));
    }
    // These fail only where it has ended.
    let _ = child.kill();
    let _ = child.wait();
    end_strays(scratch.as_os_str());
}

/// How much output has come, over both pipes.
#[derive(Debug, Default)]
struct Passed {
    bytes: AtomicU64,
    error_bytes: AtomicU64,
    cut_told: AtomicBool,
}

/// Reads both pipes in threads of their own until they close.
fn drain(child: &mut Child) -> Receiver<String> {
    let (sender, lines) = channel();
    let passed = Arc::new(Passed::default());
    if let Some(pipe) = child.stdout.take() {
        read_in_thread(pipe, sender.clone(), Arc::clone(&passed));
    }
    if let Some(pipe) = child.stderr.take() {
        read_in_thread(pipe, sender, passed);
    }
    lines
}

fn read_in_thread(pipe: impl Read + Send + 'static, sender: Sender<String>, passed: Arc<Passed>) {
    // Where no thread can be had the pipe is closed, and the process ends on its next write.
    let _ = thread::Builder::new().name("blender-output".to_owned()).spawn(move || read_lines(pipe, &sender, &passed));
}

/// Sends the lines of `pipe` until it closes.
fn read_lines(mut pipe: impl Read, sender: &Sender<String>, passed: &Passed) {
    let mut buffer = [0; 8192];
    let mut line = Vec::new();
    loop {
        let bytes = match pipe.read(&mut buffer) {
            Ok(0) => break,
            Ok(count) => buffer.get(..count).unwrap_or_default(),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(_) => break,
        };
        for &byte in bytes {
            let ends = byte == b'\n' || byte == b'\r';
            if ends || line.len() >= MOST_LINE {
                send(&line, sender, passed);
                line.clear();
            }
            if !ends {
                line.push(byte);
            }
        }
    }
    send(&line, sender, passed);
}

fn send(line: &[u8], sender: &Sender<String>, passed: &Passed) {
    if line.is_empty() {
        return;
    }
    let cost = line.len() as u64 + 1;
    let room = passed.bytes.fetch_add(cost, Ordering::Relaxed) < MOST_OUTPUT
        || line.starts_with(ERROR.as_bytes()) && passed.error_bytes.fetch_add(cost, Ordering::Relaxed) < MOST_ERRORS;
    // Sending fails only when nobody listens any more.
    if room {
        let text = String::from_utf8_lossy(line);
        let _ = sender.send(text.chars().map(|c| if c.is_control() && c != '\t' { ' ' } else { c }).collect());
    } else if !passed.cut_told.swap(true, Ordering::Relaxed) {
        let _ = sender.send(format!("output cut after {MOST_OUTPUT} bytes"));
    }
}
