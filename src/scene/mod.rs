//! What a file holds beside triangles: objects and where they stand, colours, a unit.
//!
//! A [`Scene`] is what all readers make and all writers take; a format that knows one mesh only gives a scene of one object. Every object
//! is repaired apart, in its own coordinates, so that an object which stands in several places stays one.

mod assembly;
mod length_unit;
mod object;
mod paint;
mod placed;
mod unit;

pub use length_unit::{LengthUnit, UnitSource};
pub use object::{Component, Item, Note, Object, ObjectKind, Scene, SceneError, Shape, Up};
pub use paint::{Material, PAINTLESS, Paint, PaintedMesh, Palette, Texture, Wrap};
pub use placed::Instance;
pub use unit::Unit;
