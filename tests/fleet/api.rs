//! API processes and their clients. A submission makes the calls of `src/api/submit.rs` and `src/api/idempotency.rs`; the delivery of
//! messages those of `src/webhooks/dispatcher.rs`.

use std::cell::Cell;
use std::rc::Rc;

use meshmend::access::IdSource;
use meshmend::format::Format;
use meshmend::jobs::{
    DeliveryAttempt, DeliveryResult, DueDelivery, Input, Job, JobId, JobOptions, KeyState, NewJob, RequestKey,
    StoreError,
};
use meshmend::webhooks::Schedule;
use time::OffsetDateTime;

use super::database::Guard;
use super::executor::{Millis, Signal};
use super::network::Link;
use super::plan::{APIS, ENVIRONMENT, Event};
use super::world::World;

/// How often to look for deliveries when no notification arrives.
const POLL: Millis = 2_000;
/// After this time a client gives up on a response.
const CLIENT_TIMEOUT: Millis = 20_000;
/// The delays before retries of a message.
const RETRIES: &str = "1,2,3,5,5,5,5,5,5,5,5,5,5,5,5";

/// A client's request for a job.
#[derive(Clone)]
pub struct Submission {
    pub job: usize,
    pub tenant: u64,
    pub keyed: bool,
    pub called_back: bool,
}

/// Starts the tasks of an API process.
pub fn start(world: &Rc<World>, process: usize) {
    world.sim.spawn(process, dispatch(Link { world: Rc::clone(world), process }));
}

/// A client that submits a job. With an idempotency key it retries until the job is accepted.
pub async fn submit(world: Rc<World>, submission: Submission) {
    for nth in 1_u32.. {
        let process = APIS[(submission.job + nth as usize) % APIS.len()];
        let reply = Rc::new(Cell::new(None));
        let arrived = Signal::new(&world.sim);
        if world.processes[process].is_up.get() {
            let handler = handle(Link { world: Rc::clone(&world), process }, submission.clone());
            let (answer, answered) = (Rc::clone(&reply), arrived.clone());
            world.sim.spawn(process, async move {
                answer.set(handler.await);
                answered.set();
            });
            tokio::select! {
                biased;
                () = arrived.wait() => {}
                () = world.sim.sleep(ENVIRONMENT, CLIENT_TIMEOUT) => {}
            }
        }
        let is_lost = world.plan.events.contains(&Event::LoseReply { job: submission.job, nth });
        if let Some(id) = reply.get().filter(|_| !is_lost) {
            world.note(|| format!("client of job {} has its answer", submission.job));
            world.witness.borrow_mut().acknowledged(id);
            break;
        }
        if !submission.keyed {
            break;
        }
        world.sim.sleep(ENVIRONMENT, 1_000).await;
    }
    world.busy_clients.set(world.busy_clients.get() - 1);
}

/// Handles `POST /v1/jobs`. Returns the job of a 202, and nothing for any other response.
async fn handle(link: Link, submission: Submission) -> Option<JobId> {
    let world = &link.world;
    let tenant = format!("t{}-{}", submission.tenant, world.backend.number);
    let id: JobId = format!("job_{}", world.backend.ids.sortable().simple()).parse().expect("an id");
    world.numbers.borrow_mut().insert(id, submission.job);
    let key = submission.keyed.then(|| format!("key-{}", submission.job));
    if let Some(key) = &key {
        match link.hold_key(&tenant, key, id).await {
            Ok(KeyState::Held) => {}
            Ok(KeyState::Used { job, .. }) => return link.get(job).await.ok()?.map(|job| job.id),
            Ok(KeyState::InUse) => return None,
            Err(_) => {
                let _ = link.release_key(&tenant, key, id).await;
                return None;
            }
        }
    }
    world.files.borrow_mut().insert((id, String::new()));
    let mut new = NewJob::new(id, &tenant, vec![input(id)], JobOptions::default());
    new.key = key.clone().map(|key| RequestKey { key, fingerprint: "same".to_owned() });
    new.callback_url = submission.called_back.then(|| "https://shop.example/hook".to_owned());
    match record(&link, new).await {
        Ok(job) => Some(job.id),
        Err(is_certain) => {
            if is_certain {
                world.files.borrow_mut().remove(&(id, String::new()));
            }
            if let Some(key) = &key {
                let _ = link.release_key(&tenant, key, id).await;
            }
            None
        }
    }
}

/// Inserts a job into the store. The error says whether the store certainly has no record of the job.
async fn record(link: &Link, new: NewJob) -> Result<Job, bool> {
    let id = new.id;
    match link.submit(new).await {
        Err(error) if error.is_transient() => match link.get(id).await {
            Ok(Some(job)) => Ok(job),
            found => {
                let may_take_effect = error.may_take_effect() && link.world.has(Guard::UnknownSubmissionKeepsItsFiles);
                Err(found.is_ok() && !may_take_effect)
            }
        },
        submitted => submitted.map_err(|_: StoreError| true),
    }
}

fn input(id: JobId) -> Input {
    Input { key: id.to_string(), name: "a.stl".into(), bytes: 684, sha256: "00".into(), format: Format::Stl }
}

/// A client that cancels a job, if the job was accepted.
pub async fn cancel(world: Rc<World>, job: usize) {
    let process = APIS[job % APIS.len()];
    let ids: Vec<JobId> =
        world.numbers.borrow().iter().filter(|(_, number)| **number == job).map(|(id, _)| *id).collect();
    if world.processes[process].is_up.get() {
        for id in ids {
            let link = Link { world: Rc::clone(&world), process };
            world.sim.spawn(process, async move { drop(link.cancel(id).await) });
        }
    }
}

/// Claims deliveries and sends them.
async fn dispatch(link: Link) {
    let (world, process) = (&link.world, link.process);
    loop {
        if let Ok(Some(due)) = link.claim_delivery().await {
            world.sim.spawn(process, deliver(link.clone(), due));
            continue;
        }
        tokio::select! {
            biased;
            () = world.processes[process].deliveries.take() => {}
            () = world.sim.sleep(process, POLL) => {}
        }
    }
}

/// Sends a message and records the result, without retries.
async fn deliver(link: Link, due: DueDelivery) {
    let (world, process) = (&link.world, link.process);
    world.sim.sleep(process, 30).await;
    let is_delivered = world.receive(&due);
    world.sim.sleep(process, 30).await;
    let schedule: Schedule = RETRIES.parse().expect("a schedule");
    let retry = || schedule.wait(due.tries, 0).map_or(DeliveryResult::Failed, DeliveryResult::RetryAfter);
    let result = if is_delivered { DeliveryResult::Delivered } else { retry() };
    let at = OffsetDateTime::UNIX_EPOCH;
    let attempt = DeliveryAttempt { at, status: None, error: None, milliseconds: 60 };
    let _ = link.settle_delivery(&due, attempt, result).await;
}

impl World {
    /// A receiver gets a message. Returns whether the sender gets a good answer.
    fn receive(&self, due: &DueDelivery) -> bool {
        let between = |from: &str| due.payload.split(from).nth(1).and_then(|rest| rest.split('"').next());
        let id = between("\"id\":\"").and_then(|id| id.parse().ok()).expect("a job's id");
        let kind = between("\"type\":\"job.").expect("a type").to_owned();
        let (number, nth) = (self.numbers.borrow()[&id], self.witness.borrow_mut().sent(id));
        let fails = |received| self.plan.events.contains(&Event::Receiver { job: number, nth, received });
        if fails(false) {
            return false;
        }
        self.note(|| format!("receiver gets job.{kind} of job {number}"));
        self.witness.borrow_mut().received(id, &due.message, &kind);
        !fails(true)
    }
}
