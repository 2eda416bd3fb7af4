//! How jobs lose their content, and how their rows are deleted.

use std::time::Duration;

use async_trait::async_trait;

use super::{Dialect, SqlConnection, SqlStore, outbox, sql};
use crate::jobs::row::{Reader, corrupt, millis, to_json};
use crate::jobs::{Input, JobId, RetentionStore, StoreError};

/// Empties a row's content, except its inputs.
macro_rules! emptied {
    () => {
        "worker = NULL, lease_token = NULL, lease_expires_at = NULL, progress = NULL, report = NULL, artifacts = '{}', \
         metadata = '{}', callback_url = NULL, fingerprint = NULL, version = version + 1"
    };
}

#[async_trait]
impl<D: Dialect> RetentionStore for SqlStore<D> {
    async fn expire(&self, age: Duration, most: u32) -> Result<Vec<JobId>, StoreError> {
        let mut transaction = self.begin().await?;
        // Oldest first. Several processes may expire jobs at the same time.
        let old = sql(
            "SELECT id, inputs FROM jobs WHERE finished_at <= meshmend_now($1) - $2 AND status <> 'expired' AND purged_at IS NULL \
             ORDER BY finished_at, id LIMIT $3 FOR UPDATE SKIP LOCKED",
        )
        .bind(self.now())
        .bind(millis(age))
        .bind(most);
        let mut expired = Vec::new();
        for row in transaction.query(old).await? {
            let from = Reader::new(&row)?;
            let (id, inputs) = (from.parsed("id")?, without_content(&from.id, &from.text("inputs")?)?);
            let empty = sql(concat!("UPDATE jobs SET status = 'expired', inputs = $1, ", emptied!(), " WHERE id = $2"));
            transaction.execute(empty.bind(inputs).bind(id)).await?;
            expired.push(id);
        }
        transaction.commit().await?;
        expired.iter().for_each(|id| self.notify_job(*id));
        Ok(expired)
    }

    async fn forget_jobs(&self, age: Duration) -> Result<u64, StoreError> {
        let statement = sql(
            "DELETE FROM jobs WHERE finished_at <= meshmend_now($1) - $2 AND (status = 'expired' OR purged_at IS NOT NULL)",
        );
        self.writer().await?.execute(statement.bind(self.now()).bind(millis(age))).await
    }

    async fn purge(&self, id: JobId) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        let row = transaction.query_row(sql("SELECT id, inputs FROM jobs WHERE id = $1 FOR UPDATE").bind(id)).await?;
        let Some(row) = row else { return Ok(false) };
        let from = Reader::new(&row)?;
        let empty = sql(concat!(
            "UPDATE jobs SET purged_at = coalesce(purged_at, meshmend_now($1)), \
             status = CASE WHEN status IN ('queued', 'running') THEN 'canceled' ELSE status END, \
             finished_at = coalesce(finished_at, meshmend_now($1)), problem = NULL, inputs = $2, ",
            emptied!(),
            " WHERE id = $3"
        ))
        .bind(self.now())
        .bind(without_content(&from.id, &from.text("inputs")?)?)
        .bind(id);
        transaction.execute(empty).await?;
        outbox::delete_messages(&mut *transaction, id).await?;
        transaction.commit().await?;
        self.notify_job(id);
        Ok(true)
    }
}

/// Inputs without their names and checksums.
fn without_content(id: &str, inputs: &str) -> Result<String, StoreError> {
    let mut inputs: Vec<Input> = serde_json::from_str(inputs).map_err(|error| corrupt(id, "inputs", error))?;
    for input in &mut inputs {
        input.name.clear();
        input.sha256.clear();
    }
    Ok(to_json(&inputs))
}
