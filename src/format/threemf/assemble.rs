//! Building one scene from the parts of a model: property groups become palettes, and objects are sorted so that components come before the
//! objects that use them. Mixtures become plain colours, because palettes can't represent them.

use std::collections::HashMap;
use std::sync::Arc;

use super::part::{Group, GroupKind, ObjectReference, ObjectResource, Part, ShapeResource, Warnings};
use crate::format::archive::{Archive, name_excerpt, name_key};
use crate::format::errors::{self, ReadError, ReadErrorKind};
use crate::format::paint::MAX_TEXTURE_BYTES;
use crate::scene::{
    Component, Item, Material, Note, Object, ObjectKind, PAINTLESS, PaintedMesh, Palette, Scene, Shape, Texture, Up,
};

/// Builds the scene of all parts, of which the first is the root model.
///
/// # Errors
/// A [`ReadError`] if a reference to an object, group or texture is invalid, or components are nested too deep.
pub(super) fn scene(
    mut parts: Vec<Part>,
    archive: &mut Archive<'_>,
    warnings: &mut Warnings,
) -> Result<Scene, ReadError> {
    let mut scene = Scene { up: Some(Up::Z), ..Scene::default() };
    let mut texture_files = TextureFiles { known: HashMap::new(), left: MAX_TEXTURE_BYTES };
    for part in &mut parts {
        let first_texture = u32::try_from(scene.textures.len()).unwrap_or(u32::MAX);
        for texture in &part.textures {
            scene.textures.push(Texture {
                bytes: texture_files.get(&texture.path, archive)?,
                media_type: texture.media_type.to_owned(),
                wrap_u: texture.wrap_u,
                wrap_v: texture.wrap_v,
                nearest: texture.nearest,
            });
        }
        build_palettes(part, first_texture, &mut scene.palettes, warnings)?;
    }
    if let Some(model) = parts.first_mut() {
        scene.unit = model.unit;
        scene.notes = std::mem::take(&mut model.notes);
    }
    let items = parts.first_mut().map(|model| std::mem::take(&mut model.items)).unwrap_or_default();
    let order = ObjectOrder::of(&parts)?;
    let mut resources: Vec<Vec<Option<ObjectResource>>> =
        parts.iter_mut().map(|part| std::mem::take(&mut part.objects).into_iter().map(Some).collect()).collect();
    for &(part, object) in &order.sorted {
        if let Some(resource) = resources[part][object].take() {
            scene.objects.push(order.object(part, resource)?);
        }
    }
    for item in items {
        let object = order.number(0, &item)?;
        if scene.objects[object as usize].kind == ObjectKind::Other {
            return Err(malformed(format!(
                "a build item refers to the object {}, but objects of the type 'other' must not be built",
                item.id
            )));
        }
        let ObjectReference { transform, part_number, mut notes, .. } = item;
        let name = take_title(&mut notes);
        scene.items.push(Item { object, transform, name, part_number, notes });
    }
    Ok(scene)
}

/// Takes the name of a build item from its metadata `Title`, because build items have no name attribute.
fn take_title(notes: &mut Vec<Note>) -> Option<String> {
    let title = notes.iter().position(|note| note.name == "Title" && note.kind.is_none() && !note.preserve)?;
    Some(notes.remove(title).value)
}

/// Texture files that have been unpacked, and the bytes that may still be.
struct TextureFiles {
    known: HashMap<String, Arc<[u8]>>,
    left: u64,
}

impl TextureFiles {
    fn get(&mut self, path: &str, archive: &mut Archive<'_>) -> Result<Arc<[u8]>, ReadError> {
        if let Some(bytes) = self.known.get(&name_key(path)) {
            return Ok(Arc::clone(bytes));
        }
        let bytes = archive.read_file(path, self.left)?;
        let bytes: Arc<[u8]> =
            bytes.ok_or_else(|| malformed(format!("the texture {} is not in the file", name_excerpt(path))))?.into();
        self.left -= bytes.len() as u64;
        self.known.insert(name_key(path), Arc::clone(&bytes));
        Ok(bytes)
    }
}

/// The state of an object in the depth-first search.
#[derive(Clone, Copy)]
enum VisitState {
    /// Not visited.
    Unvisited,
    /// Its components are being visited.
    InProgress,
    /// Visited; the value is the number of levels below it.
    Done(usize),
}

/// Topological order of the objects: components come before the objects that use them.
struct ObjectOrder {
    /// Index of each part by [`name_key`].
    parts: HashMap<String, usize>,
    /// Index of each object in its part, by part and id.
    places: HashMap<(usize, u32), usize>,
    /// Part and index of each object, in order.
    sorted: Vec<(usize, usize)>,
    /// Position of each object in `sorted`.
    numbers: HashMap<(usize, usize), u32>,
}

impl ObjectOrder {
    fn of(parts: &[Part]) -> Result<Self, ReadError> {
        let mut order = Self {
            parts: parts.iter().enumerate().map(|(index, part)| (name_key(&part.name), index)).collect(),
            places: HashMap::new(),
            sorted: Vec::new(),
            numbers: HashMap::new(),
        };
        for (part, content) in parts.iter().enumerate() {
            order.places.extend(content.objects.iter().enumerate().map(|(place, object)| ((part, object.id), place)));
        }
        let mut seen: Vec<_> = parts.iter().map(|part| vec![VisitState::Unvisited; part.objects.len()]).collect();
        for (part, content) in parts.iter().enumerate() {
            for place in 0..content.objects.len() {
                order.visit((part, place), parts, &mut seen, Scene::DEPTH)?;
            }
        }
        Ok(order)
    }

    /// Visits an object's components, then appends the object. Returns the number of levels below it.
    fn visit(
        &mut self,
        (part, place): (usize, usize),
        parts: &[Part],
        seen: &mut [Vec<VisitState>],
        depth: usize,
    ) -> Result<usize, ReadError> {
        let object = &parts[part].objects[place];
        match seen[part][place] {
            VisitState::Done(height) => return Ok(height),
            VisitState::InProgress => return Err(malformed(format!("the object {} contains itself", object.id))),
            VisitState::Unvisited => seen[part][place] = VisitState::InProgress,
        }
        let mut height = 0;
        if let ShapeResource::Components(components) = &object.shape {
            let below = depth.checked_sub(1).ok_or_else(too_deep)?;
            for component in components {
                let below = self.visit(self.locate(part, component)?, parts, seen, below)?;
                height = height.max(below + 1);
            }
        }
        if height > Scene::DEPTH {
            return Err(too_deep());
        }
        seen[part][place] = VisitState::Done(height);
        self.numbers.insert((part, place), u32::try_from(self.sorted.len()).unwrap_or(u32::MAX));
        self.sorted.push((part, place));
        Ok(height)
    }

    /// Part and index of the object that a component or item of a part refers to.
    fn locate(&self, part: usize, placed: &ObjectReference) -> Result<(usize, usize), ReadError> {
        let part = match &placed.path {
            Some(path) => self.parts.get(&name_key(path)).copied(),
            None => Some(part),
        };
        let location = part.and_then(|part| Some((part, *self.places.get(&(part, placed.id))?)));
        location.ok_or_else(|| {
            let of =
                placed.path.as_deref().map_or_else(String::new, |path| format!(" of the part {}", name_excerpt(path)));
            malformed(format!("a component or build item refers to the object {}{of}, which does not exist", placed.id))
        })
    }

    fn number(&self, part: usize, placed: &ObjectReference) -> Result<u32, ReadError> {
        Ok(self.numbers[&self.locate(part, placed)?])
    }

    fn object(&self, part: usize, resource: ObjectResource) -> Result<Object, ReadError> {
        let ObjectResource { name, part_number, kind, notes, shape, .. } = resource;
        let shape = match shape {
            ShapeResource::Mesh { soup, paint } => Shape::Mesh(PaintedMesh { soup, paint }),
            ShapeResource::Components(components) => {
                let component = |reference: &ObjectReference| {
                    Ok(Component { object: self.number(part, reference)?, transform: reference.transform })
                };
                Shape::Components(components.iter().map(component).collect::<Result<_, ReadError>>()?)
            }
        };
        Ok(Object { name, part_number, kind, shape, notes })
    }
}

fn too_deep() -> ReadError {
    let detail = format!("components are nested more than {} deep; export the model with fewer levels", Scene::DEPTH);
    ReadError::for_file(ReadErrorKind::TooLarge, detail)
}

fn malformed(detail: String) -> ReadError {
    ReadError::for_file(ReadErrorKind::Malformed, format!("{detail}; export the model again"))
}

/// The palette that a property group has become.
struct GroupPalette {
    kind: GroupType,
    palette: u32,
    entries: Entries,
}

/// The type of a property group, as far as multiproperties depend on it.
#[derive(Clone, Copy, PartialEq, Eq)]
enum GroupType {
    Materials,
    Composites,
    Colors,
    Texture,
}

/// The palette entries of a property group's entries.
enum Entries {
    /// The same entries; the value is their number.
    Same(usize),
    /// The palette entry of each group entry.
    Mapped(Vec<u32>),
}

impl Entries {
    fn get(&self, entry: u32) -> Option<u32> {
        match self {
            Self::Same(count) => ((entry as usize) < *count).then_some(entry),
            Self::Mapped(entries) => entries.get(entry as usize).copied(),
        }
    }
}

/// Turns a part's property groups into palettes, and updates the paint of its objects. `first_texture` is the scene index of its first
/// texture.
fn build_palettes(
    part: &mut Part,
    first_texture: u32,
    palettes: &mut Vec<Palette>,
    warnings: &mut Warnings,
) -> Result<(), ReadError> {
    let known = group_palettes(part, first_texture, palettes, warnings)?;
    let mut used = Vec::with_capacity(part.used_groups.groups.len());
    for id in &part.used_groups.groups {
        let group = known.get(id);
        used.push(group.ok_or_else(|| {
            malformed_in(&part.name, format!("an object refers to the property group {id}, which does not exist"))
        })?);
    }
    for object in &mut part.objects {
        let ShapeResource::Mesh { paint, .. } = &mut object.shape else { continue };
        for paint in paint.iter_mut().filter(|paint| **paint != PAINTLESS) {
            let group = used[paint.palette as usize];
            for at in &mut paint.at {
                *at = group.entries.get(*at).ok_or_else(|| {
                    let detail =
                        format!("the object {} refers to entry {at} of a property group that has fewer", object.id);
                    ReadError { kind: ReadErrorKind::IndexOutOfRange, ..malformed_in(&part.name, detail) }
                })?;
            }
            if group.kind == GroupType::Materials {
                paint.at = [paint.at[0]; 3];
            }
            paint.palette = group.palette;
        }
    }
    Ok(())
}

/// The palettes of a part's property groups, by group id.
fn group_palettes(
    part: &mut Part,
    first_texture: u32,
    palettes: &mut Vec<Palette>,
    warnings: &mut Warnings,
) -> Result<HashMap<u32, GroupPalette>, ReadError> {
    let malformed = |detail| malformed_in(&part.name, detail);
    let mut mixed = part
        .groups
        .iter()
        .map(|group| composite_colors(&part.groups, group))
        .collect::<Result<Vec<_>, _>>()
        .map_err(malformed)?;
    let mut known = HashMap::new();
    let mut layered = Vec::new();
    for (Group { id, kind }, mixed) in std::mem::take(&mut part.groups).into_iter().zip(&mut mixed) {
        let (kind, palette) = match kind {
            GroupKind::Materials(materials) => (GroupType::Materials, Palette::Materials(materials)),
            GroupKind::Colors(colors) => (GroupType::Colors, Palette::Colors(colors)),
            GroupKind::Composites { .. } => {
                warnings.add("mixtures of materials (composite materials) were replaced by colours");
                (GroupType::Composites, Palette::Colors(std::mem::take(mixed)))
            }
            GroupKind::TextureCoordinates { texture, places } => {
                let index = part.textures.iter().position(|resource| resource.id == texture);
                let index = index.ok_or_else(|| {
                    malformed(format!("the texture group {id} refers to the texture {texture}, which does not exist"))
                })?;
                let texture = first_texture + u32::try_from(index).unwrap_or(u32::MAX);
                (GroupType::Texture, Palette::Textured { texture, name: None, tint: [255; 4], places })
            }
            GroupKind::Layers { of, entries } => {
                layered.push((id, of, entries));
                continue;
            }
        };
        let entries = Entries::Same(palette.len());
        known.insert(id, GroupPalette { kind, palette: u32::try_from(palettes.len()).unwrap_or(u32::MAX), entries });
        palettes.push(palette);
    }
    let mut layers = Vec::with_capacity(layered.len());
    for (id, of, entries) in &layered {
        let top = top_layer(&known, of).map_err(|detail| malformed(format!("the multiproperties {id}: {detail}")))?;
        let group = &known[&of[top]];
        let chosen = entries.iter().skip(top).step_by(of.len());
        let chosen = chosen.map(|&entry| {
            group.entries.get(entry).ok_or_else(|| {
                malformed(format!(
                    "the multiproperties {id} refer to entry {entry} of the group {}, which has fewer",
                    of[top]
                ))
            })
        });
        let layer = GroupPalette {
            kind: group.kind,
            palette: group.palette,
            entries: Entries::Mapped(chosen.collect::<Result<_, _>>()?),
        };
        warnings.add("layered properties (multiproperties) were reduced to their topmost colour or texture");
        layers.push((*id, layer));
    }
    known.extend(layers);
    Ok(known)
}

/// The colours of a composite group: each the mean of its materials' colours, weighted by their shares.
fn composite_colors(groups: &[Group], group: &Group) -> Result<Vec<[u8; 4]>, String> {
    let GroupKind::Composites { of, materials, shares } = &group.kind else { return Ok(Vec::new()) };
    let base = groups.iter().find_map(|group| match &group.kind {
        GroupKind::Materials(materials) if group.id == *of => Some(materials),
        _ => None,
    });
    let base = base.ok_or_else(|| {
        format!("the composite materials {} refer to the group {of}, which is not a base materials group", group.id)
    })?;
    let colors = materials.iter().map(|&index| base.get(index as usize).map(|material: &Material| material.color));
    let colors: Option<Vec<_>> = colors.collect();
    let colors = colors.ok_or_else(|| {
        format!("the composite materials {} refer to a material that the group {of} does not have", group.id)
    })?;
    let mean = |shares: &[f64]| {
        let sum: f64 = shares.iter().sum();
        let of_channel = |channel: usize| {
            let (weighted, sum) = match sum > 0.0 {
                true => (colors.iter().zip(shares).map(|(color, share)| f64::from(color[channel]) * share).sum(), sum),
                false => (colors.iter().map(|color| f64::from(color[channel])).sum::<f64>(), colors.len() as f64),
            };
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a mean of bytes; sums beyond f64 saturate"
            )]
            {
                (weighted / sum).round() as u8
            }
        };
        std::array::from_fn(of_channel)
    };
    Ok(shares.chunks_exact(colors.len().max(1)).map(mean).collect())
}

/// The index of the last layer with colours or a texture, else the first. The rules for layers are those of the materials extension,
/// chapter 5.
fn top_layer(known: &HashMap<u32, GroupPalette>, of: &[u32]) -> Result<usize, String> {
    let kinds = of.iter().map(|id| {
        known.get(id).map(|group| group.kind).ok_or_else(|| format!("{} is not a group that can be a layer", id))
    });
    let kinds: Vec<GroupType> = kinds.collect::<Result<_, _>>()?;
    let is_material = |kind: &GroupType| matches!(kind, GroupType::Materials | GroupType::Composites);
    if kinds.iter().skip(1).any(is_material) {
        return Err("a material may only be the first layer".to_owned());
    }
    if kinds.iter().filter(|&&kind| kind == GroupType::Colors).count() > 1 {
        return Err("only one layer may be a colour group".to_owned());
    }
    Ok(kinds.iter().rposition(|kind| !is_material(kind)).unwrap_or(0))
}

fn malformed_in(part: &str, detail: String) -> ReadError {
    let detail = format!("in the part {}: {detail}; export the model again", errors::excerpt(part.as_bytes()));
    ReadError::for_file(ReadErrorKind::Malformed, detail)
}
