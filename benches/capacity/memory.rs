//! Memory of processes, from `/proc` (`man 5 proc`).

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::server::descendants;

/// The most memory that a process has had, in MiB; 0 after its end.
pub fn peak_mib(process: u32) -> f64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok()).unwrap_or(0.0) / 1024.0
}

/// Watches the processes that a program starts.
pub struct Watch {
    ends: Arc<AtomicBool>,
    thread: JoinHandle<f64>,
}

impl Watch {
    pub fn start(program: u32) -> Self {
        let ends = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&ends);
        let thread = std::thread::spawn(move || {
            let mut peak = 0.0_f64;
            while !flag.load(Ordering::Relaxed) {
                peak = descendants(program).into_iter().map(peak_mib).fold(peak, f64::max);
                std::thread::sleep(Duration::from_millis(10));
            }
            peak
        });
        Self { ends, thread }
    }

    /// The most memory that one of the processes has had, in MiB.
    pub fn end(self) -> f64 {
        self.ends.store(true, Ordering::Relaxed);
        self.thread.join().expect("no panic")
    }
}
