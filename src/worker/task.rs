use serde::{Deserialize, Serialize};

use super::ProcessLimits;
use crate::blender::BlenderConfig;
use crate::format::Limits;
use crate::jobs::{Input, JobOptions, JobProgress};
use crate::repair::{HandedOut, RemesherInfo};
use crate::sandbox::Sandbox;

/// What a worker tells its child process: a line of JSON on its standard input. That is then a lifeline: when it closes, the worker is
/// gone, and the child ends its process group.
///
/// The [`input`](Self::input) files lie in the scratch folder. The child leaves its files there too: [`MODEL`](Self::MODEL) where there is one, then
/// [`FULL_REPORT`](Self::FULL_REPORT), which says that the work is done; [`LOG`](Self::LOG), and [`PROBLEM`](Self::PROBLEM) where
/// the input is to blame. Where pictures are all that it is to make, [`MODEL`](Self::MODEL) lies there too, and it leaves nothing but them. On standard output it writes one [`JobProgress`] a line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Task {
    pub inputs: Vec<Input>,
    pub options: JobOptions,
    /// Where the job was done before and its pictures are to be drawn: the file that it handed out.
    pub draw: Option<HandedOut>,
    pub limits: Limits,
    pub confinement: Confinement,
    pub remesher: Option<RemesherInfo>,
    pub blender: BlenderConfig,
}

/// What holds a process that a worker starts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Confinement {
    pub limits: ProcessLimits,
    pub sandbox: Sandbox,
}

/// A line of the child's standard output.
pub(super) type ProgressLine = JobProgress;

impl Task {
    pub const MODEL: &str = "model";
    /// The upload as it came, where nothing made it better.
    pub const ORIGINAL: &str = "original";
    /// The whole report, as the child leaves it.
    pub const FULL_REPORT: &str = "report-full.json";
    /// The abridged report, which the worker makes of the whole one.
    pub const REPORT: &str = "report.json";
    pub const LOG: &str = "log.txt";
    pub const PROBLEM: &str = "problem.json";

    /// The child's exit code for a problem with the input, described in [`PROBLEM`](Self::PROBLEM).
    pub const EXIT_PROBLEM: u8 = 2;

    /// Most bytes of a report.
    pub const REPORT_BYTES: usize = 16 << 20;

    /// The name of an uploaded file in the folder.
    pub fn input(number: usize) -> String {
        format!("input-{number}")
    }
}
