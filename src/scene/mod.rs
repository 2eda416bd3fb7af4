//! What a file holds beside triangles: objects and where they stand, colours, a unit.
//!
//! A [`Scene`] is what all readers make and all writers take; a format that knows one mesh only gives a scene of one object. Every object
//! is repaired apart, in its own coordinates, so that an object which stands in several places stays one.

mod instances;
mod object;
mod paint;
mod unit;

pub use instances::Instance;
pub use object::{Component, Item, Note, Object, ObjectKind, Scene, SceneError, Shape};
pub use paint::{Material, PAINTLESS, Paint, PaintedMesh, Palette, Texture, Wrap};
pub use unit::{LengthUnit, Unit, UnitSource, Up};
