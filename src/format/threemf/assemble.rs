//! The parts of a model as one scene: objects in an order in which those that others are made of come first.

use std::collections::HashMap;
use std::sync::Arc;

use super::palettes;
use super::part::{ObjectResource, Part, Placed, ShapeResource};
use super::shown_name;
use super::warnings::Warnings;
use crate::format::archive::{Archive, key};
use crate::format::errors::{ReadError, ReadErrorKind};
use crate::format::pictures::MOST_BYTES;
use crate::scene::{Component, Item, Note, Object, ObjectKind, PaintedMesh, Scene, Shape, Texture, Up};

/// Makes the scene of parts, the first of which is the model.
pub(super) fn scene(
    mut parts: Vec<Part>,
    archive: &mut Archive<'_>,
    warnings: &mut Warnings,
) -> Result<Scene, ReadError> {
    let mut scene = Scene { up: Some(Up::Z), ..Scene::default() };
    let mut pictures = Pictures { known: HashMap::new(), left: MOST_BYTES };
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
        palettes::take(part, first_texture, &mut scene.palettes, warnings)?;
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
            bytes.ok_or_else(|| refused(format!("the texture {} is not in the file", shown_name(path))))?.into();
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
            let of =
                placed.path.as_deref().map_or_else(String::new, |path| format!(" of the part {}", shown_name(path)));
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
