//! Names of parts in a package (ISO/IEC 29500-2, "Open Packaging Conventions"): absolute, without `.` and `..`.

/// A name in the archive as the name of a part, if it is one: without the slash at the start, and none that leads out of the package.
pub(super) fn of_entry(name: &str) -> Option<String> {
    let name = name.replace('\\', "/");
    let name = name.strip_prefix('/').unwrap_or(&name);
    let leads_out = name.split('/').any(|segment| matches!(segment, "" | "." | ".."));
    (!leads_out && !name.contains('\0') && !name.contains(':')).then(|| name.to_owned())
}

/// The part that a reference in `source` is for; none where it leads out of the package.
pub(super) fn resolve(source: &str, reference: &str) -> Option<String> {
    let reference = percent_decoded(reference).filter(|it| !it.is_empty())?;
    let mut segments: Vec<&str> = match reference.strip_prefix('/') {
        Some(_) => Vec::new(),
        None => source.rsplit_once('/').map_or_else(Vec::new, |(folder, _)| folder.split('/').collect()),
    };
    for segment in reference.split('/') {
        match segment {
            "" | "." => {}
            ".." => {
                segments.pop()?;
            }
            _ => segments.push(segment),
        }
    }
    of_entry(&segments.join("/"))
}

/// The part that holds the relationships of a part, or, with an empty name, of the package.
pub(super) fn relationships_of(part: &str) -> String {
    let (folder, name) = part.rsplit_once('/').unwrap_or(("", part));
    let slash = if folder.is_empty() { "" } else { "/" };
    format!("{folder}{slash}_rels/{name}.rels")
}

/// What names are compared by.
pub(super) fn key(name: &str) -> String {
    name.to_ascii_lowercase()
}

fn percent_decoded(reference: &str) -> Option<String> {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reference_is_absolute_or_from_the_folder_of_its_source() {
        let resolve = |reference| resolve("3D/a.model", reference);
        assert_eq!(resolve("/3D/b.model").as_deref(), Some("3D/b.model"));
        assert_eq!(resolve("Textures/./c%20d.png").as_deref(), Some("3D/Textures/c d.png"));
        assert_eq!(resolve("../Metadata/e.png").as_deref(), Some("Metadata/e.png"));
        for out in ["../../f", "/../f", "C:/f", "http://x/f", "%2e%2e/../f", "%zz", ""] {
            assert_eq!(resolve(out), None, "{out}");
        }
    }

    #[test]
    fn an_entry_that_leads_out_is_no_part() {
        assert_eq!(of_entry("3D\\a.model").as_deref(), Some("3D/a.model"));
        assert_eq!(of_entry("/3D/a.model").as_deref(), Some("3D/a.model"));
        for out in ["../a", "3D/../../a", "//a", "C:/a", "", "./a", "..\\a"] {
            assert_eq!(of_entry(out), None, "{out}");
        }
    }

    #[test]
    fn relationships_stand_beside_their_part() {
        assert_eq!(relationships_of(""), "_rels/.rels");
        assert_eq!(relationships_of("3D/a.model"), "3D/_rels/a.model.rels");
    }
}
