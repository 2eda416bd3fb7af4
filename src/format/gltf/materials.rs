//! Writing the palettes of a scene as glTF materials, textures and samplers.

use rustc_hash::FxHashMap;
use serde_json::{Value, json};

use super::super::paint::{linear_factor, media_type};
use super::document::{CLAMP_TO_EDGE, LINEAR, LINEAR_MIPMAP_LINEAR, MIRRORED_REPEAT, NEAREST, REPEAT};
use crate::scene::{Paint, Palette, Scene, Wrap};

/// The appearance of a face; faces with the same appearance form one primitive. Appearances are compared by content, not by palette, so
/// writing a file that was read gives the same file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Appearance {
    /// No paint.
    Unpainted,
    /// The colour of a material, given by its index.
    Material(usize),
    /// Vertex colours, over a white material.
    VertexColors(usize),
    /// The texture of a material.
    Textured(usize),
}

impl Appearance {
    /// The index of the appearance's material; `None` for unpainted faces.
    pub fn material(self) -> Option<usize> {
        match self {
            Self::Unpainted => None,
            Self::Material(material) | Self::VertexColors(material) | Self::Textured(material) => Some(material),
        }
    }
}

/// What identifies a material.
#[derive(PartialEq, Eq, Hash)]
struct MaterialKey {
    name: String,
    color: [u8; 4],
    texture: Option<usize>,
    has_vertex_colors: bool,
}

/// Wrap modes of a texture in u and v, and whether it has nearest-neighbour filtering.
type Sampling = (Wrap, Wrap, bool);

/// The materials, textures, samplers and images in the order of first use.
pub(super) struct MaterialTable<'s> {
    scene: &'s Scene,
    /// glTF materials.
    pub materials: Vec<Value>,
    known: FxHashMap<MaterialKey, usize>,
    /// Appearance of palette entries; all entries of a textured palette have one appearance.
    entries: FxHashMap<(u32, u32), Appearance>,
    /// glTF textures.
    pub textures: Vec<Value>,
    known_textures: FxHashMap<(usize, usize), usize>,
    /// glTF samplers.
    pub samplers: Vec<Value>,
    samplings: Vec<Sampling>,
    /// Image files, each once.
    pub images: Vec<&'s [u8]>,
    known_images: FxHashMap<&'s [u8], usize>,
}

impl<'s> MaterialTable<'s> {
    /// No materials yet.
    pub fn new(scene: &'s Scene) -> Self {
        Self {
            scene,
            materials: Vec::new(),
            known: FxHashMap::default(),
            entries: FxHashMap::default(),
            textures: Vec::new(),
            known_textures: FxHashMap::default(),
            samplers: Vec::new(),
            samplings: Vec::new(),
            images: Vec::new(),
            known_images: FxHashMap::default(),
        }
    }

    /// The appearance of a face with this paint. Invalid paint counts as none.
    pub fn appearance_of(&mut self, paint: Paint) -> Appearance {
        let scene = self.scene;
        let Some(palette) = scene.palettes.get(paint.palette as usize) else { return Appearance::Unpainted };
        if paint.at.iter().any(|&at| at as usize >= palette.len()) {
            return Appearance::Unpainted;
        }
        // A gradient depends on all three corners, a material on one entry, a texture on none.
        let entry = match palette {
            Palette::Colors(colors) => {
                let blended = paint.at.iter().any(|&at| colors[at as usize][3] < 255);
                return Appearance::VertexColors(self.material(
                    "",
                    [255, 255, 255, if blended { 0 } else { 255 }],
                    None,
                    true,
                ));
            }
            Palette::Materials(_) => paint.at[0],
            Palette::Textured { .. } => 0,
        };
        if let Some(known) = self.entries.get(&(paint.palette, entry)) {
            return *known;
        }
        let appearance = match palette {
            Palette::Materials(materials) => {
                let material = &materials[entry as usize];
                Appearance::Material(self.material(&material.name, material.color, None, false))
            }
            Palette::Textured { texture, name, tint, .. } => {
                let name = name.as_deref().unwrap_or_default();
                match self.texture(*texture) {
                    Some(texture) => Appearance::Textured(self.material(name, *tint, Some(texture), false)),
                    None => Appearance::Material(self.material(name, *tint, None, false)),
                }
            }
            Palette::Colors(_) => Appearance::Unpainted,
        };
        self.entries.insert((paint.palette, entry), appearance);
        appearance
    }

    fn material(&mut self, name: &str, color: [u8; 4], texture: Option<usize>, has_vertex_colors: bool) -> usize {
        let next = self.materials.len();
        let at =
            *self.known.entry(MaterialKey { name: name.to_owned(), color, texture, has_vertex_colors }).or_insert(next);
        if at == next {
            let mut surface = json!({ "metallicFactor": 0.0, "roughnessFactor": 0.8 });
            if color != [255; 4] && !has_vertex_colors {
                surface["baseColorFactor"] = json!(linear_factor(color));
            }
            if let Some(texture) = texture {
                surface["baseColorTexture"] = json!({ "index": texture });
            }
            let mut material = json!({ "pbrMetallicRoughness": surface });
            if !name.is_empty() {
                material["name"] = name.into();
            }
            if color[3] < 255 {
                material["alphaMode"] = "BLEND".into();
            }
            self.materials.push(material);
        }
        at
    }

    /// The index of a texture; `None` if its image is neither PNG nor JPEG.
    fn texture(&mut self, number: u32) -> Option<usize> {
        let texture = self.scene.textures.get(number as usize)?;
        media_type(&texture.bytes)?;
        let next = self.images.len();
        let image = *self.known_images.entry(&texture.bytes).or_insert(next);
        if image == next {
            self.images.push(&texture.bytes);
        }
        let sampler = self.sampler((texture.wrap_u, texture.wrap_v, texture.nearest));
        let next = self.textures.len();
        let at = *self.known_textures.entry((image, sampler)).or_insert(next);
        if at == next {
            self.textures.push(json!({ "sampler": sampler, "source": image }));
        }
        Some(at)
    }

    fn sampler(&mut self, (u, v, nearest): Sampling) -> usize {
        // glTF has no wrap mode without continuation; clamping is nearest to it.
        let [u, v] = [u, v].map(|wrap| if wrap == Wrap::None { Wrap::Clamp } else { wrap });
        if let Some(known) = self.samplings.iter().position(|known| *known == (u, v, nearest)) {
            return known;
        }
        let code = |wrap| match wrap {
            Wrap::Repeat => REPEAT,
            Wrap::Mirror => MIRRORED_REPEAT,
            Wrap::Clamp | Wrap::None => CLAMP_TO_EDGE,
        };
        let (larger, smaller) = if nearest { (NEAREST, NEAREST) } else { (LINEAR, LINEAR_MIPMAP_LINEAR) };
        self.samplers.push(json!({ "magFilter": larger, "minFilter": smaller, "wrapS": code(u), "wrapT": code(v) }));
        self.samplings.push((u, v, nearest));
        self.samplings.len() - 1
    }

    /// The colour or texture coordinate of a face's corner, as bits. Vertices with different bits are written separately.
    pub fn corner_bits(&self, appearance: Appearance, paint: Paint, corner: usize) -> u64 {
        let at = paint.at[corner] as usize;
        match (appearance, self.scene.palettes.get(paint.palette as usize)) {
            (Appearance::VertexColors(_), Some(Palette::Colors(colors))) => u64::from(u32::from_le_bytes(colors[at])),
            (Appearance::Textured(_), Some(Palette::Textured { places, .. })) => {
                let [u, v] = places[at];
                #[expect(clippy::cast_possible_truncation, reason = "glTF has f32 only")]
                let bits = |x: f64| u64::from((x.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32).to_bits());
                // glTF's origin is the upper left corner.
                bits(u) << 32 | bits(1.0 - v)
            }
            _ => 0,
        }
    }
}
