use std::fs::create_dir_all;
use std::io::Write;
use std::path::{Path, PathBuf};

use futures::StreamExt;
use meshmend::jobs::JobId;
use sha2::{Digest, Sha256};

use super::error::RemoteError;
use super::job::{RemoteFile, RemoteJob};
use super::service::Service;
use super::show::Row;
use crate::cli::files::temporary_beside;

/// Where files go that are downloaded.
#[derive(Debug, Clone)]
pub enum Target {
    /// To this place.
    File(PathBuf),
    /// Into this folder, which is made, under the names that the service gives.
    Folder(PathBuf),
}

impl Target {
    /// Sees that something can be written there, before a service works for it.
    pub fn check(&self, force: bool) -> Result<(), RemoteError> {
        let inside = match self {
            Self::File(path) if !force && path.exists() => return Err(exists(path)),
            Self::File(path) => path.clone(),
            Self::Folder(folder) => {
                create_dir_all(folder).map_err(|error| RemoteError::local(folder.display(), error))?;
                folder.join("any")
            }
        };
        temporary_beside(&inside).map_err(|error| RemoteError::local(inside.display(), error))?;
        Ok(())
    }

    fn path(&self, file: &RemoteFile) -> PathBuf {
        match self {
            Self::File(path) => path.clone(),
            // Whatever a service says, it stays in the folder.
            Self::Folder(folder) => folder.join(Path::new(&file.filename).file_name().unwrap_or("result".as_ref())),
        }
    }
}

/// Downloads a file of a job and gives its place; nothing where the job has no such file.
///
/// It is written beside its place and moved there when its SHA-256 is right. What is there already stays, unless `force` is set.
pub async fn download(
    service: &Service,
    job: &RemoteJob,
    name: &str,
    target: &Target,
    force: bool,
    row: &Row,
) -> Result<Option<PathBuf>, RemoteError> {
    let Some(file) = job.artifacts.get(name) else { return Ok(None) };
    let path = target.path(file);
    if !force && path.exists() {
        return Err(exists(&path));
    }
    if let Target::Folder(folder) = target {
        create_dir_all(folder).map_err(|error| RemoteError::local(folder.display(), error))?;
    }
    let waits = |error: &RemoteError, delay| row.waits(error, delay);
    service.persist(waits, async || fetch(service, job.id, name, file, &path, force, row).await).await?;
    Ok(Some(path))
}

async fn fetch(
    service: &Service,
    id: JobId,
    name: &str,
    file: &RemoteFile,
    path: &Path,
    force: bool,
    row: &Row,
) -> Result<(), RemoteError> {
    let failed = |error: std::io::Error| RemoteError::local(path.display(), error);
    row.moves("fetching", file.bytes.unwrap_or_default());
    let mut chunks = Box::pin(service.file(id, name).await?);
    let mut beside = temporary_beside(path).map_err(failed)?;
    let mut digest = Sha256::new();
    while let Some(chunk) = chunks.next().await {
        let chunk = chunk?;
        digest.update(&chunk);
        beside.write_all(&chunk).map_err(failed)?;
        row.moved(chunk.len() as u64);
    }
    if file.sha256.as_ref().is_some_and(|expected| *expected != hex::encode(digest.finalize())) {
        return Err(RemoteError::Damaged { name: path.display().to_string() });
    }
    let moved = if force { beside.persist(path) } else { beside.persist_noclobber(path) };
    moved.map(drop).map_err(|error| match error.error.kind() {
        std::io::ErrorKind::AlreadyExists => exists(path),
        _ => failed(error.error),
    })
}

fn exists(path: &Path) -> RemoteError {
    RemoteError::local(path.display(), "there is a file already; --force replaces it")
}
