//! Names of parts in a package (ISO/IEC 29500-2, "Open Packaging Conventions").

use crate::format::archive;

/// The part that a reference in `source` is for; none where it leads out of the package.
pub(super) fn resolve(source: &str, reference: &str) -> Option<String> {
    let path = archive::percent_decoded(reference).filter(|it| !it.is_empty())?;
    archive::resolve(source, &path).filter(|it| !it.contains(':'))
}

/// The part that holds the relationships of a part, or, with an empty name, of the package.
pub(super) fn relationships_of(part: &str) -> String {
    let (folder, name) = part.rsplit_once('/').unwrap_or(("", part));
    let slash = if folder.is_empty() { "" } else { "/" };
    format!("{folder}{slash}_rels/{name}.rels")
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
    fn relationships_stand_beside_their_part() {
        assert_eq!(relationships_of(""), "_rels/.rels");
        assert_eq!(relationships_of("3D/a.model"), "3D/_rels/a.model.rels");
    }
}
