use std::fmt::Display;
use std::time::Duration;

use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use crate::blobs::BlobError;
use crate::jobs::StoreError;

/// How long to try again what an attempt needs to begin or to end.
const PATIENCE: Duration = Duration::from_secs(600);

/// An error of something that may be away for a while.
pub(super) trait MayPass: Display {
    /// Whether the same may succeed in a while.
    fn may_pass(&self) -> bool;
}

impl MayPass for StoreError {
    fn may_pass(&self) -> bool {
        self.may_pass()
    }
}

impl MayPass for BlobError {
    fn may_pass(&self) -> bool {
        self.may_pass()
    }
}

/// Does it, and again while the database or the file store is away: the work is done, or could not be begun elsewhere either.
/// Between two tries it gives up when that is pointless, as `over` says.
pub(super) async fn patiently<T, E, F>(over: Option<&CancellationToken>, work: impl Fn() -> F) -> Result<T, E>
where
    E: MayPass,
    F: Future<Output = Result<T, E>>,
{
    let until = Instant::now() + PATIENCE;
    let mut pause = Duration::from_millis(100);
    loop {
        match work().await {
            Err(error)
                if error.may_pass() && Instant::now() < until && !over.is_some_and(CancellationToken::is_cancelled) =>
            {
                tracing::warn!(%error, "trying again");
                tokio::time::sleep(pause).await;
                pause = (pause * 2).min(Duration::from_secs(5));
            }
            result => return result,
        }
    }
}
