//! Runs a Blender process: isolates its environment, collects its output, and ends it with all its descendants.

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

/// The pause between two checks of a running process.
const PAUSE: Duration = Duration::from_millis(20);
/// The most output that is passed on, in bytes. Further output is read and dropped, so that the process never blocks on a full pipe.
const MAX_OUTPUT: u64 = 256 << 10;
/// The most bytes that are passed on after [`MAX_OUTPUT`], only in lines that begin with [`ERROR`] and say why the script failed.
const MAX_ERRORS: u64 = 16 << 10;
/// Longer lines are split.
const MAX_LINE: usize = 4096;
/// The prefix of a line in which the script says why it failed.
pub(super) const ERROR: &str = "meshmend-error: ";
/// How long the pipes may stay open after all processes have ended.
const PIPES_CLOSE: Duration = Duration::from_secs(2);

/// Gives `command` an environment of its own. `scratch` is the working folder and the place of every user profile.
///
/// Of this process's variables, `command` keeps `PATH` and `LD_LIBRARY_PATH`, which some installations need to start.
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

/// Runs an isolated command to its end. Passes its lines of output to `line`, and calls `watch` every 20 ms; an error of `watch` stops
/// the run. Returns the exit status or that error, after the process and all its descendants have ended.
///
/// `own_group` starts the process as the leader of its own process group. Otherwise it stays in the caller's group, so that killing
/// that group kills it too.
///
/// # Errors
/// The operating system's error when the process could not be started.
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
    // Both pipes close at the end, unless a process that was not found holds them open.
    while let Ok(text) = lines.recv_timeout(PIPES_CLOSE) {
        line(&text);
    }
    Ok(ended)
}

/// Starts the process. Retries while the program is open for writing: after an installation, or while a fork of this process still
/// holds the file.
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

/// Kills and reaps the process and all processes that it started, found by descent, by process group, and by the variable [`MARK`].
fn kill(child: &mut Child, scratch: &Path, own_group: bool) {
    // The search needs a living process: its children get another parent when it ends.
    if let Some(id) = i32::try_from(child.id()).ok().and_then(Pid::from_raw)
        && matches!(child.try_wait(), Ok(None))
    {
        end_descendants(id);
    }
    // The leader must not be reaped yet: afterwards its id, and the group's, may pass to another process.
    if own_group
        && let Ok(id) = i32::try_from(child.id())
        && matches!(child.try_wait(), Ok(None))
    {
        // Fails only if the group has ended.
        let _ = Pid::from_raw(id).map(|id| kill_process_group(id, Signal::KILL));
    }
    // Both fail only if the process has ended.
    let _ = child.kill();
    let _ = child.wait();
    end_strays(scratch.as_os_str());
}

/// The output passed on so far, from both pipes.
#[derive(Debug, Default)]
struct PassedOutput {
    bytes: AtomicU64,
    error_bytes: AtomicU64,
    is_truncation_reported: AtomicBool,
}

/// Starts a thread for each pipe, which reads the pipe until it closes.
fn drain(child: &mut Child) -> Receiver<String> {
    let (sender, lines) = channel();
    let passed = Arc::new(PassedOutput::default());
    if let Some(pipe) = child.stdout.take() {
        read_in_thread(pipe, sender.clone(), Arc::clone(&passed));
    }
    if let Some(pipe) = child.stderr.take() {
        read_in_thread(pipe, sender, passed);
    }
    lines
}

fn read_in_thread(pipe: impl Read + Send + 'static, sender: Sender<String>, passed: Arc<PassedOutput>) {
    // If no thread can be started, the pipe is closed, and the process ends at its next write.
    let _ = thread::Builder::new().name("blender-output".to_owned()).spawn(move || read_lines(pipe, &sender, &passed));
}

/// Sends the lines of `pipe` until it closes.
fn read_lines(mut pipe: impl Read, sender: &Sender<String>, passed: &PassedOutput) {
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
            if ends || line.len() >= MAX_LINE {
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

fn send(line: &[u8], sender: &Sender<String>, passed: &PassedOutput) {
    if line.is_empty() {
        return;
    }
    let cost = line.len() as u64 + 1;
    let is_within_limit = passed.bytes.fetch_add(cost, Ordering::Relaxed) < MAX_OUTPUT
        || line.starts_with(ERROR.as_bytes()) && passed.error_bytes.fetch_add(cost, Ordering::Relaxed) < MAX_ERRORS;
    // Sending fails only if nobody listens any more.
    if is_within_limit {
        let text = String::from_utf8_lossy(line);
        let _ = sender.send(text.chars().map(|c| if c.is_control() && c != '\t' { ' ' } else { c }).collect());
    } else if !passed.is_truncation_reported.swap(true, Ordering::Relaxed) {
        let _ = sender.send(format!("output truncated after {MAX_OUTPUT} bytes"));
    }
}
