//! Data model of a scene: objects, their shapes, and the items that place objects for printing.

use glam::DAffine3;

use super::{PaintedMesh, Palette, Texture, Unit, Up};

/// Complete contents of a model file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scene {
    /// Unit of length that the file declares.
    pub unit: Option<Unit>,
    /// Axis that the file declares as up.
    pub up: Option<Up>,
    /// Objects in the order of the file, including objects that no item uses.
    pub objects: Vec<Object>,
    /// Objects to print with their placement, in order.
    pub items: Vec<Item>,
    /// Colours, materials and texture coordinates that faces refer to.
    pub palettes: Vec<Palette>,
    /// Images that palettes refer to.
    pub textures: Vec<Texture>,
    /// Metadata of the whole file, such as title and designer, in order.
    pub notes: Vec<Note>,
}

/// An object that items place once or more often.
#[derive(Debug, Clone, PartialEq)]
pub struct Object {
    /// Name of the object in the file.
    pub name: Option<String>,
    /// Part number that the author gave the object.
    pub part_number: Option<String>,
    /// Purpose of the object.
    pub kind: ObjectKind,
    /// Geometry of the object.
    pub shape: Shape,
    /// Metadata of the object, in order.
    pub notes: Vec<Note>,
}

/// Purpose of an object, after the 3MF core specification.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum ObjectKind {
    /// A model to print.
    #[default]
    Model,
    /// A support structure, printed solid.
    SolidSupport,
    /// A support structure; the slicer decides how to print it.
    Support,
    /// A surface rather than a solid.
    Surface,
    /// An object that is not printed.
    Other,
}

impl ObjectKind {
    /// Whether objects of this purpose are printed as solids, which 3MF requires to be closed.
    #[must_use]
    pub fn is_printed(self) -> bool {
        matches!(self, Self::Model | Self::SolidSupport)
    }
}

/// Geometry of an object.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// Triangles, in the object's own coordinates.
    Mesh(PaintedMesh),
    /// Placed instances of other objects, each of which precedes this object in [`Scene::objects`].
    Components(Vec<Component>),
}

/// An object placed inside another object.
#[derive(Debug, Clone, PartialEq)]
pub struct Component {
    /// Index into [`Scene::objects`].
    pub object: u32,
    /// Transform from the component's coordinates to the coordinates of the containing object.
    pub transform: DAffine3,
}

/// An object placed in the scene for printing.
#[derive(Debug, Clone, PartialEq)]
pub struct Item {
    /// Index into [`Scene::objects`].
    pub object: u32,
    /// Transform from the object's coordinates to the coordinates of the scene.
    pub transform: DAffine3,
    /// Name of this placement; `None` if it has the object's name.
    pub name: Option<String>,
    /// Part number that the author gave this placement.
    pub part_number: Option<String>,
    /// Metadata of this placement, in order.
    pub notes: Vec<Note>,
}

/// A metadata entry of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Note {
    /// Key, such as `Title`, `Designer`, or a name with a namespace.
    pub name: String,
    /// Namespace of a key with a prefix.
    pub namespace: Option<String>,
    /// Value of the entry.
    pub value: String,
    /// Type of the value, if the file declares one.
    pub kind: Option<String>,
    /// Whether programs that edit the file should keep the entry.
    pub preserve: bool,
}

/// Why the instances of a scene cannot be combined.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SceneError {
    /// The instances have more faces than allowed.
    #[error("with all object instances placed, the model has more than {0} faces")]
    TooManyFaces(u64),
    /// The instances have more vertices than 32-bit indices can address.
    #[error("with all object instances placed, the model has too many vertices for 32-bit indices")]
    TooManyVertices,
    /// Components are nested too deeply.
    #[error("components are nested more than {} deep", Scene::DEPTH)]
    TooDeep,
}

impl Object {
    /// Creates an object to print from a mesh.
    #[must_use]
    pub fn of_mesh(name: Option<String>, mesh: PaintedMesh) -> Self {
        Self { name, part_number: None, kind: ObjectKind::Model, shape: Shape::Mesh(mesh), notes: Vec::new() }
    }

    /// Whether the object has faces of its own.
    #[must_use]
    pub fn has_faces(&self) -> bool {
        self.mesh().is_some_and(|mesh| !mesh.soup.faces.is_empty())
    }

    /// The object's own mesh; `None` for an object of components.
    #[must_use]
    pub fn mesh(&self) -> Option<&PaintedMesh> {
        match &self.shape {
            Shape::Mesh(mesh) => Some(mesh),
            Shape::Components(_) => None,
        }
    }
}

impl Item {
    /// Places an object without a transform.
    #[must_use]
    pub fn of(object: u32) -> Self {
        Self { object, transform: DAffine3::IDENTITY, name: None, part_number: None, notes: Vec::new() }
    }
}

impl Scene {
    /// The transform of an item in a frame with `up` as the up axis. Unchanged if the scene declares no up axis.
    #[must_use]
    pub fn stood(&self, up: Up, transform: DAffine3) -> DAffine3 {
        self.up.map_or(transform, |own| own.rotated_to(up, transform))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_without_an_up_axis_is_not_rotated() {
        let scene = Scene::default();
        assert_eq!(scene.stood(Up::Y, DAffine3::IDENTITY), DAffine3::IDENTITY);
        assert_ne!(Scene { up: Some(Up::Z), ..scene }.stood(Up::Y, DAffine3::IDENTITY), DAffine3::IDENTITY);
    }
}
