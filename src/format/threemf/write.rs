//! Writing 3MF: the package with content types and relationships, and the model part with resources, objects and build. The same scene
//! always gives the same bytes.

use std::fmt::Write as _;
use std::io::{self, Cursor, Write};

use glam::DAffine3;
use zip::ZipWriter;
use zip::result::ZipResult;

use super::schema::{CORE, MATERIAL, MODEL_RELATIONSHIP, Prefixes, TEXTURE_RELATIONSHIP, attribute};
use crate::format::archive::{deflate_options, store_options};
use crate::format::errors::WriteError;
use crate::scene::{
    Item, Note, Object, ObjectKind, PAINTLESS, Paint, PaintedMesh, Palette, Scene, Shape, Texture, Unit, Up, Wrap,
};

const ROOT: &str = "3D/3dmodel.model";

/// Writes 3MF. Tints and names of textured palettes, and textures that are neither PNG nor JPEG, are dropped.
///
/// # Errors
/// [`WriteError::NotFinite`] for infinite or not-a-number values, [`WriteError::TooLarge`] if the package exceeds ZIP's limits.
pub(crate) fn write(scene: &Scene) -> Result<Vec<u8>, WriteError> {
    match package(scene) {
        Ok((true, archive)) => Ok(archive),
        Ok((false, _)) => Err(WriteError::NotFinite),
        // Writing to memory fails only if a size is too large.
        Err(_) => Err(WriteError::TooLarge),
    }
}

/// Writes the package. The flag tells whether all numbers are finite.
fn package(scene: &Scene) -> ZipResult<(bool, Vec<u8>)> {
    let texture_parts = TextureParts::of(&scene.textures);
    let packed = deflate_options(false);
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    zip.start_file("[Content_Types].xml", packed)?;
    zip.write_all(content_types(&texture_parts).as_bytes())?;
    zip.start_file("_rels/.rels", packed)?;
    zip.write_all(relationships([(MODEL_RELATIONSHIP, ROOT)].into_iter()).as_bytes())?;
    zip.start_file(ROOT, deflate_options(is_long(scene)))?;
    let finite = ModelWriter::new(scene, &texture_parts.of_textures).write(&mut zip)?;
    if !texture_parts.files.is_empty() {
        zip.start_file("3D/_rels/3dmodel.model.rels", packed)?;
        let targets = texture_parts.files.iter().map(|(path, _)| (TEXTURE_RELATIONSHIP, path.as_str()));
        zip.write_all(relationships(targets).as_bytes())?;
    }
    for (path, texture) in &texture_parts.files {
        zip.start_file(path.as_str(), store_options())?;
        zip.write_all(&texture.bytes)?;
    }
    Ok((finite, zip.finish()?.into_inner()))
}

/// Whether the model part may need ZIP64, which entries over 4 GiB do.
fn is_long(scene: &Scene) -> bool {
    let lengths = scene
        .objects
        .iter()
        .filter_map(|object| object.mesh())
        .map(|mesh| 100 * (mesh.soup.positions.len() as u64 + mesh.soup.faces.len() as u64));
    lengths.sum::<u64>() > u64::from(u32::MAX) / 2
}

/// The texture parts of the package.
struct TextureParts<'s> {
    files: Vec<(String, &'s Texture)>,
    /// The part of each texture; `None` if it is neither PNG nor JPEG.
    of_textures: Vec<Option<String>>,
}

impl<'s> TextureParts<'s> {
    fn of(textures: &'s [Texture]) -> Self {
        let mut texture_parts = Self { files: Vec::new(), of_textures: Vec::new() };
        for texture in textures {
            let ending = match texture.media_type.as_str() {
                "image/png" => "png",
                "image/jpeg" => "jpg",
                _ => {
                    texture_parts.of_textures.push(None);
                    continue;
                }
            };
            let same = |other: &&(String, &Texture)| {
                other.1.bytes == texture.bytes && other.1.media_type == texture.media_type
            };
            let path = match texture_parts.files.iter().find(same) {
                Some((path, _)) => path.clone(),
                None => {
                    let path = format!("3D/Textures/texture{}.{ending}", texture_parts.files.len() + 1);
                    texture_parts.files.push((path.clone(), texture));
                    path
                }
            };
            texture_parts.of_textures.push(Some(path));
        }
        texture_parts
    }
}

const DECLARATION: &str = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n";

/// The content types part.
fn content_types(texture_parts: &TextureParts<'_>) -> String {
    let mut text =
        format!("{DECLARATION}<Types xmlns=\"http://schemas.openxmlformats.org/package/2006/content-types\">\n");
    let of_pictures = [("png", "image/png"), ("jpg", "image/jpeg")]
        .into_iter()
        .filter(|(_, media_type)| texture_parts.files.iter().any(|(_, texture)| texture.media_type == *media_type));
    let types = [
        ("rels", "application/vnd.openxmlformats-package.relationships+xml"),
        ("model", "application/vnd.ms-package.3dmanufacturing-3dmodel+xml"),
    ];
    for (extension, media_type) in types.into_iter().chain(of_pictures) {
        text += &format!("<Default Extension=\"{extension}\" ContentType=\"{media_type}\"/>\n");
    }
    text + "</Types>\n"
}

/// A relationships part, from pairs of type and target.
fn relationships<'t>(all: impl Iterator<Item = (&'t str, &'t str)>) -> String {
    let mut text = format!(
        "{DECLARATION}<Relationships xmlns=\"http://schemas.openxmlformats.org/package/2006/relationships\">\n"
    );
    for (number, (kind, target)) in all.enumerate() {
        text += &format!("<Relationship Id=\"rel{number}\" Type=\"{kind}\" Target=\"/{}\"/>\n", attribute(target));
    }
    text + "</Relationships>\n"
}

/// Size in bytes at which collected text is compressed.
const CHUNK_BYTES: usize = 64 << 10;

/// Writes the model part of a scene.
struct ModelWriter<'s> {
    scene: &'s Scene,
    /// The part of each texture; `None` if it is not written.
    texture_parts: &'s [Option<String>],
    prefixes: Prefixes<'s>,
    /// Resource ids of textures and palettes; `None` if they are not written.
    textures: Vec<Option<u32>>,
    palettes: Vec<Option<u32>>,
    first_object: u32,
    /// Whether each object is a build item.
    built: Vec<bool>,
    text: String,
    /// Whether all numbers so far were finite.
    finite: bool,
}

// Writing to a String can't fail, so the results of `write!` are ignored.
impl<'s> ModelWriter<'s> {
    fn new(scene: &'s Scene, texture_parts: &'s [Option<String>]) -> Self {
        let mut next = 0;
        let mut number = |is_written: bool| {
            next += u32::from(is_written);
            is_written.then_some(next)
        };
        let textures: Vec<_> = texture_parts.iter().map(|part| number(part.is_some())).collect();
        let is_written = |palette: &Palette| match palette {
            Palette::Textured { texture, .. } => textures.get(*texture as usize).is_some_and(Option::is_some),
            _ => true,
        };
        let palettes =
            scene.palettes.iter().map(|palette| number(!palette.is_empty() && is_written(palette))).collect();
        let prefixes = Prefixes::of(scene);
        let mut built = vec![false; scene.objects.len()];
        for item in &scene.items {
            if let Some(built) = built.get_mut(item.object as usize) {
                *built = true;
            }
        }
        let (first_object, text) = (next + 1, String::new());
        Self { scene, texture_parts, prefixes, textures, palettes, first_object, built, text, finite: true }
    }

    /// Writes the model part. Returns whether all numbers are finite, as 3MF requires.
    fn write(mut self, target: &mut impl Write) -> io::Result<bool> {
        let _ = write!(
            self.text,
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<model unit=\"{}\" xml:lang=\"en-US\" xmlns=\"{CORE}\" xmlns:m=\"{MATERIAL}\"{}>\n",
            unit(self.scene.unit),
            self.prefixes.declarations()
        );
        self.prefixes.write(self.scene.notes.iter(), &mut self.text);
        self.text.push_str("<resources>\n");
        self.textures();
        for (palette, id) in self.scene.palettes.iter().zip(self.palettes.clone()) {
            if let Some(id) = id {
                self.palette(palette, id, target)?;
            }
        }
        for (number, object) in self.scene.objects.iter().enumerate() {
            self.object(number, object, target)?;
        }
        self.text.push_str("</resources>\n<build>\n");
        for item in &self.scene.items {
            self.item(item);
            self.pack(target)?;
        }
        self.text.push_str("</build>\n</model>\n");
        target.write_all(self.text.as_bytes())?;
        Ok(self.finite)
    }

    /// Compresses the collected text once it is long enough.
    fn pack(&mut self, target: &mut impl Write) -> io::Result<()> {
        if self.text.len() >= CHUNK_BYTES {
            target.write_all(self.text.as_bytes())?;
            self.text.clear();
        }
        Ok(())
    }

    /// Writes a number, and records whether it is finite.
    fn number(&mut self, number: f64) {
        self.finite &= number.is_finite();
        let _ = write!(self.text, "{number}");
    }

    fn textures(&mut self) {
        for ((texture, path), id) in self.scene.textures.iter().zip(self.texture_parts).zip(&self.textures) {
            let (Some(path), Some(id)) = (path, id) else { continue };
            let media_type = attribute(&texture.media_type);
            let _ = write!(self.text, "<m:texture2d id=\"{id}\" path=\"/{path}\" contenttype=\"{media_type}\"");
            for (name, style) in [("tilestyleu", texture.wrap_u), ("tilestylev", texture.wrap_v)] {
                if let Some(style) = tile_style(style) {
                    let _ = write!(self.text, " {name}=\"{style}\"");
                }
            }
            self.text.push_str(if texture.nearest { " filter=\"nearest\"/>\n" } else { "/>\n" });
        }
    }

    fn palette(&mut self, palette: &Palette, id: u32, target: &mut impl Write) -> io::Result<()> {
        let element = match palette {
            Palette::Materials(materials) => {
                let _ = writeln!(self.text, "<basematerials id=\"{id}\">");
                for material in materials {
                    let (name, color) = (attribute(&material.name), color(material.color));
                    let _ = writeln!(self.text, "<base name=\"{name}\" displaycolor=\"{color}\"/>");
                    self.pack(target)?;
                }
                "basematerials"
            }
            Palette::Colors(colors) => {
                let _ = writeln!(self.text, "<m:colorgroup id=\"{id}\">");
                for &entry in colors {
                    let _ = writeln!(self.text, "<m:color color=\"{}\"/>", color(entry));
                    self.pack(target)?;
                }
                "m:colorgroup"
            }
            Palette::Textured { texture, places, .. } => {
                let texture = self.textures.get(*texture as usize).copied().flatten().unwrap_or_default();
                let _ = writeln!(self.text, "<m:texture2dgroup id=\"{id}\" texid=\"{texture}\">");
                for place in places {
                    // Texture coordinates that are not finite must not make writing fail.
                    let [u, v] = place.map(|x| if x.is_finite() { x } else { 0.0 });
                    let _ = writeln!(self.text, "<m:tex2coord u=\"{u}\" v=\"{v}\"/>");
                    self.pack(target)?;
                }
                "m:texture2dgroup"
            }
        };
        let _ = writeln!(self.text, "</{element}>");
        Ok(())
    }

    fn object(&mut self, number: usize, object: &Object, target: &mut impl Write) -> io::Result<()> {
        let id = u64::from(self.first_object) + number as u64;
        let _ = write!(self.text, "<object id=\"{id}\"");
        if let Some(kind) = self.kind(number, object.kind) {
            let _ = write!(self.text, " type=\"{kind}\"");
        }
        self.nonempty_attribute("name", object.name.as_deref());
        self.nonempty_attribute("partnumber", object.part_number.as_deref());
        let default = object.mesh().and_then(|mesh| self.default_paint(mesh));
        if let Some((palette, entry)) = default {
            let _ = write!(self.text, " pid=\"{palette}\" pindex=\"{entry}\"");
        }
        self.text.push_str(">\n");
        self.notes(object.notes.iter());
        match &object.shape {
            Shape::Mesh(mesh) => self.mesh(mesh, default, target)?,
            Shape::Components(components) => {
                self.text.push_str("<components>\n");
                for component in components.iter().filter(|component| (component.object as usize) < number) {
                    let id = u64::from(self.first_object) + u64::from(component.object);
                    let _ = write!(self.text, "<component objectid=\"{id}\"");
                    self.transform(component.transform);
                    self.text.push_str("/>\n");
                    self.pack(target)?;
                }
                self.text.push_str("</components>\n");
            }
        }
        self.text.push_str("</object>\n");
        Ok(())
    }

    /// The type of an object; `None` stands for `model`. Build items may not have the type `other`.
    fn kind(&self, number: usize, kind: ObjectKind) -> Option<&'static str> {
        Some(match kind {
            ObjectKind::Model => return None,
            ObjectKind::SolidSupport => "solidsupport",
            ObjectKind::Support => "support",
            ObjectKind::Surface => "surface",
            ObjectKind::Other if self.built[number] => return None,
            ObjectKind::Other => "other",
        })
    }

    /// Writes an attribute unless its value is empty.
    fn nonempty_attribute(&mut self, name: &str, value: Option<&str>) {
        let value = attribute(value.unwrap_or_default());
        if !value.is_empty() {
            let _ = write!(self.text, " {name}=\"{value}\"");
        }
    }

    /// Writes a metadata group unless it would be empty.
    fn notes<'n>(&mut self, notes: impl Iterator<Item = &'n Note>) {
        let before = self.text.len();
        self.text.push_str("<metadatagroup>\n");
        let begun = self.text.len();
        self.prefixes.write(notes, &mut self.text);
        match self.text.len() == begun {
            true => self.text.truncate(before),
            false => self.text.push_str("</metadatagroup>\n"),
        }
    }

    /// The resource id and entries of a face's paint; `None` if it is not painted or its palette is not written.
    fn paint(&self, paint: Paint) -> Option<(u32, [u32; 3])> {
        if paint == PAINTLESS {
            return None;
        }
        let id = self.palettes.get(paint.palette as usize).copied().flatten()?;
        let palette = &self.scene.palettes[paint.palette as usize];
        let at = match palette {
            Palette::Materials(_) => [paint.at[0]; 3],
            _ => paint.at,
        };
        at.iter().all(|&entry| (entry as usize) < palette.len()).then_some((id, at))
    }

    /// The default property of an object: that of its first face, if all faces are painted.
    fn default_paint(&self, mesh: &PaintedMesh) -> Option<(u32, u32)> {
        let all =
            mesh.paint.len() == mesh.soup.faces.len() && mesh.paint.iter().all(|&paint| self.paint(paint).is_some());
        let (palette, at) = self.paint(*mesh.paint.first()?)?;
        all.then_some((palette, at[0]))
    }

    fn mesh(&mut self, mesh: &PaintedMesh, default: Option<(u32, u32)>, target: &mut impl Write) -> io::Result<()> {
        self.text.push_str("<mesh>\n<vertices>\n");
        for position in &mesh.soup.positions {
            for (before, value) in ["<vertex x=\"", "\" y=\"", "\" z=\""].into_iter().zip(position.to_array()) {
                self.text.push_str(before);
                self.number(value);
            }
            self.text.push_str("\"/>\n");
            self.pack(target)?;
        }
        self.text.push_str("</vertices>\n<triangles>\n");
        for (face, [a, b, c]) in mesh.soup.faces.iter().enumerate() {
            let _ = write!(self.text, "<triangle v1=\"{a}\" v2=\"{b}\" v3=\"{c}\"");
            let paint = mesh.paint.get(face).and_then(|&paint| self.paint(paint));
            if let Some((palette, [p1, p2, p3])) =
                paint.filter(|&(id, at)| default != Some((id, at[0])) || at != [at[0]; 3])
            {
                let _ = write!(self.text, " pid=\"{palette}\" p1=\"{p1}\"");
                if [p2, p3] != [p1, p1] {
                    let _ = write!(self.text, " p2=\"{p2}\" p3=\"{p3}\"");
                }
            }
            self.text.push_str("/>\n");
            self.pack(target)?;
        }
        self.text.push_str("</triangles>\n</mesh>\n");
        Ok(())
    }

    fn transform(&mut self, transform: DAffine3) {
        if transform == DAffine3::IDENTITY {
            return;
        }
        self.text.push_str(" transform=\"");
        for (index, value) in transform.to_cols_array().into_iter().enumerate() {
            if index > 0 {
                self.text.push(' ');
            }
            self.number(value);
        }
        self.text.push('"');
    }

    fn item(&mut self, item: &Item) {
        if item.object as usize >= self.scene.objects.len() {
            return;
        }
        let id = u64::from(self.first_object) + u64::from(item.object);
        let _ = write!(self.text, "<item objectid=\"{id}\"");
        self.transform(self.scene.stood(Up::Z, item.transform));
        self.nonempty_attribute("partnumber", item.part_number.as_deref());
        self.text.push('>');
        // Build items have no name attribute, so the name becomes the metadata `Title`.
        let title = item.name.as_ref().filter(|name| !attribute(name).is_empty()).map(|name| Note {
            name: "Title".to_owned(),
            namespace: None,
            value: name.clone(),
            kind: None,
            preserve: false,
        });
        self.notes(title.iter().chain(&item.notes));
        self.text.push_str("</item>\n");
    }
}

fn unit(unit: Option<Unit>) -> &'static str {
    match unit {
        Some(Unit::Micrometre) => "micron",
        None | Some(Unit::Millimetre) => "millimeter",
        Some(Unit::Centimetre) => "centimeter",
        Some(Unit::Inch) => "inch",
        Some(Unit::Foot) => "foot",
        Some(Unit::Metre) => "meter",
    }
}

fn tile_style(wrap: Wrap) -> Option<&'static str> {
    match wrap {
        Wrap::Repeat => None,
        Wrap::Mirror => Some("mirror"),
        Wrap::Clamp => Some("clamp"),
        Wrap::None => Some("none"),
    }
}

fn color(color: [u8; 4]) -> String {
    let hex = hex::encode_upper(color);
    format!("#{}", hex.strip_suffix("FF").unwrap_or(&hex))
}
