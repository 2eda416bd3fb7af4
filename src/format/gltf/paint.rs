//! The paint of glTF primitives as palettes of a scene, and textures, whose image files are kept unchanged.

use std::collections::hash_map::Entry;
use std::sync::Arc;

use rustc_hash::FxHashMap;

use super::super::errors::{ReadError, ReadErrorKind};
use super::super::paint::{PaletteBuilder, media_type, srgb_of_linear};
use super::accessor::Accessor;
use super::container::Integer;
use super::document::{
    AlphaMode, Attributes, CLAMP_TO_EDGE, MIRRORED_REPEAT, Material, NEAREST, Surface, TextureTransform, TextureUse,
};
use super::file::{File, decode_data_uri, entry, relative_path};
use super::primitive::{PrimitiveData, UsedVertices};
use crate::scene::{self, PAINTLESS, Paint, Palette};

/// Builds palettes: one of all untextured materials, one of all vertex colours, and one for each textured material.
pub(super) struct Painter<'f, 'a> {
    file: &'f File<'a>,
    /// The textures in use.
    pub textures: TextureTable<'f, 'a>,
    palettes: PaletteBuilder,
    /// Palette and entry of each untextured material.
    plain: FxHashMap<u32, (u32, u32)>,
    /// The palette of each textured material; `None` if the texture can't be read.
    textured: FxHashMap<u32, Option<u32>>,
    /// Number of textured primitives whose vertex colours were dropped.
    pub dropped_vertex_colors: u64,
    /// Whether there were textures for other properties than colour.
    pub has_other_textures: bool,
}

impl<'f, 'a> Painter<'f, 'a> {
    /// No palettes yet.
    pub fn new(file: &'f File<'a>) -> Self {
        Self {
            file,
            textures: TextureTable::new(file),
            palettes: PaletteBuilder::default(),
            plain: FxHashMap::default(),
            textured: FxHashMap::default(),
            dropped_vertex_colors: 0,
            has_other_textures: false,
        }
    }

    /// The palettes and textures.
    pub fn finish(self) -> (Vec<Palette>, Vec<scene::Texture>) {
        (self.palettes.finish(), self.textures.textures)
    }

    /// Appends the paint of a primitive's faces, whose corners index its `vertices` vertices. Textures take precedence over vertex colours,
    /// and these over the material's colour.
    pub fn paint(
        &mut self,
        source: &PrimitiveData<'f, 'a>,
        faces: &[[u32; 3]],
        vertices: usize,
        paint: &mut Vec<Paint>,
    ) -> Result<(), ReadError> {
        if faces.is_empty() {
            return Ok(());
        }
        let number = source.primitive.material;
        let standard = Material::default();
        let material = match number {
            Some(number) => entry(&self.file.document.materials, number, "material")?,
            None => &standard,
        };
        self.has_other_textures |= uses_other_textures(material);
        let colors = source.vertex_attribute("COLOR_0", |attributes| attributes.color_0, vertices)?;
        if let Some(number) = number
            && let Some((palette, places)) = self.textured_palette(source, number, material, vertices)?
        {
            self.dropped_vertex_colors += u64::from(colors.is_some());
            let used = UsedVertices::of(|| faces.iter().flatten().copied(), vertices);
            let transform = texture(material).and_then(|texture| texture.extensions.transform.as_ref());
            let base = self
                .palettes
                .add_texture_coordinates(palette, used.iter().map(|v| texture_coordinate(&places, v, transform)));
            paint.extend(faces.iter().map(|face| Paint { palette, at: face.map(|v| base + used.rank(v)) }));
        } else if let Some(colors) = colors {
            let used = UsedVertices::of(|| faces.iter().flatten().copied(), vertices);
            let palette = self.palettes.colors();
            let entries: Vec<u32> =
                used.iter().map(|v| self.palettes.color(vertex_color(&colors, v, material)).1).collect();
            paint.extend(faces.iter().map(|face| Paint { palette, at: face.map(|v| entries[used.rank(v) as usize]) }));
        } else if let Some(number) = number {
            let (palette, at) = self.material_entry(number, material);
            paint.extend(faces.iter().map(|_| Paint { palette, at: [at; 3] }));
        } else {
            paint.extend(faces.iter().map(|_| PAINTLESS));
        }
        Ok(())
    }

    /// The palette of a material's texture and the texture coordinates of vertices; `None` unless both exist.
    fn textured_palette(
        &mut self,
        source: &PrimitiveData<'f, 'a>,
        number: Integer,
        material: &Material<'_>,
        vertices: usize,
    ) -> Result<Option<(u32, Accessor<'f>)>, ReadError> {
        let Some(texture) = texture(material) else { return Ok(None) };
        let set = texture
            .extensions
            .transform
            .as_ref()
            .and_then(|transform| transform.tex_coord)
            .unwrap_or(texture.tex_coord);
        let of_set = |attributes: &Attributes| match set.0 {
            0 => attributes.texcoord_0,
            1 => attributes.texcoord_1,
            2 => attributes.texcoord_2,
            3 => attributes.texcoord_3,
            _ => None,
        };
        let Some(places) = source.vertex_attribute("TEXCOORD", of_set, vertices)? else { return Ok(None) };
        let palette = match self.textured.entry(number.0) {
            Entry::Occupied(known) => *known.get(),
            Entry::Vacant(new) => {
                let image = self.textures.texture(texture.index)?;
                let name = material.name.as_deref().map(str::to_owned);
                *new.insert(image.map(|texture| self.palettes.textured(texture, name, color(material))))
            }
        };
        Ok(palette.map(|palette| (palette, places)))
    }

    fn material_entry(&mut self, number: Integer, material: &Material<'_>) -> (u32, u32) {
        *self.plain.entry(number.0).or_insert_with(|| {
            let name = material.name.as_deref().unwrap_or_default().to_owned();
            self.palettes.material(scene::Material { name, color: color(material) })
        })
    }
}

/// The colour model of a material: specular-glossiness if present, else metallic-roughness.
fn surface<'m>(material: &'m Material<'_>) -> &'m Surface {
    material.extensions.specular_glossiness.as_ref().unwrap_or(&material.pbr_metallic_roughness)
}

fn texture<'m>(material: &'m Material<'_>) -> Option<&'m TextureUse> {
    surface(material).base_color_texture.as_deref()
}

fn uses_other_textures(material: &Material<'_>) -> bool {
    material.normal_texture.is_some()
        || material.occlusion_texture.is_some()
        || material.emissive_texture.is_some()
        || surface(material).metallic_roughness_texture.is_some()
}

/// The colour of a material. Alpha is ignored if the material is declared opaque.
fn color(material: &Material<'_>) -> [u8; 4] {
    to_srgb(material, surface(material).base_color_factor.as_deref().copied().unwrap_or([1.0; 4]))
}

fn to_srgb(material: &Material<'_>, [r, g, b, alpha]: [f64; 4]) -> [u8; 4] {
    let alpha = if material.alpha_mode == AlphaMode::Opaque { 1.0 } else { alpha };
    srgb_of_linear([r, g, b, alpha])
}

fn vertex_color(colors: &Accessor<'_>, vertex: u32, material: &Material<'_>) -> [u8; 4] {
    let mut color = colors.fractions::<4>(vertex as usize).map(f64::from);
    if colors.width < 4 {
        color[3] = 1.0;
    }
    if let Some(factor) = surface(material).base_color_factor.as_deref() {
        color.iter_mut().zip(factor).for_each(|(part, factor)| *part *= factor);
    }
    to_srgb(material, color)
}

/// The texture coordinate of a vertex, with the origin in the lower left corner; glTF's origin is the upper left corner. `transform` is
/// that of `KHR_texture_transform`.
fn texture_coordinate(places: &Accessor<'_>, vertex: u32, transform: Option<&TextureTransform>) -> [f64; 2] {
    let [u, v] = places.floats::<2>(vertex as usize).map(f64::from);
    let [u, v] = match transform {
        None => [u, v],
        Some(transform) => {
            let [wide, high] = transform.scale.unwrap_or([1.0; 2]);
            let (sin, cos) = transform.rotation.sin_cos();
            let (u, v) = (u * wide, v * high);
            [cos * u + sin * v + transform.offset[0], cos * v - sin * u + transform.offset[1]]
        }
    };
    [u, 1.0 - v].map(|x| if x.is_finite() { x } else { 0.0 })
}

/// An image file and its media type.
type ImageFile = (Arc<[u8]>, &'static str);

/// The textures that faces use.
pub(super) struct TextureTable<'f, 'a> {
    file: &'f File<'a>,
    /// The scene's textures.
    pub textures: Vec<scene::Texture>,
    /// Index in `textures` of each texture of the file; `None` if its image can't be kept.
    known: FxHashMap<u32, Option<u32>>,
    /// Index in `textures` by image, wrap modes and filter.
    by_sampling: FxHashMap<(Integer, u8, u8, bool), usize>,
    /// Image files by the index of their image.
    files: FxHashMap<u32, Option<ImageFile>>,
    /// Total bytes of all image files.
    bytes: usize,
    /// Number of textures that were dropped.
    pub omitted: u64,
}

impl<'f, 'a> TextureTable<'f, 'a> {
    /// No textures yet.
    pub fn new(file: &'f File<'a>) -> Self {
        let (known, by_sampling, files) = (FxHashMap::default(), FxHashMap::default(), FxHashMap::default());
        Self { file, textures: Vec::new(), known, by_sampling, files, bytes: 0, omitted: 0 }
    }

    /// The index in [`Self::textures`] of a texture of the file; `None` if its image can't be kept.
    pub fn texture(&mut self, number: Integer) -> Result<Option<u32>, ReadError> {
        if let Some(known) = self.known.get(&number.0) {
            return Ok(*known);
        }
        let document = &self.file.document;
        let texture = entry(&document.textures, number, "texture")?;
        let sampler = texture.sampler.map(|number| entry(&document.samplers, number, "sampler")).transpose()?;
        // Without a source, the image is in a format that only an extension defines.
        let image = match texture.source {
            Some(source) => self.image(source)?.map(|image| (source, image)),
            None => None,
        };
        let added = match image {
            Some((source, (bytes, media_type))) => {
                let wrap_u = wrap(sampler.and_then(|sampler| sampler.wrap_s));
                let wrap_v = wrap(sampler.and_then(|sampler| sampler.wrap_t));
                let nearest = sampler.and_then(|sampler| sampler.mag_filter) == Some(Integer(NEAREST));
                let at = *self.by_sampling.entry((source, wrap_u as u8, wrap_v as u8, nearest)).or_insert_with(|| {
                    self.textures.push(scene::Texture {
                        bytes,
                        media_type: media_type.to_owned(),
                        wrap_u,
                        wrap_v,
                        nearest,
                    });
                    self.textures.len() - 1
                });
                u32::try_from(at).ok()
            }
            None => {
                self.omitted += 1;
                None
            }
        };
        self.known.insert(number.0, added);
        Ok(added)
    }

    fn image(&mut self, number: Integer) -> Result<Option<ImageFile>, ReadError> {
        if let Some(known) = self.files.get(&number.0) {
            return Ok(known.clone());
        }
        let image = entry(&self.file.document.images, number, "image")?;
        let (copied, view);
        let bytes = match (&image.uri, image.buffer_view) {
            (Some(uri), _) => match decode_data_uri(uri) {
                Some(data) => {
                    copied = data.unwrap_or_default();
                    &copied[..]
                }
                None => {
                    let image = relative_path(uri).and_then(|path| self.file.sidecars.read_texture(&path));
                    self.files.insert(number.0, image.clone());
                    return Ok(image);
                }
            },
            (None, Some(number)) => {
                view = self.file.view(number)?;
                view.bytes
            }
            (None, None) => &[],
        };
        let image = match media_type(bytes) {
            Some(media_type) => {
                self.bytes += bytes.len();
                // The total exceeds the file's size only if images overlap.
                if self.bytes > self.file.length {
                    let detail = "the file's images have more bytes in total than the file, so they overlap; export the model again";
                    return Err(ReadError::for_file(ReadErrorKind::TooLarge, detail));
                }
                Some((Arc::from(bytes), media_type))
            }
            None => None,
        };
        self.files.insert(number.0, image.clone());
        Ok(image)
    }
}

fn wrap(code: Option<Integer>) -> scene::Wrap {
    match code {
        Some(Integer(CLAMP_TO_EDGE)) => scene::Wrap::Clamp,
        Some(Integer(MIRRORED_REPEAT)) => scene::Wrap::Mirror,
        _ => scene::Wrap::Repeat,
    }
}
