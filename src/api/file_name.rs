use axum::http::{HeaderMap, header};

use super::extract::text_header;

/// Longest file name that is kept, in characters.
const NAME_CHARS: usize = 200;

/// The file name of a raw body's Content-Disposition.
pub(super) fn disposition_name(headers: &HeaderMap) -> Option<&str> {
    let value = text_header(headers, &header::CONTENT_DISPOSITION)?;
    value.split(';').find_map(|part| Some(part.trim().strip_prefix("filename=")?.trim_matches('"')))
}

/// A file name without folders and control characters; it is shown and handed back, never opened.
pub(super) fn clean_name(name: Option<&str>) -> String {
    let name = name.unwrap_or_default();
    let name = name.rsplit(['/', '\\']).next().unwrap_or_default();
    let name: String = name.chars().filter(|c| !c.is_control()).take(NAME_CHARS).collect();
    let name = name.trim();
    if name.is_empty() || name.chars().all(|c| c == '.') { "model".to_owned() } else { name.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_name_keeps_nothing_that_could_lead_elsewhere() {
        for (given, kept) in [
            (Some("bracket.stl"), "bracket.stl"),
            (Some("../../etc/passwd"), "passwd"),
            (Some("C:\\models\\a b.obj"), "a b.obj"),
            (Some("nul\0l\r\nX: y.stl"), "nullX: y.stl"),
            (Some(".."), "model"),
            (Some(""), "model"),
            (None, "model"),
            (Some("größe 日本.ply"), "größe 日本.ply"),
        ] {
            assert_eq!(clean_name(given), kept);
        }
        assert_eq!(clean_name(Some(&"x".repeat(1000))).len(), NAME_CHARS);
    }
}
