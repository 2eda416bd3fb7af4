//! Analysis of several files in one report.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use glam::DVec3;
use meshmend::analyze::{self, AnalysisReport, Analyst, AnalyzeError, AnalyzeOptions};
use meshmend::context::{Context, NoProgress, Progress, Stage};
use meshmend::format::{self, Format, Limits};
use meshmend::inspect::{InspectOptions, Level, inspect};

use crate::meshes::{cube, join, sphere};

fn analyse(
    files: &[(&str, Vec<u8>)],
    options: &AnalyzeOptions,
    progress: &dyn Progress,
) -> Result<AnalysisReport, AnalyzeError> {
    let cancel = AtomicBool::new(false);
    let clock = || Duration::ZERO;
    let context = Context::new(progress, &cancel, &clock, Duration::from_secs(600));
    let limits = Limits::default();
    let mut analyst = Analyst::new(options, &limits, files.len(), &context)?;
    for (name, bytes) in files {
        analyst.add(name, None, bytes)?;
    }
    analyst.finish()
}

/// A box and an open ball, in two formats.
fn two_files() -> [(&'static str, Vec<u8>); 2] {
    let mut open = sphere(DVec3::ZERO, 1.0, 12, 8);
    open.faces.drain(20..24);
    let whole = format::write(&cube(DVec3::ZERO, 1.0, 2), Format::Stl).unwrap();
    [("box.stl", whole), ("ball.off", format::write(&open, Format::Off).unwrap())]
}

#[test]
fn files_are_reported_in_order_and_all_must_be_printable() {
    let files = two_files();
    let report = analyse(&files, &AnalyzeOptions::default(), &NoProgress).unwrap();
    assert_eq!(report.printable, Some(false));
    let summaries: Vec<_> = report.files.iter().map(|file| (file.name.as_str(), file.format, file.printable)).collect();
    assert_eq!(summaries, [("box.stl", Format::Stl, Some(true)), ("ball.off", Format::Off, Some(false))]);
    let alone = analyse(&files[..1], &AnalyzeOptions::default(), &NoProgress).unwrap();
    assert_eq!(alone.printable, Some(true));
    for (file, (_, bytes)) in report.files.iter().zip(&files) {
        let read = format::read(bytes, &Limits::default()).unwrap();
        let subject = analyze::subject(&read, None);
        let cancel = AtomicBool::new(false);
        let clock = || Duration::ZERO;
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(600));
        let (seen, _) = inspect(subject, &InspectOptions::default(), &context).unwrap();
        assert_eq!((&file.inspection, file.bytes), (&seen, bytes.len() as u64));
    }
}

#[test]
fn the_options_reach_the_inspection_and_are_checked() {
    let inspect = InspectOptions { level: Level::None, ..InspectOptions::default() };
    let options = AnalyzeOptions { inspect, ..AnalyzeOptions::default() };
    let report = analyse(&two_files(), &options, &NoProgress).unwrap();
    assert!(report.files.iter().all(|file| file.inspection.level == Level::None));
    assert_eq!(report.options, options);
    let options = AnalyzeOptions { deadline_s: f64::NAN, ..options };
    let error = analyse(&two_files(), &options, &NoProgress).unwrap_err();
    assert!(matches!(error, AnalyzeError::Options(error) if error.option == "deadline_s"));
}

#[test]
fn a_file_that_can_not_be_read_is_named_where_there_are_several() {
    let [whole, _] = two_files();
    let bad = ("bad.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n".to_vec());
    let error = analyse(&[whole, bad.clone()], &AnalyzeOptions::default(), &NoProgress).unwrap_err();
    assert!(error.to_string().starts_with("file 2 of 2, 'bad.off': "), "{error}");
    assert!(matches!(error, AnalyzeError::Read { index: 1, of: 2, error, .. } if error.place.is_some()));
    let error = analyse(&[bad], &AnalyzeOptions::default(), &NoProgress).unwrap_err();
    assert!(!error.to_string().contains("file 1"), "{error}");
}

#[test]
fn omitted_faces_give_a_warning() {
    let text = "OFF\n4 2 0\n0 0 0\n1 0 0\n0 1 0\nnan 0 0\n3 0 1 2\n3 0 1 3\n";
    let report = analyse(&[("a.off", text.into())], &AnalyzeOptions::default(), &NoProgress).unwrap();
    let file = &report.files[0];
    assert!(file.warnings.iter().any(|warning| warning.starts_with("1 face with a corner that is not")), "{file:?}");
}

#[derive(Default)]
struct Recorder(Mutex<Vec<(Stage, u8)>>);

impl Progress for Recorder {
    fn report(&self, stage: Stage, _: Option<u8>, percent: u8) {
        self.0.lock().unwrap().push((stage, percent));
    }

    fn log(&self, _: &str) {}
}

#[test]
fn progress_goes_from_file_to_file_and_never_falls() {
    let heard = Recorder::default();
    analyse(&two_files(), &AnalyzeOptions::default(), &heard).unwrap();
    let heard = heard.0.into_inner().unwrap();
    let stages: Vec<Stage> = heard.iter().map(|(stage, _)| *stage).collect();
    assert_eq!(stages, [Stage::Read, Stage::Inspect, Stage::Read, Stage::Inspect, Stage::Finish]);
    let percents: Vec<u8> = heard.iter().map(|(_, percent)| *percent).collect();
    assert!(percents.is_sorted() && percents[0] == 0 && percents[2] == 50 && percents[4] == 100, "{percents:?}");
}

#[test]
fn an_analysis_stops_at_its_deadline() {
    let cancel = AtomicBool::new(false);
    let now = AtomicU64::new(0);
    let clock = || Duration::from_secs(now.fetch_add(1, Ordering::Relaxed) + 1);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
    let options = AnalyzeOptions { deadline_s: 1.0, ..AnalyzeOptions::default() };
    let limits = Limits::default();
    let mut analyst = Analyst::new(&options, &limits, 1, &context).unwrap();
    let soup = join(&cube(DVec3::ZERO, 1.0, 4), &cube(DVec3::splat(3.0), 1.0, 4));
    let ended = analyst.add("a.stl", None, &format::write(&soup, Format::Stl).unwrap());
    assert!(matches!(ended, Err(AnalyzeError::Cancelled(_))), "{ended:?}");
}
