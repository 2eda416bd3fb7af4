//! A temporary PostgreSQL cluster for one test, created with the distribution's server binaries.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use tempfile::TempDir;

/// The user that runs the server if the tests run as root, which PostgreSQL refuses.
const NOBODY: &str = "65534";

/// A running server with a Unix socket in its own folder.
pub struct Postgres {
    folder: TempDir,
    /// The server's main process.
    pub server: Child,
    synced: bool,
}

impl Postgres {
    /// Creates a cluster and starts its server without fsync.
    pub fn start() -> Self {
        Self::start_with(false)
    }

    /// Creates a cluster and starts its server; if `synced`, with fsync as in production.
    pub fn start_with(synced: bool) -> Self {
        let folder = tempfile::Builder::new().prefix("meshmend-pg-").tempdir().expect("a folder");
        if is_root() {
            let given = Command::new("chown").arg(NOBODY).arg(folder.path()).status().expect("chown");
            assert!(given.success());
        }
        let created = as_server(&binary("initdb"))
            .args(["--no-sync", "--auth=trust", "--username=meshmend", "--encoding=UTF8", "--locale=C", "-D"])
            .arg(folder.path().join("data"))
            .current_dir(folder.path())
            .stdout(Stdio::null())
            .output()
            .expect("initdb");
        assert!(created.status.success(), "initdb: {}", String::from_utf8_lossy(&created.stderr));
        let server = launch(folder.path(), synced);
        let cluster = Self { folder, server, synced };
        cluster.wait_until_ready();
        cluster
    }

    /// The URL of the database.
    pub fn url(&self) -> String {
        Self::url_at(self.folder())
    }

    /// The URL of the database through a socket in another folder.
    pub fn url_at(folder: &Path) -> String {
        format!("postgres://meshmend@localhost/postgres?host={}", folder.display())
    }

    /// The folder of the socket.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Kills the server with all of its connections.
    pub fn kill(&mut self) {
        self.server.kill().expect("a running server");
        self.server.wait().expect("an end");
        // A new server may start only after the old one's processes have ended.
        let deadline = Instant::now() + Duration::from_secs(20);
        while self.serves_anybody() {
            assert!(Instant::now() < deadline, "the killed server's processes did not end");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Starts the server again.
    pub fn restart(&mut self) {
        let _ = std::fs::remove_file(self.folder.path().join("data/postmaster.pid"));
        self.server = launch(self.folder.path(), self.synced);
        self.wait_until_ready();
    }

    fn serves_anybody(&self) -> bool {
        let data = self.folder.path().join("data");
        let ours =
            |process: &std::fs::DirEntry| std::fs::read_link(process.path().join("cwd")).is_ok_and(|cwd| cwd == data);
        std::fs::read_dir("/proc").expect("/proc").flatten().any(|process| ours(&process))
    }

    fn wait_until_ready(&self) {
        let deadline = Instant::now() + Duration::from_secs(30);
        let mut ask = Command::new(binary("pg_isready"));
        ask.args(["-q", "-U", "meshmend", "-h"]).arg(self.folder.path());
        let mut ready = || ask.status().expect("pg_isready").success();
        while !ready() {
            assert!(Instant::now() < deadline, "the server did not start");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Postgres {
    fn drop(&mut self) {
        // Immediate shutdown.
        let _ = Command::new("kill").args(["-QUIT", &self.server.id().to_string()]).status();
        let _ = self.server.wait();
    }
}

fn launch(folder: &Path, synced: bool) -> Child {
    as_server(&binary("postgres"))
        .arg("-D")
        .arg(folder.join("data"))
        .args(["-c", "listen_addresses=", "-c", "max_connections=60"])
        .args(["-c", if synced { "fsync=on" } else { "fsync=off" }, "-c"])
        .arg(format!("unix_socket_directories={}", folder.display()))
        .current_dir(folder)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("postgres")
}

/// A command that ends with this process and does not run as root.
fn as_server(program: &Path) -> Command {
    let mut command = Command::new("setpriv");
    command.args(["--pdeathsig", "QUIT"]);
    if is_root() {
        command.args(["--reuid", NOBODY, "--regid", NOBODY, "--clear-groups"]);
    }
    command.arg("--").arg(program);
    command
}

fn is_root() -> bool {
    rustix::process::geteuid().is_root()
}

/// The path of a server binary: of the distribution's newest version, or the one on PATH.
fn binary(name: &str) -> PathBuf {
    let versions = std::fs::read_dir("/usr/lib/postgresql").into_iter().flatten().flatten();
    let version = |path: &Path| path.file_name().and_then(|name| name.to_str()?.parse::<u32>().ok()).unwrap_or(0);
    let newest = versions.map(|entry| entry.path()).max_by_key(|path| version(path));
    let found = newest.map(|path| path.join("bin").join(name)).filter(|path| path.is_file());
    found.unwrap_or_else(|| PathBuf::from(name))
}
