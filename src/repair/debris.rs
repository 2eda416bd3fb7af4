//! Open bits of surface that enclose nothing and that no printer could make.

use glam::DVec3;

use super::{Cancelled, Change, Context};
use crate::inspect::{Solid, solids};
use crate::math::{Box3, Crossing, Tree, crossing, ray_direction, to_unit_range};
use crate::mesh::{Edges, Parts, Surface};

/// An open part no larger than this share of the model's diagonal is debris: on a print of 200 mm less than half the width of a
/// nozzle.
const SMALL: f64 = 1e-3;
/// So is one with at most so many faces and this share of the model's area, ...
const FEW_FACES: usize = 10;
const LITTLE_AREA: f64 = 1e-3;
/// ... or this share where it is a fin: an open part that stood on an edge of a closed one.
const FIN_AREA: f64 = 1e-2;

/// Faces of an open part that are asked whether they lie inside a solid, and rays tried from each.
const ASKED: usize = 64;
const RAYS: u32 = 8;
/// Faces that all rays together may look at.
const BUDGET: u64 = 5_000_000;

/// Removes open parts that are too small to print, and those that lie inside a closed part. An open part has no volume,
/// so nothing that could be printed is lost.
///
/// Precondition: holes that can be closed are closed, and what is not one surface was cut apart. Result: what is left is
/// as it was; the parts and faces that went are counted. Leaves: closed parts of any size, larger open sheets, and
/// everything where nothing but debris is there.
///
/// # Errors
/// [`Cancelled`] when the work should stop; the surface is then unchanged.
pub fn remove_debris(surface: &mut Surface, context: &Context<'_>) -> Result<Vec<Change>, Cancelled> {
    let edges = Edges::new(&surface.faces);
    let parts = Parts::new(surface, &edges);
    let mut open = vec![false; parts.count];
    for half_edges in edges.iter().filter(|h| h.len() == 1) {
        open[parts.of_face[half_edges[0] as usize / 3] as usize] = true;
    }
    if !open.contains(&true) {
        return Ok(Vec::new());
    }
    let solids = solids(surface, &edges, &parts);
    let diagonal = Box3::of(surface.positions.iter().copied()).diagonal();
    let area: f64 = solids.iter().map(|s| s.area).sum();
    let fins = fins(surface, &edges, &parts, &solids);
    let mut inside = Inside::new(surface, &parts, &solids);
    let (mut goes, mut hidden) = (vec![false; parts.count], 0);
    for (part, faces) in parts.faces().iter().enumerate().filter(|&(part, _)| open[part]) {
        context.check()?;
        let little = if fins[part] { FIN_AREA } else { LITTLE_AREA };
        let few = faces.len() <= FEW_FACES && solids[part].area <= little * area;
        goes[part] = few || solids[part].bounds.diagonal() <= SMALL * diagonal;
        if !goes[part] && inside.holds(surface, faces) {
            goes[part] = true;
            hidden += 1;
        }
    }
    let count = goes.iter().filter(|&&d| d).count();
    if count == 0 || count == parts.count {
        return Ok(Vec::new());
    }
    let keep: Vec<bool> = parts.of_face.iter().map(|&p| p == Parts::NONE || !goes[p as usize]).collect();
    let faces = surface.retain_faces(&keep);
    surface.drop_unreferenced();
    Ok(Change::list([
        ("debris_parts_removed", count as u64 - hidden),
        ("sheets_inside_solids_removed", hidden),
        ("debris_faces_removed", faces),
    ]))
}

/// Of each part, whether it has an edge at the same two positions as an edge of a closed part.
fn fins(surface: &Surface, edges: &Edges, parts: &Parts, solids: &[Solid]) -> Vec<bool> {
    let bits = |v: u32| surface.positions[v as usize].to_array().map(|x| (x + 0.0).to_bits());
    let mut ends: Vec<([[u64; 3]; 2], bool, u32)> = (0..edges.len())
        .map(|e| {
            let mut ends = edges.vertices(e).map(bits);
            ends.sort_unstable();
            let part = parts.of_face[edges.half_edges(e)[0] as usize / 3];
            (ends, solids[part as usize].closed, part)
        })
        .collect();
    ends.sort_unstable();
    let mut fins = vec![false; parts.count];
    for at_one_place in ends.chunk_by(|x, y| x.0 == y.0) {
        if at_one_place.iter().any(|&(_, closed, _)| closed) {
            for &(_, closed, part) in at_one_place {
                fins[part as usize] |= !closed;
            }
        }
    }
    fins
}

/// Tells what lies inside the closed parts.
struct Inside {
    unit: Vec<DVec3>,
    walls: Vec<[u32; 3]>,
    tree: Tree,
    spent: u64,
}

impl Inside {
    fn new(surface: &Surface, parts: &Parts, solids: &[Solid]) -> Self {
        let closed = |p: u32| p != Parts::NONE && solids[p as usize].closed;
        let walls: Vec<[u32; 3]> =
            surface.faces.iter().zip(&parts.of_face).filter(|&(_, &p)| closed(p)).map(|(&face, _)| face).collect();
        let unit = to_unit_range(&surface.positions);
        Self { tree: Tree::new(&unit, &walls), unit, walls, spent: 0 }
    }

    /// Whether the middle of each face that is asked is inside by the crossings of a ray.
    fn holds(&mut self, surface: &Surface, faces: &[u32]) -> bool {
        let stride = faces.len().div_ceil(ASKED);
        faces.iter().step_by(stride).all(|&f| {
            let [a, b, c] = surface.faces[f as usize].map(|v| self.unit[v as usize]);
            let from = (a + b + c) / 3.0;
            (0..RAYS).find_map(|ray| self.crossings(from, from + ray_direction(ray) * 8.0)).is_some_and(|n| n % 2 == 1)
        })
    }

    /// How often a segment goes through the walls; none where it touches an edge or the budget is spent.
    fn crossings(&mut self, from: DVec3, to: DVec3) -> Option<u64> {
        let (mut count, mut clear) = (0, true);
        self.tree.along(from, to, |i| {
            self.spent += 1;
            match crossing(from, to, self.walls[i as usize].map(|v| self.unit[v as usize])) {
                Crossing::Miss => {}
                Crossing::Touches => clear = false,
                Crossing::Enters | Crossing::Leaves => count += 1,
            }
            clear && self.spent < BUDGET
        });
        (clear && self.spent < BUDGET).then_some(count)
    }
}
