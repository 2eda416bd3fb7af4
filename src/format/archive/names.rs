//! Names of files in an archive: from its root, parted by slashes, without `.` and `..`.

/// The name of an entry as the name of a file, without what some programs put before it; none where it leads out of the archive.
pub(super) fn inside(name: &str) -> Option<String> {
    let name = name.replace('\\', "/");
    let name = name.strip_prefix('/').unwrap_or(&name);
    let name = name.strip_prefix("./").unwrap_or(name);
    let leads_out = |segment: &str| matches!(segment, "" | "." | "..") || is_drive(segment);
    (!name.split('/').any(leads_out) && !name.contains('\0')).then(|| name.to_owned())
}

/// The file that `source` means by a path: absolute from the archive's root, else from its own folder. None where it leads out.
pub(in crate::format) fn resolve(source: &str, path: &str) -> Option<String> {
    let path = path.replace('\\', "/");
    let folder = if path.starts_with('/') { None } else { source.rsplit_once('/') };
    let mut segments: Vec<&str> = folder.map_or_else(Vec::new, |(folder, _)| folder.split('/').collect());
    for segment in path.split('/') {
        match segment {
            "" | "." => {}
            ".." => {
                segments.pop()?;
            }
            _ => segments.push(segment),
        }
    }
    inside(&segments.join("/"))
}

/// What names are compared by.
pub(in crate::format) fn key(name: &str) -> String {
    name.to_ascii_lowercase()
}

/// A reference as a path, where `%20` stands for a blank and so on.
pub(in crate::format) fn percent_decoded(reference: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(reference.len());
    let mut rest = reference.bytes();
    while let Some(byte) = rest.next() {
        if byte == b'%' {
            let digit = |b: Option<u8>| char::from(b?).to_digit(16);
            bytes.push(u8::try_from(digit(rest.next())? * 16 + digit(rest.next())?).ok()?);
        } else {
            bytes.push(byte);
        }
    }
    String::from_utf8(bytes).ok()
}

/// `C:`, as paths of Windows begin.
fn is_drive(segment: &str) -> bool {
    matches!(segment.as_bytes(), [letter, b':', ..] if letter.is_ascii_alphabetic())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_absolute_or_from_the_folder_of_its_source() {
        let resolve = |path| resolve("a/b.obj", path);
        assert_eq!(resolve("/c.mtl").as_deref(), Some("c.mtl"));
        assert_eq!(resolve("d\\.\\c 1.mtl").as_deref(), Some("a/d/c 1.mtl"));
        assert_eq!(resolve("../e/c.png").as_deref(), Some("e/c.png"));
        for out in ["../../f", "/../f", "C:\\f"] {
            assert_eq!(resolve(out), None, "{out}");
        }
    }

    #[test]
    fn an_entry_that_leads_out_is_no_file() {
        assert_eq!(inside("3D\\a.model").as_deref(), Some("3D/a.model"));
        assert_eq!(inside("/3D/a.model").as_deref(), Some("3D/a.model"));
        assert_eq!(inside("./a 12:30.obj").as_deref(), Some("a 12:30.obj"));
        for out in ["../a", "3D/../../a", "//a", "C:/a", "c:a", "", "a/./b", "..\\a", "a\0"] {
            assert_eq!(inside(out), None, "{out}");
        }
    }

    #[test]
    fn escapes_are_read_and_bad_ones_are_none() {
        assert_eq!(percent_decoded("c%20d%C3%A9.png").as_deref(), Some("c dé.png"));
        for bad in ["%", "%4", "%zz", "%ff"] {
            assert_eq!(percent_decoded(bad), None, "{bad}");
        }
    }
}
