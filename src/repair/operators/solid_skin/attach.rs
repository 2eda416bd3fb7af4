//! Joins islands to the largest part by struts.

use glam::DVec3;

use super::close::resolve;
use crate::context::{Cancelled, Context};
use crate::inspect::solids;
use crate::math::{Precision, Tree};
use crate::mesh::{Edges, Parts, Surface};

/// Sides of a strut.
const SIDES: u32 = 8;
/// Boxes and faces that one search may visit.
const STEPS: u64 = 1 << 24;

/// A strut between an island and the largest part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Attached {
    /// The strut's middle.
    pub at: DVec3,
    /// The width of the gap that the strut bridges, in the model's unit.
    pub gap: f64,
    /// The island's volume, in cubic units.
    pub volume: f64,
}

/// Joins every island to the largest part with a prism of the given diameter across the narrowest gap, and unites
/// them. Returns the struts; none if the union failed, and the surface is unchanged then.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn attach(
    surface: &mut Surface,
    diameter: f64,
    precision: Precision,
    context: &Context<'_>,
) -> Result<Vec<Attached>, Cancelled> {
    let edges = Edges::new(&surface.faces);
    let parts = Parts::new(surface, &edges);
    let solids = solids(surface, &edges, &parts);
    let Some(largest) = (0..parts.count).max_by(|&a, &b| solids[a].volume.total_cmp(&solids[b].volume)) else {
        return Ok(Vec::new());
    };
    let faces = parts.faces();
    let main: Vec<[u32; 3]> = faces[largest].iter().map(|&f| surface.faces[f as usize]).collect();
    let tree = Tree::new(&surface.positions, &main);
    let mut joined = surface.clone();
    let mut attached = Vec::new();
    for island in (0..parts.count).filter(|&part| part != largest && solids[part].volume > 0.0) {
        context.check()?;
        let mut vertices: Vec<u32> = faces[island].iter().flat_map(|&f| surface.faces[f as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let mut nearest: Option<[DVec3; 2]> = None;
        for v in vertices {
            let point = surface.positions[v as usize];
            let bound = nearest.map_or(f64::INFINITY, |[p, q]| p.distance(q));
            let mut steps = STEPS;
            let found =
                tree.nearest(point, bound, &mut steps, |f| main[f as usize].map(|v| surface.positions[v as usize]));
            nearest = found.map_or(nearest, |found| Some([point, found.point]));
        }
        if let Some([from, to]) = nearest.filter(|[from, to]| from != to) {
            push_strut(&mut joined, [from, to], diameter / 2.0, precision);
            let at = from.midpoint(to);
            attached.push(Attached { at, gap: from.distance(to), volume: solids[island].volume });
        }
    }
    if attached.is_empty() || !resolve(&mut joined, context)? {
        return Ok(Vec::new());
    }
    *surface = joined;
    Ok(attached)
}

/// Adds a closed prism around a line, which reaches into both bodies by its radius.
fn push_strut(surface: &mut Surface, [from, to]: [DVec3; 2], radius: f64, precision: Precision) {
    let axis = (to - from).normalize_or_zero();
    let (u, v) = axis.any_orthonormal_pair();
    #[expect(clippy::cast_possible_truncation, reason = "positions are counted in u32")]
    let first = surface.positions.len() as u32;
    for end in [from - axis * radius, to + axis * radius] {
        for side in 0..SIDES {
            let angle = std::f64::consts::TAU * f64::from(side) / f64::from(SIDES);
            // Circumscribed, so that flats are a diameter apart.
            let reach = radius / (std::f64::consts::PI / f64::from(SIDES)).cos();
            let at = end + (u * angle.cos() + v * angle.sin()) * reach;
            surface.positions.push(precision.round(at));
        }
    }
    let corner = |ring: u32, side: u32| first + ring * SIDES + side % SIDES;
    for side in 0..SIDES {
        let [a, b, c, d] = [corner(0, side), corner(0, side + 1), corner(1, side + 1), corner(1, side)];
        surface.push_patch([a, b, c]);
        surface.push_patch([a, c, d]);
    }
    for side in 1..SIDES - 1 {
        surface.push_patch([corner(0, 0), corner(0, side + 1), corner(0, side)]);
        surface.push_patch([corner(1, 0), corner(1, side), corner(1, side + 1)]);
    }
}
