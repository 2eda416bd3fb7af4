//! What a person sees on standard error while jobs are on their way: bars on a terminal, a line now and then elsewhere. Results alone
//! go to standard output.

use std::io::{IsTerminal, Write};
use std::sync::Arc;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use meshmend::jobs::Status;

use super::error::RemoteError;
use super::service::RemoteProgress;
use crate::cli::engine::stage_in_words;

/// How a row looks while bytes are moved, while a job waits or nothing is known, and while it is worked on. Names come last, since they
/// may be long.
const BYTES: &str = "[{bar:20}] {percent:>3} %  {msg:8} {bytes:>10} {bytes_per_sec:>14}  {prefix}";
const WAITING: &str = "{spinner} {elapsed:25}  {msg:34}  {prefix}";
const WORK: &str = "[{bar:20}] {percent:>3} %  {msg:34}  {prefix}";

/// Everything that is shown.
#[derive(Debug, Clone)]
pub struct Console {
    bars: MultiProgress,
    lines: bool,
}

impl Console {
    /// `quiet` shows what went wrong and nothing else.
    pub fn new(quiet: bool) -> Self {
        let bars = MultiProgress::new();
        let is_terminal = std::io::stderr().is_terminal();
        if quiet || !is_terminal {
            bars.set_draw_target(indicatif::ProgressDrawTarget::hidden());
        }
        Self { bars, lines: !quiet && !is_terminal }
    }

    /// A row for one file or job.
    pub fn row(&self, name: &str) -> Row {
        let bar = self.bars.add(ProgressBar::new_spinner()).with_prefix(name.to_owned());
        bar.enable_steady_tick(Duration::from_millis(200));
        Row { bar, name: name.to_owned(), console: self.clone(), last: Arc::default() }
    }

    /// Says something on standard error, above the rows.
    pub fn print_note(&self, text: &str) {
        self.bars.suspend(|| drop(writeln!(std::io::stderr(), "{text}")));
    }

    /// Gives a result on standard output.
    pub fn print_result(&self, line: &str) -> std::io::Result<()> {
        self.bars.suspend(|| writeln!(std::io::stdout(), "{line}"))
    }
}

/// The row of one file or job, which goes when it is dropped.
#[derive(Debug)]
pub struct Row {
    bar: ProgressBar,
    name: String,
    console: Console,
    /// What the last line said, where there are lines.
    last: Arc<Mutex<String>>,
}

impl Row {
    /// So many bytes are about to be moved.
    pub fn start_transfer(&self, how: &str, bytes: u64) {
        self.set_style(BYTES, how);
        self.bar.set_length(bytes);
        self.bar.set_position(0);
        self.bar.reset_eta();
    }

    /// So many bytes more were.
    pub fn advance(&self, bytes: u64) {
        self.bar.inc(bytes);
    }

    /// Tells of each number of bytes that moved.
    pub fn meter(&self) -> impl Fn(u64) + Send + Sync + 'static {
        let bar = self.bar.clone();
        move |bytes| bar.inc(bytes)
    }

    /// That nothing can be told but what it is about.
    pub fn show_waiting(&self, text: &str) {
        self.set_style(WAITING, text);
    }

    /// How far the job is.
    pub fn show_progress(&self, status: Status, progress: RemoteProgress) {
        let RemoteProgress { stage, tier, percent, queue_position } = progress;
        match (status, stage) {
            (Status::Running, Some(stage)) => {
                self.set_style(WORK, &stage_in_words(stage, tier));
                self.bar.set_length(100);
                self.bar.set_position(u64::from(percent));
                self.line("running");
            }
            (Status::Running, None) => {
                self.show_waiting("running");
                self.line("running");
            }
            (Status::Queued, _) => {
                let before = match queue_position {
                    None => "waits".to_owned(),
                    Some(0) => "waits, next in turn".to_owned(),
                    Some(before) => format!("waits, {before} before it"),
                };
                self.show_waiting(&before);
                self.line("waits for its turn");
            }
            _ => {}
        }
    }

    /// That something did not work and is tried again.
    pub fn show_retry(&self, error: &RemoteError, delay: Duration) {
        let text = format!("{}; tried again in {} s", error.brief(), delay.as_secs_f64().ceil());
        self.show_waiting(&text);
        self.line(&text);
    }

    /// A line where there are no bars, unless it would say the same as the last.
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

    /// What became of it; nothing where all is to be quiet.
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
