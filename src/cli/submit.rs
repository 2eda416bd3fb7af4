//! `meshmend submit` and `meshmend watch`: jobs of a service, sent and followed.

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
use super::remote::{DisplayArgs, RemoteError, RemoteJob, Row, ServiceArgs, Session, Submission, Target, Wanted};
use super::repair::{RepairOptionArgs, format_named};

/// Files that are on their way at the same time.
const MAX_SENT: usize = 4;

/// Arguments of `meshmend submit`.
#[derive(Debug, Args)]
pub struct SubmitArgs {
    /// The models. Each becomes a job of its own.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    #[command(flatten)]
    service: ServiceArgs,
    /// Where the result of one file goes; its ending (.stl, .obj, .ply, .off, .mesh, .glb, .3mf, .zip) is the format. For an analysis, the
    /// report.
    #[arg(short, long, env = "MESHMEND_OUTPUT", value_name = "FILE", conflicts_with_all = ["output_dir", "output_format"])]
    output: Option<PathBuf>,
    /// Folder that results go into, under the names that the service gives them, such as part-repaired.stl. It is made. Without it
    /// and without --output, the current one.
    #[arg(long, env = "MESHMEND_OUTPUT_DIR", value_name = "FOLDER")]
    output_dir: Option<PathBuf>,
    /// The format of results: auto, stl, obj, ply, off, mesh, 3mf, glb, zip or same.
    #[arg(long, env = "MESHMEND_OUTPUT_FORMAT", value_name = "FORMAT", value_parser = output_format)]
    output_format: Option<OutputFormat>,
    /// Where the report of one file goes, as JSON.
    #[arg(long, env = "MESHMEND_REPORT", value_name = "FILE")]
    report: Option<PathBuf>,
    /// Folder for pictures of what was found and changed. It is made. Without it none are downloaded.
    #[arg(long, env = "MESHMEND_PICTURES", value_name = "FOLDER")]
    pictures: Option<PathBuf>,
    /// What to do with the models.
    #[arg(long, env = "MESHMEND_MODE", value_enum, default_value_t)]
    mode: Task,
    /// An option as the API calls it, such as level=full for an analysis; it wins over the flags below. May be given again.
    #[arg(long = "option", env = "MESHMEND_OPTION", value_name = "NAME=VALUE", value_delimiter = ';', value_parser = option)]
    options: Vec<(String, Value)>,
    /// Print the jobs' ids once they are submitted, and do not wait for them.
    #[arg(long, env = "MESHMEND_NO_WAIT", conflicts_with_all = ["output", "output_dir", "report", "pictures"])]
    no_wait: bool,
    #[command(flatten)]
    display: DisplayArgs,
    #[command(flatten, next_help_heading = "Options of a repair")]
    repair: RepairOptionArgs,
}

/// What a service does with a model.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum Task {
    /// Repair it.
    #[default]
    Repair,
    /// Tell what is wrong with it, and change nothing.
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

fn output_format(text: &str) -> Result<OutputFormat, String> {
    serde_json::from_value(json!(text))
        .map_err(|_| "a format is auto, stl, obj, ply, off, mesh, 3mf, glb, zip or same".to_owned())
}

fn option(text: &str) -> Result<(String, Value), String> {
    let (name, value) = text.split_once('=').ok_or("an option is like level=full")?;
    let value = serde_json::from_str(value).unwrap_or_else(|_| json!(value));
    Ok((name.trim().replace('-', "_"), value))
}

/// Runs `meshmend submit`.
pub fn submit(args: &SubmitArgs) -> ExitCode {
    let prepared = args.prepare().and_then(|prepared| Ok((prepared, args.service.open()?)));
    let ((options, wanted), service) = match prepared {
        Ok(prepared) => prepared,
        Err(error) => return exit::fail(error.code(), error),
    };
    let session = Session::new(service, &args.display, wanted);
    session.run(submit_all(args, &session, &options))
}

impl SubmitArgs {
    /// The options as the service is told them, and what is wanted back, as far as that can be seen here.
    fn prepare(&self) -> Result<(Vec<(String, String)>, Wanted), RemoteError> {
        let options = self.fields().map_err(RemoteError::Local)?;
        let several = self.files.len() > 1;
        let for_one = |flag: &str, path: &Option<PathBuf>| match path {
            Some(_) if several => {
                Err(RemoteError::Local(format!("{flag} is for one file; for several, see --output-dir")))
            }
            path => Ok(path.clone().map(Target::File)),
        };
        let mut wanted = Wanted { pictures: self.pictures.clone(), ..Wanted::default() };
        if self.no_wait {
            return Ok((options, wanted));
        }
        let folder = self.output_dir.clone().unwrap_or_default();
        let result = for_one("--output", &self.output)?.unwrap_or(Target::Folder(folder));
        if matches!(result, Target::Folder(_)) {
            self.differ()?;
        }
        wanted.report = for_one("--report", &self.report)?;
        wanted.result = Some(result);
        let pictures = self.pictures.clone().map(Target::Folder);
        for target in [&wanted.result, &wanted.report, &pictures].into_iter().flatten() {
            target.check(self.display.force)?;
        }
        Ok((options, wanted))
    }

    /// Whether no two files would leave results of the same name.
    fn differ(&self) -> Result<(), RemoteError> {
        let mut stems: BTreeMap<Option<&OsStr>, &Path> = BTreeMap::new();
        for file in &self.files {
            if let Some(other) = stems.insert(file.file_stem(), file) {
                let (file, other) = (file.display(), other.display());
                return Err(RemoteError::Local(format!(
                    "the results of {other} and {file} would have one name; submit them apart"
                )));
            }
        }
        Ok(())
    }

    /// Mode and options as fields of a query: what differs from the defaults, so that a service of another version decides the rest.
    fn fields(&self) -> Result<Vec<(String, String)>, String> {
        let output = match (&self.output, self.output_format) {
            (Some(output), _) if self.mode == Task::Repair => format_named(output)?,
            (_, format) => format.unwrap_or_default(),
        };
        let options = self.repair.options(output)?;
        let fields = |options: &Options| match serde_json::to_value(options) {
            Ok(Value::Object(fields)) => fields,
            _ => Map::new(),
        };
        let usual = fields(&Options::default());
        let mut fields = fields(&options);
        fields.retain(|name, value| usual.get(name) != Some(value));
        fields.insert("mode".to_owned(), json!(self.mode.mode()));
        fields.extend(self.options.iter().cloned());
        let text = |value: Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        Ok(fields.into_iter().map(|(name, value)| (name, text(value))).collect())
    }
}

/// Submits all files, a few at a time, and gives the worst code.
async fn submit_all(args: &SubmitArgs, session: &Session<'_>, options: &[(String, String)]) -> u8 {
    let first = session.console.row(session.service.address());
    first.show_waiting("asks what it takes");
    let most = match session
        .service
        .persist(|e, delay| first.show_retry(e, delay), async || session.service.most_bytes().await)
        .await
    {
        Ok(most) => most,
        Err(error) => {
            drop(first);
            session.console.print_note(&format!("meshmend: {error}"));
            return error.code();
        }
    };
    drop(first);
    let each = args.files.iter().map(|path| async move {
        let name = path.display().to_string();
        let row = session.console.row(&name);
        match send(session, path, options, most, &row).await {
            Ok(job) if args.no_wait => session.print_submitted(&name, &job),
            Ok(job) => session.follow_to_end(&row, &name, job.id).await,
            Err(error) => session.failed(&row, &name, None, &error),
        }
    });
    futures::stream::iter(each)
        .buffer_unordered(MAX_SENT)
        .fold(exit::PRINTABLE, async |worst, code| worst.max(code))
        .await
}

/// Makes one job of a file, however often it has to be sent.
async fn send(
    session: &Session<'_>,
    path: &Path,
    options: &[(String, String)],
    most: u64,
    row: &Row,
) -> Result<RemoteJob, RemoteError> {
    let found = std::fs::metadata(path).map_err(|error| RemoteError::Local(error.to_string()))?;
    if !found.is_file() {
        return Err(RemoteError::Local("this is no file".to_owned()));
    }
    if found.len() > most {
        return Err(RemoteError::Local(format!("larger than the {} MiB that the service takes", most >> 20)));
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let key = Uuid::new_v4().to_string();
    let submission = Submission { path, name: &name, options, key: &key };
    let waits = |error: &RemoteError, delay| row.show_retry(error, delay);
    let job = session
        .service
        .persist(waits, async || {
            row.start_transfer("sending", found.len());
            session.service.submit(&submission, row.meter()).await
        })
        .await?;
    session.mark_open(job.id);
    row.line(&format!("submitted as {}", job.id));
    Ok(job)
}

/// Jobs that are followed at the same time.
const MAX_FOLLOWED: usize = 16;
/// How often to look for jobs that came.
const POLL: Duration = Duration::from_secs(2);

/// Arguments of `meshmend watch`.
#[derive(Debug, Args)]
pub struct WatchArgs {
    /// The jobs' ids, as `submit` tells them. Without any, all that run and wait, and those that come, until it is interrupted.
    jobs: Vec<JobId>,
    #[command(flatten)]
    service: ServiceArgs,
    /// Folder that the results go into, under the names that the service gives them. It is made. Without it nothing is downloaded.
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
    let session = Session::new(service, &args.display, Wanted { result, ..Wanted::default() });
    if args.jobs.is_empty() {
        return session.run(watch_all(&session));
    }
    let each = args.jobs.iter().map(|id| watch_job(&session, id.to_string(), *id));
    let codes = futures::stream::iter(each).buffer_unordered(MAX_FOLLOWED);
    session.run(codes.fold(exit::PRINTABLE, async |worst, code| worst.max(code)))
}

async fn watch_job(session: &Session<'_>, name: String, id: JobId) -> u8 {
    let row = session.console.row(&name);
    session.follow_to_end(&row, &name, id).await
}

/// Follows what runs and what waits, the oldest first, until the service can't be asked any more.
async fn watch_all(session: &Session<'_>) -> u8 {
    let (mut seen, mut followed) = (BTreeSet::new(), FuturesUnordered::new());
    let row = session.console.row(session.service.address());
    loop {
        row.show_waiting("looks for jobs");
        let look =
            async || Ok([session.service.jobs(Status::Running).await?, session.service.jobs(Status::Queued).await?]);
        let found = match session.service.persist(|error, delay| row.show_retry(error, delay), look).await {
            Ok(found) => found,
            Err(error) => {
                session.console.print_note(&format!("meshmend: {error}"));
                return error.code();
            }
        };
        for job in found.iter().flat_map(|jobs| jobs.iter().rev()) {
            if followed.len() < MAX_FOLLOWED && seen.insert(job.id) {
                followed.push(watch_job(session, format!("{} {}", job.id, job.input.name), job.id));
            }
        }
        let next_poll = Instant::now() + POLL;
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
    fn only_options_that_are_not_the_usual_ones_are_sent_as_the_api_calls_them() {
        for (line, expected) in [
            ("a.stl", "mode=repair"),
            ("a.stl --max-tier 3 --pictures seen", "mode=repair"),
            ("a.stl -o out.3MF --scale-to in", "mode=repair&output=3mf&scale_to=in"),
            ("a.stl --output-format same", "mode=repair&output=same"),
            ("a.stl --without sew,stitch", "mode=repair&without=[\"sew\",\"stitch\"]"),
            ("a.stl --max-tier 1 --option max-tier=2;inside=odd", "winding_rule=odd&max_tier=2&mode=repair"),
            ("a.stl --mode analyze -o r.json --option level=basic", "level=basic&mode=analyze"),
        ] {
            assert_eq!(fields(line).as_deref(), Ok(expected), "{line}");
        }
        for (line, words) in [
            ("a.stl -o out", "must end in"),
            ("a.stl --deadline-s 0", "deadline_s"),
            ("a.stl --option level", "an option is like"),
            ("a.stl --output-format gif", "a format is auto"),
            ("a.stl -o a.off --output-format stl", "cannot be used with"),
        ] {
            let error = fields(line).expect_err("refused");
            assert!(error.contains(words), "{line}: {error}");
        }
    }
}
