use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use meshmend::jobs::{BackupError, SqliteStore};

use super::service::{ServiceError, start, to_stdout};
use super::settings::DataArgs;
use super::{database, exit};

/// Arguments of `meshmend backup`.
#[derive(Debug, Args)]
pub struct BackupArgs {
    /// The new file of the copy, or an existing folder that gets a file `meshmend.db`. A file that exists is not overwritten.
    #[arg(value_name = "FILE|FOLDER")]
    target: PathBuf,
    #[command(flatten)]
    data: DataArgs,
}

/// Runs `meshmend backup`.
pub fn run(args: &BackupArgs) -> ExitCode {
    if args.data.database_url.is_some() {
        return exit::fail(
            exit::BAD_INPUT,
            "backup copies a SQLite database, and --database-url (MESHMEND_DATABASE_URL) names a PostgreSQL database. \
             Copy that with `pg_dump --format=custom --file=meshmend.dump URL`.",
        );
    }
    start(&args.data, async { back_up(&args.data.data_dir, &args.target).await })
}

async fn back_up(data_dir: &Path, target: &Path) -> Result<(), ServiceError> {
    let source = database::file(data_dir);
    if !source.is_file() {
        return Err(ServiceError::Refused(format!(
            "--data-dir (MESHMEND_DATA_DIR): there is no database {}. Name the folder of the service.",
            source.display()
        )));
    }
    let target = if target.is_dir() { database::file(target) } else { target.to_owned() };
    SqliteStore::back_up(&source, &target).await.map_err(|error| match error {
        BackupError::Store(error) => database::sqlite_error(&source, &error),
        BackupError::Io(error) if error.kind() == io::ErrorKind::AlreadyExists => ServiceError::Refused(format!(
            "{}: the file exists and is not overwritten. Name another file.",
            target.display()
        )),
        BackupError::Io(error) => {
            ServiceError::Refused(format!("{}: the copy can't be written: {error}.", target.display()))
        }
    })?;
    to_stdout(&target.display().to_string())
}
