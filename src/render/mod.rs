//! Pictures and coloured meshes of what was found on a mesh, and of what became of it.
//!
//! [`Scene`] lays a mesh and its findings out once; [`write_picture`], [`write_glb`] and [`write_ply`] draw it, and
//! [`draw_repaired`] and [`draw_inspected`] make the files that go beside a result. The colours are in [`palette`].

mod export;
mod image;
mod overlay;
pub mod palette;
mod picture;
mod raster;
mod scene;

pub use export::{write_glb, write_ply};
pub use palette::{Colour, LegendEntry, Paint};
pub use picture::write_picture;
pub use scene::{Dot, Frame, RenderError, Scene, Segment, Shows};

use crate::context::Context;
use crate::inspect::{Findings, SurfaceProvenance};
use crate::mesh::Soup;

/// A mesh of more faces gets a coarse preview too, of at most so many.
const LARGE: u64 = 400_000;
const PREVIEW: usize = 150_000;
/// The drawing of what is wrong with a result.
pub const REMAINING: &str = "remaining.glb";

/// A mesh and what was found on it.
#[derive(Debug, Clone, Copy)]
pub struct Marked<'a> {
    /// The mesh, as its file has it.
    pub soup: &'a Soup,
    /// What was found, with a mark for each of its faces.
    pub findings: &'a Findings,
}

/// A file that shows what was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawing {
    /// Its name.
    pub name: &'static str,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

/// The drawings of an inspection: `defects.png`, `defects.glb` and `defects.ply`, and of a large mesh `defects-preview.glb`.
///
/// # Errors
/// The first [`RenderError`].
pub fn draw_inspected(marked: Marked<'_>, context: &Context<'_>) -> Result<Vec<Drawing>, RenderError> {
    draw_input(marked, "defects.png", "found", context)
}

/// The drawings of a repair: `before.png`, `defects.glb` and `defects.ply` of the input, and `after.png` of the result,
/// where there is one; of a large input `defects-preview.glb`.
///
/// # Errors
/// The first [`RenderError`].
pub fn draw_repaired(
    before: Marked<'_>,
    after: Option<Marked<'_>>,
    context: &Context<'_>,
) -> Result<Vec<Drawing>, RenderError> {
    let mut drawings = draw_input(before, "before.png", "before", context)?;
    if let Some(after) = after {
        let scene = Scene::new(after.soup, after.findings, context)?;
        drawings.push(Drawing { name: "after.png", bytes: write_picture(&scene, "after", context)? });
    }
    Ok(drawings)
}

/// The drawing of what is wrong with a result that is not printable: `remaining.glb`.
///
/// # Errors
/// [`RenderError`].
pub fn draw_remaining(after: Marked<'_>, context: &Context<'_>) -> Result<Drawing, RenderError> {
    let scene = Scene::new(after.soup, after.findings, context)?;
    Ok(Drawing { name: REMAINING, bytes: write_glb(&scene, context)? })
}

/// The drawings of what became of a mesh: `change.png`, `change.glb` and `change.ply`, and of a large one `change-preview.glb`. `after`
/// is the result as its file has it.
///
/// # Errors
/// The first [`RenderError`].
pub fn draw_change(
    after: &Soup,
    provenance: &SurfaceProvenance,
    context: &Context<'_>,
) -> Result<Vec<Drawing>, RenderError> {
    let scene = Scene::of_change(after, provenance, context)?;
    let mut drawings = vec![
        Drawing { name: "change.png", bytes: write_picture(&scene, "change", context)? },
        Drawing { name: "change.glb", bytes: write_glb(&scene, context)? },
        Drawing { name: "change.ply", bytes: write_ply(&scene, context)? },
    ];
    if is_large(after.faces.len() as u64) {
        drawings.push(preview("change-preview.glb", &scene, context)?);
    }
    Ok(drawings)
}

fn draw_input(
    marked: Marked<'_>,
    name: &'static str,
    title: &str,
    context: &Context<'_>,
) -> Result<Vec<Drawing>, RenderError> {
    let scene = Scene::new(marked.soup, marked.findings, context)?;
    let mut drawings = vec![
        Drawing { name, bytes: write_picture(&scene, title, context)? },
        Drawing { name: "defects.glb", bytes: write_glb(&scene, context)? },
        Drawing { name: "defects.ply", bytes: write_ply(&scene, context)? },
    ];
    if is_large(marked.soup.faces.len() as u64) {
        drawings.push(preview("defects-preview.glb", &scene, context)?);
    }
    Ok(drawings)
}

/// A coarse mesh of a scene that is large.
fn preview(name: &'static str, scene: &Scene, context: &Context<'_>) -> Result<Drawing, RenderError> {
    Ok(Drawing { name, bytes: write_glb(&scene.coarse(PREVIEW, context)?, context)? })
}

/// Whether a mesh of so many faces gets a preview.
fn is_large(faces: u64) -> bool {
    faces > LARGE
}

/// The names of the drawings of an inspection of a mesh of so many faces.
#[must_use]
pub fn names_of_inspection(faces: u64) -> Vec<&'static str> {
    names_of_input("defects.png", faces)
}

/// The names of the drawings of a repair and of what became of the mesh, by the faces of the input and of the result, where there is one.
#[must_use]
pub fn names_of_repair(before: u64, after: Option<u64>) -> Vec<&'static str> {
    let mut names = names_of_input("before.png", before);
    if let Some(faces) = after {
        names.extend(["after.png", "change.png", "change.glb", "change.ply"]);
        names.extend(is_large(faces).then_some("change-preview.glb"));
    }
    names
}

fn names_of_input(picture: &'static str, faces: u64) -> Vec<&'static str> {
    let mut names = vec![picture, "defects.glb", "defects.ply"];
    names.extend(is_large(faces).then_some("defects-preview.glb"));
    names
}
