//! MTL: the materials that OBJ files refer to ("Advanced Visualizer Manual", appendix B2). The colour, opacity and colour texture of each
//! material are read. Malformed statements are ignored, because the surface does not depend on them.

use rustc_hash::FxHashMap;

use super::super::paint::byte;
use super::super::text::{Text, Word, number};

/// Maximum number of materials.
pub(super) const MAX_MATERIALS: usize = 1 << 20;
/// Maximum size of an MTL file, in bytes.
pub(super) const MAX_LIBRARY_BYTES: u64 = 64 << 20;

/// The material name of unpainted faces; no MTL file defines it.
pub(super) const UNPAINTED: &str = "(null)";

/// The name of a material that stands for a plain colour.
pub(super) fn color_name(color: [u8; 4]) -> String {
    let hex = hex::encode_upper(color);
    format!("color_{}", hex.strip_suffix("FF").filter(|rest| rest.len() == 6).unwrap_or(&hex))
}

/// Materials by their names.
pub(super) type MaterialDefinitions = FxHashMap<Vec<u8>, MaterialDefinition>;

/// A material as an MTL file defines it.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct MaterialDefinition {
    diffuse: Option<[f32; 3]>,
    /// `d`: 1 is opaque.
    dissolve: Option<f32>,
    /// `Tr`, which some exporters write instead of `d`: 0 is opaque.
    transparency: Option<f32>,
    /// `map_Kd`: the colour texture.
    pub texture: Option<ColorTexture>,
}

/// A colour texture.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) struct ColorTexture {
    /// File name, as written in the MTL file.
    pub file: String,
    /// Whether the texture's edge pixels continue beyond its border (`-clamp on`).
    pub clamp: bool,
}

impl MaterialDefinition {
    /// The material's colour. Without `Kd` it is light grey, or white if there is a texture. Black with a texture also becomes white,
    /// because some exporters write black to say that the material has no colour of its own.
    pub fn color(&self) -> [u8; 4] {
        let [r, g, b] = match (self.diffuse, &self.texture) {
            (None, None) => [0.8; 3],
            (None, Some(_)) => [1.0; 3],
            (Some(diffuse), Some(_)) if diffuse == [0.0; 3] => [1.0; 3],
            (Some(diffuse), _) => diffuse,
        };
        let opacity = self.dissolve.or(self.transparency.map(|transparency| 1.0 - transparency)).unwrap_or(1.0);
        [r, g, b, opacity].map(|part| byte(f64::from(part)))
    }
}

/// Texture options with their number of arguments. The options in [`PLACEMENT_OPTIONS`] take one to three numbers.
const FIXED_OPTIONS: [(&str, usize); 10] = [
    ("-blendu", 1),
    ("-blendv", 1),
    ("-cc", 1),
    ("-clamp", 1),
    ("-boost", 1),
    ("-texres", 1),
    ("-bm", 1),
    ("-imfchan", 1),
    ("-type", 1),
    ("-mm", 2),
];
const PLACEMENT_OPTIONS: [&str; 3] = ["-o", "-s", "-t"];

/// Adds the materials of an MTL file to `definitions`. Of several materials with one name, the first counts.
pub(super) fn read(bytes: &[u8], definitions: &mut MaterialDefinitions) {
    let mut text = Text::new(bytes).with_comments();
    let mut current: Option<(&[u8], MaterialDefinition)> = None;
    while let Some(word) = text.word() {
        if word.is("newmtl") {
            add(current.take(), definitions);
            if definitions.len() < MAX_MATERIALS {
                current = Some((text.rest_of_line(), MaterialDefinition::default()));
            }
        } else if let Some((_, definition)) = &mut current {
            statement(word, &mut text, definition);
        }
        text.skip_line();
    }
    add(current, definitions);
}

fn add(current: Option<(&[u8], MaterialDefinition)>, definitions: &mut MaterialDefinitions) {
    if let Some((name, definition)) = current {
        definitions.entry(name.to_vec()).or_insert(definition);
    }
}

fn statement(word: Word<'_>, text: &mut Text<'_>, definition: &mut MaterialDefinition) {
    if word.is("kd") {
        // A single number stands for all three components; the forms `spectral` and `xyz` are ignored.
        let parts: Vec<f32> = std::iter::from_fn(|| finite(text.word_on_line())).take(3).collect();
        match parts[..] {
            [r, g, b] => definition.diffuse = Some([r, g, b]),
            [grey, ..] => definition.diffuse = Some([grey; 3]),
            [] => {}
        }
    } else if word.is("d") {
        let first = text.word_on_line();
        let value = if first.is_some_and(|word| word.is("-halo")) { text.word_on_line() } else { first };
        definition.dissolve = finite(value).or(definition.dissolve);
    } else if word.is("tr") {
        definition.transparency = finite(text.word_on_line()).or(definition.transparency);
    } else if word.is("map_kd") {
        definition.texture = color_texture(text).or(definition.texture.take());
    }
}

fn finite(word: Option<Word<'_>>) -> Option<f32> {
    #[expect(clippy::cast_possible_truncation, reason = "f32 is more precise than a colour needs")]
    number(word?.bytes).map(|value| value as f32).filter(|value| value.is_finite())
}

/// Parses the texture's options and file name, which may contain blanks.
fn color_texture(text: &mut Text<'_>) -> Option<ColorTexture> {
    let mut clamp = false;
    loop {
        let before = text.clone();
        let option = text.word_on_line()?;
        if let Some((name, values)) = FIXED_OPTIONS.iter().find(|(name, _)| option.is(name)) {
            for _ in 0..*values {
                let value = text.word_on_line()?;
                clamp |= *name == "-clamp" && value.is("on");
            }
        } else if PLACEMENT_OPTIONS.iter().any(|name| option.is(name)) {
            for _ in 0..3 {
                let before = text.clone();
                if finite(text.word_on_line()).is_none() {
                    *text = before;
                    break;
                }
            }
        } else {
            *text = before;
            let file = text.rest_of_line();
            return Some(ColorTexture { file: String::from_utf8_lossy(file).trim_matches('"').to_owned(), clamp });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn only(text: &str) -> MaterialDefinition {
        let mut definitions = MaterialDefinitions::default();
        read(format!("# made\nKd 1 1 1\nnewmtl  a b \n{text}\n").as_bytes(), &mut definitions);
        assert_eq!(definitions.len(), 1);
        definitions[&b"a b"[..]].clone()
    }

    fn file(text: &str) -> Option<ColorTexture> {
        only(&format!("map_Kd {text}")).texture
    }

    #[test]
    fn colour_and_opacity_are_read() {
        assert_eq!(only("Kd 1 0 0.2\nd 0.5\nTr 0.9").color(), [255, 0, 51, 128]);
        assert_eq!(only("\tkd 0.4 # all\nTr 0.2").color(), [102, 102, 102, 204]);
        assert_eq!(only("Kd 9 -1 nan\nd -halo 0").color(), [255, 255, 255, 0]);
        assert_eq!(only("Kd spectral x.rfl\nKd\nd\nTr x\nillum 2").color(), [204, 204, 204, 255]);
    }

    #[test]
    fn a_texture_without_a_colour_is_not_tinted() {
        assert_eq!(only("map_Kd a.png").color(), [255; 4]);
        assert_eq!(only("Kd 0 0 0\nmap_Kd a.png").color(), [255; 4]);
        assert_eq!(only("Kd 1 0 0\nmap_Kd a.png").color(), [255, 0, 0, 255]);
    }

    #[test]
    fn the_texture_file_name_follows_its_options() {
        let picture = |file: &str, clamp| Some(ColorTexture { file: file.to_owned(), clamp });
        assert_eq!(file("a b.png "), picture("a b.png", false));
        assert_eq!(file("-s 1 1 1 -o 0.5 -mm 0 1 -bm 1 -clamp on x/1.png"), picture("x/1.png", true));
        assert_eq!(file("-clamp off \"C:\\my files\\1.png\""), picture("C:\\my files\\1.png", false));
        for none in ["", "-clamp", "-s 1 1"] {
            assert_eq!(file(none), None, "{none}");
        }
    }

    #[test]
    fn the_first_of_two_materials_with_one_name_counts() {
        let mut definitions = MaterialDefinitions::default();
        read(b"newmtl a\nKd 1 0 0\nnewmtl a\nKd 0 1 0\n", &mut definitions);
        read(b"newmtl a\nKd 0 0 1\nnewmtl b\n", &mut definitions);
        assert_eq!((definitions.len(), definitions[&b"a"[..]].color()), (2, [255, 0, 0, 255]));
    }

    #[test]
    fn a_plain_colour_is_named_by_its_hex_components() {
        assert_eq!(color_name([255, 0, 10, 255]), "color_FF000A");
        assert_eq!(color_name([255, 255, 255, 254]), "color_FFFFFFFE");
    }
}
