//! The lines of a history's journal.

use std::collections::BTreeMap;

use meshmend::jobs::{CancelResult, Job, JobId, KeyState, StoreError};

use super::request::{Answer, Request};

type Numbers = BTreeMap<JobId, usize>;

fn number(numbers: &Numbers, id: JobId) -> String {
    numbers.get(&id).map_or_else(|| "?".to_owned(), |number| format!("job {number}"))
}

fn state(job: &Job) -> String {
    let Job { attempt, crashes, version, .. } = job;
    format!("{}, attempt {attempt}, {crashes} crashes, version {version}", job.status.as_str())
}

/// Whether a request looked for work and found none.
pub fn is_idle(request: &Request, answer: &Result<Answer, StoreError>) -> bool {
    match (request, answer) {
        (_, Ok(Answer::Claimed(None) | Answer::Due(None))) => true,
        (_, Ok(Answer::Requeued(jobs))) => jobs.is_empty(),
        _ => false,
    }
}

/// A request that the database executed, and what it returned.
pub fn executed(request: &Request, answer: &Result<Answer, StoreError>, numbers: &Numbers) -> String {
    let of = |id| number(numbers, id);
    let asked = match request {
        Request::Submit(new) => format!("submit {}", of(new.id)),
        Request::Get(id) => format!("get {}", of(*id)),
        Request::Cancel(id) => format!("cancel {}", of(*id)),
        Request::HoldKey { key, .. } => format!("hold {key}"),
        Request::ReleaseKey { key, .. } => format!("release {key}"),
        Request::Claim { .. } => "claim".to_owned(),
        Request::Heartbeat(held, progress) => {
            let progress = if progress.is_some() { " with progress" } else { "" };
            format!("heartbeat {} attempt {}{progress}", of(held.id), held.attempt)
        }
        Request::Complete(held, _) => format!("complete {} attempt {}", of(held.id), held.attempt),
        Request::Fail(held, failure) => {
            format!("fail {} attempt {} ({:?})", of(held.id), held.attempt, failure.kind)
        }
        Request::Release(held) => format!("release {} attempt {}", of(held.id), held.attempt),
        Request::RequeueExpired => "requeue expired".to_owned(),
        Request::ClaimDelivery => "claim delivery".to_owned(),
        Request::Settle(_, _, result) => format!("settle delivery ({result:?})"),
    };
    format!("{asked}: {}", returned(answer, numbers))
}

fn returned(answer: &Result<Answer, StoreError>, numbers: &Numbers) -> String {
    match answer {
        Ok(Answer::Job(job)) => state(job),
        Ok(Answer::Found(Some(job))) => state(job),
        Ok(Answer::Canceled(Some(CancelResult::Canceled(job) | CancelResult::AlreadyEnded(job)))) => state(job),
        Ok(Answer::Key(KeyState::Used { job, .. })) => format!("used by {}", number(numbers, *job)),
        Ok(Answer::Key(key)) => format!("{key:?}"),
        Ok(Answer::Claimed(Some(claim))) => format!("{}, {}", number(numbers, claim.job.id), state(&claim.job)),
        Ok(Answer::Requeued(jobs)) => {
            let jobs = jobs.iter().map(|job| format!("{}, {}", number(numbers, job.id), state(job)));
            jobs.collect::<Vec<_>>().join("; ")
        }
        Ok(Answer::Due(Some(due))) => format!("{}, try {}", due.message, due.tries),
        Ok(Answer::Done | Answer::Settled) => "done".to_owned(),
        Ok(Answer::Found(None) | Answer::Canceled(None) | Answer::Claimed(None) | Answer::Due(None)) => {
            "none".to_owned()
        }
        Err(StoreError::Database(_)) => "refused by the database".to_owned(),
        Err(error) => error.to_string(),
    }
}
