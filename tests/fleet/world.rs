//! The simulated world of one history: the database with its network, the processes, the file store, and the journal.

use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt::Write as _;
use std::future::Future;
use std::rc::Rc;
use std::sync::Arc;

use futures::FutureExt;
use meshmend::jobs::{JobId, JobReport, JobStore, RetryPolicy, StoreError};
use tokio::runtime::Runtime;

use super::database::{CountedIds, Guard, ManualClock, SimDatabase};
use super::executor::{Millis, Signal, Sim};
use super::plan::{Ending, Event, Fault, PROCESSES, Plan};
use super::request::{Answer, FleetStore, Kind, Request};
use super::show;
use super::witness::Witness;

/// The store of a history.
#[derive(Clone)]
pub struct Backend {
    pub store: Arc<dyn FleetStore>,
    pub clock: Arc<ManualClock>,
    pub ids: Arc<CountedIds>,
    pub retry: RetryPolicy,
    /// The store again, if it is the simulated database.
    pub simulated: Option<Arc<SimDatabase>>,
    /// Where a real store's calls run.
    pub runtime: Option<Rc<Runtime>>,
    /// The guard that is missing.
    pub missing: Option<Guard>,
    /// A report for every result.
    pub report: JobReport,
    /// The history's number in this database. Its jobs, tenants and times differ from those of other histories.
    pub number: u64,
}

impl Backend {
    /// Waits for a call of the store, which takes no simulated time.
    pub fn wait<T>(&self, call: impl Future<Output = T>) -> T {
        match &self.runtime {
            Some(runtime) => runtime.block_on(call),
            None => call.now_or_never().expect("the simulated database answers at once"),
        }
    }

    /// The start of the history by the database's clock.
    fn start_ms(&self) -> i64 {
        1_800_000_000_000 + i64::try_from(self.number).expect("few") * 100_000_000
    }
}

/// The connection of a process to the database.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Connection {
    #[default]
    Up,
    /// Requests arrive, and answers are lost.
    OneWay,
    Down,
}

/// What the tasks of a process share.
pub struct ProcessState {
    pub is_up: Cell<bool>,
    /// Grows with every start.
    pub starts: Cell<u32>,
    pub connection: Cell<Connection>,
    /// Notifications of the database.
    pub work: Signal,
    pub deliveries: Signal,
    pub changed: RefCell<BTreeMap<JobId, Signal>>,
    /// The two steps of a shutdown.
    pub drain: RefCell<Signal>,
    pub now: RefCell<Signal>,
}

/// The world of one history.
pub struct World {
    pub sim: Sim,
    pub plan: Plan,
    pub backend: Backend,
    pub witness: RefCell<Witness>,
    pub processes: Vec<ProcessState>,
    /// By how much the database's clock is ahead of simulated time.
    pub clock_offset: Cell<i64>,
    pub is_database_up: Cell<bool>,
    /// The files of attempts, by the attempt's token, and of uploads, with an empty token.
    pub files: RefCell<BTreeSet<(JobId, String)>>,
    /// The number of each job in the plan.
    pub numbers: RefCell<BTreeMap<JobId, usize>>,
    /// Clients that still try to submit.
    pub busy_clients: Cell<usize>,
    /// What happened, if it is to be shown.
    pub journal: Option<RefCell<Vec<String>>>,
    faults: HashMap<(usize, Kind, u32), Fault>,
    calls: RefCell<HashMap<(usize, Kind), u32>>,
}

impl World {
    pub fn new(plan: &Plan, backend: Backend, is_shown: bool) -> Rc<Self> {
        let sim = Sim::new(PROCESSES);
        let faults = plan.events.iter().filter_map(|event| match *event {
            Event::Request { process, kind, nth, fault } => Some(((process, kind, nth), fault)),
            _ => None,
        });
        let clients = plan.events.iter().filter(|event| matches!(event, Event::Submit { .. })).count();
        let process = |_| ProcessState {
            is_up: Cell::new(false),
            starts: Cell::new(0),
            connection: Cell::default(),
            work: Signal::new(&sim),
            deliveries: Signal::new(&sim),
            changed: RefCell::default(),
            drain: RefCell::new(Signal::new(&sim)),
            now: RefCell::new(Signal::new(&sim)),
        };
        backend.ids.restart(backend.number);
        Rc::new(Self {
            witness: RefCell::new(Witness::new(backend.retry, plan.max_running)),
            processes: (0..PROCESSES).map(process).collect(),
            clock_offset: Cell::new(backend.start_ms()),
            is_database_up: Cell::new(true),
            files: RefCell::default(),
            numbers: RefCell::default(),
            busy_clients: Cell::new(clients),
            journal: is_shown.then(RefCell::default),
            faults: faults.collect(),
            calls: RefCell::default(),
            plan: plan.clone(),
            backend,
            sim,
        })
    }

    /// Whether the fleet has a guard.
    pub fn has(&self, guard: Guard) -> bool {
        self.backend.missing != Some(guard)
    }

    /// The database crashes, and loses what did not wait for the disk.
    pub fn crash(&self) {
        if let Some(database) = &self.backend.simulated {
            database.crash();
            let find = |id| self.backend.wait(database.get(id)).expect("an answer");
            self.witness.borrow_mut().crashed(find);
        }
    }

    /// The database's time.
    pub fn database_now(&self) -> i64 {
        self.clock_offset.get() + i64::try_from(self.sim.now()).expect("short")
    }

    /// The fault of the next request of this kind from a process.
    pub fn next_fault(&self, process: usize, kind: Kind) -> Option<Fault> {
        if self.faults.is_empty() {
            return None;
        }
        let mut calls = self.calls.borrow_mut();
        let nth = calls.entry((process, kind)).or_default();
        *nth += 1;
        self.faults.get(&(process, kind, *nth)).copied()
    }

    /// How the child of an attempt ends, and after how long.
    pub fn child(&self, job: JobId, attempt: u32) -> (Ending, Millis) {
        let number = self.numbers.borrow()[&job];
        let planned = self.plan.events.iter().find_map(|event| match *event {
            Event::Child { job, attempt: nth, ending, ms } if job == number && nth == attempt => Some((ending, ms)),
            _ => None,
        });
        let usual = 200 + super::random::hash(&[self.plan.seed, number as u64, u64::from(attempt)]) % 4_000;
        planned.unwrap_or((Ending::Success, usual))
    }

    /// Executes a request at the database, and has the witness judge the result.
    pub fn execute(&self, process: usize, request: Request) -> Result<Answer, StoreError> {
        self.backend.clock.set(self.database_now());
        if let Some(database) = &self.backend.simulated {
            database.write_messages();
        }
        let (store, asked) = (self.backend.store.as_ref(), request.clone());
        let answer = self.backend.wait(request.execute(store));
        let jobs = Witness::jobs_of(&asked, &answer);
        let rows = jobs.iter().filter_map(|id| self.backend.wait(store.get(*id)).expect("an answer"));
        let now = self.database_now();
        self.witness.borrow_mut().executed(now, &asked, &answer, rows.collect());
        if self.backend.simulated.as_ref().is_none_or(|database| database.is_synced()) {
            self.witness.borrow_mut().synced();
        }
        if !show::is_idle(&asked, &answer) {
            self.note(|| format!("{} {}", name_of(process), show::executed(&asked, &answer, &self.numbers.borrow())));
        }
        let is_quiet = matches!(asked, Request::Get(_) | Request::HoldKey { .. } | Request::Heartbeat(_, None))
            || answer.is_err()
            || show::is_idle(&asked, &answer);
        if !is_quiet {
            self.notify(&jobs);
        }
        answer
    }

    /// Notifies the connected processes of changed jobs, as the database's triggers do.
    fn notify(&self, jobs: &[JobId]) {
        for state in self.processes.iter().filter(|state| state.connection.get() == Connection::Up) {
            state.work.set();
            state.deliveries.set();
            let changed = state.changed.borrow();
            jobs.iter().filter_map(|id| changed.get(id)).for_each(Signal::set);
        }
    }

    /// Adds a line to the journal.
    pub fn note(&self, line: impl FnOnce() -> String) {
        if let Some(journal) = &self.journal {
            let mut text = String::new();
            write!(text, "{:>9.3} s  {}", self.sim.now() as f64 / 1000.0, line()).expect("text");
            journal.borrow_mut().push(text);
        }
    }

    /// The answers of the database so far, for comparisons of stores.
    pub fn journal_lines(&self) -> Vec<String> {
        self.journal.as_ref().map(|journal| journal.borrow().clone()).unwrap_or_default()
    }
}

/// A process's name in the journal.
pub fn name_of(process: usize) -> String {
    match process {
        super::plan::ENVIRONMENT => "environment".to_owned(),
        1 | 2 => format!("api {process}"),
        _ => format!("worker {}", process - 2),
    }
}
