//! Objects, what they are made of, and the items that are built of them.

use glam::DAffine3;

use super::{PaintedMesh, Palette, Texture, Unit, Up};

/// All that a file holds.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scene {
    /// The unit that the file says its lengths are in.
    pub unit: Option<Unit>,
    /// Which axis the file says points up.
    pub up: Option<Up>,
    /// The objects in the order of the file. One that is not used by an item is kept all the same.
    pub objects: Vec<Object>,
    /// What is to be built, in order.
    pub items: Vec<Item>,
    /// What faces are painted with.
    pub palettes: Vec<Palette>,
    /// The pictures of palettes.
    pub textures: Vec<Texture>,
    /// Notes on the whole, such as title and designer, in order.
    pub notes: Vec<Note>,
}

/// Something that can be built, once or more often.
#[derive(Debug, Clone, PartialEq)]
pub struct Object {
    /// Its name in the file.
    pub name: Option<String>,
    /// The number of the part, in the words of its maker.
    pub part_number: Option<String>,
    /// What it is for.
    pub kind: ObjectKind,
    /// What it is made of.
    pub shape: Shape,
    /// Notes on it, in order.
    pub notes: Vec<Note>,
}

/// What an object is for, after the 3MF core specification.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum ObjectKind {
    /// To be printed.
    #[default]
    Model,
    /// To hold what is printed, filled.
    SolidSupport,
    /// To hold what is printed, in whatever way.
    Support,
    /// A surface, not a body.
    Surface,
    /// Not to be printed.
    Other,
}

impl ObjectKind {
    /// Whether such an object is a body to be printed, which 3MF asks to be a closed solid.
    #[must_use]
    pub fn is_printed(self) -> bool {
        matches!(self, Self::Model | Self::SolidSupport)
    }
}

/// What an object is made of.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// Triangles, in the object's own coordinates.
    Mesh(PaintedMesh),
    /// Other objects, each before this one in [`Scene::objects`].
    Components(Vec<Component>),
}

/// An object as a part of another one.
#[derive(Debug, Clone, PartialEq)]
pub struct Component {
    /// Index into [`Scene::objects`].
    pub object: u32,
    /// From its coordinates to those of the object that it is part of.
    pub transform: DAffine3,
}

/// An object where it is to be built.
#[derive(Debug, Clone, PartialEq)]
pub struct Item {
    /// Index into [`Scene::objects`].
    pub object: u32,
    /// From its coordinates to those of the scene.
    pub transform: DAffine3,
    /// The name of this one of the object's places; none where it is the object's.
    pub name: Option<String>,
    /// The number of the part, in the words of its maker.
    pub part_number: Option<String>,
    /// Notes on it, in order.
    pub notes: Vec<Note>,
}

/// A note that its maker left in a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Note {
    /// What it says something of: `Title`, `Designer`, or a name with a namespace.
    pub name: String,
    /// The namespace of a name with a prefix.
    pub namespace: Option<String>,
    /// What it says.
    pub value: String,
    /// Its type, where the file names one.
    pub kind: Option<String>,
    /// Whether who edits the file is asked to keep it.
    pub preserve: bool,
}

/// A scene that can't be put together.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SceneError {
    /// Places of objects, taken together, have more faces than may be.
    #[error("placed in all their places, the objects have more than {0} faces")]
    TooManyFaces(u64),
    /// They have more vertices than can be numbered.
    #[error("placed in all their places, the objects have more vertices than can be numbered")]
    TooManyVertices,
    /// Objects are made of objects too often.
    #[error("objects are made of objects more than {} deep", Scene::DEPTH)]
    TooDeep,
}

impl Object {
    /// An object of triangles with a name, to be printed.
    #[must_use]
    pub fn of_mesh(name: Option<String>, mesh: PaintedMesh) -> Self {
        Self { name, part_number: None, kind: ObjectKind::Model, shape: Shape::Mesh(mesh), notes: Vec::new() }
    }

    /// Whether it has faces of its own.
    #[must_use]
    pub fn has_faces(&self) -> bool {
        self.mesh().is_some_and(|mesh| !mesh.soup.faces.is_empty())
    }

    /// Its triangles, if it has some of its own.
    #[must_use]
    pub fn mesh(&self) -> Option<&PaintedMesh> {
        match &self.shape {
            Shape::Mesh(mesh) => Some(mesh),
            Shape::Components(_) => None,
        }
    }
}

impl Item {
    /// An object in its own place.
    #[must_use]
    pub fn of(object: u32) -> Self {
        Self { object, transform: DAffine3::IDENTITY, name: None, part_number: None, notes: Vec::new() }
    }
}

impl Scene {
    /// The transform of an item in a frame in which `up` points up; unchanged where the scene names no up axis.
    #[must_use]
    pub fn stood(&self, up: Up, transform: DAffine3) -> DAffine3 {
        self.up.map_or(transform, |own| own.turned_to(up, transform))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_say_how_it_stands_is_left_as_it_is() {
        let scene = Scene::default();
        assert_eq!(scene.stood(Up::Y, DAffine3::IDENTITY), DAffine3::IDENTITY);
        assert_ne!(Scene { up: Some(Up::Z), ..scene }.stood(Up::Y, DAffine3::IDENTITY), DAffine3::IDENTITY);
    }
}
