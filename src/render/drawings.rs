use super::{RenderError, Scene, write_glb, write_picture, write_ply};
use crate::context::Context;
use crate::inspect::{Fates, Findings};
use crate::mesh::Soup;

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

/// The drawings of an inspection: `defects.png`, `defects.glb` and `defects.ply`.
///
/// # Errors
/// The first [`RenderError`].
pub fn draw_inspected(marked: Marked<'_>, context: &Context<'_>) -> Result<Vec<Drawing>, RenderError> {
    draw_input(marked, "defects.png", "found", context)
}

/// The drawings of a repair: `before.png`, `defects.glb` and `defects.ply` of the input, and `after.png` of the result,
/// where there is one.
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

/// The drawings of what became of a mesh: `change.png`, `change.glb` and `change.ply`. `after` is the result as its file has
/// it.
///
/// # Errors
/// The first [`RenderError`].
pub fn draw_change(after: &Soup, fates: &Fates, context: &Context<'_>) -> Result<Vec<Drawing>, RenderError> {
    let scene = Scene::of_change(after, fates, context)?;
    Ok(vec![
        Drawing { name: "change.png", bytes: write_picture(&scene, "change", context)? },
        Drawing { name: "change.glb", bytes: write_glb(&scene, context)? },
        Drawing { name: "change.ply", bytes: write_ply(&scene, context)? },
    ])
}

fn draw_input(
    marked: Marked<'_>,
    name: &'static str,
    title: &str,
    context: &Context<'_>,
) -> Result<Vec<Drawing>, RenderError> {
    let scene = Scene::new(marked.soup, marked.findings, context)?;
    Ok(vec![
        Drawing { name, bytes: write_picture(&scene, title, context)? },
        Drawing { name: "defects.glb", bytes: write_glb(&scene, context)? },
        Drawing { name: "defects.ply", bytes: write_ply(&scene, context)? },
    ])
}
