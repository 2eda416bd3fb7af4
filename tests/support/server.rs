//! The built program as a server, and a client for it.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use reqwest::{Client, RequestBuilder, Response};
use serde_json::Value;

/// The longest wait for anything in a test.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// A running `meshmend` process; killed with all its children when dropped.
pub struct Program {
    child: Child,
    /// The service's address, for `serve`.
    pub url: String,
    /// The address of its listener for probes and metrics, if it has one.
    pub probes: String,
    log: Arc<Mutex<String>>,
}

/// The command that starts a program.
pub struct Start<'a> {
    command: Command,
    data: &'a Path,
}

impl<'a> Start<'a> {
    /// `meshmend serve` on any free port.
    pub fn serve(data: &'a Path) -> Self {
        Self::serve_on("127.0.0.1:0", data)
    }

    /// `meshmend serve` on this address.
    pub fn serve_on(address: &str, data: &'a Path) -> Self {
        Self::verb("serve", data).arg("--listen", address)
    }

    /// `meshmend work`.
    pub fn work(data: &'a Path) -> Self {
        Self::verb("work", data)
    }

    /// Any command of the program that runs until it is stopped.
    pub fn of(command: Command, data: &'a Path) -> Self {
        Self { command, data }
    }

    fn verb(verb: &str, data: &'a Path) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_meshmend"));
        command.arg(verb).arg("--data-dir").arg(data).env("MESHMEND_LEASE_S", "1.5").env_remove("FAILPOINTS");
        // Tests that need Blender set it; the others should not wait for it.
        command.args(["--blender", "/nonexistent/blender", "--blender-warm-up", "false"]);
        Self { command, data }
    }

    pub fn arg(mut self, name: &str, value: impl AsRef<std::ffi::OsStr>) -> Self {
        self.command.arg(name).arg(value);
        self
    }

    pub fn env(mut self, name: &str, value: &str) -> Self {
        self.command.env(name, value);
        self
    }

    /// Uses this program as Blender.
    pub fn blender(self, program: &Path) -> Self {
        self.real_blender().arg("--blender", program)
    }

    /// Uses the Blender that the program finds.
    pub fn real_blender(mut self) -> Self {
        let old = std::mem::replace(&mut self.command, Command::new(env!("CARGO_BIN_EXE_meshmend")));
        let mut args = old.get_args();
        while let Some(arg) = args.next() {
            if arg == "--blender" {
                args.next();
            } else {
                self.command.arg(arg);
            }
        }
        for (name, value) in old.get_envs() {
            match value {
                Some(value) => self.command.env(name, value),
                None => self.command.env_remove(name),
            };
        }
        self
    }

    /// Starts the program with a small disk mounted at its data folder, in a separate mount namespace; none if this user
    /// may not mount anything.
    pub fn on_small_disk(mut self, mebibytes: u32) -> Option<Program> {
        if !mounts_small_disks() {
            return None;
        }
        let mut unshare = in_new_mount_namespace();
        let script = format!("mount -t tmpfs -o size={mebibytes}m none \"$0\" && exec \"$@\"");
        unshare
            .args(["sh", "-c", &script])
            .arg(self.data)
            .arg(self.command.get_program())
            .args(self.command.get_args());
        for (name, value) in self.command.get_envs() {
            match value {
                Some(value) => unshare.env(name, value),
                None => unshare.env_remove(name),
            };
        }
        self.command = unshare;
        Some(self.start())
    }

    /// Starts the program and waits until it is ready.
    pub fn start(mut self) -> Program {
        let mut child = self.command.stderr(Stdio::piped()).spawn().expect("the program starts");
        let stderr = BufReader::new(child.stderr.take().expect("a pipe"));
        let log = Arc::new(Mutex::new(String::new()));
        let (sender, ready) = std::sync::mpsc::channel();
        let kept = Arc::clone(&log);
        std::thread::spawn(move || {
            let address = |rest: &str| rest.split(['"', ',', ' ']).next().unwrap_or_default().to_owned();
            let mut probes = String::new();
            for line in stderr.lines().map_while(Result::ok) {
                if let Some((_, rest)) = line.split_once("probes and metrics at ") {
                    probes = address(rest);
                } else if let Some((_, rest)) = line.split_once("listening on ") {
                    let _ = sender.send((address(rest), probes.clone()));
                } else if line.contains("workers ready") {
                    let _ = sender.send((String::new(), probes.clone()));
                }
                let mut log = kept.lock().expect("not poisoned");
                log.push_str(&line);
                log.push('\n');
            }
        });
        let wants_url = self.command.get_args().any(|arg| arg == "serve");
        let (url, probes) = loop {
            match ready.recv_timeout(PATIENCE) {
                Ok((url, _)) if wants_url && url.is_empty() => {}
                Ok(found) => break found,
                Err(_) => panic!("not ready in {}: {}", self.data.display(), log.lock().expect("not poisoned")),
            }
        };
        Program { child, url, probes, log }
    }
}

/// A command that runs another in a new mount namespace.
fn in_new_mount_namespace() -> Command {
    let mut unshare = Command::new("unshare");
    unshare.arg("--mount");
    if !rustix::process::geteuid().is_root() {
        unshare.arg("--map-root-user");
    }
    unshare
}

/// Whether this user may mount a disk; prints a note if not.
pub fn mounts_small_disks() -> bool {
    let mounted = in_new_mount_namespace().args(["mount", "-t", "tmpfs", "none", "/mnt"]).output();
    let mounts = mounted.is_ok_and(|mounted| mounted.status.success());
    if !mounts {
        let _ = writeln!(std::io::stderr(), "SKIPPED: this machine does not let tests mount a small disk");
    }
    mounts
}

impl Program {
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    pub fn log(&self) -> String {
        self.log.lock().expect("not poisoned").clone()
    }

    /// `kill -9`.
    pub fn kill(mut self) {
        self.child.kill().expect("it can be killed");
        self.child.wait().expect("it ended");
    }

    /// SIGTERM.
    pub fn terminate(&self) {
        signal(self.pid(), "TERM");
    }

    /// Waits for the program to end, and returns its exit code.
    pub fn wait(&mut self) -> Option<i32> {
        let started = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().expect("it can be asked") {
                return status.code();
            }
            assert!(started.elapsed() < PATIENCE, "the program does not end: {}", self.log());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// The processes that run one job each, without those that still wait for one.
    pub fn job_children(&self) -> Vec<u32> {
        children(self.pid()).into_iter().filter(|&child| !waits_for_a_job(child)).collect()
    }

    /// The processes that wait for a job.
    pub fn waiting_children(&self) -> Vec<u32> {
        children(self.pid()).into_iter().filter(|&child| waits_for_a_job(child)).collect()
    }

    /// The processes of all running jobs, at any depth.
    pub fn job_processes(&self) -> Vec<u32> {
        self.job_children().into_iter().flat_map(|child| [vec![child], descendants(child)].concat()).collect()
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let _ = writeln!(std::io::stderr(), "log of process {}:\n{}", self.pid(), self.log());
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Sends a signal by process id.
pub fn signal(pid: u32, name: &str) {
    let status = Command::new("kill").arg(format!("-{name}")).arg(pid.to_string()).status().expect("kill runs");
    assert!(status.success(), "kill -{name} {pid}");
}

/// Whether a child process has no task yet: it opens its log when it gets one.
fn waits_for_a_job(child: u32) -> bool {
    let arguments = std::fs::read(format!("/proc/{child}/cmdline")).unwrap_or_default();
    let arguments: Vec<String> =
        arguments.split(|&byte| byte == 0).map(|argument| String::from_utf8_lossy(argument).into_owned()).collect();
    match &arguments[..] {
        // A new process has its parent's command line until it runs the program, and for a moment none. A zombie has none either.
        [_] => is_alive(child),
        [_, verb, ..] if verb == "serve" || verb == "work" => true,
        [_, verb, folder, ..] if verb == "job-child" => {
            // The folder may be in another mount namespace, and the link may not be readable for this user.
            let folders = [folder.clone(), format!("/proc/{child}/cwd")];
            !folders.iter().any(|folder| Path::new(folder).join("log.txt").exists())
        }
        _ => false,
    }
}

/// The direct children of a process.
pub fn children(pid: u32) -> Vec<u32> {
    let tasks = std::fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten();
    tasks
        .filter_map(|task| std::fs::read_to_string(task.path().join("children")).ok())
        .flat_map(|list| list.split_whitespace().filter_map(|id| id.parse().ok()).collect::<Vec<u32>>())
        .collect()
}

/// The processes below one, at any depth.
pub fn descendants(pid: u32) -> Vec<u32> {
    children(pid).into_iter().flat_map(|child| [vec![child], descendants(child)].concat()).collect()
}

/// Whether a process exists and is not a zombie.
pub fn is_alive(pid: u32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    stat.rsplit(") ").next().is_some_and(|rest| !rest.is_empty() && !rest.starts_with(['Z', 'X']))
}

/// Waits until `ready` returns something; `what` says what for in the panic message.
pub async fn until<T>(what: &str, mut ready: impl AsyncFnMut() -> Option<T>) -> T {
    let started = Instant::now();
    loop {
        if let Some(found) = ready().await {
            return found;
        }
        assert!(started.elapsed() < PATIENCE, "waited too long until {what}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// A client of one service.
#[derive(Clone)]
pub struct Api {
    pub url: String,
    pub http: Client,
}

impl Api {
    pub fn new(program: &Program) -> Self {
        meshmend::tls::use_ring();
        Self { url: program.url.clone(), http: Client::new() }
    }

    pub fn get(&self, path: &str) -> RequestBuilder {
        self.http.get(format!("{}{path}", self.url))
    }

    pub fn post(&self, path: &str) -> RequestBuilder {
        self.http.post(format!("{}{path}", self.url))
    }

    pub fn delete(&self, path: &str) -> RequestBuilder {
        self.http.delete(format!("{}{path}", self.url))
    }

    /// Submits a file as a form with options.
    pub async fn try_submit(&self, name: &str, file: Vec<u8>, options: Value) -> Response {
        let part = reqwest::multipart::Part::bytes(file).file_name(name.to_owned());
        let form = reqwest::multipart::Form::new().part("file", part).text("options", options.to_string());
        self.post("/v1/jobs").multipart(form).send().await.expect("a response")
    }

    /// Submits a file, asserts that it is accepted, and returns the job's id.
    pub async fn submit(&self, file: Vec<u8>, options: Value) -> String {
        let answer = self.try_submit("model.stl", file, options).await;
        assert_eq!(answer.status(), 202);
        let job: Value = answer.json().await.expect("a job");
        job["id"].as_str().expect("an id").to_owned()
    }

    /// The job with its report.
    pub async fn job(&self, id: &str) -> Value {
        let answer = self.get(&format!("/v1/jobs/{id}?include=report")).send().await.expect("a response");
        assert_eq!(answer.status(), 200);
        answer.json().await.expect("a job")
    }

    /// Waits until the job has ended.
    pub async fn finished(&self, id: &str) -> Value {
        until("the job has ended", async || {
            let job = self.job(id).await;
            (!job["finished_at"].is_null()).then_some(job)
        })
        .await
    }

    /// Waits until the job's progress is at `stage`, and in `tier` if given.
    pub async fn wait_for_stage(&self, id: &str, stage: &str, tier: Option<u64>) {
        until("the job reaches its stage", async || {
            let progress = self.job(id).await["progress"].clone();
            (progress["stage"] == stage && (tier.is_none() || progress["tier"].as_u64() == tier)).then_some(())
        })
        .await;
    }

    pub async fn artifact(&self, id: &str, name: &str) -> Vec<u8> {
        let answer = self.get(&format!("/v1/jobs/{id}/artifacts/{name}")).send().await.expect("a response");
        assert_eq!(answer.status(), 200, "{name}");
        answer.bytes().await.expect("bytes").to_vec()
    }
}

/// The number of jobs with uploads in the store, including incomplete ones.
pub fn stored_uploads(data: &Path) -> usize {
    let entries = |kind: &str| std::fs::read_dir(data.join("files").join(kind)).into_iter().flatten().flatten();
    let id = |entry: std::fs::DirEntry| entry.file_name().to_string_lossy().split('#').next().map(str::to_owned);
    entries("uploads").chain(entries("more")).filter_map(id).collect::<std::collections::BTreeSet<_>>().len()
}

/// The stored files of a job: its uploads and the files of its attempts.
pub fn stored_files(data: &Path, id: &str) -> Vec<PathBuf> {
    let files = data.join("files");
    let upload = Some(files.join("uploads").join(id)).filter(|upload| upload.exists());
    let folders = ["jobs", "more"].into_iter().flat_map(|kind| files_below(&files.join(kind).join(id)));
    let found = folders.chain(upload).map(|path| path.strip_prefix(&files).expect("inside").to_owned());
    let mut found: Vec<_> = found.collect();
    found.sort();
    found
}

/// All files in a folder and its subfolders.
pub fn files_below(folder: &Path) -> Vec<PathBuf> {
    let paths = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    paths.flat_map(|path| if path.is_dir() { files_below(&path) } else { vec![path] }).collect()
}

/// Makes a folder and its contents so old that a sweep deletes the files that no job owns.
pub fn make_old(path: &Path) {
    for entry in std::fs::read_dir(path).into_iter().flatten().flatten() {
        make_old(&entry.path());
    }
    std::fs::File::open(path).and_then(|file| file.set_modified(std::time::SystemTime::UNIX_EPOCH)).expect("a time");
}
