//! Whether every end is announced once.

use std::collections::BTreeSet;

use meshmend::jobs::{DeliveryResult, DueDelivery, Job, JobId};

use super::{Invariant, Witness};
use crate::request::DELIVERY_LEASE;

/// The witness's account of a delivery.
#[derive(Default)]
pub(super) struct DeliveryView {
    token: Option<String>,
    held_until: i64,
    result: Option<DeliveryResult>,
}

/// The messages about a job that its receiver got.
#[derive(Default)]
pub(super) struct Announcements {
    sent: u32,
    /// Receivers recognize a repeated message by its id.
    messages: BTreeSet<String>,
    is_closed: bool,
}

impl Witness {
    pub(super) fn delivery_claimed(&mut self, now: i64, due: &DueDelivery) {
        let view = self.deliveries.entry(due.id.clone()).or_default();
        let is_delivered = view.result == Some(DeliveryResult::Delivered);
        let is_held = view.token.is_some() && view.held_until > now;
        let held_until = now + i64::try_from(DELIVERY_LEASE.as_millis()).expect("short");
        *view = DeliveryView { token: Some(due.token.clone()), held_until, result: view.result };
        self.require(!is_delivered, Invariant::EveryEndIsAnnouncedOnce, || {
            format!("{} is sent again after it was delivered", due.message)
        });
        self.require(!is_held, Invariant::LeasesAreExclusive, || format!("two dispatchers hold {}", due.message));
    }

    pub(super) fn settled(&mut self, due: &DueDelivery, result: DeliveryResult) {
        let view = self.deliveries.entry(due.id.clone()).or_default();
        if view.token.as_ref() != Some(&due.token) {
            return;
        }
        view.token = None;
        view.result = Some(result);
        if matches!(result, DeliveryResult::Delivered | DeliveryResult::Failed) {
            let id = due.payload.split("\"id\":\"").nth(1).and_then(|rest| rest.split('"').next()?.parse().ok());
            self.announcements.entry(id.expect("a job's id")).or_default().is_closed = true;
        }
    }

    /// Counts a message that is sent, and returns how many were sent about the job.
    pub fn sent(&mut self, id: JobId) -> u32 {
        let announcements = self.announcements.entry(id).or_default();
        announcements.sent += 1;
        announcements.sent
    }

    /// A receiver got a message that the job ended with this status.
    pub fn received(&mut self, id: JobId, message: &str, status: &str) {
        let announcements = self.announcements.entry(id).or_default();
        announcements.messages.insert(message.to_owned());
        let count = announcements.messages.len();
        let is_true = self.jobs.get(&id).is_some_and(|view| view.row.status.as_str() == status);
        self.require(count == 1, Invariant::EveryEndIsAnnouncedOnce, || format!("{count} messages announce {id}"));
        self.require(is_true, Invariant::EveryEndIsAnnouncedOnce, || format!("{id} has not {status}"));
    }

    /// Whether nothing remains to be announced about a job.
    pub(super) fn is_announced(&self, row: &Job) -> bool {
        row.callback_url.is_none()
            || self.announcements.get(&row.id).is_some_and(|announcements| announcements.is_closed)
    }
}
