//! Runs the engine for one call from Python: without the GIL, with progress, and until Ctrl-C.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

use meshmend::context::{Context, Progress, Stage, monotonic_clock};
use meshmend::format::Limits;
use pyo3::prelude::*;
use rayon::ThreadPoolBuilder;

use crate::LimitNumbers;
use crate::errors::Failure;

/// The pause between two checks for signals and for a cancellation.
const PAUSE: Duration = Duration::from_millis(50);
/// The stack of each thread, as large as that of a program's first thread. Only used pages take memory.
const STACK_BYTES: usize = 8 << 20;

/// What each call has: its limits, threads, and callbacks.
#[pyclass(frozen, module = "meshmend._engine")]
pub struct Settings {
    /// The limits on each model.
    pub limits: Limits,
    threads: usize,
    progress: Option<Py<PyAny>>,
    log: Option<Py<PyAny>>,
    is_cancelled: Option<Py<PyAny>>,
}

#[pymethods]
impl Settings {
    #[new]
    #[pyo3(signature = (limits, threads, progress, log, is_cancelled))]
    fn new(
        limits: LimitNumbers,
        threads: usize,
        progress: Option<Py<PyAny>>,
        log: Option<Py<PyAny>>,
        is_cancelled: Option<Py<PyAny>>,
    ) -> Self {
        Self { limits: crate::limits(limits), threads, progress, log, is_cancelled }
    }
}

/// A message of the engine to the thread of the caller.
enum Message {
    Stage(Stage, Option<u8>, u8),
    Line(String),
}

/// Sends progress to the thread of the caller.
struct ProgressSender {
    sender: Mutex<Sender<Message>>,
    has_progress: bool,
    has_log: bool,
}

impl ProgressSender {
    fn send(&self, message: Message) {
        if let Ok(sender) = self.sender.lock() {
            // Fails only if the caller has ended.
            let _ = sender.send(message);
        }
    }
}

impl Progress for ProgressSender {
    fn report(&self, stage: Stage, tier: Option<u8>, percent: u8) {
        if self.has_progress {
            self.send(Message::Stage(stage, tier, percent));
        }
    }

    fn log(&self, line: &str) {
        if self.has_log {
            self.send(Message::Line(line.to_owned()));
        }
    }
}

impl Settings {
    /// Runs `work` in threads of its own, without the GIL. Meanwhile this thread calls the callbacks and looks for signals. An exception of
    /// either cancels the work.
    ///
    /// The threads end with the call. A pool for the whole process would not exist in a forked child, where the work would wait forever.
    pub fn run<T: Send>(
        &self,
        py: Python<'_>,
        deadline_s: Option<f64>,
        work: impl FnOnce(&Context<'_>) -> Result<T, Failure> + Send,
    ) -> PyResult<T> {
        let threads = ThreadPoolBuilder::new().num_threads(self.threads).stack_size(STACK_BYTES);
        let pool = threads.build().map_err(|error| Failure::Other(error.to_string()).into_exception(None, false))?;
        let cancel = AtomicBool::new(false);
        let (sender, receiver) = channel();
        let progress = ProgressSender {
            sender: Mutex::new(sender),
            has_progress: self.progress.is_some(),
            has_log: self.log.is_some(),
        };
        let mut outcome = None;
        let (result, is_cancelled) = (&mut outcome, &cancel);
        let stopped = py.detach(move || {
            pool.in_place_scope(|scope| {
                scope.spawn(move |_| {
                    let clock = monotonic_clock();
                    let deadline = deadline_s.map_or(Duration::MAX, Duration::from_secs_f64);
                    let context = Context::new(&progress, is_cancelled, &clock, deadline);
                    *result = Some(catch_unwind(AssertUnwindSafe(|| work(&context))));
                    // Ends the caller's wait.
                    drop(progress);
                });
                let stopped = self.serve(&receiver);
                is_cancelled.store(stopped.is_err(), Ordering::Relaxed);
                stopped
            })
        });
        stopped?;
        let outcome = match outcome {
            Some(Ok(outcome)) => outcome,
            Some(Err(panic)) => Err(Failure::Other(format!("The engine failed: {}", panic_message(&*panic)))),
            None => Err(Failure::Stopped),
        };
        outcome.map_err(|failure| failure.into_exception(deadline_s, cancel.load(Ordering::Relaxed)))
    }

    /// Passes messages to the callbacks until the work has ended.
    fn serve(&self, receiver: &Receiver<Message>) -> PyResult<()> {
        loop {
            let message = match receiver.recv_timeout(PAUSE) {
                Ok(message) => Some(message),
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
            };
            Python::attach(|py| {
                py.check_signals()?;
                if let Some(message) = message {
                    self.pass_on(py, message)?;
                }
                match &self.is_cancelled {
                    Some(asked) if asked.call0(py)?.is_truthy(py)? => Err(Failure::Stopped.into_exception(None, true)),
                    _ => Ok(()),
                }
            })?;
        }
    }

    fn pass_on(&self, py: Python<'_>, message: Message) -> PyResult<()> {
        match (message, &self.progress, &self.log) {
            (Message::Stage(stage, tier, percent), Some(progress), _) => {
                progress.call1(py, (stage_name(stage), tier, f64::from(percent) / 100.0)).map(drop)
            }
            (Message::Line(line), _, Some(log)) => log.call1(py, (line,)).map(drop),
            _ => Ok(()),
        }
    }
}

fn stage_name(stage: Stage) -> &'static str {
    match stage {
        Stage::Read => "read",
        Stage::Inspect => "inspect",
        Stage::Repair => "repair",
        Stage::Wait => "wait",
        Stage::Verify => "verify",
        Stage::Finish => "finish",
    }
}

fn panic_message(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("unknown error")
}
