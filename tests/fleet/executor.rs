//! A single-threaded executor with simulated time. It runs the tasks of all simulated processes in one fixed order, and can kill or
//! pause a process at any point where one of its tasks waits.

use std::cell::{Cell, RefCell};
use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};
use std::future::Future;
use std::pin::Pin;
use std::rc::Rc;
use std::task::{Context, Poll, Waker};

/// A point in simulated time, in milliseconds since the start of the history.
pub type Millis = u64;
type TaskId = usize;
type Work = Pin<Box<dyn Future<Output = ()>>>;

struct Task {
    process: usize,
    /// `None` while the task is polled.
    work: Option<Work>,
}

#[derive(Default)]
struct ProcessState {
    paused_at: Option<Millis>,
    /// By how much the process's monotonic clock is behind, because it stood still while the process was suspended.
    lag: Millis,
    /// Tasks that became ready during the pause.
    deferred: Vec<TaskId>,
}

#[derive(Default)]
struct Core {
    now: Cell<Millis>,
    sequence: Cell<u64>,
    current: Cell<TaskId>,
    timers: RefCell<BinaryHeap<Reverse<(Millis, u64, TaskId)>>>,
    ready: RefCell<VecDeque<TaskId>>,
    tasks: RefCell<Vec<Option<Task>>>,
    processes: RefCell<Vec<ProcessState>>,
}

/// The executor, shared by all tasks.
#[derive(Clone)]
pub struct Sim(Rc<Core>);

impl Sim {
    pub fn new(processes: usize) -> Self {
        let core = Core::default();
        core.processes.borrow_mut().resize_with(processes, ProcessState::default);
        Self(Rc::new(core))
    }

    pub fn now(&self) -> Millis {
        self.0.now.get()
    }

    /// The monotonic clock of a process.
    pub fn local_now(&self, process: usize) -> Millis {
        self.now() - self.0.processes.borrow()[process].lag
    }

    /// Starts a task of a process.
    pub fn spawn(&self, process: usize, work: impl Future<Output = ()> + 'static) {
        let mut tasks = self.0.tasks.borrow_mut();
        self.0.ready.borrow_mut().push_back(tasks.len());
        tasks.push(Some(Task { process, work: Some(Box::pin(work)) }));
    }

    /// Waits by the clock of the process that runs the current task.
    pub fn sleep(&self, process: usize, time: Millis) -> Sleep {
        Sleep { sim: self.clone(), process, until: self.local_now(process) + time, armed_for: None }
    }

    /// Drops every task of a process, as a crash does.
    pub fn kill(&self, process: usize) {
        let of_process = |task: &&mut Option<Task>| task.as_ref().is_some_and(|task| task.process == process);
        let killed: Vec<_> = self.0.tasks.borrow_mut().iter_mut().filter(of_process).map(Option::take).collect();
        drop(killed);
        self.0.processes.borrow_mut()[process] = ProcessState::default();
    }

    /// Stops running the tasks of a process.
    pub fn pause(&self, process: usize) {
        let now = self.now();
        self.0.processes.borrow_mut()[process].paused_at.get_or_insert(now);
    }

    /// Continues a paused process. If it was suspended, its monotonic clock stood still.
    pub fn resume(&self, process: usize, suspended: bool) {
        let mut processes = self.0.processes.borrow_mut();
        let state = &mut processes[process];
        if let Some(paused_at) = state.paused_at.take() {
            state.lag += if suspended { self.now() - paused_at } else { 0 };
            self.0.ready.borrow_mut().extend(state.deferred.drain(..));
        }
    }

    /// Runs tasks in the order of time until `is_done`. Returns false if nothing is left to run or `deadline` passes before.
    pub fn run_until(&self, deadline: Millis, is_done: impl Fn() -> bool) -> bool {
        loop {
            loop {
                let next = self.0.ready.borrow_mut().pop_front();
                let Some(task) = next else { break };
                self.poll(task);
            }
            if is_done() {
                return true;
            }
            let next = self.0.timers.borrow_mut().pop();
            match next {
                Some(Reverse((at, _, task))) if at <= deadline => {
                    self.0.now.set(at);
                    self.poll(task);
                }
                _ => return false,
            }
        }
    }

    /// Drops every task. Tasks refer to the world that owns this executor, so nothing would be freed otherwise.
    pub fn clear(&self) {
        let tasks = std::mem::take(&mut *self.0.tasks.borrow_mut());
        drop(tasks);
    }

    fn poll(&self, id: TaskId) {
        let work = {
            let mut tasks = self.0.tasks.borrow_mut();
            let Some(task) = tasks[id].as_mut() else { return };
            let state = &mut self.0.processes.borrow_mut()[task.process];
            if state.paused_at.is_some() {
                state.deferred.push(id);
                return;
            }
            task.work.take()
        };
        let Some(mut work) = work else { return };
        self.0.current.set(id);
        let is_pending = work.as_mut().poll(&mut Context::from_waker(Waker::noop())).is_pending();
        let mut tasks = self.0.tasks.borrow_mut();
        match tasks[id].as_mut() {
            Some(task) if is_pending => task.work = Some(work),
            _ => tasks[id] = None,
        }
    }

    fn arm(&self, at: Millis) {
        self.0.sequence.set(self.0.sequence.get() + 1);
        self.0.timers.borrow_mut().push(Reverse((at, self.0.sequence.get(), self.0.current.get())));
    }
}

/// A wait of a process.
pub struct Sleep {
    sim: Sim,
    process: usize,
    until: Millis,
    armed_for: Option<Millis>,
}

impl Future for Sleep {
    type Output = ();

    fn poll(mut self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<()> {
        let (now, local) = (self.sim.now(), self.sim.local_now(self.process));
        if local >= self.until {
            return Poll::Ready(());
        }
        if self.armed_for.is_none_or(|at| at <= now) {
            let at = now + (self.until - local);
            self.sim.arm(at);
            self.armed_for = Some(at);
        }
        Poll::Pending
    }
}

#[derive(Default)]
struct SignalState {
    is_set: Cell<bool>,
    waiting: RefCell<Vec<TaskId>>,
}

/// A flag that tasks can wait for.
#[derive(Clone)]
pub struct Signal(Sim, Rc<SignalState>);

impl Signal {
    pub fn new(sim: &Sim) -> Self {
        Self(sim.clone(), Rc::default())
    }

    pub fn is_set(&self) -> bool {
        self.1.is_set.get()
    }

    pub fn set(&self) {
        self.1.is_set.set(true);
        let waiting = std::mem::take(&mut *self.1.waiting.borrow_mut());
        self.0.0.ready.borrow_mut().extend(waiting);
    }

    /// Waits until the flag is set, and leaves it set.
    pub async fn wait(&self) {
        std::future::poll_fn(|_| if self.is_set() { Poll::Ready(()) } else { self.register() }).await;
    }

    /// Waits until the flag is set, and clears it.
    pub async fn take(&self) {
        std::future::poll_fn(|_| if self.1.is_set.replace(false) { Poll::Ready(()) } else { self.register() }).await;
    }

    fn register(&self) -> Poll<()> {
        let (current, mut waiting) = (self.0.0.current.get(), self.1.waiting.borrow_mut());
        if waiting.last() != Some(&current) {
            waiting.push(current);
        }
        Poll::Pending
    }
}
