//! The network between the processes and the database. Requests and answers take time, and can be lost, late or repeated.

use std::cell::RefCell;
use std::rc::Rc;

use meshmend::jobs::{
    CancelResult, Claim, Completion, DeliveryAttempt, DeliveryResult, DueDelivery, Failure, Job, JobId, JobProgress,
    KeyState, Lease, NewJob, StoreError,
};

use super::executor::{Millis, Signal};
use super::plan::{ENVIRONMENT, Fault};
use super::random::hash;
use super::request::{Answer, Request};
use super::world::{Connection, World};

/// After this time a caller gives up on a request, as the server's `statement_timeout` makes it.
const TIMEOUT: Millis = 15_000;
/// How long a process tries to connect.
const CONNECT: Millis = 3_000;

type Reply = Result<Answer, StoreError>;

/// The error of a broken connection.
fn broken() -> StoreError {
    sqlx::Error::Io(std::io::ErrorKind::ConnectionReset.into()).into()
}

/// Where the answer to a request arrives.
struct Slot {
    reply: RefCell<Option<Reply>>,
    arrived: Signal,
}

impl Slot {
    fn fill(&self, reply: Reply) {
        *self.reply.borrow_mut() = Some(reply);
        self.arrived.set();
    }
}

/// A process's connection to the store. Its methods are those of the store's traits.
#[derive(Clone)]
pub struct Link {
    pub world: Rc<World>,
    pub process: usize,
}

/// Takes the value of the answer that a request has.
macro_rules! expect {
    ($reply:expr, $variant:ident) => {
        match $reply? {
            Answer::$variant(value) => Ok(value),
            other => unreachable!("{other:?}"),
        }
    };
}

impl Link {
    /// Sends a request, and waits for the answer. The request goes its way even if this process ends or stands still.
    async fn call(&self, request: Request) -> Reply {
        let (world, process) = (&self.world, self.process);
        let fault = world.next_fault(process, request.kind());
        let slot = Rc::new(Slot { reply: RefCell::default(), arrived: Signal::new(&world.sim) });
        world.sim.spawn(ENVIRONMENT, travel(self.clone(), request, fault, Rc::clone(&slot)));
        tokio::select! {
            biased;
            () = slot.arrived.wait() => slot.reply.borrow_mut().take().expect("filled before the signal"),
            () = world.sim.sleep(process, TIMEOUT) => Err(broken()),
        }
    }

    fn connection(&self) -> Connection {
        self.world.processes[self.process].connection.get()
    }

    async fn pass(&self, time: Millis) {
        self.world.sim.sleep(ENVIRONMENT, time).await;
    }

    pub async fn submit(&self, new: NewJob) -> Result<Job, StoreError> {
        expect!(self.call(Request::Submit(Box::new(new))).await, Job).map(|job| *job)
    }

    pub async fn get(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        expect!(self.call(Request::Get(id)).await, Found).map(|job| job.map(|job| *job))
    }

    pub async fn cancel(&self, id: JobId) -> Result<Option<CancelResult>, StoreError> {
        expect!(self.call(Request::Cancel(id)).await, Canceled)
    }

    pub async fn hold_key(&self, tenant: &str, key: &str, job: JobId) -> Result<KeyState, StoreError> {
        let request = Request::HoldKey { tenant: tenant.to_owned(), key: key.to_owned(), job };
        expect!(self.call(request).await, Key)
    }

    pub async fn release_key(&self, tenant: &str, key: &str, job: JobId) -> Result<(), StoreError> {
        self.call(Request::ReleaseKey { tenant: tenant.to_owned(), key: key.to_owned(), job }).await.map(drop)
    }

    pub async fn claim(&self, worker: &str) -> Result<Option<Claim>, StoreError> {
        let max_running = self.world.plan.max_running;
        let request = Request::Claim { worker: worker.to_owned(), max_running };
        expect!(self.call(request).await, Claimed).map(|claim| claim.map(|claim| *claim))
    }

    pub async fn heartbeat(&self, held: &Lease, progress: Option<JobProgress>) -> Result<(), StoreError> {
        self.call(Request::Heartbeat(held.clone(), progress)).await.map(drop)
    }

    pub async fn complete(&self, held: &Lease, completion: Completion) -> Result<Job, StoreError> {
        expect!(self.call(Request::Complete(held.clone(), Box::new(completion))).await, Job).map(|job| *job)
    }

    pub async fn fail(&self, held: &Lease, failure: Failure) -> Result<Job, StoreError> {
        expect!(self.call(Request::Fail(held.clone(), Box::new(failure))).await, Job).map(|job| *job)
    }

    pub async fn release(&self, held: &Lease) -> Result<(), StoreError> {
        self.call(Request::Release(held.clone())).await.map(drop)
    }

    pub async fn requeue_expired(&self) -> Result<Vec<Job>, StoreError> {
        expect!(self.call(Request::RequeueExpired).await, Requeued)
    }

    pub async fn claim_delivery(&self) -> Result<Option<DueDelivery>, StoreError> {
        expect!(self.call(Request::ClaimDelivery).await, Due).map(|due| due.map(|due| *due))
    }

    pub async fn settle_delivery(
        &self,
        due: &DueDelivery,
        attempt: DeliveryAttempt,
        result: DeliveryResult,
    ) -> Result<(), StoreError> {
        self.call(Request::Settle(Box::new(due.clone()), attempt, result)).await.map(drop)
    }
}

/// A request's way to the database and the answer's way back.
async fn travel(link: Link, request: Request, fault: Option<Fault>, slot: Rc<Slot>) {
    let world = Rc::clone(&link.world);
    let latency = 1 + hash(&[world.plan.seed, world.sim.now(), link.process as u64, request.kind() as u64]) % 4;
    if link.connection() == Connection::Down || fault == Some(Fault::LoseRequest) {
        link.pass(CONNECT).await;
        return slot.fill(Err(broken()));
    }
    let late = if let Some(Fault::DelayRequest(late)) = fault { late } else { 0 };
    link.pass(latency + late).await;
    if !world.is_database_up.get() {
        return slot.fill(Err(broken()));
    }
    if let Some(Fault::Repeat(after)) = fault {
        world.sim.spawn(ENVIRONMENT, repeat(link.clone(), request.clone(), after));
    }
    let reply = world.execute(link.process, request);
    let is_lost = fault == Some(Fault::LoseAnswer) || link.connection() != Connection::Up;
    if is_lost && let Some(database) = &world.backend.simulated {
        database.break_connection();
    }
    link.pass(latency).await;
    // Nobody learns of an answer that a partition swallows. A reset connection is noticed.
    if fault == Some(Fault::LoseAnswer) {
        slot.fill(Err(broken()));
    } else if !is_lost {
        slot.fill(reply);
    }
}

/// Executes a request again, and drops the answer.
async fn repeat(link: Link, request: Request, after: Millis) {
    link.pass(after).await;
    if link.world.is_database_up.get() {
        drop(link.world.execute(link.process, request));
    }
}
