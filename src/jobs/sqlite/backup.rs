use std::fs::File;
use std::io;
use std::path::Path;

use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{ConnectOptions, Connection};

use super::SqliteStore;
use crate::jobs::StoreError;

/// Why a database could not be copied.
#[derive(Debug, thiserror::Error)]
pub enum BackupError {
    /// The database could not be read, or the copy not be written.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The copy could not be put in its place, which may be taken.
    #[error(transparent)]
    Io(#[from] io::Error),
}

impl SqliteStore {
    /// Copies the database in the file `source` to the new file `target`, which only this user may read. Other processes may go on
    /// writing: the copy holds what was committed when it began. Tables are not brought up to date, so that an older database can
    /// be saved before an upgrade.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`] when there is a file at `target`, which is left as it is.
    pub async fn back_up(source: &Path, target: &Path) -> Result<(), BackupError> {
        if target.try_exists()? {
            return Err(io::Error::from(io::ErrorKind::AlreadyExists).into());
        }
        let folder = target.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        // No other program sees a copy that is not whole. The file is private from its creation, and SQLite accepts an empty one.
        let copy = tempfile::Builder::new().prefix(".meshmend-backup-").tempfile_in(folder)?;
        let options = SqliteConnectOptions::new().filename(source).read_only(true);
        let mut connection: SqliteConnection = options.connect().await.map_err(StoreError::from)?;
        let path = copy.path().to_string_lossy().into_owned();
        let copied = sqlx::query("VACUUM INTO ?").bind(path).execute(&mut connection).await;
        copied.map_err(StoreError::from)?;
        connection.close().await.map_err(StoreError::from)?;
        // `VACUUM INTO` does not wait for the disk.
        copy.as_file().sync_all()?;
        copy.persist_noclobber(target).map_err(|error| error.error)?;
        File::open(folder)?.sync_all()?;
        Ok(())
    }
}
