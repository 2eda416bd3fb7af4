use super::{RenderError, Scene, write_glb, write_picture, write_ply};
use crate::context::Context;
use crate::inspect::{DefectKind, Fates, Findings};
use crate::mesh::Soup;

/// A mesh of more faces gets a coarse preview too, of at most so many.
const LARGE: usize = 400_000;
const PREVIEW: usize = 150_000;
/// What is no fault by itself.
const REMARKS: [DefectKind; 3] = [DefectKind::Disjoint, DefectKind::InnerShell, DefectKind::TinyPart];

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
/// where there is one; of a large input `defects-preview.glb`, and of a result that something is still wrong with `remaining.glb`.
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
        let is_faulty = |&kind: &DefectKind| !REMARKS.contains(&kind) && after.findings.count(kind) > 0;
        if DefectKind::ALL.iter().any(is_faulty) {
            drawings.push(Drawing { name: "remaining.glb", bytes: write_glb(&scene, context)? });
        }
    }
    Ok(drawings)
}

/// The drawings of what became of a mesh: `change.png`, `change.glb` and `change.ply`, and of a large one `change-preview.glb`. `after`
/// is the result as its file has it.
///
/// # Errors
/// The first [`RenderError`].
pub fn draw_change(after: &Soup, fates: &Fates, context: &Context<'_>) -> Result<Vec<Drawing>, RenderError> {
    let scene = Scene::of_change(after, fates, context)?;
    let mut drawings = vec![
        Drawing { name: "change.png", bytes: write_picture(&scene, "change", context)? },
        Drawing { name: "change.glb", bytes: write_glb(&scene, context)? },
        Drawing { name: "change.ply", bytes: write_ply(&scene, context)? },
    ];
    drawings.extend(preview("change-preview.glb", &scene, context)?);
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
    drawings.extend(preview("defects-preview.glb", &scene, context)?);
    Ok(drawings)
}

/// A coarse mesh of a scene that is large.
fn preview(name: &'static str, scene: &Scene, context: &Context<'_>) -> Result<Option<Drawing>, RenderError> {
    if scene.surface.faces.len() <= LARGE {
        return Ok(None);
    }
    Ok(Some(Drawing { name, bytes: write_glb(&scene.coarse(PREVIEW, context)?, context)? }))
}
