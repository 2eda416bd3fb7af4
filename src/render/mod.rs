//! Pictures and coloured meshes of a mesh's defects, and of the changes by a repair.
//!
//! [`Scene`] lays out a mesh and its findings once; [`write_picture`], [`write_glb`] and [`write_ply`] draw the
//! scene. [`draw_repaired`], [`draw_inspected`] and [`draw_change`] make the files that accompany a result.
//! [`palette`] has the colours.

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

/// A mesh with more faces than `LARGE` also gets a coarse preview of at most `PREVIEW` faces.
const LARGE: u64 = 400_000;
const PREVIEW: usize = 150_000;
/// Name of the drawing of a result's remaining defects.
pub const REMAINING: &str = "remaining.glb";

/// A mesh with its findings.
#[derive(Debug, Clone, Copy)]
pub struct Marked<'a> {
    /// The mesh, with the faces of its file.
    pub soup: &'a Soup,
    /// Findings, with a mark for each face of the mesh.
    pub findings: &'a Findings,
}

/// A rendered file.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawing {
    /// Name of the file.
    pub name: &'static str,
    /// Contents of the file.
    pub bytes: Vec<u8>,
}

/// Draws an inspected mesh: `defects.png`, `defects.glb` and `defects.ply`, and `defects-preview.glb` for a large
/// mesh.
///
/// # Errors
/// The first [`RenderError`].
pub fn draw_inspected(marked: Marked<'_>, context: &Context<'_>) -> Result<Vec<Drawing>, RenderError> {
    draw_input(marked, "defects.png", "inspected", context)
}

/// Draws a repair: `before.png`, `defects.glb` and `defects.ply` of the input, `defects-preview.glb` of a large
/// input, and `after.png` of the result, if any.
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
        drawings.push(draw_result(after, context)?);
    }
    Ok(drawings)
}

/// Names of the drawings of an alternative, as for the default result. [`name_for_choice`] tells them apart.
pub const ALTERNATIVE_DRAWINGS: [&str; 2] = ["after.png", "change.glb"];

/// The name of an alternative's drawing: the name of the default result's, with `choice` before the extension.
#[must_use]
pub fn name_for_choice(name: &str, choice: &str) -> String {
    name.replace('.', &format!("-{choice}."))
}

/// Draws the result of an alternative: `after.png`, and `change.glb`, which is coarse for a large mesh. `provenance` belongs to the
/// comparison with the input.
///
/// # Errors
/// The first [`RenderError`].
pub fn draw_alternative(
    after: Marked<'_>,
    provenance: &SurfaceProvenance,
    context: &Context<'_>,
) -> Result<Vec<Drawing>, RenderError> {
    let scene = Scene::of_change(after.soup, provenance, context)?;
    let [_, name] = ALTERNATIVE_DRAWINGS;
    let change = if is_large(after.soup.faces.len() as u64) {
        preview(name, &scene, context)?
    } else {
        Drawing { name, bytes: write_glb(&scene, context)? }
    };
    Ok(vec![draw_result(after, context)?, change])
}

/// Draws the result of a repair: `after.png`.
fn draw_result(after: Marked<'_>, context: &Context<'_>) -> Result<Drawing, RenderError> {
    let scene = Scene::new(after.soup, after.findings, context)?;
    Ok(Drawing { name: "after.png", bytes: write_picture(&scene, "after", context)? })
}

/// Draws the remaining defects of a result that is not printable: `remaining.glb`.
///
/// # Errors
/// [`RenderError`].
pub fn draw_remaining(after: Marked<'_>, context: &Context<'_>) -> Result<Drawing, RenderError> {
    let scene = Scene::new(after.soup, after.findings, context)?;
    Ok(Drawing { name: REMAINING, bytes: write_glb(&scene, context)? })
}

/// Draws the changes by a repair: `change.png`, `change.glb` and `change.ply`, and `change-preview.glb` for a large
/// mesh. `after` is the result, with the faces of its file.
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

/// Names of the drawings of wall thickness.
pub const THICKNESS: [&str; 3] = ["thickness.png", "thickness.glb", "thickness.ply"];

/// Draws the wall thickness of a solid: `thickness.png`, `thickness.glb` and `thickness.ply`. Parameters as in
/// [`Scene::of_thickness`].
///
/// # Errors
/// The first [`RenderError`].
pub fn draw_thickness(
    soup: &Soup,
    thickness: &[f32],
    limit_and_mm: [f64; 2],
    context: &Context<'_>,
) -> Result<Vec<Drawing>, RenderError> {
    let scene = Scene::of_thickness(soup, thickness, limit_and_mm, context)?;
    let [picture, glb, ply] = THICKNESS;
    Ok(vec![
        Drawing { name: picture, bytes: write_picture(&scene, "wall thickness", context)? },
        Drawing { name: glb, bytes: write_glb(&scene, context)? },
        Drawing { name: ply, bytes: write_ply(&scene, context)? },
    ])
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

/// Writes a coarse version of a scene.
fn preview(name: &'static str, scene: &Scene, context: &Context<'_>) -> Result<Drawing, RenderError> {
    Ok(Drawing { name, bytes: write_glb(&scene.coarse(PREVIEW, context)?, context)? })
}

/// Whether a mesh with this number of faces gets a preview.
fn is_large(faces: u64) -> bool {
    faces > LARGE
}

/// Names of the drawings of an inspected mesh with this number of faces.
#[must_use]
pub fn names_of_inspection(faces: u64) -> Vec<&'static str> {
    names_of_input("defects.png", faces)
}

/// Names of the drawings of a repair and its changes, given the number of faces of the input and of the result, if
/// any.
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
