//! Progress on standard error: bars on a terminal, otherwise a line for each change. Standard output gets results only.

use std::io::{IsTerminal, Write};
use std::sync::Arc;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use meshmend::jobs::Status;

use super::error::RemoteError;
use super::job::RemoteProgress;
use crate::cli::engine::stage_description;

/// Row templates: while bytes are transferred, while nothing is measurable, and while the job runs. File names come last because they
/// may be long.
const TRANSFER: &str = "[{bar:20}] {percent:>3} %  {msg:8} {bytes:>10} {bytes_per_sec:>14}  {prefix}";
const WAITING: &str = "{spinner} {elapsed:25}  {msg:34}  {prefix}";
const RUNNING: &str = "[{bar:20}] {percent:>3} %  {msg:34}  {prefix}";

/// Standard error with one row per file or job, and standard output for results.
#[derive(Debug, Clone)]
pub struct Console {
    bars: MultiProgress,
    /// Whether progress is printed as lines.
    lines: bool,
}

impl Console {
    /// With `quiet`, only errors are printed.
    pub fn new(quiet: bool) -> Self {
        let bars = MultiProgress::new();
        let is_terminal = std::io::stderr().is_terminal();
        if quiet || !is_terminal {
            bars.set_draw_target(indicatif::ProgressDrawTarget::hidden());
        }
        Self { bars, lines: !quiet && !is_terminal }
    }

    /// Adds a row for one file or job.
    pub fn row(&self, name: &str) -> Row {
        let bar = self.bars.add(ProgressBar::new_spinner()).with_prefix(name.to_owned());
        bar.enable_steady_tick(Duration::from_millis(200));
        Row { bar, name: name.to_owned(), console: self.clone(), last: Arc::default() }
    }

    /// Prints a line on standard error, above the rows.
    pub fn print_note(&self, text: &str) {
        self.bars.suspend(|| drop(writeln!(std::io::stderr(), "{text}")));
    }

    /// Prints a result on standard output.
    ///
    /// # Errors
    /// Standard output cannot be written.
    pub fn print_result(&self, line: &str) -> std::io::Result<()> {
        self.bars.suspend(|| writeln!(std::io::stdout(), "{line}"))
    }
}

/// The row of one file or job; it disappears when dropped.
#[derive(Debug)]
pub struct Row {
    bar: ProgressBar,
    name: String,
    console: Console,
    /// The last printed line.
    last: Arc<Mutex<String>>,
}

impl Row {
    /// Starts a transfer of `bytes` bytes; `action` names the transfer.
    pub fn start_transfer(&self, action: &str, bytes: u64) {
        self.set_style(TRANSFER, action);
        self.bar.set_length(bytes);
        self.bar.set_position(0);
        self.bar.reset_eta();
    }

    /// Adds transferred bytes.
    pub fn advance(&self, bytes: u64) {
        self.bar.inc(bytes);
    }

    /// Returns a callback that adds transferred bytes.
    pub fn meter(&self) -> impl Fn(u64) + Send + Sync + 'static {
        let bar = self.bar.clone();
        move |bytes| bar.inc(bytes)
    }

    /// Shows a text without a measure of progress.
    pub fn show_waiting(&self, text: &str) {
        self.set_style(WAITING, text);
    }

    /// Shows the progress of a job.
    pub fn show_progress(&self, status: Status, progress: RemoteProgress) {
        let RemoteProgress { stage, tier, percent, queue_position } = progress;
        match (status, stage) {
            (Status::Running, Some(stage)) => {
                self.set_style(RUNNING, &stage_description(stage, tier));
                self.bar.set_length(100);
                self.bar.set_position(u64::from(percent));
                self.line("running");
            }
            (Status::Running, None) => {
                self.show_waiting("running");
                self.line("running");
            }
            (Status::Queued, _) => {
                let text = match queue_position {
                    None => "queued".to_owned(),
                    Some(0) => "queued, next".to_owned(),
                    Some(ahead) => format!("queued, {ahead} ahead"),
                };
                self.show_waiting(&text);
                self.line("queued");
            }
            _ => {}
        }
    }

    /// Shows that a request failed and when it is retried.
    pub fn show_retry(&self, error: &RemoteError, delay: Duration) {
        let text = format!("{}; retry in {} s", error.brief(), delay.as_secs_f64().ceil());
        self.show_waiting(&text);
        self.line(&text);
    }

    /// Prints a line if there are no bars and the line differs from the last one.
    pub fn line(&self, text: &str) {
        if !self.console.lines {
            return;
        }
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if *last != text {
            self.console.print_note(&format!("{}: {text}", self.name));
            text.clone_into(&mut last);
        }
    }

    /// Removes the bar and, unless `quiet`, prints the outcome.
    pub fn finish(&self, lines: &[String], quiet: bool) {
        self.bar.finish_and_clear();
        if !quiet {
            self.console.print_note(&format!("{}: {}", self.name, lines.join("\n")));
        }
    }

    fn set_style(&self, template: &str, message: &str) {
        if let Ok(style) = ProgressStyle::with_template(template) {
            self.bar.set_style(style.progress_chars("=> "));
        }
        self.bar.set_message(message.to_owned());
    }
}

impl Drop for Row {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
        self.console.bars.remove(&self.bar);
    }
}
