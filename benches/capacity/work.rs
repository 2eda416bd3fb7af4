//! What jobs with models of several sizes cost a worker, and the files that they leave.

use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use meshmend::context::{Context, NoProgress, monotonic_clock};
use meshmend::format::Limits;
use meshmend::jobs::JobReport;
use meshmend::repair::{Options, repair};

use crate::LOG;
use crate::drive::drive;
use crate::memory::{Watch, peak_mib};
use crate::models::Model;
use crate::requests::service;
use crate::server::{Start, files_below};

/// The models, and how many jobs each has.
const MODELS: [(Model, usize); 4] =
    [(Model::Box, 60), (Model::Ball(1000), 40), (Model::Ball(10_000), 16), (Model::Ball(100_000), 4)];

/// Repairs each model in a service with one worker, and prints what its jobs cost.
pub async fn print(data: &Path) {
    println!(
        "\n{:24} {:>5} {:>9} {:>12} {:>9} {:>9} {:>9} {:>9} {:>9}",
        "one worker, SQLite", "jobs", "per s", "CPU ms/job", "MiB peak", "KiB sent", "KiB model", "KiB more", "files"
    );
    for (number, (model, jobs)) in MODELS.into_iter().enumerate() {
        let folder = data.join(format!("work-{number}"));
        let program = Start::serve(&folder).arg("--log", LOG).arg("--workers", "1").start();
        // The program is loaded, and its files are in memory.
        drive(&service(&program), model, 0..1, 1).await;
        let watch = Watch::start(program.pid());
        let figures = drive(&service(&program), model, 1..jobs + 1, 2).await;
        let peak = watch.end();
        let files = files_below(&folder.join("files"));
        let bytes: u64 = files.iter().map(|file| file.metadata().expect("a file").len()).sum();
        let share = |total: f64| total / (jobs + 1) as f64;
        let (sent, result) = (model.bytes(1).len() as f64 / 1024.0, figures.result.len() as f64 / 1024.0);
        println!(
            "{:24} {jobs:5} {:9.2} {:12.0} {peak:9.0} {sent:9.0} {result:9.0} {:9.0} {:9.1}",
            model.name(),
            figures.per_second(),
            figures.cpu_per_job(),
            share(bytes as f64) / 1024.0 - sent - result,
            share(files.len() as f64)
        );
        println!("{:24} {:.0} MiB", "  the serving process", peak_mib(program.pid()));
    }
}

/// The report of the smallest repair.
pub fn box_report() -> JobReport {
    let (cancel, clock) = (AtomicBool::new(false), monotonic_clock());
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(60));
    let repaired = repair(&Model::Box.bytes(0), &Options::default(), &Limits::default(), None, &context);
    JobReport::Repair(Box::new(repaired.expect("a result").report))
}
