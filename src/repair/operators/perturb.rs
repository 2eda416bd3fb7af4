//! Keeping sheets apart that a reader would weld, because STL knows positions and no indices.

use glam::DVec3;

use super::face_pairs::{NONE, Pairing, pair_faces};
use super::free_positions::{FreePositions, MoveClearance, NEIGHBOURS, NEW, keep_facing, key, spacing, with_vertex};
use super::operator::{Applied, Counter, Operation, Scope};
use super::rounding::{DistinguishLimits, distinguish_vertices};
use super::split_non_manifold::{Pinches, split_non_manifold};
use crate::math::{Precision, collinear};
use crate::mesh::{Edges, Stars, Surface};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// Rounds of cutting and splitting; an edge that is still doubled after them is left.
const MOST_ROUNDS: usize = 4;
/// No vertex is moved farther than this share of the diagonal.
const MOST: f64 = 1e-4;

/// Keeps sheets apart by position.
#[derive(Debug, Clone, Copy)]
pub struct Perturb {
    /// No vertex is moved farther than this, in the model's unit; nor farther than 1e-4 of the diagonal.
    pub max_deviation: f64,
}

impl Default for Perturb {
    fn default() -> Self {
        Self { max_deviation: f64::INFINITY }
    }
}

impl Perturb {
    /// Moves vertices that stand on one another, and the middles of edges that lie on one another, apart by the smallest
    /// distance that f32 can tell, each into the solid that it bounds, so that the result is manifold when it is welded by
    /// position.
    ///
    /// ```text
    ///    --------+--------             -------+ +-------
    ///       A   / \   B         ->        A   / \   B
    /// ```
    ///
    /// Precondition: consistently wound and outward. Result: of each group of vertices at one f32 position the one with the
    /// largest faces stays, the others moved by a few units in the last place; no face is turned over, and none comes to
    /// intersect another, by exact signs. Leaves: vertices that can't be moved so within 1e-4 of the diagonal, counted as
    /// `coincident_vertices_left`.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let mut changes = Vec::new();
        let mut split = 0;
        let mut places = Aside::new(surface, self.max_deviation);
        for _ in 0..MOST_ROUNDS {
            changes.extend(split_non_manifold(surface, Pairing::Angular, Pinches::Cut, context)?);
            let done = split_doubled_edges(surface, &mut places, context)?;
            split += done;
            if done == 0 {
                break;
            }
        }
        let (moved, left) = spread(surface, &mut places, context)?;
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
        let left = (left > 0).then(|| format!("{left} vertices stand on others and could not be moved aside"));
        Ok(Applied { changes, moved: places.moved(), left, ..Applied::default() })
    }
}

/// Places beside vertices, each within its reach.
struct Aside {
    places: FreePositions,
    reach: f64,
    max_deviation: f64,
}

impl Aside {
    fn new(surface: &Surface, max_deviation: f64) -> Self {
        let diagonal = surface.bounds().diagonal();
        Self {
            places: FreePositions::new(surface, Precision::F32),
            reach: (MOST * diagonal).min(max_deviation),
            max_deviation,
        }
    }

    /// The farthest that was gone so far.
    fn moved(&self) -> f64 {
        self.places.moved
    }

    /// The nearest free position from `p` in a direction for which `fits` holds, as f32 says it; then it is taken.
    fn find(&mut self, p: DVec3, direction: DVec3, fits: impl FnMut(DVec3) -> bool) -> Option<DVec3> {
        self.places.find(p, direction, self.reach.max(4.0 * spacing(p)).min(self.max_deviation), fits)
    }
}

/// Splits edges that several pairs of faces share after everything was cut that could be: all pairs but one get a
/// vertex in the middle of the edge, moved into the solid.
fn split_doubled_edges(surface: &mut Surface, places: &mut Aside, context: &Context<'_>) -> Result<u64, Cancelled> {
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
        // One pair may keep the edge; where one can't be moved, that is the one.
        while pairs.len() > 1 && !clear.is_spent() {
            let Some(at) = (0..pairs.len()).rev().find(|&i| {
                let (x, y) = pairs[i];
                let [f, g] = [x, y].map(|h| h as usize / 3);
                let fits = !busy[f] && !busy[g] && split_pair(surface, x, y, places, &mut clear);
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

/// Puts a vertex near the middle of the edge along which the faces of half-edges `x` and `y` meet.
fn split_pair(surface: &mut Surface, x: u32, y: u32, places: &mut Aside, clear: &mut MoveClearance) -> bool {
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
    let placed = places.find(middle, direction, |w| {
        !collinear(at(a), w, at(b))
            && new_faces(w).iter().all(|&[p, q, r, n]| (q - p).cross(r - p).dot(n) > 0.0)
            && clear.is_clear(surface, &new, &[], w)
    });
    let Some(w) = placed else { return false };
    clear.added(w, w.distance((at(a) + at(b)) * 0.5));
    #[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
    let v = surface.positions.len() as u32;
    surface.positions.push(w);
    surface.faces[f] = [a, v, c];
    surface.faces[g] = [b, v, d];
    for (face, from) in [([v, b, c], f), ([v, a, d], g)] {
        #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
        clear.cut(from as u32, surface.faces.len() as u32);
        surface.faces.push(face);
        surface.source.push(surface.source[from]);
    }
    true
}

/// Moves all but one of the vertices of each group at one position. Answers how many were moved and how many could not be.
fn spread(surface: &mut Surface, places: &mut Aside, context: &Context<'_>) -> Result<(u64, u64), Cancelled> {
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
        // One may stay; where one can't be moved, that is the one.
        let mut staying = by_area.len();
        for &(_, v) in by_area.iter().rev() {
            if staying == 1 || clear.is_spent() {
                break;
            }
            if let Some(q) = aside(surface, v, stars.of(v), places, &mut clear) {
                clear.moved(v, q);
                surface.positions[v as usize] = q;
                staying -= 1;
                moved += 1;
            }
        }
        left += staying.saturating_sub(1) as u64;
    }
    Ok((moved, left))
}

/// A free position beside a vertex, into the solid that its faces bound.
fn aside(surface: &Surface, v: u32, star: &[u32], places: &mut Aside, clear: &mut MoveClearance) -> Option<DVec3> {
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
    let mut fits = |q: DVec3| keep_facing(surface, star.iter().copied(), v, q) && clear.is_clear(surface, &new, &[], q);
    let ahead = (-normal).try_normalize().or_else(|| middle.try_normalize())?;
    places.find(p, ahead, &mut fits).or_else(|| {
        let mut around: Vec<DVec3> = NEIGHBOURS.iter().map(|d| d.normalize()).collect();
        around.sort_by(|x, y| y.dot(ahead).total_cmp(&x.dot(ahead)));
        around.into_iter().find_map(|direction| places.find(p, direction, &mut fits))
    })
}

impl Operation for Perturb {
    const FIXES: &'static [Counter] = &[Counter::NonManifoldEdges];
    const MAY_RAISE: &'static [Counter] = &[Counter::BoundaryEdges, Counter::DuplicateFaces];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { max_deviation: scope.max_deviation }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
