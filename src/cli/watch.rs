use std::collections::BTreeSet;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Args;
use futures::StreamExt;
use futures::stream::FuturesUnordered;
use meshmend::jobs::{JobId, Status};
use tokio::time::Instant;

use super::exit;
use super::remote::{Desk, ServiceArgs, Target, TellArgs, Wanted};

/// Jobs that are followed at the same time.
const AT_ONCE: usize = 16;
/// How often to look for jobs that came.
const LOOK: Duration = Duration::from_secs(2);

/// Arguments of `meshmend watch`.
#[derive(Debug, Args)]
pub struct WatchArgs {
    /// The jobs' ids, as `submit` tells them. Without any, all that run and wait, and those that come, until it is interrupted.
    jobs: Vec<JobId>,
    #[command(flatten)]
    service: ServiceArgs,
    /// Folder that the results go into, under the names that the service gives them. It is made. Without it nothing is downloaded.
    #[arg(long, env = "MESHMEND_DOWNLOAD", value_name = "FOLDER")]
    download: Option<PathBuf>,
    #[command(flatten)]
    tell: TellArgs,
}

/// Runs `meshmend watch`.
pub fn run(args: &WatchArgs) -> ExitCode {
    let result = args.download.clone().map(Target::Folder);
    let checked = result.as_ref().map_or(Ok(()), |target| target.check(args.tell.force));
    let service = match checked.and_then(|()| args.service.open()) {
        Ok(service) => service,
        Err(error) => return exit::fail(error.code(), error),
    };
    let desk = Desk::new(service, &args.tell, Wanted { result, ..Wanted::default() });
    if args.jobs.is_empty() {
        return desk.run(watch_all(&desk));
    }
    let each = args.jobs.iter().map(|id| watch(&desk, id.to_string(), *id));
    let codes = futures::stream::iter(each).buffer_unordered(AT_ONCE);
    desk.run(codes.fold(exit::PRINTABLE, async |worst, code| worst.max(code)))
}

async fn watch(desk: &Desk<'_>, name: String, id: JobId) -> u8 {
    let row = desk.board.row(&name);
    desk.see_to_the_end(&row, &name, id).await
}

/// Follows what runs and what waits, the oldest first, until the service can't be asked any more.
async fn watch_all(desk: &Desk<'_>) -> u8 {
    let (mut seen, mut followed) = (BTreeSet::new(), FuturesUnordered::new());
    let row = desk.board.row(desk.service.address());
    loop {
        row.rests("looks for jobs");
        let look = async || Ok([desk.service.jobs(Status::Running).await?, desk.service.jobs(Status::Queued).await?]);
        let found = match desk.service.persist(|error, delay| row.waits(error, delay), look).await {
            Ok(found) => found,
            Err(error) => {
                desk.board.say(&format!("meshmend: {error}"));
                return error.code();
            }
        };
        for job in found.iter().flat_map(|jobs| jobs.iter().rev()) {
            if followed.len() < AT_ONCE && seen.insert(job.id) {
                followed.push(watch(desk, format!("{} {}", job.id, job.input.name), job.id));
            }
        }
        let next_look = Instant::now() + LOOK;
        while let Ok(ended) = tokio::time::timeout_at(next_look, followed.next()).await {
            if ended.is_none() {
                tokio::time::sleep_until(next_look).await;
            }
        }
    }
}
