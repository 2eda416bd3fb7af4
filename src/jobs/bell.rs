use tokio::sync::{Notify, broadcast};

use super::JobId;

/// Rings inside one process when a job changes or work arrives, so that waiting requests and idle workers need not
/// poll. A ring can be missed (another process has its own bell), so every listener also looks by itself now and then.
#[derive(Debug)]
pub struct Bell {
    changed: broadcast::Sender<JobId>,
    work: Notify,
    deliveries: Notify,
}

impl Default for Bell {
    fn default() -> Self {
        Self { changed: broadcast::channel(1024).0, work: Notify::new(), deliveries: Notify::new() }
    }
}

impl Bell {
    /// Tells that a job's row changed.
    pub fn ring(&self, id: JobId) {
        // No listener is no error.
        let _ = self.changed.send(id);
    }

    /// Tells one idle worker that there is a job to claim.
    pub fn ring_for_work(&self) {
        self.work.notify_one();
    }

    /// Tells who delivers webhooks that there is something to deliver.
    pub fn ring_for_deliveries(&self) {
        self.deliveries.notify_one();
    }

    /// A stream of the ids of jobs that change from now on. A listener that falls behind is told so and must look.
    #[must_use]
    pub fn listen(&self) -> broadcast::Receiver<JobId> {
        self.changed.subscribe()
    }

    /// Waits until there may be work.
    pub async fn work(&self) {
        self.work.notified().await;
    }

    /// Waits until there may be something to deliver.
    pub async fn deliveries(&self) {
        self.deliveries.notified().await;
    }
}
