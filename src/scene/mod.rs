//! Contents of a model file beyond triangles: objects and their placement, colours, textures, and the unit of length.
//!
//! All readers return a [`Scene`] and all writers take one; formats with a single mesh give a scene with one object.
//! Objects are repaired separately, in their own coordinates, so that an object with several instances stays one
//! object.

mod instances;
mod object;
mod paint;
mod unit;

pub use instances::Instance;
pub use object::{Component, Item, Note, Object, ObjectKind, Scene, SceneError, Shape};
pub use paint::{Material, PAINTLESS, Paint, PaintedMesh, Palette, Texture, Wrap};
pub use unit::{LengthUnit, PLAUSIBLE_SIZE_MM, Unit, UnitSource, Up};
