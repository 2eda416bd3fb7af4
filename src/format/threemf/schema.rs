//! Names and values of the 3MF schema: namespaces, extensions, metadata names, part names and attribute values; and escaping of XML text.

use std::borrow::Cow;
use std::fmt::Write as _;
use std::str::FromStr;

use glam::{DAffine3, DMat3, DVec3};

use crate::format::archive;
use crate::format::errors::excerpt_up_to;
use crate::scene::{Note, Scene};

/// Namespace of the core specification.
pub(super) const CORE: &str = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02";
/// Namespace of the materials and properties extension.
pub(super) const MATERIAL: &str = "http://schemas.microsoft.com/3dmanufacturing/material/2015/02";
/// Namespace of drafts before the core specification. Meshes and build items are the same as in the final version, colours differ.
const DRAFT: &str = "http://schemas.microsoft.com/3dmanufacturing/2013/01";
const PRODUCTION: &str = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06";
const SCHEMA_INSTANCE: &str = "http://www.w3.org/2001/XMLSchema-instance";
const XML: &str = "http://www.w3.org/XML/1998/namespace";

/// The namespace of a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Namespace {
    /// No namespace.
    None,
    /// The core specification.
    Core,
    /// A draft of the core specification.
    Draft,
    /// The materials extension.
    Material,
    /// The production extension.
    Production,
    /// XML itself, as in `xml:lang`.
    /// To XML itself, as `xml:lang`.
    Xml,
    /// XML Schema, as in `xsi:type`.
    SchemaInstance,
    /// An unknown namespace, by its index in the reader's list.
    Other(u16),
}

impl Namespace {
    /// The namespace with this URI; `None` if it is unknown.
    pub fn known(uri: &str) -> Option<Self> {
        Some(match uri {
            "" => Self::None,
            CORE => Self::Core,
            DRAFT => Self::Draft,
            MATERIAL => Self::Material,
            PRODUCTION => Self::Production,
            XML => Self::Xml,
            SCHEMA_INSTANCE => Self::SchemaInstance,
            _ => return None,
        })
    }

    /// Whether the namespace has the elements of the core specification.
    pub fn is_core(self) -> bool {
        matches!(self, Self::Core | Self::Draft)
    }
}

/// Unsupported extensions: namespace, subject, and whether a model that requires the extension is complete without it.
const EXTENSIONS: [(&str, &str, bool); 13] = [
    ("http://schemas.microsoft.com/3dmanufacturing/slice/2015/07", "slices", true),
    ("http://schemas.microsoft.com/3dmanufacturing/trianglesets/2021/07", "triangle sets", true),
    ("http://schemas.microsoft.com/3dmanufacturing/production/alternatives/2021/04", "alternatives of objects", true),
    ("http://schemas.3mf.io/3dmanufacturing/production/alternatives/2021/04", "alternatives of objects", true),
    ("http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02", "beam lattices", false),
    ("http://schemas.microsoft.com/3dmanufacturing/beamlattice/balls/2020/07", "balls of beam lattices", false),
    ("http://schemas.microsoft.com/3dmanufacturing/securecontent/2019/04", "encrypted content", false),
    ("http://schemas.microsoft.com/3dmanufacturing/displacement/2022/07", "displacement", false),
    ("http://schemas.3mf.io/3dmanufacturing/displacement/2023/10", "displacement", false),
    ("http://schemas.3mf.io/3dmanufacturing/volumetric/2022/01", "volumetric data", false),
    ("http://schemas.3mf.io/3dmanufacturing/implicit/2023/12", "implicit functions", false),
    ("http://schemas.3mf.io/3dmanufacturing/booleanoperations/2023/07", "boolean operations", false),
    ("http://schemas.3mf.io/3dmanufacturing/toolpath/2019/05", "tool paths", false),
];

/// The subject of an extension; its URI if the extension is unknown.
pub(super) fn subject(uri: &str) -> String {
    let known = EXTENSIONS.iter().find(|(address, ..)| *address == uri);
    known.map_or_else(|| format!("'{}'", excerpt_up_to(100, uri.as_bytes())), |(_, subject, _)| (*subject).to_owned())
}

/// Whether a model that requires this extension is complete without it.
pub(super) fn is_optional_extension(uri: &str) -> bool {
    Namespace::known(uri).is_some() || EXTENSIONS.iter().any(|&(address, _, is_optional)| address == uri && is_optional)
}

/// Type of the relationship to the root model, or to a part with objects that it uses.
pub(super) const MODEL_RELATIONSHIP: &str = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel";
/// Type of the relationship to a texture.
pub(super) const TEXTURE_RELATIONSHIP: &str = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dtexture";

/// Metadata names that need no namespace (core specification, 3.4.1).
const NOTES: [&str; 9] = [
    "Title",
    "Designer",
    "Description",
    "Copyright",
    "LicenseTerms",
    "Rating",
    "CreationDate",
    "ModificationDate",
    "Application",
];

/// Namespace for metadata that needs one and has none.
pub(super) const OWN_NOTES_URI: &str = "urn:meshmend:notes";

/// Whether a metadata name needs no namespace.
pub(super) fn is_known_note(name: &str) -> bool {
    NOTES.contains(&name)
}

/// Namespaces that XML reserves for their own prefixes.
const RESERVED_NAMESPACES: [&str; 2] = ["http://www.w3.org/XML/1998/namespace", "http://www.w3.org/2000/xmlns/"];

/// The namespace with which a note is written; `None` if it needs none.
fn note_namespace(note: &Note) -> Option<&str> {
    match note.namespace.as_deref().filter(|uri| !uri.is_empty() && !RESERVED_NAMESPACES.contains(uri)) {
        None if is_known_note(&note.name) => None,
        None => Some(OWN_NOTES_URI),
        uri => uri,
    }
}

// Part names in a package (ISO/IEC 29500-2, "Open Packaging Conventions").

/// The part that a reference in `source` refers to; `None` if it points outside the package.
pub(super) fn resolve(source: &str, reference: &str) -> Option<String> {
    let path = archive::percent_decoded(reference).filter(|path| !path.is_empty())?;
    archive::resolve(source, &path).filter(|path| !path.contains(':'))
}

// Values of attributes.

/// A whole number below 2^31: `ST_ResourceID`, `ST_ResourceIndex`.
#[inline]
pub(super) fn index(value: &[u8]) -> Option<u32> {
    let digits = value.trim_ascii();
    if digits.is_empty() {
        return None;
    }
    digits.iter().try_fold(0_u32, |sum, &digit| match digit {
        b'0'..=b'9' => sum.checked_mul(10)?.checked_add(u32::from(digit - b'0')).filter(|&sum| sum < 1 << 31),
        _ => None,
    })
}

/// A finite decimal number: `ST_Number`.
#[inline]
pub(super) fn number(value: &[u8]) -> Option<f64> {
    let word = value.trim_ascii();
    // Rust also parses words such as `inf` and `NaN`, which 3MF does not allow.
    if !word.iter().all(|b| matches!(b, b'0'..=b'9' | b'.' | b'-' | b'+' | b'e' | b'E')) {
        return None;
    }
    f64::from_str(std::str::from_utf8(word).ok()?).ok().filter(|number| number.is_finite())
}

/// Words between white space.
pub(super) fn words(value: &[u8]) -> impl Iterator<Item = &[u8]> {
    value.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
}

/// Twelve numbers of a row-major matrix that multiplies row vectors from the right: `ST_Matrix3D`.
pub(super) fn matrix(value: &[u8]) -> Option<DAffine3> {
    let mut numbers = [0.0; 12];
    let mut all = words(value);
    for slot in &mut numbers {
        *slot = number(all.next()?)?;
    }
    let [m00, m01, m02, m10, m11, m12, m20, m21, m22, m30, m31, m32] = numbers;
    let matrix3 = DMat3::from_cols_array(&[m00, m01, m02, m10, m11, m12, m20, m21, m22]);
    all.next().is_none().then_some(DAffine3 { matrix3, translation: DVec3::new(m30, m31, m32) })
}

/// `#RRGGBB` or `#RRGGBBAA`: `ST_ColorValue`.
pub(super) fn color(value: &[u8]) -> Option<[u8; 4]> {
    let digits = value.trim_ascii().strip_prefix(b"#")?;
    let mut color = [0, 0, 0, 255];
    let channels = match digits.len() {
        6 | 8 => digits.chunks_exact(2),
        _ => return None,
    };
    for (channel, pair) in color.iter_mut().zip(channels) {
        let digit = |b: u8| char::from(b).to_digit(16);
        *channel = u8::try_from(digit(pair[0])? * 16 + digit(pair[1])?).ok()?;
    }
    Some(color)
}

/// `xs:boolean`.
pub(super) fn boolean(value: &[u8]) -> Option<bool> {
    match value.trim_ascii() {
        b"1" | b"true" => Some(true),
        b"0" | b"false" => Some(false),
        _ => None,
    }
}

/// The text without characters that XML forbids.
fn without_forbidden(text: &str) -> impl Iterator<Item = char> {
    text.chars().filter(|&c| c >= ' ' && !matches!(c, '\u{FFFE}' | '\u{FFFF}') || matches!(c, '\t' | '\n' | '\r'))
}

/// Replaces characters by references, and drops characters that XML forbids.
fn escaped<'t>(text: &'t str, escape: impl Fn(char) -> Option<&'static str>) -> Cow<'t, str> {
    let plain = |c: char| (' '..'\u{FFFE}').contains(&c) && escape(c).is_none();
    if text.chars().all(plain) {
        return Cow::Borrowed(text);
    }
    let mut whole = String::with_capacity(text.len() + 16);
    for c in without_forbidden(text) {
        match escape(c) {
            Some(reference) => whole.push_str(reference),
            None => whole.push(c),
        }
    }
    Cow::Owned(whole)
}

/// Escapes the value of an attribute in double quotes.
pub(super) fn attribute(text: &str) -> Cow<'_, str> {
    escaped(text, |c| match c {
        '&' => Some("&amp;"),
        '<' => Some("&lt;"),
        '>' => Some("&gt;"),
        '"' => Some("&quot;"),
        '\t' => Some("&#9;"),
        '\n' => Some("&#10;"),
        '\r' => Some("&#13;"),
        _ => None,
    })
}

/// Escapes the text of an element.
fn content(text: &str) -> Cow<'_, str> {
    escaped(text, |c| match c {
        '&' => Some("&amp;"),
        '<' => Some("&lt;"),
        '>' => Some("&gt;"),
        '\r' => Some("&#13;"),
        _ => None,
    })
}

/// A valid XML name without a prefix (`NCName`); invalid characters become `_`.
fn name(text: &str) -> String {
    let in_name =
        |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.') || (c > '\u{FF}' && c.is_alphabetic());
    let mut name: String = text.chars().map(|c| if in_name(c) { c } else { '_' }).collect();
    if !name.starts_with(|c: char| c == '_' || c.is_alphabetic()) {
        name.insert(0, '_');
    }
    name
}

/// Prefixes that are not available for metadata.
const RESERVED_PREFIXES: [&str; 3] = ["m", "xml", "xmlns"];

/// The prefix of each metadata namespace, in the order of first use.
pub(super) struct Prefixes<'s> {
    all: Vec<(String, &'s str)>,
}

impl<'s> Prefixes<'s> {
    /// Chooses prefixes for all metadata of a scene.
    pub fn of(scene: &'s Scene) -> Self {
        let mut prefixes = Self { all: Vec::new() };
        let of_objects = scene.objects.iter().flat_map(|object| &object.notes);
        let of_items = scene.items.iter().flat_map(|item| &item.notes);
        for note in scene.notes.iter().chain(of_objects).chain(of_items) {
            match note_namespace(note) {
                Some(OWN_NOTES_URI) => prefixes.add(Some("note"), OWN_NOTES_URI),
                Some(namespace) => prefixes.add(note.name.split_once(':').map(|(prefix, _)| prefix), namespace),
                None => {}
            }
        }
        prefixes
    }

    fn add(&mut self, wanted: Option<&str>, namespace: &'s str) {
        if self.all.iter().any(|(_, known)| *known == namespace) {
            return;
        }
        let free = |prefix: &String| {
            !RESERVED_PREFIXES.contains(&prefix.as_str()) && self.all.iter().all(|(taken, _)| taken != prefix)
        };
        let wanted = wanted.map(name).filter(free);
        let prefix = wanted.or_else(|| (1..).map(|number| format!("n{number}")).find(free));
        self.all.extend(prefix.map(|prefix| (prefix, namespace)));
    }

    /// The namespace declarations, as attributes of the root element.
    pub fn declarations(&self) -> String {
        self.all.iter().map(|(prefix, uri)| format!(" xmlns:{prefix}=\"{}\"", attribute(uri))).collect()
    }

    /// Writes notes as `metadata` elements. Of several with one name, only the first is written.
    pub fn write<'n>(&self, notes: impl Iterator<Item = &'n Note>, text: &mut String) {
        let mut written: Vec<String> = Vec::new();
        for note in notes {
            let local =
                note.namespace.as_ref().and(note.name.split_once(':')).map_or(note.name.as_str(), |(_, local)| local);
            let name = match note_namespace(note) {
                None => note.name.clone(),
                Some(namespace) => match self.all.iter().find(|(_, uri)| *uri == namespace) {
                    Some((prefix, _)) => format!("{prefix}:{}", qualified(local)),
                    None => continue,
                },
            };
            if written.contains(&name) {
                continue;
            }
            let preserve = if note.preserve { " preserve=\"1\"" } else { "" };
            let kind = note.kind.as_ref().map_or_else(String::new, |kind| format!(" type=\"{}\"", attribute(kind)));
            // Writing to a String can't fail.
            let _ = writeln!(text, "<metadata name=\"{name}\"{preserve}{kind}>{}</metadata>", content(&note.value));
            written.push(name);
        }
    }
}

/// A name after a prefix. A leading digit is kept, because names in use have one and readers accept it.
fn qualified(local: &str) -> String {
    let clean = name(local);
    match local.starts_with(|c: char| c.is_ascii_digit()) {
        true => clean[1..].to_owned(),
        false => clean,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reference_resolves_from_the_root_or_from_its_source_folder() {
        let resolve = |reference| resolve("3D/a.model", reference);
        assert_eq!(resolve("/3D/b.model").as_deref(), Some("3D/b.model"));
        assert_eq!(resolve("Textures/./c%20d.png").as_deref(), Some("3D/Textures/c d.png"));
        assert_eq!(resolve("../Metadata/e.png").as_deref(), Some("Metadata/e.png"));
        for out in ["../../f", "/../f", "C:/f", "http://x/f", "%2e%2e/../f", "%zz", ""] {
            assert_eq!(resolve(out), None, "{out}");
        }
    }

    #[test]
    fn numbers_are_decimal_and_finite() {
        assert_eq!(number(b" -1.5e1 "), Some(-15.0));
        assert_eq!(number(b".5"), Some(0.5));
        for refused in [&b"NaN"[..], b"inf", b"1e999", b"1,5", b"0x1", b"", b"1 2", b"-"] {
            assert_eq!(number(refused), None, "{}", String::from_utf8_lossy(refused));
        }
    }

    #[test]
    fn indices_are_whole_numbers_below_two_to_the_31() {
        assert_eq!(index(b" 07 "), Some(7));
        assert_eq!(index(b"2147483647"), Some(i32::MAX as u32));
        for refused in [&b"2147483648"[..], b"99999999999999999999", b"-1", b"+1", b"1.0", b""] {
            assert_eq!(index(refused), None, "{}", String::from_utf8_lossy(refused));
        }
    }

    #[test]
    fn a_matrix_has_twelve_numbers_by_rows() {
        let turned = matrix(b"0 1 0  -1 0 0  0 0 1  5 6 7").expect("a matrix");
        assert_eq!(turned.transform_point3(DVec3::X), DVec3::new(5.0, 7.0, 7.0));
        assert_eq!(matrix(b"1 0 0 0 1 0 0 0 1 0 0"), None);
        assert_eq!(matrix(b"1 0 0 0 1 0 0 0 1 0 0 0 0"), None);
        assert_eq!(matrix(b"1,0 0 0 0 1 0 0 0 1 0 0 0"), None);
    }

    #[test]
    fn colours_have_three_or_four_channels() {
        assert_eq!(color(b"#FF8000"), Some([255, 128, 0, 255]));
        assert_eq!(color(b"#ff800010"), Some([255, 128, 0, 16]));
        for refused in [&b"FF8000"[..], b"#FF80", b"#GG8000", b"#FF80001"] {
            assert_eq!(color(refused), None, "{}", String::from_utf8_lossy(refused));
        }
    }

    #[test]
    fn xml_text_is_escaped_and_forbidden_characters_are_dropped() {
        assert_eq!(attribute("a \"b\" <c> & d\n\u{1}\u{FFFF}"), "a &quot;b&quot; &lt;c&gt; &amp; d&#10;");
        assert_eq!(content("]]>\r\n\u{8}\u{1F600}"), "]]&gt;&#13;\n\u{1F600}");
        assert!(matches!(attribute("plain"), Cow::Borrowed("plain")));
        assert_eq!(content("\u{10000}\u{FFFD}"), "\u{10000}\u{FFFD}");
    }

    #[test]
    fn any_text_becomes_a_name() {
        assert_eq!(name("Title"), "Title");
        assert_eq!(name("my note: 1"), "my_note__1");
        assert_eq!(name("3mfVersion"), "_3mfVersion");
        assert_eq!(name(""), "_");
    }
}
