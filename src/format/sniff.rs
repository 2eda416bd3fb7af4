//! Detecting a file's format from its first bytes.
//!
//! Binary STL is the only format without a signature: its header is free text, often `solid ...`. If the file's length fits the facet
//! count exactly, the file is binary STL. A text file would have to be gigabytes long to fit by chance, so this check comes first. If the
//! count is wrong, plausible coordinates decide.

use super::errors::{ReadError, ReadErrorKind, excerpt};
use super::formats::{Format, GLB_SIGNATURE};
use super::limits::SNIFFED_BYTES;
use super::off::is_off_keyword;
use super::text::{Text, UTF8_MARK, integer, number};
use super::{archive, stl, vertex_face};

/// Detects the format of a file from its first bytes, and from its length if known.
///
/// At most 4096 bytes are used, so [`read`](super::read) detects the same format. A ZIP archive's content is known only from its end.
/// [`Format::ThreeMf`] and [`Format::Zip`] may therefore turn out to be each other, or the format of the model in the archive.
///
/// # Errors
/// [`ReadErrorKind::Empty`], [`ReadErrorKind::UnknownFormat`] or [`ReadErrorKind::UnsupportedFormat`], with a description of the file.
pub fn sniff(head: &[u8], length: Option<u64>) -> Result<Format, ReadError> {
    let head = &head[..head.len().min(SNIFFED_BYTES)];
    if head.is_empty() {
        return Err(ReadError::for_file(ReadErrorKind::Empty, "the file is empty; send it again"));
    }
    if stl::length_fits(head, length) {
        return Ok(Format::Stl);
    }
    if is_damaged_by_text_conversion(head) {
        return Err(ReadError::for_file(
            ReadErrorKind::UnknownFormat,
            "this binary file was converted as if it were text, which destroyed it; send the original file",
        ));
    }
    let start = text_start(head);
    if head.starts_with(GLB_SIGNATURE) || is_gltf(&head[start..]) {
        return Ok(Format::Glb);
    }
    // Only the archive's directory, at its end, lists all files; the reader decides from that.
    if head.starts_with(archive::LOCAL_HEADER_SIGNATURE) {
        let is_unknown = archive::names_in_head(head).next().is_none();
        return Ok(if is_unknown || archive::is_likely_3mf(head) { Format::ThreeMf } else { Format::Zip });
    }
    if let Some(unsupported) = recognise_unsupported(head) {
        return Err(ReadError::for_file(
            ReadErrorKind::UnsupportedFormat,
            format!(
                "the file is {}, which can't be read; {}, and send that file",
                unsupported.name, unsupported.advice
            ),
        ));
    }
    let first = Text::new(&head[start..]).with_comments().word().map_or(&[][..], |word| word.bytes);
    if is_ply(&head[start..]) {
        return Ok(Format::Ply);
    }
    if is_off_keyword(first) && !has_binary_bytes(head) {
        return Ok(Format::Off);
    }
    if stl::starts_as_text(head) || (has_binary_bytes(head) && stl::looks_like_facets(head)) {
        return Ok(Format::Stl);
    }
    if is_off_keyword(first) {
        // Binary OFF: the reader reports that it is not supported.
        return Ok(Format::Off);
    }
    if !has_binary_bytes(head) {
        if vertex_face::starts_with_element(head) {
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

/// Offset of the first byte after a byte order mark and white space.
fn text_start(head: &[u8]) -> usize {
    let mark = if head.starts_with(UTF8_MARK) { UTF8_MARK.len() } else { 0 };
    mark + head[mark..].iter().take_while(|b| b.is_ascii_whitespace()).count()
}

/// Whether there are control characters that no text file contains.
fn has_binary_bytes(head: &[u8]) -> bool {
    head.iter().any(|&b| b < 0x20 && !matches!(b, b'\t' | b'\n' | b'\r' | 0x0B | 0x0C | 0x1A))
}

/// Whether a program took a binary file for UTF-8 and replaced its invalid bytes by U+FFFD. The whole file is then valid UTF-8. The bytes
/// of U+FFFD alone prove nothing: they may be a colour that repeats for every face.
fn is_damaged_by_text_conversion(head: &[u8]) -> bool {
    let is_text = std::str::from_utf8(head).map_or_else(|error| error.error_len().is_none(), |_| true);
    is_text && head.contains(&0) && head.windows(3).filter(|w| w == b"\xEF\xBF\xBD").count() >= 3
}

/// Whether the text is a JSON object with a member of glTF. Its first member may be a buffer that is longer than the bytes examined.
fn is_gltf(text: &[u8]) -> bool {
    const MEMBERS: [&[u8]; 5] = [b"\"asset\"", b"\"meshes\"", b"\"accessors\"", b"\"buffers\"", b"\"bufferViews\""];
    let has = |member: &&[u8]| text.windows(member.len()).any(|window| window == *member);
    text.starts_with(b"{") && MEMBERS.iter().any(has)
}

fn is_ply(head: &[u8]) -> bool {
    head.len() >= 4 && head[..3].eq_ignore_ascii_case(b"ply") && head[3].is_ascii_whitespace()
}

/// Whether the first line has three whole numbers and the second at least three numbers.
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

/// Statements that an OBJ file may begin with (Wavefront, "Advanced Visualizer Manual", appendix B1).
const OBJ_STATEMENTS: &str = "v vt vn vp f fo l p o g s mg usemtl mtllib usemap maplib cstype deg bmat step curv curv2 \
    surf parm trim hole scrv sp end con bevel c_interp d_interp lod shadow_obj trace_obj ctech stech";

/// Whether the first statement belongs to OBJ, or there is a line `v x y z`, or the file has only comments so far.
fn is_obj(head: &[u8]) -> bool {
    let mut text = Text::new(head).with_comments();
    let Some(first) = text.word() else {
        return head.contains(&b'#');
    };
    let is_statement = OBJ_STATEMENTS.split(' ').any(|s| first.bytes == s.as_bytes());
    // Many texts begin with a single letter, so the next word must fit too.
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
    while let Some(statement) = word {
        if statement.bytes == b"v" {
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

/// The error for a file of no known format.
fn unknown(head: &[u8]) -> ReadError {
    let detail = if head.starts_with(b"\xFF\xFE") || head.starts_with(b"\xFE\xFF") {
        "the file is text in UTF-16; save it as UTF-8 or ASCII text, or export a binary format, and send that file"
            .to_owned()
    } else {
        let cut = if has_binary_bytes(head) && head.len() < stl::MIN_BINARY_BYTES {
            "; if it was binary STL, it was cut off, so send it again"
        } else {
            ""
        };
        format!(
            "the file begins with '{}', which matches no supported format; send STL, OBJ, PLY, OFF, 3MF or GLB{cut}",
            excerpt(&head[..head.len().min(16)])
        )
    };
    ReadError::for_file(ReadErrorKind::UnknownFormat, detail)
}

/// A format that is recognised but not read.
struct UnsupportedFormat {
    /// Name of the format, with an article.
    name: &'static str,
    /// How to get a file that can be read.
    advice: &'static str,
}

const EXPORT: &str = "open it in the program that made it, export 3MF, GLB, STL, OBJ, PLY or OFF";
const UNPACK: &str = "unpack it, take the 3MF, GLB, STL, OBJ, PLY or OFF file from it";
const NOT_A_MODEL: &str = "find the 3D model itself, as 3MF, GLB, STL, OBJ, PLY or OFF";

/// Signatures at the very start of a file.
const SIGNATURES: [(&[u8], &str, &str); 40] = [
    (b"ISO-10303-21", "a STEP file", EXPORT),
    (b"ISO-10303", "a STEP file", EXPORT),
    (b"Kaydara FBX Binary", "a binary FBX file", EXPORT),
    (b"; FBX ", "an ASCII FBX file", EXPORT),
    (b"BLENDER", "a Blender file", EXPORT),
    (b"PXR-USDC", "a USD file", EXPORT),
    (b"#usda", "a USD file", EXPORT),
    (b"#VRML", "a VRML file", EXPORT),
    (b"#X3D", "an X3D file", EXPORT),
    (b"#Inventor", "an Open Inventor file", EXPORT),
    (b"# vtk DataFile", "a VTK file", EXPORT),
    (b"OCTM", "an OpenCTM file", EXPORT),
    (b"DRACO", "a Draco file", EXPORT),
    (b"$MeshFormat", "a Gmsh file", EXPORT),
    (b"MeshVersionFormatted", "a Medit mesh file", EXPORT),
    (b"3D Geometry File Format", "a Rhino file", EXPORT),
    (b"AutoCAD Binary DXF", "a DXF file", EXPORT),
    (b"AC10", "a DWG file", EXPORT),
    (b"DBRep_DrawableShape", "an OpenCASCADE BREP file", EXPORT),
    (b"CASCADE Topology", "an OpenCASCADE BREP file", EXPORT),
    (b"xof 0", "a DirectX X file", EXPORT),
    (b"\xD0\xCF\x11\xE0\xA1\xB1\x1A\xE1", "a compound document, such as SolidWorks and 3ds Max write", EXPORT),
    (b"GCDE", "a binary G-code file", NOT_A_MODEL),
    (b"; generated by", "a G-code file", NOT_A_MODEL),
    (b";FLAVOR:", "a G-code file", NOT_A_MODEL),
    (b"G28", "a G-code file", NOT_A_MODEL),
    (b"PK\x05\x06", "an empty ZIP archive", NOT_A_MODEL),
    (b"\x1F\x8B", "a gzip archive", UNPACK),
    (b"BZh", "a bzip2 archive", UNPACK),
    (b"\xFD7zXZ\0", "an xz archive", UNPACK),
    (b"\x28\xB5\x2F\xFD", "a Zstandard archive", UNPACK),
    (b"7z\xBC\xAF\x27\x1C", "a 7z archive", UNPACK),
    (b"Rar!\x1A\x07", "a RAR archive", UNPACK),
    (b"%PDF", "a PDF document", NOT_A_MODEL),
    (b"\x89PNG", "a PNG image", NOT_A_MODEL),
    (b"\xFF\xD8\xFF", "a JPEG image", NOT_A_MODEL),
    (b"GIF8", "a GIF image", NOT_A_MODEL),
    (b"RIFF", "a RIFF file, such as a WebP image", NOT_A_MODEL),
    (b"\x7FELF", "a program", NOT_A_MODEL),
    (b"PAR1", "a Parquet file", NOT_A_MODEL),
];

/// Elements that identify XML and HTML files.
const ELEMENTS: [(&[u8], &str, &str); 9] = [
    (b"<!doctype html", "an HTML page, perhaps an error page that was saved instead of the model", NOT_A_MODEL),
    (b"<html", "an HTML page, perhaps an error page that was saved instead of the model", NOT_A_MODEL),
    (b"<amf", "an AMF file", EXPORT),
    (b"<collada", "a COLLADA file", EXPORT),
    (b"<model", "the model part of a 3MF file", EXPORT),
    (b"<x3d", "an X3D file", EXPORT),
    (b"<vtkfile", "a VTK file", EXPORT),
    (b"<svg", "an SVG drawing", NOT_A_MODEL),
    (b"<error", "an XML error message that was saved instead of the model", NOT_A_MODEL),
];

/// Recognises a format that meshmend does not read.
fn recognise_unsupported(head: &[u8]) -> Option<UnsupportedFormat> {
    let mark = if head.starts_with(UTF8_MARK) { 3 } else { 0 };
    let text = head[mark..].trim_ascii_start();
    for (signature, name, advice) in SIGNATURES {
        if head.starts_with(signature) || text.starts_with(signature) {
            return Some(UnsupportedFormat { name, advice });
        }
    }
    match text.first()? {
        b'<' => {
            let lower = text.to_ascii_lowercase();
            let known = ELEMENTS.iter().find(|(element, ..)| contains(&lower, element));
            match known {
                Some((_, name, advice)) => Some(UnsupportedFormat { name, advice }),
                None if lower.starts_with(b"<?xml") => Some(UnsupportedFormat { name: "an XML file", advice: EXPORT }),
                None => None,
            }
        }
        b'{' if contains(text, b"\":") || contains(text, b"\" :") => {
            Some(UnsupportedFormat { name: "a JSON file", advice: NOT_A_MODEL })
        }
        b'0' | b'9' if is_dxf(text) => Some(UnsupportedFormat { name: "a DXF file", advice: EXPORT }),
        _ if is_iges(head) => Some(UnsupportedFormat { name: "an IGES file", advice: EXPORT }),
        _ => None,
    }
}

/// Whether the text begins with the lines `0` and `SECTION`, or `999` and a comment.
fn is_dxf(text: &[u8]) -> bool {
    let mut lines = text.split(|&b| b == b'\n').map(<[u8]>::trim_ascii);
    match (lines.next(), lines.next()) {
        (Some(b"0"), Some(b"SECTION")) => true,
        (Some(b"999"), Some(_)) => lines.any(|line| line == b"SECTION"),
        _ => false,
    }
}

/// Whether column 73 holds an `S` and columns 74 to 80 a sequence number.
fn is_iges(head: &[u8]) -> bool {
    head.len() >= 80
        && head[72] == b'S'
        && head[73..80].iter().all(|b| b.is_ascii_digit() || *b == b' ')
        && head[73..80].contains(&b'1')
        && head[..72].iter().all(|b| (0x20..0x7F).contains(b))
}

fn contains(text: &[u8], part: &[u8]) -> bool {
    text.windows(part.len()).any(|window| window == part)
}
