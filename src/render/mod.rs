//! Pictures and coloured meshes of what was found on a mesh, and of what became of it.
//!
//! [`Scene`] lays a mesh and its findings out once; [`write_picture`], [`write_glb`] and [`write_ply`] draw it, and
//! [`draw_repaired`] and [`draw_inspected`] make the files that go beside a result. The colours are in [`palette`].

mod camera;
mod canvas;
mod coarse;
mod drawings;
mod glb;
mod overlay;
pub mod palette;
mod picture;
mod ply;
mod raster;
mod scene;

pub use drawings::{
    Drawing, Marked, REMAINING, draw_change, draw_inspected, draw_remaining, draw_repaired, names_of_inspection,
    names_of_repair,
};
pub use glb::write_glb;
pub use palette::{Colour, LegendEntry, Paint};
pub use picture::write_picture;
pub use ply::write_ply;
pub use scene::{Dot, Frame, Scene, Segment, Shows};

/// Why a picture or a coloured mesh could not be made.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The work was asked to stop, or its time ran out.
    #[error(transparent)]
    Cancelled(#[from] crate::context::Cancelled),
    /// The mesh has more in it than the format can say.
    #[error("the mesh is too large for the format")]
    TooLarge,
    /// The PNG could not be made.
    #[error("the picture could not be encoded: {0}")]
    Png(#[from] png::EncodingError),
}
