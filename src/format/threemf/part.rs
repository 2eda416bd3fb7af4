//! What a model part says, with its own numbers for resources.

use std::collections::HashMap;

use glam::DAffine3;

use crate::mesh::Soup;
use crate::scene::{Material, Note, ObjectKind, Paint, Unit, Wrap};

/// A model part.
#[derive(Default)]
pub(super) struct Part {
    pub name: String,
    pub unit: Option<Unit>,
    pub notes: Vec<Note>,
    pub textures: Vec<TextureResource>,
    pub groups: Vec<Group>,
    pub objects: Vec<ObjectResource>,
    pub items: Vec<Placed>,
    pub painted_by: PaintedBy,
}

/// The groups that objects name, numbered as they come: until palettes are made, these numbers are [`Paint::palette`].
#[derive(Default)]
pub(super) struct PaintedBy {
    pub groups: Vec<u32>,
    numbers: HashMap<u32, u32>,
}

impl PaintedBy {
    /// The number of a group.
    pub fn number(&mut self, group: u32) -> u32 {
        let next = u32::try_from(self.groups.len()).unwrap_or(u32::MAX);
        let number = *self.numbers.entry(group).or_insert(next);
        if number == next {
            self.groups.push(group);
        }
        number
    }
}

pub(super) struct ObjectResource {
    pub id: u32,
    pub name: Option<String>,
    pub part_number: Option<String>,
    pub kind: ObjectKind,
    pub notes: Vec<Note>,
    pub shape: ShapeResource,
}

pub(super) enum ShapeResource {
    Mesh { soup: Soup, paint: Vec<Paint> },
    Components(Vec<Placed>),
}

/// An object in a place: a component or a build item.
pub(super) struct Placed {
    /// The part that has the object, where it is another one.
    pub path: Option<String>,
    pub id: u32,
    pub transform: DAffine3,
    pub part_number: Option<String>,
    pub notes: Vec<Note>,
}

pub(super) struct TextureResource {
    pub id: u32,
    pub path: String,
    pub media_type: &'static str,
    pub wrap_u: Wrap,
    pub wrap_v: Wrap,
    pub nearest: bool,
}

/// What triangles are painted with.
pub(super) struct Group {
    pub id: u32,
    pub kind: GroupKind,
}

pub(super) enum GroupKind {
    Materials(Vec<Material>),
    Colors(Vec<[u8; 4]>),
    Places {
        texture: u32,
        places: Vec<[f64; 2]>,
    },
    /// Mixtures of materials of one group; a row of `shares` a mixture, as long as `materials`.
    Composites {
        of: u32,
        materials: Vec<u32>,
        shares: Vec<f64>,
    },
    /// Entries of several groups on one another; a row of `entries` each, as long as `of`.
    Layers {
        of: Vec<u32>,
        entries: Vec<u32>,
    },
}
