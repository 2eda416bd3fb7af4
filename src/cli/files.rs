use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use tempfile::NamedTempFile;

/// A file beside a place, which goes unless it is moved there, so that no half file is ever seen.
pub fn temporary_beside(path: &Path) -> std::io::Result<NamedTempFile> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    tempfile::Builder::new()
        .prefix(".meshmend-")
        .permissions(std::fs::Permissions::from_mode(0o644))
        .tempfile_in(folder)
}

/// Writes beside the place and then moves.
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<(), String> {
    let name = path.display();
    let mut file = temporary_beside(path).map_err(|e| format!("{name}: {e}"))?;
    file.write_all(bytes).map_err(|e| format!("{name}: {e}"))?;
    file.persist(path).map_err(|e| format!("{name}: {}", e.error))?;
    Ok(())
}
