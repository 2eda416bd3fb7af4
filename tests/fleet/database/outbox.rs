//! The outbox: messages about ends, and their deliveries.

use std::time::Duration;

use async_trait::async_trait;
use meshmend::jobs::{
    Backlog, Delivery, DeliveryAttempt, DeliveryQuery, DeliveryResult, DeliveryStatus, DeliveryStore, DueDelivery, Job,
    JobId, Page, RedeliveryResult, StoreError,
};

use super::{Guard, SimDatabase, Tables, time_of};

const UNUSED: &str = "no process of the fleet calls this";

/// A row of the table of deliveries, with its message.
pub(super) struct DeliveryRow {
    id: String,
    message: String,
    tenant: String,
    job: JobId,
    kind: String,
    url: String,
    status: DeliveryStatus,
    tries: u32,
    attempts: Vec<DeliveryAttempt>,
    created_at: i64,
    next_at: i64,
    token: Option<String>,
}

impl DeliveryRow {
    fn is_due(&self, now: i64) -> bool {
        self.status == DeliveryStatus::Pending && self.next_at <= now
    }
}

impl SimDatabase {
    /// Commits the end of an attempt or a job, with the message about it.
    pub(super) fn end(&self, tables: &mut Tables, job: &Job, now: i64) {
        if job.status.is_final() {
            if self.has(Guard::MessageIsWrittenWithTheEnd) {
                self.add_message(tables, job, now);
            } else {
                tables.unannounced.push(job.clone());
            }
        }
        tables.sync();
    }

    fn add_message(&self, tables: &mut Tables, job: &Job, now: i64) {
        let Some(url) = job.callback_url.clone() else { return };
        let (message, id) = (self.new_id("msg"), self.new_id("whd"));
        tables.deliveries.push(DeliveryRow {
            id,
            message,
            tenant: job.tenant.clone(),
            job: job.id,
            kind: format!("job.{}", job.status.as_str()),
            url,
            status: DeliveryStatus::Pending,
            tries: 0,
            attempts: Vec::new(),
            created_at: now,
            next_at: now,
            token: None,
        });
    }

    /// Writes the messages of ended jobs, where the ending transaction did not. The process that ended a job does this in its next
    /// statement, so a broken connection prevents it.
    pub fn write_messages(&self) {
        let (now, tables) = (self.now(), &mut *self.tables());
        for job in std::mem::take(&mut tables.unannounced) {
            self.add_message(tables, &job, now);
        }
    }

    /// Forgets the messages of ended jobs that no statement wrote.
    pub fn break_connection(&self) {
        self.tables().unannounced.clear();
    }
}

#[async_trait]
impl DeliveryStore for SimDatabase {
    async fn send_ping(&self, _: &str, _: &str) -> Result<Option<String>, StoreError> {
        unreachable!("{UNUSED}")
    }

    async fn deliveries(&self, query: DeliveryQuery) -> Result<Page<Delivery, String>, StoreError> {
        let tables = self.tables();
        let about = tables.deliveries.iter().filter(|row| query.job.is_none_or(|job| row.job == job));
        let items = about.map(|row| Delivery {
            id: row.id.clone(),
            message: row.message.clone(),
            kind: row.kind.clone(),
            job: Some(row.job),
            endpoint: None,
            url: Some(row.url.clone()),
            status: row.status,
            attempts: row.attempts.clone(),
            created_at: time_of(row.created_at),
            next_at: time_of(row.next_at),
        });
        Ok(Page { items: items.collect(), next: None })
    }

    async fn redeliver(&self, _: &str, _: &str) -> Result<RedeliveryResult, StoreError> {
        unreachable!("{UNUSED}")
    }

    async fn claim_delivery(&self, lease: Duration, max: u32) -> Result<Option<DueDelivery>, StoreError> {
        let (now, tables) = (self.now(), &mut *self.tables());
        let mut turns: Vec<(usize, &str, &str)> = Vec::new();
        for row in tables.deliveries.iter().filter(|row| row.is_due(now)) {
            let is_under_way =
                |other: &&DeliveryRow| other.token.is_some() && other.tenant == row.tenant && other.next_at > now;
            let under_way = tables.deliveries.iter().filter(is_under_way).count();
            let own = tables.deliveries.iter().filter(|other| other.tenant == row.tenant && other.is_due(now));
            let next = own.min_by_key(|other| (other.next_at, &other.id)).expect("one is due");
            if under_way < max as usize {
                turns.push((under_way, &next.id, &row.tenant));
            }
        }
        let Some(id) = turns.iter().min().map(|(_, id, _)| (*id).to_owned()) else { return Ok(None) };
        let token = self.new_token();
        let row = tables.deliveries.iter_mut().find(|row| row.id == id).expect("found above");
        row.tries += 1;
        row.token = Some(token.clone());
        if self.has(Guard::DeliveryIsLeased) {
            row.next_at = now + i64::try_from(lease.as_millis()).expect("short");
        }
        let due = DueDelivery {
            id,
            token,
            tenant: row.tenant.clone(),
            endpoint: None,
            url: row.url.clone(),
            message: row.message.clone(),
            payload: format!("{{\"type\":\"{}\",\"data\":{{\"id\":\"{}\"}}}}", row.kind, row.job),
            secrets: None,
            tries: row.tries,
            attempts: row.attempts.clone(),
        };
        tables.sync();
        Ok(Some(due))
    }

    async fn settle_delivery(
        &self,
        due: &DueDelivery,
        attempt: DeliveryAttempt,
        result: DeliveryResult,
    ) -> Result<bool, StoreError> {
        let (now, tables) = (self.now(), &mut *self.tables());
        let row = tables.deliveries.iter_mut().find(|row| row.id == due.id).expect("deliveries are kept");
        if row.token.as_deref() == Some(due.token.as_str()) || !self.has(Guard::SettlementIsFenced) {
            row.status = result.status();
            if let DeliveryResult::RetryAfter(after) = result {
                row.next_at = now + i64::try_from(after.as_millis()).expect("short");
            }
            row.attempts = due.attempts.clone();
            row.attempts.push(attempt);
            row.token = None;
        }
        tables.sync();
        Ok(false)
    }

    async fn backlog(&self) -> Result<Backlog, StoreError> {
        unreachable!("{UNUSED}")
    }

    async fn forget_messages(&self, _: Duration) -> Result<u64, StoreError> {
        unreachable!("{UNUSED}")
    }
}
