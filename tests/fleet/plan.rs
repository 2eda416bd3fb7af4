//! The plan of a history: what clients ask and what goes wrong, and when. A seed makes a plan, and removing events from a plan gives
//! another plan, so that a failure can be shortened.

use super::executor::Millis;
use super::random::Random;
use super::request::Kind;

/// The processes: the environment, two API processes, three workers.
pub const ENVIRONMENT: usize = 0;
pub const APIS: [usize; 2] = [1, 2];
pub const WORKERS: [usize; 3] = [3, 4, 5];
pub const PROCESSES: usize = 6;

/// How long a lease lasts.
pub const LEASE: Millis = 10_000;

/// How a child process ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    Success,
    /// The result does not meet the job's options: it is published, and the job fails.
    NotPrintable,
    Problem,
    Crash,
    /// A failure outside the job.
    Internal,
    /// The worker process dies with the child.
    WorkerDies,
}

/// What happens to one request to the database.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// It never arrives.
    LoseRequest,
    /// It takes effect, and the caller gets an error.
    LoseAnswer,
    /// It arrives this late. The caller may have given up.
    DelayRequest(Millis),
    /// It takes effect a second time, this much later.
    Repeat(Millis),
}

/// One thing that happens in a history.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// A client submits a job; with a key it retries until it is accepted.
    Submit {
        at: Millis,
        job: usize,
        tenant: u64,
        keyed: bool,
        called_back: bool,
    },
    /// The client of the job does not get the answer to its `nth` request.
    LoseReply {
        job: usize,
        nth: u32,
    },
    Cancel {
        at: Millis,
        job: usize,
    },
    /// The child of this attempt ends so after `ms`. Without such an event it succeeds.
    Child {
        job: usize,
        attempt: u32,
        ending: Ending,
        ms: Millis,
    },
    /// The receiver's `nth` request about the job gets no good answer. With `received`, the receiver keeps the message all the same.
    Receiver {
        job: usize,
        nth: u32,
        received: bool,
    },
    /// What happens to the `nth` request of this kind from this process.
    Request {
        process: usize,
        kind: Kind,
        nth: u32,
        fault: Fault,
    },
    /// No connection between a process and the database; or, with `one_way`, only answers are lost.
    Partition {
        process: usize,
        at: Millis,
        ms: Millis,
        one_way: bool,
    },
    /// A process stands still. With `suspended`, so does its monotonic clock.
    Pause {
        process: usize,
        at: Millis,
        ms: Millis,
        suspended: bool,
    },
    Kill {
        process: usize,
        at: Millis,
        ms: Millis,
    },
    /// A graceful shutdown, and a start after `ms`.
    Stop {
        process: usize,
        at: Millis,
        ms: Millis,
    },
    /// The database restarts. A crash loses the commits that did not wait for the disk.
    Restart {
        at: Millis,
        ms: Millis,
        crash: bool,
    },
    /// The database's wall clock jumps.
    Jump {
        at: Millis,
        ms: i64,
    },
}

impl Event {
    /// When the event is over.
    fn end(&self) -> Millis {
        match *self {
            Self::Submit { at, .. } | Self::Cancel { at, .. } | Self::Jump { at, .. } => at,
            Self::Partition { at, ms, .. } | Self::Pause { at, ms, .. } | Self::Restart { at, ms, .. } => at + ms,
            Self::Kill { at, ms, .. } | Self::Stop { at, ms, .. } => at + ms,
            Self::LoseReply { .. } | Self::Child { .. } | Self::Receiver { .. } | Self::Request { .. } => 0,
        }
    }
}

/// A history to run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Plan {
    pub seed: u64,
    /// Slots of each worker process.
    pub slots: usize,
    /// How many jobs of a tenant may run at the same time.
    pub max_running: u32,
    pub events: Vec<Event>,
}

impl Plan {
    /// The plan of a seed.
    pub fn of(seed: u64) -> Self {
        let random = &mut Random::new(seed);
        let jobs = usize::try_from(random.between(2, 7)).expect("few");
        let mut events = Vec::new();
        for job in 0..jobs {
            submit(random, job, &mut events);
        }
        for _ in 0..random.between(0, 8) {
            events.push(trouble(random));
        }
        for _ in 0..random.between(0, 6) {
            events.push(request_fault(random));
        }
        let slots = usize::try_from(random.between(1, 2)).expect("few");
        Self { seed, slots, max_running: random.pick(&[1, 2, 8]), events }
    }

    /// The time after which nothing goes wrong any more.
    pub fn healed_at(&self) -> Millis {
        self.events.iter().map(Event::end).max().unwrap_or(0)
    }

    /// By how much the database's clock is set back in total.
    pub fn set_back(&self) -> Millis {
        let back = |event: &Event| if let Event::Jump { ms, .. } = event { ms.min(&0).unsigned_abs() } else { 0 };
        self.events.iter().map(back).sum()
    }

    /// The same plan with other events.
    pub fn with(&self, events: Vec<Event>) -> Self {
        Self { events, ..self.clone() }
    }

    /// The same plan for a database that can't crash on request.
    pub fn without_crashes(mut self) -> Self {
        for event in &mut self.events {
            if let Event::Restart { crash, .. } = event {
                *crash = false;
            }
        }
        self
    }
}

/// The submission of a job and what happens to it.
fn submit(random: &mut Random, job: usize, events: &mut Vec<Event>) {
    let (at, tenant) = (random.between(0, 15_000), random.between(0, 2));
    events.push(Event::Submit { at, job, tenant, keyed: random.chance(70), called_back: random.chance(70) });
    if random.chance(15) {
        events.push(Event::LoseReply { job, nth: 1 });
    }
    if random.chance(20) {
        events.push(Event::Cancel { at: at + random.between(1, 12_000), job });
    }
    for nth in 1..=3 {
        if random.chance(15) {
            events.push(Event::Receiver { job, nth, received: random.chance(50) });
        }
    }
    if random.chance(3) {
        let dies = |attempt| Event::Child { job, attempt, ending: Ending::WorkerDies, ms: 200 };
        events.extend((1..=5).map(dies));
        return;
    }
    for attempt in 1..=4 {
        if random.chance(25) {
            let ending = match random.between(0, 19) {
                0..6 => Ending::Success,
                6..8 => Ending::NotPrintable,
                8..10 => Ending::Problem,
                10..14 => Ending::Crash,
                14..18 => Ending::Internal,
                _ => Ending::WorkerDies,
            };
            let longest = random.pick(&[500, 5_000, 25_000]);
            events.push(Event::Child { job, attempt, ending, ms: random.between(20, longest) });
        }
    }
}

/// Something that goes wrong with a process, its connection, or the database.
fn trouble(random: &mut Random) -> Event {
    let (at, worker) = (random.between(0, 25_000), random.pick(&WORKERS));
    let process = if random.chance(70) { worker } else { random.pick(&APIS) };
    let ms = match random.between(0, 2) {
        0 => random.between(50, 2_000),
        1 => random.between(2_000, LEASE),
        _ => random.between(LEASE, 3 * LEASE),
    };
    match random.between(0, 9) {
        0 | 1 => Event::Partition { process, at, ms, one_way: random.chance(50) },
        2 | 3 => Event::Pause { process, at, ms, suspended: random.chance(50) },
        4 | 5 => Event::Kill { process, at, ms: random.between(50, 5_000) },
        6 => Event::Stop { process: worker, at, ms: random.between(12_050, 16_000) },
        7 | 8 => Event::Restart { at, ms: random.between(50, 3_000), crash: random.chance(80) },
        _ => Event::Jump { at, ms: random.pick(&[-30_000, -5_000, -500, 500, 5_000, 15_000, 3_600_000]) },
    }
}

fn request_fault(random: &mut Random) -> Event {
    let of_worker = [
        (Kind::Claim, 40),
        (Kind::Heartbeat, 12),
        (Kind::Complete, 4),
        (Kind::Complete, 4),
        (Kind::Complete, 4),
        (Kind::Fail, 3),
        (Kind::Release, 2),
        (Kind::RequeueExpired, 8),
    ];
    let of_api = [
        (Kind::Submit, 4),
        (Kind::Submit, 4),
        (Kind::HoldKey, 4),
        (Kind::Cancel, 2),
        (Kind::ClaimDelivery, 20),
        (Kind::Settle, 5),
    ];
    let (process, (kind, most)) = if random.chance(65) {
        (random.pick(&WORKERS), random.pick(&of_worker))
    } else {
        (random.pick(&APIS), random.pick(&of_api))
    };
    let late = random.pick(&[500, 5_000, 30_000]);
    let fault = match random.between(0, 4) {
        0 => Fault::LoseRequest,
        1 | 2 => Fault::LoseAnswer,
        3 => Fault::DelayRequest(random.between(5, late)),
        _ => Fault::Repeat(random.between(5, late)),
    };
    Event::Request { process, kind, nth: u32::try_from(random.between(1, most)).expect("small"), fault }
}
