//! `meshmend submit` and `meshmend watch`: submit jobs to a service and follow them.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use clap::{Args, ValueEnum};
use futures::StreamExt;
use futures::stream::FuturesUnordered;
use meshmend::jobs::{JobId, Mode, Status};
use meshmend::repair::{Options, OutputFormat};
use serde_json::{Map, Value, json};
use tokio::time::Instant;
use uuid::Uuid;

use super::exit;
use super::remote::{DisplayArgs, Downloads, RemoteError, RemoteJob, Row, ServiceArgs, Session, Submission, Target};
use super::repair::{RepairOptionArgs, format_from_extension};

/// Files that are submitted and followed at the same time.
const MAX_CONCURRENT_FILES: usize = 4;

/// Arguments of `meshmend submit`.
#[derive(Debug, Args)]
pub struct SubmitArgs {
    /// The models. Each becomes a separate job.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    #[command(flatten)]
    service: ServiceArgs,
    /// File for the result of a single model; its extension (.stl, .obj, .ply, .off, .mesh, .glb, .3mf, .zip) sets
    /// the format. For an analysis, the file for the report.
    #[arg(short, long, env = "MESHMEND_OUTPUT", value_name = "FILE", conflicts_with_all = ["output_dir", "output_format"])]
    output: Option<PathBuf>,
    /// Folder for the results, named by the service, such as part-repaired.stl. A missing folder is created. Default
    /// without --output: the current folder.
    #[arg(long, env = "MESHMEND_OUTPUT_DIR", value_name = "FOLDER")]
    output_dir: Option<PathBuf>,
    /// Format of the results: auto, stl, obj, ply, off, mesh, 3mf, glb, zip or same.
    #[arg(long, env = "MESHMEND_OUTPUT_FORMAT", value_name = "FORMAT", value_parser = parse_output_format)]
    output_format: Option<OutputFormat>,
    /// File for the report of a single model, as JSON.
    #[arg(long, env = "MESHMEND_REPORT", value_name = "FILE")]
    report: Option<PathBuf>,
    /// Folder for pictures of the defects and the changes. A missing folder is created. Default: no pictures are
    /// downloaded.
    #[arg(long, env = "MESHMEND_PICTURES", value_name = "FOLDER")]
    pictures: Option<PathBuf>,
    /// What to do with the models.
    #[arg(long, env = "MESHMEND_MODE", value_enum, default_value_t)]
    mode: Task,
    /// An option with its API name, such as level=full for an analysis; overrides the flags below. May be
    /// repeated.
    #[arg(long = "option", env = "MESHMEND_OPTION", value_name = "NAME=VALUE", value_delimiter = ';', value_parser = parse_option)]
    options: Vec<(String, Value)>,
    /// Print the ids of the submitted jobs and exit without waiting for the jobs.
    #[arg(long, env = "MESHMEND_NO_WAIT", conflicts_with_all = ["output", "output_dir", "report", "pictures"])]
    no_wait: bool,
    #[command(flatten)]
    display: DisplayArgs,
    #[command(flatten, next_help_heading = "Repair options")]
    repair: RepairOptionArgs,
}

/// What the service does with a model.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum Task {
    /// Repair the model.
    #[default]
    Repair,
    /// List its defects and change nothing.
    Analyze,
}

impl Task {
    fn mode(self) -> Mode {
        match self {
            Self::Repair => Mode::Repair,
            Self::Analyze => Mode::Analyze,
        }
    }
}

/// Parses `--output-format`.
fn parse_output_format(text: &str) -> Result<OutputFormat, String> {
    serde_json::from_value(json!(text))
        .map_err(|_| "the format must be auto, stl, obj, ply, off, mesh, 3mf, glb, zip or same".to_owned())
}

/// Parses `--option`.
fn parse_option(text: &str) -> Result<(String, Value), String> {
    let (name, value) = text.split_once('=').ok_or("expected NAME=VALUE, such as level=full")?;
    let value = serde_json::from_str(value).unwrap_or_else(|_| json!(value));
    Ok((name.trim().replace('-', "_"), value))
}

/// Runs `meshmend submit`.
pub fn submit(args: &SubmitArgs) -> ExitCode {
    let prepared = args.prepare().and_then(|prepared| Ok((prepared, args.service.open()?)));
    let ((options, downloads), service) = match prepared {
        Ok(prepared) => prepared,
        Err(error) => return exit::fail(error.code(), error),
    };
    let session = Session::new(service, &args.display, downloads);
    session.run(submit_all(args, &session, &options))
}

impl SubmitArgs {
    /// The options for the service, and the files to download. Checks all that can be checked before any upload.
    fn prepare(&self) -> Result<(Vec<(String, String)>, Downloads), RemoteError> {
        let options = self.fields().map_err(RemoteError::Local)?;
        let several = self.files.len() > 1;
        let for_one = |flag: &str, path: &Option<PathBuf>| match path {
            Some(_) if several => Err(RemoteError::Local(format!(
                "{flag} works only with a single file; for several files, use --output-dir"
            ))),
            path => Ok(path.clone().map(Target::File)),
        };
        let mut downloads = Downloads { pictures: self.pictures.clone(), ..Downloads::default() };
        if self.no_wait {
            return Ok((options, downloads));
        }
        let folder = self.output_dir.clone().unwrap_or_default();
        let result = for_one("--output", &self.output)?.unwrap_or(Target::Folder(folder));
        if matches!(result, Target::Folder(_)) {
            self.check_names_differ()?;
        }
        downloads.report = for_one("--report", &self.report)?;
        downloads.result = Some(result);
        let pictures = self.pictures.clone().map(Target::Folder);
        for target in [&downloads.result, &downloads.report, &pictures].into_iter().flatten() {
            target.check(self.display.force)?;
        }
        Ok((options, downloads))
    }

    /// Checks that no two results would have the same name.
    fn check_names_differ(&self) -> Result<(), RemoteError> {
        let mut stems: BTreeMap<Option<&OsStr>, &Path> = BTreeMap::new();
        for file in &self.files {
            if let Some(other) = stems.insert(file.file_stem(), file) {
                let (file, other) = (file.display(), other.display());
                return Err(RemoteError::Local(format!(
                    "the results of {other} and {file} would have the same name; submit these files separately"
                )));
            }
        }
        Ok(())
    }

    /// Mode and options as query fields. Options with their default value are omitted, so that the service applies
    /// its own default.
    fn fields(&self) -> Result<Vec<(String, String)>, String> {
        let output = match (&self.output, self.output_format) {
            (Some(output), _) if self.mode == Task::Repair => format_from_extension(output)?,
            (_, format) => format.unwrap_or_default(),
        };
        let options = self.repair.service_options(output)?;
        let fields = |options: &Options| match serde_json::to_value(options) {
            Ok(Value::Object(fields)) => fields,
            _ => Map::new(),
        };
        let defaults = fields(&Options::default());
        let mut fields = fields(&options);
        fields.retain(|name, value| defaults.get(name) != Some(value));
        fields.insert("mode".to_owned(), json!(self.mode.mode()));
        fields.extend(self.options.iter().cloned());
        let text = |value: Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        Ok(fields.into_iter().map(|(name, value)| (name, text(value))).collect())
    }
}

/// Submits all files, a few at a time, and returns the highest exit code.
async fn submit_all(args: &SubmitArgs, session: &Session<'_>, options: &[(String, String)]) -> u8 {
    let row = session.console.row(session.service.address());
    row.show_waiting("asking for limits");
    let max_bytes = match session
        .service
        .retry_with_backoff(|e, delay| row.show_retry(e, delay), async || session.service.max_bytes().await)
        .await
    {
        Ok(max_bytes) => max_bytes,
        Err(error) => {
            drop(row);
            session.console.print_note(&format!("meshmend: {error}"));
            return error.code();
        }
    };
    drop(row);
    let jobs = args.files.iter().map(|path| async move {
        let name = path.display().to_string();
        let row = session.console.row(&name);
        match send(session, path, options, max_bytes, &row).await {
            Ok(job) if args.no_wait => session.print_submitted(&name, &job),
            Ok(job) => session.follow_to_end(&row, &name, job.id).await,
            Err(error) => session.failed(&row, &name, None, &error),
        }
    });
    futures::stream::iter(jobs)
        .buffer_unordered(MAX_CONCURRENT_FILES)
        .fold(exit::PRINTABLE, async |worst, code| worst.max(code))
        .await
}

/// Submits a file as one job. Retries reuse the idempotency key, so there is never a second job.
async fn send(
    session: &Session<'_>,
    path: &Path,
    options: &[(String, String)],
    max_bytes: u64,
    row: &Row,
) -> Result<RemoteJob, RemoteError> {
    let metadata = std::fs::metadata(path).map_err(|error| RemoteError::Local(error.to_string()))?;
    if !metadata.is_file() {
        return Err(RemoteError::Local("not a regular file".to_owned()));
    }
    if metadata.len() > max_bytes {
        return Err(RemoteError::Local(format!(
            "the file is larger than {} MiB, the limit of the service",
            max_bytes >> 20
        )));
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let key = Uuid::new_v4().to_string();
    let submission = Submission { path, name: &name, options, key: &key };
    let on_retry = |error: &RemoteError, delay| row.show_retry(error, delay);
    let job = session
        .service
        .retry_with_backoff(on_retry, async || {
            row.start_transfer("sending", metadata.len());
            session.service.submit(&submission, row.meter()).await
        })
        .await?;
    session.mark_open(job.id);
    row.line(&format!("submitted as {}", job.id));
    Ok(job)
}

/// Jobs that are followed at the same time.
const MAX_FOLLOWED: usize = 16;
/// Interval of checking for new jobs.
const POLL_INTERVAL: Duration = Duration::from_secs(2);

/// Arguments of `meshmend watch`.
#[derive(Debug, Args)]
pub struct WatchArgs {
    /// Ids of the jobs, as printed by `submit`. Default: all running, queued and new jobs, until interrupted.
    jobs: Vec<JobId>,
    #[command(flatten)]
    service: ServiceArgs,
    /// Folder for the results, named by the service. A missing folder is created. Default: nothing is downloaded.
    #[arg(long, env = "MESHMEND_DOWNLOAD", value_name = "FOLDER")]
    download: Option<PathBuf>,
    #[command(flatten)]
    display: DisplayArgs,
}

/// Runs `meshmend watch`.
pub fn watch(args: &WatchArgs) -> ExitCode {
    let result = args.download.clone().map(Target::Folder);
    let checked = result.as_ref().map_or(Ok(()), |target| target.check(args.display.force));
    let service = match checked.and_then(|()| args.service.open()) {
        Ok(service) => service,
        Err(error) => return exit::fail(error.code(), error),
    };
    let session = Session::new(service, &args.display, Downloads { result, ..Downloads::default() });
    if args.jobs.is_empty() {
        return session.run(watch_all(&session));
    }
    let jobs = args.jobs.iter().map(|id| watch_job(&session, id.to_string(), *id));
    let codes = futures::stream::iter(jobs).buffer_unordered(MAX_FOLLOWED);
    session.run(codes.fold(exit::PRINTABLE, async |worst, code| worst.max(code)))
}

async fn watch_job(session: &Session<'_>, name: String, id: JobId) -> u8 {
    let row = session.console.row(&name);
    session.follow_to_end(&row, &name, id).await
}

/// Follows running and queued jobs, oldest first, until the service stays unreachable.
async fn watch_all(session: &Session<'_>) -> u8 {
    let (mut seen, mut followed) = (BTreeSet::new(), FuturesUnordered::new());
    let row = session.console.row(session.service.address());
    loop {
        row.show_waiting("looking for jobs");
        let list =
            async || Ok([session.service.jobs(Status::Running).await?, session.service.jobs(Status::Queued).await?]);
        let pages = match session.service.retry_with_backoff(|error, delay| row.show_retry(error, delay), list).await {
            Ok(pages) => pages,
            Err(error) => {
                session.console.print_note(&format!("meshmend: {error}"));
                return error.code();
            }
        };
        for job in pages.iter().flat_map(|jobs| jobs.iter().rev()) {
            if followed.len() < MAX_FOLLOWED && seen.insert(job.id) {
                followed.push(watch_job(session, format!("{} {}", job.id, job.input.name), job.id));
            }
        }
        let next_poll = Instant::now() + POLL_INTERVAL;
        while let Ok(ended) = tokio::time::timeout_at(next_poll, followed.next()).await {
            if ended.is_none() {
                tokio::time::sleep_until(next_poll).await;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        args: SubmitArgs,
    }

    fn fields(line: &str) -> Result<String, String> {
        let words = std::iter::once("submit").chain(line.split_whitespace());
        let fields = Line::try_parse_from(words).map_err(|error| error.to_string())?.args.fields()?;
        Ok(fields.into_iter().map(|(name, value)| format!("{name}={value}")).collect::<Vec<_>>().join("&"))
    }

    #[test]
    fn only_options_that_differ_from_their_default_are_sent_by_their_api_names() {
        for (line, expected) in [
            ("a.stl", "mode=repair"),
            ("a.stl --max-tier 3 --pictures seen", "mode=repair"),
            ("a.stl -o out.3MF --scale-to in", "mode=repair&output=3mf&scale_to=in"),
            ("a.stl --output-format same", "mode=repair&output=same"),
            ("a.stl --without sew,stitch", "mode=repair&without=[\"sew\",\"stitch\"]"),
            ("a.stl --max-tier 1 --option max-tier=2;winding_rule=odd", "max_tier=2&mode=repair&winding_rule=odd"),
            ("a.stl --mode analyze -o r.json --option level=basic", "level=basic&mode=analyze"),
            ("a.stl --process our-sls --min-wall 1.5", "min_wall=1.5&mode=repair&process=our-sls"),
            ("a.stl --mode analyze --process tpu", "mode=analyze&process=tpu"),
        ] {
            assert_eq!(fields(line).as_deref(), Ok(expected), "{line}");
        }
        for (line, words) in [
            ("a.stl -o out", "must end in"),
            ("a.stl --deadline-s 0", "deadline_s"),
            ("a.stl --process our-sls --min-wall 0", "min_wall"),
            ("a.stl --option level", "expected NAME=VALUE"),
            ("a.stl --output-format gif", "the format must be auto"),
            ("a.stl -o a.off --output-format stl", "cannot be used with"),
        ] {
            let error = fields(line).expect_err("refused");
            assert!(error.contains(words), "{line}: {error}");
        }
    }
}
