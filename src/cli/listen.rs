use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

/// Longest time for a request's headers to come, and for a connection to stay open without one.
const HEADER_TIME: Duration = Duration::from_secs(30);
/// Open files that this process asks the operating system for; connections may take half of what it gets.
const OPEN_FILES: u64 = 65_536;
/// Pause after a connection could not be taken, which is mostly for want of open files.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// Serves until `stop`, then finishes the connections that are open. Silent connections are closed, and there are never
/// so many that workers run out of open files: more wait to be taken.
pub async fn listen(listener: TcpListener, router: Router, stop: CancellationToken) {
    let files = rlimit::increase_nofile_limit(OPEN_FILES).unwrap_or(1024);
    let most = usize::try_from(files / 2).unwrap_or(512);
    let places = Arc::new(Semaphore::new(most));
    let open = GracefulShutdown::new();
    loop {
        let accepted = async {
            let place = Arc::clone(&places).acquire_owned().await;
            (place, listener.accept().await)
        };
        let (place, accepted) = tokio::select! {
            accepted = accepted => accepted,
            () = stop.cancelled() => break,
        };
        let stream = match accepted {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::warn!(%error, "a connection could not be taken");
                tokio::time::sleep(ACCEPT_PAUSE).await;
                continue;
            }
        };
        let _ = stream.set_nodelay(true);
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(HEADER_TIME)
            .serve_connection(TokioIo::new(stream), TowerToHyperService::new(router.clone()));
        let connection = open.watch(connection);
        tokio::spawn(async move {
            // A client that hangs up or talks nonsense is no news.
            let ended = connection.await;
            tracing::debug!(ended = ?ended.err(), "connection closed");
            drop(place);
        });
    }
    drop(listener);
    open.shutdown().await;
}
