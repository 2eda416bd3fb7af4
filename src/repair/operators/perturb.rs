//! Perturbs coincident sheets, because STL readers merge vertices by position.

use glam::DVec3;

use super::face_pairs::{NONE, Pairing, pair_faces};
use super::free_positions::{
    FreePositions, MoveClearance, NEIGHBOUR_DIRECTIONS, NEW, keeps_orientation, key, spacing, with_vertex,
};
use super::operator::{Applied, Counter, Operation, Scope};
use super::rounding::{DistinguishLimits, distinguish_vertices};
use super::split_non_manifold::{Pinches, split_non_manifold};
use crate::math::{Precision, collinear};
use crate::mesh::{Edges, Stars, Surface, are_distinct};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// The most rounds of splitting; an edge that is still doubled after them stays.
const MAX_ROUNDS: usize = 4;
/// The largest displacement of a vertex, as a share of the diagonal.
const MAX_SHARE_OF_DIAGONAL: f64 = 1e-4;
/// With more vertices than this that cannot move, beside one in each group, no others are tried. The result is not manifold
/// by position in any case.
const MAX_STUCK: u64 = 100;

/// Separates coincident sheets by moving vertices.
#[derive(Debug, Clone, Copy)]
pub struct Perturb {
    /// No vertex moves farther than this, in the model's unit, nor farther than 1e-4 of the diagonal.
    pub max_deviation: f64,
}

impl Default for Perturb {
    fn default() -> Self {
        Self { max_deviation: f64::INFINITY }
    }
}

impl Perturb {
    /// Moves coincident vertices, and new vertices on the middles of coincident edges, apart by the smallest distance that f32
    /// can represent. Each moves into the solid that it bounds, so that the surface stays manifold when merged by position.
    ///
    /// ```text
    ///    --------+--------             -------+ +-------
    ///       A   / \   B         ->        A   / \   B
    /// ```
    ///
    /// Precondition: consistent, outward winding. Result: of each group of vertices at one f32 position, the one with the
    /// largest faces stays and the others move by a few units in the last place. By exact predicates, no face flips and no
    /// new intersection arises. Leaves: vertices that cannot move within 1e-4 of the diagonal, and all others after a
    /// hundred such vertices, counted as `coincident_vertices_left`.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let mut changes = Vec::new();
        let mut split = 0;
        let mut nearby = NearbyPositions::new(surface, self.max_deviation);
        for _ in 0..MAX_ROUNDS {
            changes.extend(split_non_manifold(surface, Pairing::Angular, Pinches::Cut, context)?);
            let count = split_doubled_edges(surface, &mut nearby, context)?;
            split += count;
            if count == 0 {
                break;
            }
        }
        let (moved, left) = separate_coincident(surface, &mut nearby, context)?;
        let merged = distinguish_vertices(
            surface,
            DistinguishLimits { max_deviation: self.max_deviation, moves: true },
            |_| true,
            context,
        )?;
        changes.extend(Change::list([
            (ChangeKind::NearCoincidentVerticesMerged, merged),
            (ChangeKind::DoubledEdgesSplit, split),
            (ChangeKind::CoincidentVerticesPerturbed, moved),
            (ChangeKind::CoincidentVerticesLeft, left),
        ]));
        let left =
            (left > 0).then(|| format!("{left} vertices share a position with others and could not be moved apart"));
        Ok(Applied { changes, moved: nearby.moved(), left, ..Applied::default() })
    }
}

/// Free positions near vertices, each within a limited distance.
struct NearbyPositions {
    free: FreePositions,
    reach: f64,
    max_deviation: f64,
}

impl NearbyPositions {
    fn new(surface: &Surface, max_deviation: f64) -> Self {
        let diagonal = surface.bounds().diagonal();
        Self {
            free: FreePositions::new(surface, Precision::F32),
            reach: (MAX_SHARE_OF_DIAGONAL * diagonal).min(max_deviation),
            max_deviation,
        }
    }

    /// The largest displacement so far.
    fn moved(&self) -> f64 {
        self.free.moved
    }

    /// Finds and takes the nearest free f32 position from `p` in a direction for which `fits` holds.
    fn find(
        &mut self,
        surface: &Surface,
        (p, direction): (DVec3, DVec3),
        fits: impl FnMut(DVec3) -> bool,
    ) -> Option<DVec3> {
        let most = self.reach.max(4.0 * spacing(p)).min(self.max_deviation);
        self.free.find(surface, (p, direction), most, fits)
    }
}

/// Splits edges that several pairs of faces still share after all possible splits. Every pair but one gets a vertex in the
/// middle of the edge, moved into the solid.
fn split_doubled_edges(
    surface: &mut Surface,
    nearby: &mut NearbyPositions,
    context: &Context<'_>,
) -> Result<u64, Cancelled> {
    let edges = Edges::new(&surface.faces);
    if edges.iter().all(|h| h.len() <= 2) {
        return Ok(0);
    }
    let mut clear = MoveClearance::new(surface);
    let mates = pair_faces(surface, &edges, Pairing::Angular, context)?.mate;
    let mut busy = vec![false; surface.faces.len()];
    let mut split = 0;
    for half_edges in edges.iter().filter(|h| h.len() > 2) {
        let mut pairs: Vec<(u32, u32)> =
            half_edges.iter().map(|&h| (h, mates[h as usize])).filter(|&(h, m)| m != NONE && h < m).collect();
        // One pair may keep the edge: a pair that cannot be split, if there is one.
        while pairs.len() > 1 && !clear.is_spent() {
            let Some(at) = (0..pairs.len()).rev().find(|&i| {
                let (x, y) = pairs[i];
                let [f, g] = [x, y].map(|h| h as usize / 3);
                let fits = !busy[f] && !busy[g] && split_pair(surface, x, y, nearby, &mut clear);
                if fits {
                    (busy[f], busy[g]) = (true, true);
                }
                fits
            }) else {
                break;
            };
            pairs.remove(at);
            split += 1;
        }
    }
    Ok(split)
}

/// Adds a vertex near the middle of the common edge of the faces with half-edges `x` and `y`.
fn split_pair(surface: &mut Surface, x: u32, y: u32, nearby: &mut NearbyPositions, clear: &mut MoveClearance) -> bool {
    let [a, b] = Edges::ends(&surface.faces, x);
    let (c, d) = (Edges::opposite(&surface.faces, x), Edges::opposite(&surface.faces, y));
    let [f, g] = [x, y].map(|h| h as usize / 3);
    let at = |v: u32| surface.positions[v as usize];
    let [n, m] = [f, g].map(|f| surface.area_vector(f).normalize_or_zero());
    let middle = Precision::F32.round((at(a) + at(b)) * 0.5);
    let Some(direction) = (-(n + m)).try_normalize() else { return false };
    let new_faces = |w: DVec3| [[at(a), w, at(c), n], [w, at(b), at(c), n], [at(b), w, at(d), m], [w, at(a), at(d), m]];
    #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
    let [from_f, from_g] = [f as u32, g as u32];
    let new = [([a, NEW, c], from_f), ([NEW, b, c], from_f), ([b, NEW, d], from_g), ([NEW, a, d], from_g)];
    let new_position = nearby.find(surface, (middle, direction), |w| {
        !collinear(at(a), w, at(b))
            && new_faces(w).iter().all(|&[p, q, r, n]| (q - p).cross(r - p).dot(n) > 0.0)
            && clear.is_clear(surface, &new, &[], w)
    });
    let Some(w) = new_position else { return false };
    clear.record_vertex(w, w.distance((at(a) + at(b)) * 0.5));
    #[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
    let v = surface.positions.len() as u32;
    surface.positions.push(w);
    surface.faces[f] = [a, v, c];
    surface.faces[g] = [b, v, d];
    for (face, from) in [([v, b, c], f), ([v, a, d], g)] {
        #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
        clear.record_split(from as u32, surface.faces.len() as u32);
        surface.faces.push(face);
        surface.source.push(surface.source[from]);
    }
    true
}

/// Moves all but one vertex of each group at one position. Returns the number of moved vertices and of those left.
fn separate_coincident(
    surface: &mut Surface,
    nearby: &mut NearbyPositions,
    context: &Context<'_>,
) -> Result<(u64, u64), Cancelled> {
    if are_distinct(surface.positions.len(), |v| surface.positions[v].as_vec3().as_dvec3()) {
        return Ok((0, 0));
    }
    let mut order: Vec<([u32; 3], u32)> = surface.positions.iter().map(|&p| key(p)).zip(0u32..).collect();
    order.sort_unstable();
    let groups: Vec<&[([u32; 3], u32)]> = order.chunk_by(|x, y| x.0 == y.0).filter(|g| g.len() > 1).collect();
    if groups.is_empty() {
        return Ok((0, 0));
    }
    let stars = Stars::new(surface.positions.len(), &surface.faces);
    let mut clear = MoveClearance::new(surface);
    let (mut moved, mut left) = (0, 0);
    for (count, group) in groups.into_iter().enumerate() {
        if count % 16 == 0 {
            context.check()?;
        }
        let area = |v: u32| -> f64 { stars.of(v).iter().map(|&f| surface.area_vector(f as usize).length()).sum() };
        let mut by_area: Vec<(f64, u32)> =
            group.iter().map(|&(_, v)| (area(v), v)).filter(|&(_, v)| !stars.of(v).is_empty()).collect();
        by_area.sort_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
        // One vertex may stay: one that cannot be moved, if there is one.
        let mut remaining = by_area.len();
        let mut stuck: u64 = 0;
        for &(_, v) in by_area.iter().rev() {
            if remaining == 1 || left + stuck > MAX_STUCK || clear.is_spent() {
                break;
            }
            if let Some(q) = find_position(surface, v, stars.of(v), nearby, &mut clear) {
                clear.record_move(v, q);
                surface.positions[v as usize] = q;
                remaining -= 1;
                moved += 1;
            } else {
                stuck += 1;
            }
        }
        left += remaining.saturating_sub(1) as u64;
    }
    Ok((moved, left))
}

/// A free position next to a vertex, in the direction of the solid that its faces bound.
fn find_position(
    surface: &Surface,
    v: u32,
    star: &[u32],
    nearby: &mut NearbyPositions,
    clear: &mut MoveClearance,
) -> Option<DVec3> {
    let p = surface.positions[v as usize];
    let mut normal = DVec3::ZERO;
    let mut middle = DVec3::ZERO;
    for &f in star {
        let corners = surface.corners(f as usize);
        let i = surface.faces[f as usize].iter().position(|&w| w == v)?;
        let (q, r) = (corners[(i + 1) % 3] - p, corners[(i + 2) % 3] - p);
        normal += surface.area_vector(f as usize).normalize_or_zero() * q.angle_between(r);
        middle += (q.normalize_or_zero() + r.normalize_or_zero()) * 0.5;
    }
    let new = with_vertex(surface, star, v, NEW);
    let mut fits =
        |q: DVec3| keeps_orientation(surface, star.iter().copied(), v, q) && clear.is_clear(surface, &new, &[], q);
    let ahead = (-normal).try_normalize().or_else(|| middle.try_normalize())?;
    nearby.find(surface, (p, ahead), &mut fits).or_else(|| {
        let mut around: Vec<DVec3> = NEIGHBOUR_DIRECTIONS.iter().map(|d| d.normalize()).collect();
        around.sort_by(|x, y| y.dot(ahead).total_cmp(&x.dot(ahead)));
        around.into_iter().find_map(|direction| nearby.find(surface, (p, direction), &mut fits))
    })
}

impl Operation<'_> for Perturb {
    const FIXES: &'static [Counter] = &[Counter::NonManifoldEdges];
    const MAY_RAISE: &'static [Counter] = &[Counter::BoundaryEdges, Counter::DuplicateFaces];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { max_deviation: scope.max_deviation }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
