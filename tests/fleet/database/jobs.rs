//! Jobs and idempotency keys.

use async_trait::async_trait;
use meshmend::jobs::{
    CancelResult, IdempotencyStore, Job, JobId, JobStore, KEY_HOLD, KEY_LIFE, KeyState, ListQuery, NewJob, Page,
    Status, StatusCount, StoreError,
};

use super::{Guard, KeyRow, Row, SimDatabase, time_of};

const UNUSED: &str = "no process of the fleet calls this";

#[async_trait]
impl JobStore for SimDatabase {
    async fn submit(&self, new: NewJob) -> Result<Job, StoreError> {
        let (now, mut tables) = (self.now(), self.tables());
        if tables.jobs.contains_key(&new.id) {
            return Err(sqlx::Error::RowNotFound.into());
        }
        if let Some(request) = &new.key
            && self.has(Guard::KeyIsRecordedWithTheJob)
        {
            let key = tables.keys.get_mut(&(new.tenant.clone(), request.key.clone()));
            let key = key.filter(|key| key.job == new.id).ok_or(StoreError::KeyLost)?;
            key.fingerprint = Some(request.fingerprint.clone());
            key.expires_at = now + i64::try_from(KEY_LIFE.as_millis()).expect("short");
        }
        let row = Row {
            job: accepted(new, now),
            run_at: now,
            claimed_at: None,
            token: None,
            lease_expires_at: 0,
            ended_token: None,
        };
        let job = row.job.clone();
        tables.jobs.insert(job.id, row);
        if self.has(Guard::SubmissionWaitsForTheDisk) {
            tables.sync();
        } else {
            tables.unsynced.push((job.id, None));
        }
        Ok(job)
    }

    async fn get(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        Ok(self.tables().jobs.get(&id).map(|row| row.job.clone()))
    }

    async fn list(&self, _: ListQuery) -> Result<Page<Job, JobId>, StoreError> {
        unreachable!("{UNUSED}")
    }

    async fn find_result(&self, _: &str, _: &str) -> Result<Option<Job>, StoreError> {
        unreachable!("{UNUSED}")
    }

    async fn counts(&self) -> Result<Vec<StatusCount>, StoreError> {
        unreachable!("{UNUSED}")
    }

    async fn cancel(&self, id: JobId) -> Result<Option<CancelResult>, StoreError> {
        let (now, tables) = (self.now(), &mut *self.tables());
        let Some(row) = tables.jobs.get_mut(&id) else { return Ok(None) };
        if row.job.status.is_final() {
            let job = Box::new(row.job.clone());
            let is_canceled = job.status == Status::Canceled;
            return Ok(Some(if is_canceled { CancelResult::Canceled(job) } else { CancelResult::AlreadyEnded(job) }));
        }
        row.job.status = Status::Canceled;
        row.job.finished_at = Some(time_of(now));
        let token = row.token.clone();
        row.drop_lease();
        if !self.has(Guard::CancellationRevokesTheLease) {
            row.token = token;
        }
        let job = row.job.clone();
        self.end(tables, &job, now);
        Ok(Some(CancelResult::Canceled(Box::new(job))))
    }
}

/// A new job as it is stored.
fn accepted(new: NewJob, now: i64) -> Job {
    Job {
        id: new.id,
        tenant: new.tenant,
        api_key_id: new.api_key_id,
        status: Status::Queued,
        outcome: None,
        progress: None,
        attempt: 0,
        crashes: 0,
        created_at: time_of(now),
        started_at: None,
        finished_at: None,
        run_at: time_of(now),
        inputs: new.inputs,
        options: new.options,
        metadata: new.metadata,
        callback_url: new.callback_url,
        reused_from: None,
        report: None,
        artifacts: Default::default(),
        problem: None,
        traceparent: new.traceparent,
        version: 1,
        purged: false,
    }
}

#[async_trait]
impl IdempotencyStore for SimDatabase {
    async fn hold_key(&self, tenant: &str, key: &str, job: JobId) -> Result<KeyState, StoreError> {
        let (now, mut tables) = (self.now(), self.tables());
        let expires_at = now + i64::try_from(KEY_HOLD.as_millis()).expect("short");
        let name = (tenant.to_owned(), key.to_owned());
        let state = match tables.keys.get(&name) {
            Some(row) if row.expires_at > now && (row.job != job || row.fingerprint.is_some()) => {
                let used = |fingerprint: &String| KeyState::Used { fingerprint: fingerprint.clone(), job: row.job };
                return Ok(row.fingerprint.as_ref().map_or(KeyState::InUse, used));
            }
            _ => KeyState::Held,
        };
        tables.keys.insert(name, KeyRow { job, fingerprint: None, expires_at });
        tables.sync();
        Ok(state)
    }

    async fn release_key(&self, tenant: &str, key: &str, job: JobId) -> Result<(), StoreError> {
        let mut tables = self.tables();
        let name = (tenant.to_owned(), key.to_owned());
        if tables.keys.get(&name).is_some_and(|row| row.job == job && row.fingerprint.is_none()) {
            tables.keys.remove(&name);
        }
        tables.sync();
        Ok(())
    }

    async fn forget_keys(&self) -> Result<u64, StoreError> {
        unreachable!("{UNUSED}")
    }
}
