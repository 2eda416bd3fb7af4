//! The service under benches/peers: FastAPI and pymeshfix, as such services are usually written.

use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::drive::Service;

/// A running peer; gone when dropped.
pub struct Peer {
    server: Child,
    port: u16,
}

impl Peer {
    /// Starts it with this Python, to repair in so many processes, or in its own threads where that is 0; with a time limit in so many
    /// at once, one for each job.
    pub fn start(python: &str, processes: usize, limit: Option<Duration>) -> Self {
        let port = TcpListener::bind(("127.0.0.1", 0)).and_then(|it| it.local_addr()).expect("a free port").port();
        let server = Command::new("setpriv")
            .args([
                "--pdeathsig",
                "TERM",
                "--",
                python,
                "-m",
                "uvicorn",
                "service:app",
                "--log-level",
                "warning",
                "--port",
            ])
            .arg(port.to_string())
            .env("REPAIR_PROCESSES", processes.to_string())
            .env("REPAIR_TIMEOUT_S", limit.unwrap_or_default().as_secs().to_string())
            .current_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/peers"))
            // pymeshfix says of every file that it could not fix everything.
            .stderr(Stdio::null())
            .spawn()
            .expect("MESHMEND_PEER_PYTHON is a Python");
        let mut peer = Self { server, port };
        let deadline = Instant::now() + Duration::from_secs(30);
        while std::net::TcpStream::connect(("127.0.0.1", port)).is_err() {
            let ended = peer.server.try_wait().expect("it can be asked");
            assert!(
                ended.is_none() && Instant::now() < deadline,
                "the peer did not start: see benches/peers/README.md"
            );
            std::thread::sleep(Duration::from_millis(50));
        }
        peer
    }

    pub fn service(&self, name: String) -> Service {
        Service {
            name,
            jobs: format!("http://127.0.0.1:{}/jobs", self.port),
            result: "result",
            options: None,
            processes: vec![self.server.id()],
        }
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // So that it ends its processes and removes its files.
        let _ = Command::new("kill").arg(self.server.id().to_string()).status();
        let _ = self.server.wait();
    }
}
