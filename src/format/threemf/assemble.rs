//! The parts of a model as one scene: their groups of properties as palettes, and objects in an order in which those that others are made of
//! come first. What mixes groups is told by colours alone, since a palette knows no mixtures.

use std::collections::HashMap;
use std::sync::Arc;

use super::part::{Group, GroupKind, ObjectResource, Part, Placed, ShapeResource, Warnings};
use crate::format::archive::{Archive, key, shown};
use crate::format::errors::{self, ReadError, ReadErrorKind};
use crate::format::paint::MOST_PICTURE_BYTES;
use crate::scene::{
    Component, Item, Material, Note, Object, ObjectKind, PAINTLESS, PaintedMesh, Palette, Scene, Shape, Texture, Up,
};

/// Makes the scene of parts, the first of which is the model.
pub(super) fn scene(
    mut parts: Vec<Part>,
    archive: &mut Archive<'_>,
    warnings: &mut Warnings,
) -> Result<Scene, ReadError> {
    let mut scene = Scene { up: Some(Up::Z), ..Scene::default() };
    let mut pictures = Pictures { known: HashMap::new(), left: MOST_PICTURE_BYTES };
    for part in &mut parts {
        let first_texture = u32::try_from(scene.textures.len()).unwrap_or(u32::MAX);
        for texture in &part.textures {
            scene.textures.push(Texture {
                bytes: pictures.get(&texture.path, archive)?,
                media_type: texture.media_type.to_owned(),
                wrap_u: texture.wrap_u,
                wrap_v: texture.wrap_v,
                nearest: texture.nearest,
            });
        }
        take_palettes(part, first_texture, &mut scene.palettes, warnings)?;
    }
    if let Some(model) = parts.first_mut() {
        scene.unit = model.unit;
        scene.notes = std::mem::take(&mut model.notes);
    }
    let items = parts.first_mut().map(|model| std::mem::take(&mut model.items)).unwrap_or_default();
    let order = Order::of(&parts)?;
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
            return Err(refused(format!(
                "an item of the build is the object {}, which is of the type 'other' and not to be built",
                item.id
            )));
        }
        let Placed { transform, part_number, mut notes, .. } = item;
        let name = take_title(&mut notes);
        scene.items.push(Item { object, transform, name, part_number, notes });
    }
    Ok(scene)
}

/// The name of a build item: the core specification gives it none, but notes, of which `Title` is one.
fn take_title(notes: &mut Vec<Note>) -> Option<String> {
    let title = notes.iter().position(|note| note.name == "Title" && note.kind.is_none() && !note.preserve)?;
    Some(notes.remove(title).value)
}

/// The pictures that have been unpacked.
struct Pictures {
    known: HashMap<String, Arc<[u8]>>,
    left: u64,
}

impl Pictures {
    fn get(&mut self, path: &str, archive: &mut Archive<'_>) -> Result<Arc<[u8]>, ReadError> {
        if let Some(bytes) = self.known.get(&key(path)) {
            return Ok(Arc::clone(bytes));
        }
        let bytes = archive.bytes(path, self.left)?;
        let bytes: Arc<[u8]> =
            bytes.ok_or_else(|| refused(format!("the texture {} is not in the file", shown(path))))?.into();
        self.left -= bytes.len() as u64;
        self.known.insert(key(path), Arc::clone(&bytes));
        Ok(bytes)
    }
}

/// How far an object has been looked at.
#[derive(Clone, Copy)]
enum Seen {
    Not,
    /// Those that it is made of are looked at.
    Open,
    /// It is made of so many levels.
    Whole(usize),
}

/// Where objects are, and the order in which none comes before those that it is made of.
struct Order {
    /// The parts by [`key`].
    parts: HashMap<String, usize>,
    /// Where an object is in its part, by part and id.
    places: HashMap<(usize, u32), usize>,
    sorted: Vec<(usize, usize)>,
    /// The place of objects in `sorted`.
    numbers: HashMap<(usize, usize), u32>,
}

impl Order {
    fn of(parts: &[Part]) -> Result<Self, ReadError> {
        let mut order = Self {
            parts: parts.iter().enumerate().map(|(index, part)| (key(&part.name), index)).collect(),
            places: HashMap::new(),
            sorted: Vec::new(),
            numbers: HashMap::new(),
        };
        for (part, it) in parts.iter().enumerate() {
            order.places.extend(it.objects.iter().enumerate().map(|(place, object)| ((part, object.id), place)));
        }
        let mut seen: Vec<_> = parts.iter().map(|part| vec![Seen::Not; part.objects.len()]).collect();
        for (part, it) in parts.iter().enumerate() {
            for place in 0..it.objects.len() {
                order.visit((part, place), parts, &mut seen, Scene::DEPTH)?;
            }
        }
        Ok(order)
    }

    /// Puts an object after those that it is made of. Answers of how many levels it is made.
    fn visit(
        &mut self,
        (part, place): (usize, usize),
        parts: &[Part],
        seen: &mut [Vec<Seen>],
        depth: usize,
    ) -> Result<usize, ReadError> {
        let object = &parts[part].objects[place];
        match seen[part][place] {
            Seen::Whole(height) => return Ok(height),
            Seen::Open => return Err(refused(format!("the object {} is made of itself", object.id))),
            Seen::Not => seen[part][place] = Seen::Open,
        }
        let mut height = 0;
        if let ShapeResource::Components(components) = &object.shape {
            let below = depth.checked_sub(1).ok_or_else(too_deep)?;
            for component in components {
                let below = self.visit(self.place(part, component)?, parts, seen, below)?;
                height = height.max(below + 1);
            }
        }
        if height > Scene::DEPTH {
            return Err(too_deep());
        }
        seen[part][place] = Seen::Whole(height);
        self.numbers.insert((part, place), u32::try_from(self.sorted.len()).unwrap_or(u32::MAX));
        self.sorted.push((part, place));
        Ok(height)
    }

    /// Where the object is that is named in a part.
    fn place(&self, part: usize, placed: &Placed) -> Result<(usize, usize), ReadError> {
        let part = match &placed.path {
            Some(path) => self.parts.get(&key(path)).copied(),
            None => Some(part),
        };
        let found = part.and_then(|part| Some((part, *self.places.get(&(part, placed.id))?)));
        found.ok_or_else(|| {
            let of = placed.path.as_deref().map_or_else(String::new, |path| format!(" of the part {}", shown(path)));
            refused(format!("a component or an item of the build is the object {}{of}, which is not there", placed.id))
        })
    }

    fn number(&self, part: usize, placed: &Placed) -> Result<u32, ReadError> {
        Ok(self.numbers[&self.place(part, placed)?])
    }

    fn object(&self, part: usize, resource: ObjectResource) -> Result<Object, ReadError> {
        let ObjectResource { name, part_number, kind, notes, shape, .. } = resource;
        let shape = match shape {
            ShapeResource::Mesh { soup, paint } => Shape::Mesh(PaintedMesh { soup, paint }),
            ShapeResource::Components(components) => {
                let component = |it: &Placed| Ok(Component { object: self.number(part, it)?, transform: it.transform });
                Shape::Components(components.iter().map(component).collect::<Result<_, ReadError>>()?)
            }
        };
        Ok(Object { name, part_number, kind, shape, notes })
    }
}

fn too_deep() -> ReadError {
    let detail =
        format!("objects are made of objects more than {} deep; export the model with fewer levels", Scene::DEPTH);
    ReadError::whole(ReadErrorKind::TooLarge, detail)
}

fn refused(detail: String) -> ReadError {
    ReadError::whole(ReadErrorKind::Malformed, format!("{detail}; export the model again"))
}

/// What a group has become.
struct Known {
    kind: Kind,
    palette: u32,
    entries: Entries,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Materials,
    Composites,
    Colors,
    Texture,
}

/// The entries of a palette that are those of a group.
enum Entries {
    /// The first ones, as many.
    First(usize),
    These(Vec<u32>),
}

impl Entries {
    fn get(&self, entry: u32) -> Option<u32> {
        match self {
            Self::First(count) => ((entry as usize) < *count).then_some(entry),
            Self::These(entries) => entries.get(entry as usize).copied(),
        }
    }
}

/// Takes a part's groups over into palettes, and makes its paint name them. Its textures are `first_texture` and the following.
fn take_palettes(
    part: &mut Part,
    first_texture: u32,
    palettes: &mut Vec<Palette>,
    warnings: &mut Warnings,
) -> Result<(), ReadError> {
    let known = groups(part, first_texture, palettes, warnings)?;
    let mut used = Vec::with_capacity(part.painted_by.groups.len());
    for id in &part.painted_by.groups {
        let group = known.get(id);
        used.push(group.ok_or_else(|| {
            refused_in(&part.name, format!("an object names the property group {id}, which is not there"))
        })?);
    }
    for object in &mut part.objects {
        let ShapeResource::Mesh { paint, .. } = &mut object.shape else { continue };
        for paint in paint.iter_mut().filter(|paint| **paint != PAINTLESS) {
            let group = used[paint.palette as usize];
            for at in &mut paint.at {
                *at = group.entries.get(*at).ok_or_else(|| {
                    let detail =
                        format!("the object {} names entry {at} of a property group that has fewer", object.id);
                    ReadError { kind: ReadErrorKind::IndexOutOfRange, ..refused_in(&part.name, detail) }
                })?;
            }
            if group.kind == Kind::Materials {
                paint.at = [paint.at[0]; 3];
            }
            paint.palette = group.palette;
        }
    }
    Ok(())
}

fn groups(
    part: &mut Part,
    first_texture: u32,
    palettes: &mut Vec<Palette>,
    warnings: &mut Warnings,
) -> Result<HashMap<u32, Known>, ReadError> {
    let refused = |detail| refused_in(&part.name, detail);
    let mut mixed =
        part.groups.iter().map(|group| mix(&part.groups, group)).collect::<Result<Vec<_>, _>>().map_err(refused)?;
    let mut known = HashMap::new();
    let mut layered = Vec::new();
    for (Group { id, kind }, mixed) in std::mem::take(&mut part.groups).into_iter().zip(&mut mixed) {
        let (kind, palette) = match kind {
            GroupKind::Materials(materials) => (Kind::Materials, Palette::Materials(materials)),
            GroupKind::Colors(colors) => (Kind::Colors, Palette::Colors(colors)),
            GroupKind::Composites { .. } => {
                warnings.tell("mixtures of materials (composite materials) became colours");
                (Kind::Composites, Palette::Colors(std::mem::take(mixed)))
            }
            GroupKind::Places { texture, places } => {
                let index = part.textures.iter().position(|it| it.id == texture);
                let index = index.ok_or_else(|| {
                    refused(format!("the texture group {id} names the texture {texture}, which is not there"))
                })?;
                let texture = first_texture + u32::try_from(index).unwrap_or(u32::MAX);
                (Kind::Texture, Palette::Textured { texture, name: None, tint: [255; 4], places })
            }
            GroupKind::Layers { of, entries } => {
                layered.push((id, of, entries));
                continue;
            }
        };
        let entries = Entries::First(palette.len());
        known.insert(id, Known { kind, palette: u32::try_from(palettes.len()).unwrap_or(u32::MAX), entries });
        palettes.push(palette);
    }
    let mut layers = Vec::with_capacity(layered.len());
    for (id, of, entries) in &layered {
        let top = top_layer(&known, of).map_err(|detail| refused(format!("the multiproperties {id}: {detail}")))?;
        let group = &known[&of[top]];
        let chosen = entries.iter().skip(top).step_by(of.len());
        let chosen = chosen.map(|&entry| {
            group.entries.get(entry).ok_or_else(|| {
                refused(format!(
                    "the multiproperties {id} name entry {entry} of the group {}, which has fewer",
                    of[top]
                ))
            })
        });
        let layer = Known {
            kind: group.kind,
            palette: group.palette,
            entries: Entries::These(chosen.collect::<Result<_, _>>()?),
        };
        warnings.tell("of properties on one another (multiproperties) only the uppermost colours or texture were kept");
        layers.push((*id, layer));
    }
    known.extend(layers);
    Ok(known)
}

/// The colours of a group of mixtures, each the mean of its materials' colours.
fn mix(groups: &[Group], group: &Group) -> Result<Vec<[u8; 4]>, String> {
    let GroupKind::Composites { of, materials, shares } = &group.kind else { return Ok(Vec::new()) };
    let base = groups.iter().find_map(|it| match &it.kind {
        GroupKind::Materials(materials) if it.id == *of => Some(materials),
        _ => None,
    });
    let base = base
        .ok_or_else(|| format!("the mixtures {} are of the group {of}, which is none of base materials", group.id))?;
    let colors = materials.iter().map(|&index| base.get(index as usize).map(|material: &Material| material.color));
    let colors: Option<Vec<_>> = colors.collect();
    let colors =
        colors.ok_or_else(|| format!("the mixtures {} name a material that the group {of} does not have", group.id))?;
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

/// The last of the layers that has colours or a texture, else the first; the rules for what may be a layer are those of the materials
/// extension, chapter 5.
fn top_layer(known: &HashMap<u32, Known>, of: &[u32]) -> Result<usize, String> {
    let kinds = of
        .iter()
        .map(|id| known.get(id).map(|it| it.kind).ok_or_else(|| format!("{} is no group that can be a layer", id)));
    let kinds: Vec<Kind> = kinds.collect::<Result<_, _>>()?;
    let is_material = |kind: &Kind| matches!(kind, Kind::Materials | Kind::Composites);
    if kinds.iter().skip(1).any(is_material) {
        return Err("a material may only be the first layer".to_owned());
    }
    if kinds.iter().filter(|&&kind| kind == Kind::Colors).count() > 1 {
        return Err("only one layer may be a colour group".to_owned());
    }
    Ok(kinds.iter().rposition(|kind| !is_material(kind)).unwrap_or(0))
}

fn refused_in(part: &str, detail: String) -> ReadError {
    let detail = format!("in the part {}: {detail}; export the model again", errors::shown(part.as_bytes()));
    ReadError::whole(ReadErrorKind::Malformed, detail)
}
