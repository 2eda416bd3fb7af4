//! What rounding leaves of an arrangement: crumbs, and places where sheets touch that no movement of a vertex separates.

use glam::DVec3;
use rustc_hash::FxHashSet;

use crate::inspect::{IntersectingPair, Meeting, solids};
use crate::math::{Precision, intersection, unit_scale};
use crate::mesh::{Edges, Fans, Parts, Surface, position_key, weld_exactly};
use crate::repair::operators::free_positions::spacing;

/// The largest diagonal of a crumb, as a share of the surface's diagonal.
const MAX_CRUMB_SHARE: f64 = 1e-3;
/// The largest thickness of a crumb, in steps of f32 at the largest coordinate: rounding moves each of two sides by up to
/// one step.
const MAX_CRUMB_STEPS: f64 = 2.0;

/// Removes crumbs: small closed pieces that the arrangement cut out between faces that nearly coincide, and that are thinner
/// than rounding moves a vertex. `is_new` tells the positions that the arrangement made; a piece without one is the input's.
/// Returns the number of removed pieces.
pub(super) fn remove_crumbs(surface: &mut Surface, is_new: impl Fn(DVec3) -> bool) -> u64 {
    let edges = Edges::new(&surface.faces);
    let parts = Parts::new(surface, &edges);
    if parts.count < 2 {
        return 0;
    }
    let bounds = surface.bounds();
    let max_thickness = MAX_CRUMB_STEPS * spacing(bounds.min.abs().max(bounds.max.abs()));
    let mut is_crumb: Vec<bool> = solids(surface, &edges, &parts)
        .iter()
        .map(|piece| {
            let thickness = 2.0 * piece.volume.abs() / piece.area.max(f64::MIN_POSITIVE);
            piece.closed && piece.bounds.diagonal() <= MAX_CRUMB_SHARE * bounds.diagonal() && thickness <= max_thickness
        })
        .collect();
    let mut has_new = vec![false; parts.count];
    for (face, &part) in surface.faces.iter().zip(&parts.of_face).filter(|(_, part)| **part != Parts::NONE) {
        let part = part as usize;
        if is_crumb[part] && !has_new[part] {
            has_new[part] = face.iter().any(|&v| is_new(surface.positions[v as usize]));
        }
    }
    for (crumb, has_new) in is_crumb.iter_mut().zip(has_new) {
        *crumb &= has_new;
    }
    let crumbs = is_crumb.iter().filter(|crumb| **crumb).count();
    if crumbs > 0 && crumbs < parts.count {
        parts.remove(&is_crumb, surface);
        return crumbs as u64;
    }
    0
}

/// A segment, or a point where both ends are equal, at which sheets touch.
#[derive(Debug, Clone, Copy)]
struct Place {
    ends: [DVec3; 2],
    /// The source of a face there.
    source: u32,
}

/// The places where a surface is not manifold when merged by position.
pub(super) struct Pinched {
    /// The keys of all positions in `places`.
    vertices: FxHashSet<[u64; 3]>,
    /// The edges and vertices, each as its ends.
    places: Vec<Place>,
}

impl Pinched {
    /// Finds edges with more than two faces and vertices with several fans.
    pub fn of(surface: &Surface) -> Self {
        let mut welded = surface.clone();
        weld_exactly(&mut welded);
        let edges = Edges::new(&welded.faces);
        let mut found = Self { vertices: FxHashSet::default(), places: Vec::new() };
        for half_edges in edges.iter().filter(|half_edges| half_edges.len() > 2) {
            let ends = Edges::ends(&welded.faces, half_edges[0]).map(|v| welded.positions[v as usize]);
            found.add(ends, welded.source[half_edges[0] as usize / 3]);
        }
        let fans = Fans::new(&welded, &edges).at_vertices(&welded);
        if fans.iter().any(|&fans| fans > 1) {
            for (face, &source) in welded.faces.iter().zip(&welded.source) {
                for p in face.iter().filter(|&&v| fans[v as usize] > 1).map(|&v| welded.positions[v as usize]) {
                    if !found.vertices.contains(&position_key(p)) {
                        found.add([p; 2], source);
                    }
                }
            }
        }
        found
    }

    fn add(&mut self, ends: [DVec3; 2], source: u32) {
        self.places.push(Place { ends, source });
        self.vertices.extend(ends.map(position_key));
    }

    /// The number of edges and vertices.
    pub fn count(&self) -> u64 {
        self.places.len() as u64
    }

    /// Marks the faces of a surface that have a vertex at one of the places.
    pub fn mark(&self, surface: &Surface, marked: &mut [bool]) {
        if self.places.is_empty() {
            return;
        }
        for (face, is_marked) in surface.faces.iter().zip(marked) {
            *is_marked |= face.iter().any(|&v| self.vertices.contains(&position_key(surface.positions[v as usize])));
        }
    }
}

/// Up to this length, in steps of the grid, a place gets an axis-parallel box with a margin of one to two steps.
const MAX_BOX_LENGTH: f64 = 8.0;
/// The margin of a prism around a longer place, in steps, before its corners are rounded to the grid.
const PRISM_MARGIN: f64 = 2.0;
/// The largest distance from a place to a corner of its plug, in steps.
pub(super) const MAX_PLUG_REACH: f64 = 5.0;

/// Small closed solids around the pinched places and around the intersections of faces of a surface, with corners at
/// multiples of `step`. United with the surface they join the sheets that touch there.
pub(super) fn plugs(surface: &Surface, pinched: &Pinched, pairs: &[IntersectingPair], step: f64) -> Surface {
    let scale = unit_scale(&surface.positions);
    let mut all = Surface::default();
    for place in pinched.places.iter().copied().chain(pairs.iter().map(|pair| place_of(surface, pair, scale))) {
        all.append(plug(place, step));
    }
    all
}

/// The longest segment between two points in which two faces meet. `scale` brings the surface into the range of the
/// predicates.
fn place_of(surface: &Surface, pair: &IntersectingPair, scale: f64) -> Place {
    let [p, q] = pair.faces.map(|f| surface.corners(f as usize).map(|corner| corner * scale));
    let common = intersection(&p, &q, pair.meeting == Meeting::Coplanar);
    let segments = common.iter().flat_map(|&a| common.iter().map(move |&b| [a, b]));
    let longest = segments.max_by(|[a, b], [c, d]| a.distance(*b).total_cmp(&c.distance(*d)));
    let ends = longest.unwrap_or([p[0]; 2]).map(|end| end / scale);
    Place { ends, source: surface.source[pair.faces[0] as usize] }
}

/// A closed box or prism around a segment, oriented outward, with corners at multiples of `step`.
fn plug(Place { ends: [a, b], source }: Place, step: f64) -> Surface {
    const QUADS: [[u32; 4]; 6] = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let is_high = |i: usize, bit: usize| i >> bit & 1 == 1;
    let corner = |i: usize| {
        let p = if a.distance(b) <= MAX_BOX_LENGTH * step {
            let [low, high] = [(a.min(b) / step).floor() - 1.0, (a.max(b) / step).ceil() + 1.0];
            DVec3::from_array([0, 1, 2].map(|k| if is_high(i, k) { high[k] } else { low[k] }))
        } else {
            let along = (b - a).normalize();
            let across = along.any_orthonormal_vector();
            let sides = [along, across, along.cross(across)];
            let margin = |k: usize| sides[k] * if is_high(i, k) { PRISM_MARGIN } else { -PRISM_MARGIN };
            let end = if is_high(i, 0) { b } else { a };
            (end / step + margin(0) + margin(1) + margin(2)).round()
        };
        Precision::F32.round(p * step)
    };
    let faces: Vec<[u32; 3]> = QUADS.iter().flat_map(|&[p, q, r, s]| [[p, q, r], [p, r, s]]).collect();
    Surface { positions: (0..8).map(corner).collect(), source: vec![source; faces.len()], faces }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    use glam::DQuat;

    use super::*;
    use crate::arrange::{Arrangement, Exact, WindingRule};
    use crate::mesh::ClosedSurface;
    use crate::repair::{Context, NoProgress};

    /// A cube with sides of 2 around a point with whole coordinates.
    fn cube(centre: DVec3) -> Surface {
        plug(Place { ends: [centre; 2], source: 7 }, 1.0)
    }

    fn with_tetrahedron(height: f64) -> Surface {
        let corners = [[3.0, 0.0, 0.0], [3.001, 0.0, 0.0], [3.0, 0.001, 0.0], [3.0, 0.0, height]];
        let mut all = cube(DVec3::ZERO);
        all.append(Surface {
            positions: corners.map(DVec3::from).to_vec(),
            faces: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
            source: vec![0; 4],
        });
        all
    }

    #[test]
    fn a_new_piece_thinner_than_rounding_is_a_crumb() {
        let mut thin = with_tetrahedron(1e-7);
        assert_eq!(remove_crumbs(&mut thin.clone(), |_| false), 0, "the input's own piece stays");
        assert_eq!(remove_crumbs(&mut with_tetrahedron(1e-4), |_| true), 0, "a thick piece stays");
        assert_eq!(remove_crumbs(&mut thin, |_| true), 1);
        assert_eq!((thin.faces.len(), thin.positions.len(), &thin.source[..]), (12, 8, &[7; 12][..]));
    }

    #[test]
    fn plugs_join_two_cubes_that_touch_in_a_vertex_or_along_an_edge() {
        let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7);
        for (offset, is_turned) in [([2.0; 3], false), ([2.0, 2.0, 0.0], false), ([2.0, 2.0, 0.0], true)] {
            let mut touching = cube(DVec3::ZERO);
            touching.append(cube(DVec3::from(offset)));
            if is_turned {
                touching.positions.iter_mut().for_each(|p| *p = Precision::F32.round(turn * *p));
            }
            let pinched = Pinched::of(&touching);
            assert_eq!(pinched.count(), 1);
            let mut marked = vec![false; touching.faces.len()];
            pinched.mark(&touching, &mut marked);
            assert!(marked.contains(&true) && marked.contains(&false));
            let plugs = plugs(&touching, &pinched, &[], 1.0 / 4096.0);
            touching.append(plugs);
            weld_exactly(&mut touching);
            let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
            let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(60));
            let closed = ClosedSurface::try_from(&touching).expect("both are closed");
            let joined =
                Exact.solid(closed, None, WindingRule::Positive.into(), &context).expect("they are solids").surface;
            assert_eq!(Pinched::of(&joined).count(), 0);
            let edges = Edges::new(&joined.faces);
            let parts = Parts::new(&joined, &edges);
            let volume: f64 = solids(&joined, &edges, &parts).iter().map(|solid| solid.volume).sum();
            assert!(parts.count == 1 && (volume - 16.0).abs() < 1e-5, "{} parts, {volume}", parts.count);
        }
    }

    #[test]
    fn a_plug_covers_the_intersection_of_two_faces() {
        let positions = [[0, 0, 0], [4, 0, 0], [0, 4, 0], [1, 1, -1], [1, 1, 1], [3, 1, 0]];
        let positions = positions.map(|p| DVec3::from(p.map(f64::from))).to_vec();
        let crossing = Surface { positions, faces: vec![[0, 1, 2], [3, 4, 5]], source: vec![3, 4] };
        let pair = IntersectingPair { faces: [0, 1], meeting: Meeting::Crossing, within_one_part: false };
        let plug = plugs(&crossing, &Pinched::of(&cube(DVec3::ZERO)), &[pair], 1.0 / 4096.0);
        let bounds = plug.bounds();
        assert!(bounds.min.x < 1.0 && bounds.max.x > 3.0 && bounds.max.x < 3.01, "{bounds:?}");
        assert!(plug.source.iter().all(|&source| source == 3));
    }
}
