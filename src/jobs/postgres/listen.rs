use std::sync::Arc;
use std::time::Duration;

use sqlx::postgres::{PgListener, PgPool};

use crate::jobs::{Bell, Status};

/// What the triggers of `migrations/postgres` notify.
const CHANNEL: &str = "meshmend_jobs";
/// The news that there is something to deliver.
const DELIVERIES: &str = "webhooks";
/// The news that there is something to draw.
const DRAWINGS: &str = "drawings";
/// How long to wait after the connection was lost.
const PAUSE: Duration = Duration::from_secs(1);

/// Rings the bell for whatever changes in the database, whoever changed it, as long as it runs.
pub(super) async fn ring(pool: PgPool, bell: Arc<Bell>) {
    loop {
        if let Err(error) = listen(&pool, &bell).await {
            tracing::warn!(%error, "the database can't be listened to; looking now and then meanwhile");
        }
        tokio::time::sleep(PAUSE).await;
    }
}

async fn listen(pool: &PgPool, bell: &Bell) -> Result<(), sqlx::Error> {
    let mut listener = PgListener::connect_with(pool).await?;
    listener.listen(CHANNEL).await?;
    // There may have been news before.
    bell.ring_for_work();
    bell.ring_for_deliveries();
    // None where the connection was lost.
    while let Some(told) = listener.try_recv().await? {
        match told.payload() {
            DELIVERIES => bell.ring_for_deliveries(),
            DRAWINGS => bell.ring_for_work(),
            _ => {}
        }
        let Some((id, status)) = told.payload().split_once(' ') else { continue };
        if let Ok(id) = id.parse() {
            bell.ring(id);
        }
        if status == Status::Queued.as_str() {
            bell.ring_for_work();
        }
    }
    Ok(())
}
