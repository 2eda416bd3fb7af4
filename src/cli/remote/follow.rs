use futures::{Stream, StreamExt};
use meshmend::jobs::{JobId, Status};
use serde::Deserialize;
use sse_stream::SseStream;

use super::error::RemoteError;
use super::job::{RemoteJob, RemoteProgress};
use super::service::Service;
use super::show::Row;

/// What an event `progress` says.
#[derive(Deserialize)]
struct Standing {
    status: Status,
    #[serde(flatten)]
    progress: RemoteProgress,
}

/// Follows a job until it has ended.
///
/// Its events are listened to. Where they break off, or something on the way does not let them through, the job is asked for, with an
/// answer that is held until its status changes, and then listened to again.
pub async fn follow(service: &Service, id: JobId, row: &Row) -> Result<RemoteJob, RemoteError> {
    loop {
        match service.events(id).await {
            Ok(events) => {
                if let Some(job) = listen(events, row).await {
                    return Ok(job);
                }
            }
            Err(error) if error.may_pass() || matches!(error, RemoteError::Strange { .. }) => {}
            Err(error) => return Err(error),
        }
        let job = service.persist(|error, delay| row.waits(error, delay), async || service.job(id, true).await).await?;
        if job.status.is_final() {
            return Ok(job);
        }
        if let Some(progress) = job.progress {
            row.stands(job.status, progress);
        }
    }
}

/// The job, if its end is told of before the events end.
async fn listen(events: impl Stream<Item = Result<bytes::Bytes, RemoteError>>, row: &Row) -> Option<RemoteJob> {
    let mut events = std::pin::pin!(SseStream::from_bytes_stream(events));
    while let Some(Ok(event)) = events.next().await {
        let data = event.data.unwrap_or_default();
        match event.event.as_deref() {
            Some("done") => return serde_json::from_str(&data).ok(),
            Some("progress") => {
                if let Ok(Standing { status, progress }) = serde_json::from_str(&data) {
                    row.stands(status, progress);
                }
            }
            _ => {}
        }
    }
    None
}
