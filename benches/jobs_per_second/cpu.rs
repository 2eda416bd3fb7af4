//! CPU time of processes, which other work on the machine changes less than it changes elapsed time.

use std::time::Duration;

use crate::server::children;

/// Clock ticks a second: the unit in which Linux reports CPU time (`man 5 proc`), the same on all supported machines.
const TICKS: u32 = 100;

/// What these processes took until now, with all that they started: those still there and those that have ended.
pub fn used(processes: &[u32]) -> Duration {
    processes.iter().map(|&process| own(process) + used(&children(process))).sum()
}

/// Time of a process and of its children that it has waited for: user and system of each.
fn own(process: u32) -> Duration {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    let fields = stat.rsplit(") ").next().unwrap_or_default().split(' ').skip(11).take(4);
    Duration::from_secs(fields.filter_map(|ticks| ticks.parse::<u64>().ok()).sum()) / TICKS
}
