//! Offending elements by the numbers that the file gives them.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use meshmend::inspect::{Analysis, Thresholds, aspect_ratio};
use meshmend::mesh::Edges;

use super::Look;

/// Vertices, edges and faces that keep the mesh from being good, each kind in a list, by vertex and face numbers of the file; where it gives
/// none, they count from 0. Nothing where there is no offender.
pub fn section(look: &Look, analysis: &Analysis<'_>, thresholds: Option<&Thresholds>) -> String {
    let numbering = look.mesh.numbering.as_ref();
    let vertex = |index: u32| numbering.map_or(index, |it| it.vertex(index));
    let face = |index: u32| numbering.map_or(index, |it| it.face(index));
    let (surface, soup) = (&analysis.surface, &look.mesh.soup);
    let face_of = |f: u32| face(surface.source[f as usize]);
    let corner_of = |h: u32| vertex(soup.faces[surface.source[h as usize / 3] as usize][h as usize % 3]);
    let edge_of = |h: u32| format!("{} {}", corner_of(h), corner_of(Edges::next(h)));
    let (mut border, mut shared, mut flipped, mut short) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (edge, half_edges) in analysis.edges.iter().enumerate() {
        let Some(&first) = half_edges.first() else { continue };
        let faces: Vec<String> = half_edges.iter().map(|h| face_of(h / 3).to_string()).collect();
        let line = format!("{} of face {}", edge_of(first), faces.join(" "));
        let [a, b] = analysis.edges.vertices(edge).map(|v| surface.positions[v as usize]);
        if thresholds.is_some_and(|than| a.distance(b) <= than.edge_length) {
            short.push(line.clone());
        }
        match half_edges {
            [_] => border.push(line),
            [x, y] if Edges::is_forward(&surface.faces, *x) == Edges::is_forward(&surface.faces, *y) => {
                flipped.push(line)
            }
            [_, _] => {}
            _ => shared.push(line),
        }
    }
    let mut used = vec![false; soup.positions.len()];
    for &v in soup.faces.iter().flatten() {
        if let Some(used) = used.get_mut(v as usize) {
            *used = true;
        }
    }
    let orphans = (0u32..).zip(&used).filter(|(_, used)| !**used).map(|(v, _)| vertex(v).to_string()).collect();
    let numbers = |list: &[u32]| list.iter().map(u32::to_string).collect::<Vec<_>>();
    let missing = numbering.map_or_else(Vec::new, |it| numbers(&it.missing));
    let left_out =
        numbering.map_or_else(Vec::new, |it| it.left_out.iter().map(|face| face.number.to_string()).collect());
    let is_thin = |&f: &u32| {
        let is_over = |than: &Thresholds| aspect_ratio(analysis, f).is_some_and(|ratio| ratio >= than.aspect_ratio);
        thresholds.is_some_and(is_over)
    };
    let thin = (0u32..).take(surface.faces.len()).filter(is_thin).map(|f| face_of(f).to_string()).collect();
    let lists = [
        ("border edges", border),
        ("non-manifold edges", shared),
        ("flipped edges", flipped),
        ("non-manifold vertices", pinched(analysis, corner_of)),
        ("orphan vertices", orphans),
        ("missing vertices", missing),
        ("faces that name missing vertices", left_out),
        ("edges that are too short", short),
        ("faces of too large an aspect ratio", thin),
    ];
    let mut text = String::new();
    for (name, list) in lists.iter().filter(|(_, list)| !list.is_empty()) {
        // Writing to a string can't fail.
        let _ = writeln!(text, "  {name} ({}): {}", list.len(), list.join(", "));
    }
    let counted = if numbering.is_some() { "as in the file" } else { "from 0" };
    if text.is_empty() { text } else { format!("\nOffending elements, numbered {counted}\n{text}") }
}

/// Vertices of more than one fan.
fn pinched(analysis: &Analysis<'_>, number: impl Fn(u32) -> u32) -> Vec<String> {
    let mut fans: BTreeMap<u32, (u32, u32)> = BTreeMap::new();
    let mut found = Vec::new();
    let faces = analysis.surface.faces.as_flattened();
    for ((corner, &v), &fan) in (0u32..).zip(faces).zip(&analysis.fans.of_corner) {
        let [a, b, c] = analysis.surface.faces[corner as usize / 3];
        if a == b || b == c || c == a {
            continue;
        }
        let (first, told) = fans.entry(v).or_insert((fan, 0));
        if *first != fan && *told == 0 {
            *told = 1;
            found.push(number(corner).to_string());
        }
    }
    found
}
