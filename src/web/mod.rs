//! The page that people see, the widget that shops embed and the frame of the documentation, as files in the program: they work offline,
//! and there is nothing else to deploy.
//!
//! Their sources are in `page/`, in TypeScript; `make page` builds them into `dist/`, which is committed, so that the program builds
//! without node. Assets have a hash of their bytes in their names and never change.

use std::borrow::Cow;
use std::io::Write;
use std::sync::OnceLock;

use flate2::Compression;
use flate2::write::GzEncoder;
use sha2::{Digest, Sha256};

mod dist {
    include!("dist/files.rs");
}

/// A file that is served as it is.
#[derive(Debug)]
pub struct File {
    /// Its media type.
    pub media_type: &'static str,
    plain: Cow<'static, [u8]>,
    etag: OnceLock<String>,
    packed: OnceLock<Vec<u8>>,
}

impl File {
    /// A file of that name, which tells its media type, with these bytes.
    pub fn new(name: &str, plain: impl Into<Cow<'static, [u8]>>) -> Self {
        Self { media_type: media_type(name), plain: plain.into(), etag: OnceLock::new(), packed: OnceLock::new() }
    }

    /// Its bytes.
    #[must_use]
    pub fn plain(&self) -> &[u8] {
        &self.plain
    }

    /// The entity tag of its bytes.
    #[must_use]
    pub fn etag(&self) -> &str {
        self.etag.get_or_init(|| format!("\"{}\"", hex::encode(&Sha256::digest(&self.plain)[..16])))
    }

    /// Its bytes in gzip, packed when they are first asked for; none of a picture, which is packed as it is.
    #[must_use]
    pub fn gzip(&self) -> Option<&[u8]> {
        let pack = || {
            let mut packer = GzEncoder::new(Vec::new(), Compression::best());
            // Memory takes all that is written.
            packer.write_all(&self.plain).and_then(|()| packer.finish()).unwrap_or_default()
        };
        (self.media_type != "image/png").then(|| self.packed.get_or_init(pack).as_slice())
    }
}

/// The document at `/`.
pub fn document() -> &'static File {
    static DOCUMENT: OnceLock<File> = OnceLock::new();
    DOCUMENT.get_or_init(|| File::new("index.html", dist::DOCUMENT.as_bytes()))
}

/// The script of the widget.
pub fn widget() -> &'static File {
    static WIDGET: OnceLock<File> = OnceLock::new();
    WIDGET.get_or_init(|| File::new("widget.js", dist::WIDGET.as_bytes()))
}

/// The frame of the documentation's pages: a document with `{title}`, `{summary}`, `{name}`, `{pages}`, `{sections}` and `{text}` in
/// place of what is of one page.
#[must_use]
pub fn manual() -> &'static str {
    dist::MANUAL
}

/// A file that a document or the widget asks for, by its name under `/assets/`.
#[must_use]
pub fn asset(name: &str) -> Option<&'static File> {
    static ASSETS: OnceLock<Vec<(&str, File)>> = OnceLock::new();
    let assets = ASSETS.get_or_init(|| dist::ASSETS.iter().map(|&(name, it)| (name, File::new(name, it))).collect());
    assets.iter().find(|(known, _)| *known == name).map(|(_, file)| file)
}

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
    fn every_file_that_a_document_names_is_there() {
        let text = std::str::from_utf8(document().plain()).expect("text");
        let named = |text: &'static str| text.split('"').filter_map(|word| word.strip_prefix("/assets/"));
        assert_eq!(named(text).count(), 3, "a style, a script and an icon: {text}");
        assert_eq!(named(manual()).count(), 2, "a style and an icon: {}", manual());
        for name in named(text).chain(named(manual())) {
            let file = asset(name).unwrap_or_else(|| panic!("there is no {name}"));
            assert_ne!(file.media_type, "application/octet-stream", "{name}");
        }
    }

    #[test]
    fn the_widget_loads_a_viewer_that_is_there_and_is_small_without_it() {
        let text = std::str::from_utf8(widget().plain()).expect("text");
        let named: Vec<&str> = text.split('"').filter_map(|word| word.strip_prefix("/assets/")).collect();
        assert_eq!(named.len(), 1, "the viewer: {named:?}");
        assert!(asset(named[0]).is_some_and(|file| file.media_type.starts_with("text/javascript")), "{named:?}");
        let packed = widget().gzip().expect("it is packed").len();
        assert!(packed < 40_000, "{packed} bytes");
    }

    #[test]
    fn a_packed_file_is_the_plain_one() {
        let file = document();
        let mut unpacked = Vec::new();
        GzDecoder::new(file.gzip().expect("it is packed")).read_to_end(&mut unpacked).expect("gzip");
        assert_eq!(unpacked, file.plain());
        assert!(file.gzip().is_some_and(|packed| packed.len() < unpacked.len()));
    }
}
