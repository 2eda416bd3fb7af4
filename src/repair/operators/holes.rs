//! Closing boundary loops.

use std::collections::HashSet;

use glam::DVec3;

use super::triangulate::{flat, least_weight, shortest_cut};
use crate::inspect::solids;
use crate::mesh::{Edges, Fans, Parts, Surface, boundary_loops};
use crate::repair::sheets::encloses;
use crate::repair::{Cancelled, Change, Context};

/// Longest loop for the cubic triangulation: about 0.03 s.
const MOST_FOR_LEAST_WEIGHT: usize = 128;
/// Longest loop for ear cutting, whose worst case is quadratic.
const MOST_FOR_EARS: usize = 5_000;

/// Which holes are closed.
#[derive(Debug, Clone, Copy)]
pub struct FillHoles {
    /// Most edges around a hole.
    pub max_edges: u32,
}

/// What filling did and left.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Filled {
    /// By operator.
    pub changes: Vec<Change>,
    /// Loops that are still open in parts that were not taken for sheets.
    pub holes_left: u64,
    /// Parts that were taken for open sheets and left open.
    pub open_sheets: u64,
}

impl Filled {
    /// What is left, if anything.
    pub(super) fn in_words(&self) -> Option<String> {
        match (self.holes_left, self.open_sheets) {
            (0, 0) => None,
            (0, sheets) => Some(format!("{sheets} parts are open sheets that enclose nothing; they were left open")),
            (holes, 0) => Some(format!("{holes} holes could not be closed")),
            (holes, sheets) => {
                Some(format!("{holes} holes could not be closed; {sheets} parts are open sheets and were left open"))
            }
        }
    }
}

impl FillHoles {
    /// Closes boundary loops with triangles over their own vertices.
    ///
    /// A loop gets the triangulation of least worst fold and least area (Liepa 2003) up to 128 edges; a longer one is
    /// cut by ears where it is simple in its own plane, and else by short diagonals down to that length. A diagonal
    /// is never an edge that is there already, so that no edge gets a third face. All loops of a part are closed or
    /// none: see [`encloses`] for what tells a solid with holes from an open sheet.
    ///
    /// ```text
    ///    ___________          ___________
    ///   |   /   \   |        |   / | \   |
    ///   |  |     |  |   ->   |  |  |/ |  |
    ///   |   \___/   |        |   \_|_/   |
    /// ```
    ///
    /// Precondition: consistent winding, or walks along the boundary end and are left. Result: no vertex moves and no
    /// face goes. Leaves: loops over `max_edges`, those of open sheets, those whose every triangulation needs
    /// an edge that exists. Patches may cross other faces.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Filled, Cancelled> {
        let edges = Edges::new(&surface.faces);
        if edges.iter().all(|h| h.len() != 1) {
            return Ok(Filled::default());
        }
        let fans = Fans::new(surface, &edges);
        let parts = Parts::new(surface, &edges);
        let loops = boundary_loops(surface, &edges, &fans);
        let solids = solids(surface, &edges, &parts);
        let mut by_part: Vec<(u32, usize)> =
            loops.face.iter().enumerate().map(|(i, &f)| (parts.of_face[f as usize], i)).collect();
        by_part.sort_unstable();
        let mut filled = Filled { holes_left: loops.left.min(1), ..Filled::default() };
        let mut new_edges: HashSet<(u32, u32)> = HashSet::new();
        let mut patches: Vec<[u32; 3]> = Vec::new();
        let mut closed = 0u64;
        for of_part in by_part.chunk_by(|a, b| a.0 == b.0) {
            let part = of_part[0].0 as usize;
            let about = solids[part].bounds.centre();
            let before = patches.len();
            let mut left = 0u64;
            let mut own_edges: Vec<(u32, u32)> = Vec::new();
            for &(_, i) in of_part {
                context.check()?;
                let vertices = &loops.simple[i];
                let taken = |a: u32, b: u32| edges.find(a, b).is_some() || new_edges.contains(&(a.min(b), a.max(b)));
                let patch = if vertices.len() > self.max_edges as usize || is_a_face(surface, &edges, vertices) {
                    None
                } else {
                    cover(surface, &edges, vertices, taken, context)
                };
                context.check()?;
                let Some(patch) = patch else {
                    left += 1;
                    continue;
                };
                for &[a, b, c] in &patch {
                    for (u, v) in [(a, b), (b, c), (c, a)] {
                        if edges.find(u, v).is_none() && new_edges.insert((u.min(v), u.max(v))) {
                            own_edges.push((u.min(v), u.max(v)));
                        }
                    }
                }
                patches.extend(patch);
            }
            let (mut patch_area, mut volume) = (0.0, solids[part].volume);
            for t in &patches[before..] {
                let [a, b, c] = t.map(|v| surface.positions[v as usize] - about);
                patch_area += (b - a).cross(c - a).length() / 2.0;
                volume += a.dot(b.cross(c)) / 6.0;
            }
            if encloses(solids[part].area, patch_area, (left == 0).then_some(volume)) {
                filled.holes_left += left;
                closed += of_part.len() as u64 - left;
            } else {
                patches.truncate(before);
                for edge in own_edges {
                    new_edges.remove(&edge);
                }
                filled.open_sheets += 1;
            }
        }
        let added = patches.len() as u64;
        for face in patches {
            surface.push_patch(face);
        }
        filled.changes = Change::list([
            ("holes_closed", closed),
            ("faces_added", added),
            ("holes_left", filled.holes_left),
            ("open_sheets_left", filled.open_sheets),
        ]);
        Ok(filled)
    }
}

/// Whether the loop is the border of a single face, whose patch would be the face's own back.
fn is_a_face(surface: &Surface, edges: &Edges, vertices: &[u32]) -> bool {
    let &[a, b, c] = vertices else { return false };
    edges.find(a, b).is_some_and(|e| edges.half_edges(e).iter().any(|&h| surface.faces[h as usize / 3].contains(&c)))
}

/// Triangles over a loop, by vertex.
fn cover(
    surface: &Surface,
    edges: &Edges,
    vertices: &[u32],
    taken: impl Fn(u32, u32) -> bool,
    context: &Context<'_>,
) -> Option<Vec<[u32; 3]>> {
    let points: Vec<DVec3> = vertices.iter().map(|&v| surface.positions[v as usize]).collect();
    let side = |i: usize, j: usize| {
        let across = edges.find(vertices[i], vertices[j]).map(|e| edges.half_edges(e)[0] as usize / 3);
        across.map_or(DVec3::ZERO, |f| surface.area_vector(f).normalize_or_zero())
    };
    let n = vertices.len();
    let mut triangles = Vec::with_capacity(n - 2);
    let mut polygons: Vec<Vec<usize>> = vec![(0..n).collect()];
    while let Some(polygon) = polygons.pop() {
        context.check().ok()?;
        let corners: Vec<DVec3> = polygon.iter().map(|&i| points[i]).collect();
        let forbidden = |i: usize, j: usize| taken(vertices[polygon[i]], vertices[polygon[j]]);
        let found = if polygon.len() <= MOST_FOR_LEAST_WEIGHT {
            let m = polygon.len();
            let normals: Vec<DVec3> = (0..m).map(|i| side(polygon[i], polygon[(i + 1) % m])).collect();
            Some(least_weight(&corners, &normals, forbidden, || context.check().is_ok())?)
        } else if polygon.len() == n && n <= MOST_FOR_EARS {
            flat(&corners, forbidden)
        } else {
            None
        };
        if let Some(found) = found {
            triangles.extend(found.into_iter().map(|t| t.map(|i| vertices[polygon[i]])));
        } else {
            let (i, j) = shortest_cut(&corners, forbidden)?;
            polygons.push(polygon[i..=j].to_vec());
            polygons.push(polygon[j..].iter().chain(&polygon[..=i]).copied().collect());
        }
    }
    Some(triangles)
}
