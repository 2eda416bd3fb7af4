use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;

use super::usage::Excess;
use crate::jobs::{FailureKind, JobProblem, ProblemKind};

/// What is said where memory ends: by the allocator, by a read into memory, by the operating system of a mapping and of a
/// thread's stack.
const OUT_OF_MEMORY: [&str; 4] =
    ["memory allocation of", "out of memory", "Cannot allocate memory", "Resource temporarily unavailable"];

/// What is said where a disk is full.
const OUT_OF_ROOM: [&str; 2] = ["No space left on device", "Disk quota exceeded"];

/// Why a job's process ended without a result and without saying so in its own words: by its exit status and what it
/// wrote to standard error. A limit would be met again, so that is final; anything else may be tried again.
pub(super) fn explain(status: ExitStatus, stderr: &str, memory_bytes: u64) -> (FailureKind, JobProblem) {
    const SIGXCPU: i32 = 24;
    const SIGXFSZ: i32 = 25;
    let megabytes = memory_bytes >> 20;
    let (kind, code, detail) = if OUT_OF_MEMORY.iter().any(|words| stderr.contains(words)) {
        let detail = format!(
            "The job needs more than the {megabytes} MiB of memory that a job may have. Send the model with \
             fewer faces, or raise the service's --job-memory."
        );
        (FailureKind::Final, ProblemKind::OutOfMemory, detail)
    } else if status.signal() == Some(SIGXCPU) {
        let detail = "The job used more processor time than a job may have. Send it with fewer faces, or a smaller max_tier \
                      or level.";
        (FailureKind::Final, ProblemKind::CpuLimit, detail.to_owned())
    } else if status.signal() == Some(SIGXFSZ) {
        let detail = "The job wrote a larger file than a job may write. Ask for a coarser result, such as a \
                      smaller voxel_resolution.";
        (FailureKind::Final, ProblemKind::FileLimit, detail.to_owned())
    } else if OUT_OF_ROOM.iter().any(|words| stderr.contains(words)) {
        let detail =
            "The disk that jobs are done on is full. The operator has to make room; send the model again then.";
        (FailureKind::Passing, ProblemKind::Internal, detail.to_owned())
    } else {
        let detail = format!(
            "The job's process ended by itself ({status}). This is a fault of the service, not of the model: \
             please report it with the job's log."
        );
        (FailureKind::Crash, ProblemKind::Crashed, detail)
    };
    (kind, JobProblem { code, detail, place: None, file: None })
}

/// Why a job was killed that took too much of what is counted for all its processes together.
pub(super) fn too_much(excess: Excess, scratch_bytes: u64, processes: u64) -> JobProblem {
    let (code, detail) = match excess {
        Excess::Scratch => (
            ProblemKind::FileLimit,
            format!(
                "The job's files took more than the {} MiB of disk that a job may have. Ask for a coarser result, such as a \
                 smaller voxel_resolution, or raise the service's --job-scratch-mib.",
                scratch_bytes >> 20
            ),
        ),
        Excess::Processes => (
            ProblemKind::Crashed,
            format!(
                "The job started more than the {processes} processes that a job may have, and was stopped. This is a fault \
                 of the service, not of the model: please report it with the job's log, or raise the service's --job-processes."
            ),
        ),
    };
    JobProblem { code, detail, place: None, file: None }
}
