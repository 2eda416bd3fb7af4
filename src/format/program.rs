//! The program that wrote a file, as the file names it.

use serde::Deserialize;

use super::formats::Format;

/// Bytes at the start of a text file in which comments are looked for.
const TEXT_BYTES: usize = 4 << 10;
/// Longest text to return, in characters.
const MAX_CHARACTERS: usize = 200;
/// Size of the header of a binary STL file.
const STL_HEADER: usize = 80;
/// Offset of the JSON chunk's text in a GLB file, and the offset of its length.
const GLB_JSON: usize = 20;
const GLB_LENGTH: usize = 12;
/// Longest JSON chunk to read for the generator's name.
const GLB_BYTES: usize = 64 << 20;

/// The text in which a file names the program that wrote it. That is an STL header, the comments of an OBJ or PLY file, or the generator
/// of a GLB file. `None` for other formats, and for files without such text.
#[must_use]
pub fn program_of(bytes: &[u8], format: Format) -> Option<String> {
    let text = match format {
        Format::Stl if bytes.starts_with(b"solid") => {
            let line = bytes.split(|&byte| byte == b'\n').next().unwrap_or_default();
            printable_text(&line[5.min(line.len())..])
        }
        Format::Stl => printable_text(&bytes[..STL_HEADER.min(bytes.len())]),
        Format::Obj => comments(bytes, "#"),
        Format::Ply => comments(bytes, "comment "),
        Format::Glb => generator(bytes)?,
        _ => return None,
    };
    let text: String = text.trim().chars().take(MAX_CHARACTERS).collect();
    (!text.is_empty()).then_some(text)
}

/// The printable characters of some bytes; others count as spaces.
fn printable_text(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(&bytes[..TEXT_BYTES.min(bytes.len())]);
    let printable = text.chars().map(|c| if c.is_control() || c == char::REPLACEMENT_CHARACTER { ' ' } else { c });
    printable.collect::<String>().split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The first lines of a text that begin with a mark, without it.
fn comments(bytes: &[u8], mark: &str) -> String {
    let text = String::from_utf8_lossy(&bytes[..TEXT_BYTES.min(bytes.len())]);
    let lines = text.lines().filter_map(|line| line.trim_start().strip_prefix(mark)).map(str::trim);
    printable_text(lines.collect::<Vec<_>>().join(" ").as_bytes())
}

/// The text `asset.generator` of a GLB file.
fn generator(bytes: &[u8]) -> Option<String> {
    #[derive(Deserialize)]
    struct Asset {
        generator: Option<String>,
    }
    #[derive(Deserialize)]
    struct Document {
        asset: Asset,
    }
    let length = bytes.get(GLB_LENGTH..GLB_LENGTH + 4)?;
    let length = u32::from_le_bytes(length.try_into().ok()?) as usize;
    let json = bytes.get(GLB_JSON..GLB_JSON.checked_add(length.min(GLB_BYTES))?)?;
    let Document { asset: Asset { generator } } = serde_json::from_slice(json).ok()?;
    generator.map(|text| printable_text(text.as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_format_names_its_program_in_its_own_place() {
        let mut stl = b"Exported from SketchUp 2024".to_vec();
        stl.resize(84, 0);
        assert_eq!(program_of(&stl, Format::Stl).as_deref(), Some("Exported from SketchUp 2024"));
        assert_eq!(program_of(b"solid OpenSCAD_Model\n facet", Format::Stl).as_deref(), Some("OpenSCAD_Model"));
        let obj = b"# Blender 4.2\n# www.blender.org\nmtllib a.mtl\nv 0 0 0\n";
        assert_eq!(program_of(obj, Format::Obj).as_deref(), Some("Blender 4.2 www.blender.org"));
        let ply = b"ply\nformat ascii 1.0\ncomment VCGLIB generated\nelement vertex 1\n";
        assert_eq!(program_of(ply, Format::Ply).as_deref(), Some("VCGLIB generated"));
        let json = br#"{"asset":{"version":"2.0","generator":"TRELLIS.2"},"meshes":[]}"#;
        let mut glb = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
        glb.extend(u32::try_from(json.len()).expect("short").to_le_bytes());
        glb.extend(b"JSON");
        glb.extend(json);
        assert_eq!(program_of(&glb, Format::Glb).as_deref(), Some("TRELLIS.2"));
    }

    #[test]
    fn damaged_and_silent_files_name_no_program() {
        for (bytes, format) in [
            (&b""[..], Format::Stl),
            (&[0u8; 84][..], Format::Stl),
            (b"glTF\x02\0\0\0", Format::Glb),
            (b"glTF\x02\0\0\0\0\0\0\0\xff\xff\xff\xffJSON{", Format::Glb),
            (b"v 0 0 0", Format::Obj),
            (b"PK\x03\x04", Format::ThreeMf),
        ] {
            assert_eq!(program_of(bytes, format), None, "{format:?}");
        }
    }
}
