//! Telling formats apart by their first bytes.
//!
//! Only binary STL has no mark of its own: its header is free text, often `solid ...`. A length that fits its facet count
//! exactly is proof (a text file would have to be gigabytes long to fit by accident), so that test comes first; where
//! the count is wrong, numbers that look like coordinates have to do.

use super::errors::{ReadError, ReadErrorKind, shown};
use super::foreign;
use super::text::{Text, UTF8_MARK, integer, number};
use super::{Format, archive, gltf, stl, threemf, vertex_face};

/// How much of a file is looked at. Longer heads are cut to this, so that a reader and a sniffer agree.
pub(super) const HEAD: usize = 4096;

/// See [`super::sniff`].
pub(super) fn sniff(head: &[u8], length: Option<u64>) -> Result<Format, ReadError> {
    let head = &head[..head.len().min(HEAD)];
    if head.is_empty() {
        return Err(ReadError::whole(ReadErrorKind::Empty, "the file is empty; send it again"));
    }
    if stl::length_fits(head, length) {
        return Ok(Format::Stl);
    }
    if is_mangled(head) {
        return Err(ReadError::whole(
            ReadErrorKind::UnknownFormat,
            "this was a binary file and was then converted as if it were text, which can't be undone; send the original",
        ));
    }
    let start = text_start(head);
    if head.starts_with(gltf::MAGIC) || is_gltf(&head[start..]) {
        return Ok(Format::Glb);
    }
    // What the archive holds is told by its end, which only the reader looks at.
    if head.starts_with(archive::LOCAL) {
        let is_unknown = archive::names_in_head(head).next().is_none();
        return Ok(if is_unknown || threemf::is_likely(head) { Format::ThreeMf } else { Format::Zip });
    }
    if let Some(found) = foreign::recognise(head) {
        return Err(ReadError::whole(
            ReadErrorKind::UnsupportedFormat,
            format!("this is {}; {}, and send that", found.name, found.advice),
        ));
    }
    let first = Text::new(&head[start..]).with_comments().word().map_or(&[][..], |word| word.bytes);
    if is_ply(&head[start..]) {
        return Ok(Format::Ply);
    }
    if is_off_keyword(first) && !looks_binary(head) {
        return Ok(Format::Off);
    }
    if stl::starts_as_text(head) || (looks_binary(head) && stl::looks_like_facets(head)) {
        return Ok(Format::Stl);
    }
    if is_off_keyword(first) {
        // OFF BINARY: the reader names it.
        return Ok(Format::Off);
    }
    if !looks_binary(head) {
        if vertex_face::starts(head) {
            return Ok(Format::Mesh);
        }
        if is_off_without_keyword(head) {
            return Ok(Format::Off);
        }
        if is_obj(head) {
            return Ok(Format::Obj);
        }
    }
    Err(unknown(head))
}

/// Offset of the first byte that is neither a byte order mark nor white space.
fn text_start(head: &[u8]) -> usize {
    let mark = if head.starts_with(UTF8_MARK) { UTF8_MARK.len() } else { 0 };
    mark + head[mark..].iter().take_while(|b| b.is_ascii_whitespace()).count()
}

/// Whether there are bytes that no text has.
fn looks_binary(head: &[u8]) -> bool {
    head.iter().any(|&b| b < 0x20 && !matches!(b, b'\t' | b'\n' | b'\r' | 0x0B | 0x0C | 0x1A))
}

/// Whether bytes of a binary file were replaced by U+FFFD, as programs do that take it for UTF-8: then the whole is UTF-8. The bytes of such
/// a mark alone may be a colour, which a file has for every face.
fn is_mangled(head: &[u8]) -> bool {
    let is_text = std::str::from_utf8(head).map_or_else(|error| error.error_len().is_none(), |_| true);
    is_text && head.contains(&0) && head.windows(3).filter(|w| w == b"\xEF\xBF\xBD").count() >= 3
}

/// An object of JSON with a member that glTF has. It may begin with a buffer that is longer than the head.
fn is_gltf(text: &[u8]) -> bool {
    const MEMBERS: [&[u8]; 5] = [b"\"asset\"", b"\"meshes\"", b"\"accessors\"", b"\"buffers\"", b"\"bufferViews\""];
    let has = |member: &&[u8]| text.windows(member.len()).any(|window| window == *member);
    text.starts_with(b"{") && MEMBERS.iter().any(has)
}

fn is_ply(head: &[u8]) -> bool {
    head.len() >= 4 && head[..3].eq_ignore_ascii_case(b"ply") && head[3].is_ascii_whitespace()
}

/// `OFF` with the prefixes that its page in the Geomview manual gives: `[ST][C][N][4][n]OFF`.
pub(super) fn is_off_keyword(word: &[u8]) -> bool {
    let Some((prefix, keyword)) = word.split_at_checked(word.len().saturating_sub(3)) else { return false };
    if !keyword.eq_ignore_ascii_case(b"off") {
        return false;
    }
    let mut rest = prefix;
    for part in [&b"ST"[..], b"C", b"N", b"4", b"n"] {
        if rest.len() >= part.len() && rest[..part.len()].eq_ignore_ascii_case(part) {
            rest = &rest[part.len()..];
        }
    }
    rest.is_empty()
}

/// Three whole numbers on the first line and at least three numbers on the second.
fn is_off_without_keyword(head: &[u8]) -> bool {
    let mut text = Text::new(head).with_comments();
    let line = |text: &mut Text<'_>| -> Vec<Vec<u8>> {
        let Some(first) = text.word() else { return Vec::new() };
        let mut words = vec![first.bytes.to_vec()];
        while let Some(word) = text.word_on_line() {
            words.push(word.bytes.to_vec());
        }
        words
    };
    let counts = line(&mut text);
    let vertex = line(&mut text);
    counts.len() == 3
        && counts.iter().all(|w| integer(w).is_some_and(|n| n >= 0))
        && vertex.len() >= 3
        && vertex.iter().all(|w| number(w).is_some())
}

/// Statements that an OBJ file may begin with, after Wavefront's "Advanced Visualizer Manual", appendix B1.
const OBJ_STATEMENTS: [&str; 38] = [
    "v",
    "vt",
    "vn",
    "vp",
    "f",
    "fo",
    "l",
    "p",
    "o",
    "g",
    "s",
    "mg",
    "usemtl",
    "mtllib",
    "usemap",
    "maplib",
    "cstype",
    "deg",
    "bmat",
    "step",
    "curv",
    "curv2",
    "surf",
    "parm",
    "trim",
    "hole",
    "scrv",
    "sp",
    "end",
    "con",
    "bevel",
    "c_interp",
    "d_interp",
    "lod",
    "shadow_obj",
    "trace_obj",
    "ctech",
    "stech",
];

/// The first statement is one of OBJ's, or there is a line `v x y z`, or there is nothing but comments.
fn is_obj(head: &[u8]) -> bool {
    let mut text = Text::new(head).with_comments();
    let Some(first) = text.word() else {
        return head.contains(&b'#');
    };
    let is_statement = OBJ_STATEMENTS.iter().any(|s| first.bytes == s.as_bytes());
    // A letter alone starts many a text; what follows has to fit.
    let mut rest = text.clone();
    let second = rest.word_on_line();
    let fits = match first.bytes {
        [b'v'] => second.is_some_and(|w| w.bytes.first().is_some_and(|b| b"+-.0123456789nNiI".contains(b))),
        [b'f' | b'l' | b'p'] => second.is_none_or(|w| w.bytes.first().is_some_and(|b| b"-0123456789".contains(b))),
        _ => true,
    };
    if is_statement && fits {
        return true;
    }
    let mut word = Some(first);
    while let Some(found) = word {
        if found.bytes == b"v" {
            let coordinates = (0..3).map_while(|_| text.word_on_line()).filter(|w| number(w.bytes).is_some()).count();
            if coordinates == 3 {
                return true;
            }
        }
        text.skip_line();
        word = text.word();
    }
    false
}

fn unknown(head: &[u8]) -> ReadError {
    let detail = if head.starts_with(b"\xFF\xFE") || head.starts_with(b"\xFE\xFF") {
        "this is text in UTF-16; save it as UTF-8 or plain ASCII text, or export a binary format, and send that"
            .to_owned()
    } else {
        let cut = if looks_binary(head) && head.len() < stl::LEAST_BINARY {
            "; if it was binary STL, it was cut off, so send it again"
        } else {
            ""
        };
        format!(
            "the file begins with '{}', which is no format that is known here; send STL, OBJ, PLY, OFF, 3MF or GLB{cut}",
            shown(&head[..head.len().min(16)])
        )
    };
    ReadError::whole(ReadErrorKind::UnknownFormat, detail)
}
