//! The web page, the widget that shops embed, and the template of the documentation pages, embedded in the program. They work offline and
//! need no separate deployment.
//!
//! Their TypeScript sources are in `page/`. `make page` builds them into `dist/`, which is committed, so that building the program needs no
//! Node.js. The names of assets contain a hash of their content, so an asset never changes.

use std::borrow::Cow;
use std::io::Write;
use std::sync::OnceLock;

use flate2::Compression;
use flate2::write::GzEncoder;
use sha2::{Digest, Sha256};

mod dist {
    include!("dist/files.rs");
}

/// A static file with its media type, entity tag and compressed form.
#[derive(Debug)]
pub struct StaticFile {
    /// The file's media type.
    pub media_type: &'static str,
    plain: Cow<'static, [u8]>,
    etag: OnceLock<String>,
    compressed: OnceLock<Vec<u8>>,
}

impl StaticFile {
    /// Creates a file from its bytes. The extension of `name` determines the media type.
    pub fn new(name: &str, plain: impl Into<Cow<'static, [u8]>>) -> Self {
        Self { media_type: media_type(name), plain: plain.into(), etag: OnceLock::new(), compressed: OnceLock::new() }
    }

    /// Returns the file's bytes.
    #[must_use]
    pub fn plain(&self) -> &[u8] {
        &self.plain
    }

    /// Returns the entity tag: a hash of the bytes.
    #[must_use]
    pub fn etag(&self) -> &str {
        self.etag.get_or_init(|| format!("\"{}\"", hex::encode(&Sha256::digest(&self.plain)[..16])))
    }

    /// Returns the file compressed with gzip, cached after the first call. `None` for PNG images, which are already compressed.
    #[must_use]
    pub fn gzip(&self) -> Option<&[u8]> {
        let pack = || {
            let mut packer = GzEncoder::new(Vec::new(), Compression::best());
            // Writing to memory can't fail.
            packer.write_all(&self.plain).and_then(|()| packer.finish()).unwrap_or_default()
        };
        (self.media_type != "image/png").then(|| self.compressed.get_or_init(pack).as_slice())
    }
}

/// Returns the HTML document at `/`.
pub fn document() -> &'static StaticFile {
    static DOCUMENT: OnceLock<StaticFile> = OnceLock::new();
    DOCUMENT.get_or_init(|| StaticFile::new("index.html", dist::DOCUMENT.as_bytes()))
}

/// Returns the widget's script.
pub fn widget() -> &'static StaticFile {
    static WIDGET: OnceLock<StaticFile> = OnceLock::new();
    WIDGET.get_or_init(|| StaticFile::new("widget.js", dist::WIDGET.as_bytes()))
}

/// Returns the HTML template of the documentation pages, with the placeholders `{title}`, `{summary}`, `{name}`, `{pages}`, `{sections}`
/// and `{text}`.
#[must_use]
pub fn manual() -> &'static str {
    dist::MANUAL
}

/// Returns an asset of the page, the widget or the documentation, by its name under `/assets/`.
#[must_use]
pub fn asset(name: &str) -> Option<&'static StaticFile> {
    static ASSETS: OnceLock<Vec<(&str, StaticFile)>> = OnceLock::new();
    let assets =
        ASSETS.get_or_init(|| dist::ASSETS.iter().map(|&(name, bytes)| (name, StaticFile::new(name, bytes))).collect());
    assets.iter().find(|(asset, _)| *asset == name).map(|(_, file)| file)
}

/// Returns the media type of a file, by its extension.
fn media_type(name: &str) -> &'static str {
    match name.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("md") => "text/markdown; charset=utf-8",
        Some("txt") => "text/plain; charset=utf-8",
        Some("png") => "image/png",
        Some("svg") => "image/svg+xml",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use flate2::read::GzDecoder;

    use super::*;

    #[test]
    fn every_asset_that_a_document_references_exists() {
        let text = std::str::from_utf8(document().plain()).expect("text");
        let references = |text: &'static str| text.split('"').filter_map(|word| word.strip_prefix("/assets/"));
        assert_eq!(references(text).count(), 3, "a style, a script and an icon: {text}");
        assert_eq!(references(manual()).count(), 2, "a style and an icon: {}", manual());
        for name in references(text).chain(references(manual())) {
            let file = asset(name).unwrap_or_else(|| panic!("there is no {name}"));
            assert_ne!(file.media_type, "application/octet-stream", "{name}");
        }
    }

    #[test]
    fn the_widget_references_an_existing_viewer_and_is_small_without_it() {
        let text = std::str::from_utf8(widget().plain()).expect("text");
        let references: Vec<&str> = text.split('"').filter_map(|word| word.strip_prefix("/assets/")).collect();
        assert_eq!(references.len(), 1, "the viewer: {references:?}");
        assert!(
            asset(references[0]).is_some_and(|file| file.media_type.starts_with("text/javascript")),
            "{references:?}"
        );
        let compressed = widget().gzip().expect("a compressible file").len();
        assert!(compressed < 42_000, "{compressed} bytes");
    }

    #[test]
    fn a_compressed_file_decompresses_to_the_original() {
        let file = document();
        let mut unpacked = Vec::new();
        GzDecoder::new(file.gzip().expect("it is compressed")).read_to_end(&mut unpacked).expect("gzip");
        assert_eq!(unpacked, file.plain());
        assert!(file.gzip().is_some_and(|compressed| compressed.len() < unpacked.len()));
    }
}
