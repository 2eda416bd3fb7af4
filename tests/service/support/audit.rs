//! Invariants of a service on PostgreSQL that must hold after it has recovered from any fault.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use serde_json::Value;
use sqlx::PgPool;

use super::receiver::Receiver;

/// How long no job and no message may end before the audit fails.
const PATIENCE: Duration = Duration::from_secs(60);

/// Records every end of a job in the database with a trigger.
pub struct Audit {
    pub pool: PgPool,
}

impl Audit {
    pub async fn begin(url: &str) -> Self {
        let pool = PgPool::connect(url).await.expect("a connection");
        for statement in [
            "CREATE TABLE audit (id TEXT NOT NULL, status TEXT NOT NULL)",
            "CREATE FUNCTION note_end() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN \
                 INSERT INTO audit VALUES (NEW.id, NEW.status); RETURN NULL; END $$",
            "CREATE TRIGGER ends AFTER UPDATE ON jobs FOR EACH ROW \
                 WHEN (NEW.finished_at IS NOT NULL AND OLD.status IS DISTINCT FROM NEW.status) EXECUTE FUNCTION note_end()",
        ] {
            sqlx::query(statement).execute(&pool).await.expect("made");
        }
        Self { pool }
    }

    /// Waits until every job has ended and every message has been delivered.
    pub async fn at_rest(&self) {
        let (mut least, mut since) = (i64::MAX, Instant::now());
        while least > 0 {
            let open: Result<i64, _> = sqlx::query_scalar(
                "SELECT (SELECT count(*) FROM jobs WHERE finished_at IS NULL) \
                      + (SELECT count(*) FROM webhook_deliveries WHERE status = 'pending')",
            )
            .fetch_one(&self.pool)
            .await;
            match open {
                Ok(open) if open < least => (least, since) = (open, Instant::now()),
                open => assert!(since.elapsed() < PATIENCE, "{open:?} jobs and messages do not end"),
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// Asserts that every accepted job exists and that every job ended once. Returns the number of jobs.
    pub async fn ended_once(&self, accepted: &[String]) -> usize {
        let ends: Vec<(String, i64)> = sqlx::query_as("SELECT id, count(*) FROM audit GROUP BY id")
            .fetch_all(&self.pool)
            .await
            .expect("the audit");
        let twice: Vec<_> = ends.iter().filter(|(_, count)| *count != 1).collect();
        assert!(twice.is_empty(), "{twice:?}");
        let ended: BTreeSet<&String> = ends.iter().map(|(id, _)| id).collect();
        let unique: BTreeSet<&String> = accepted.iter().collect();
        assert_eq!(unique.len(), accepted.len(), "each request created its own job");
        assert!(unique.is_subset(&ended), "lost: {:?}", unique.difference(&ended));
        ended.len()
    }

    /// Asserts that the receiver got one correct message about every job, possibly several times. Returns the number received.
    pub async fn delivered_once(&self, receiver: &Receiver) -> usize {
        let stored: Vec<(String, String, Option<String>, Option<String>)> = sqlx::query_as(
            "SELECT j.id, j.status, m.id, d.status FROM jobs j LEFT JOIN webhook_messages m ON m.job_id = j.id \
             LEFT JOIN webhook_deliveries d ON d.message_id = m.id WHERE j.finished_at IS NOT NULL",
        )
        .fetch_all(&self.pool)
        .await
        .expect("messages");
        let mut received: BTreeMap<String, BTreeSet<(String, String)>> = BTreeMap::new();
        let seen = receiver.seen();
        for message in &seen {
            let event = message.json();
            let job = event["data"]["id"].as_str().expect("an id").to_owned();
            let kind = event["type"].as_str().expect("a type").to_owned();
            received.entry(job).or_default().insert((message.id(), kind));
        }
        let mut checked = BTreeSet::new();
        for (job, status, message, delivery) in &stored {
            assert!(checked.insert(job), "{job} has more than one message");
            assert_eq!(delivery.as_deref(), Some("delivered"), "{job}");
            let right = (message.clone().expect("a message"), format!("job.{status}"));
            assert_eq!(received.remove(job), Some(BTreeSet::from([right])), "{job}");
        }
        assert!(received.is_empty(), "messages about jobs that never ended: {received:?}");
        seen.len()
    }

    /// The keys of all files that jobs own.
    pub async fn owned(&self) -> BTreeSet<String> {
        let rows: Vec<(String, String)> = sqlx::query_as("SELECT inputs, artifacts FROM jobs WHERE purged_at IS NULL")
            .fetch_all(&self.pool)
            .await
            .expect("jobs");
        let json = |text: &str| serde_json::from_str::<Value>(text).expect("JSON");
        // Pictures that were not requested have no key.
        let key = |file: &Value| file["key"].as_str().map(str::to_owned);
        let keys = rows.iter().flat_map(|(inputs, artifacts)| {
            let inputs: Vec<_> = json(inputs).as_array().expect("a list").iter().filter_map(key).collect();
            let artifacts = json(artifacts).as_object().expect("files").values().filter_map(key).collect();
            [inputs, artifacts].concat()
        });
        keys.collect()
    }
}
