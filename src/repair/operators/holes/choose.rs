//! Computes candidate patches for a hole and chooses one of them.

use std::collections::{HashMap, HashSet};

use glam::DVec3;

use super::clearance::Clearance;
use super::group::{Hole, newell};
use super::patch::{Faults, Patch};
use super::triangulate::{Criterion, grow_from_sharp_corners, least_weight, shortest_cut};
use crate::math::{Precision, Sign, collinear, orient3d, triangulated_area};
use crate::mesh::{Edges, Surface};
use crate::repair::options::HoleFilling;
use crate::repair::{Cancelled, Context};

/// The most corners for the cubic triangulation, which then takes about 0.03 s.
const MAX_CORNERS_FOR_LEAST_WEIGHT: usize = 128;
/// The most corners of the pieces into which longer loops are split: for up to a thousand corners, and for more.
const MAX_PIECE_CORNERS: [usize; 2] = [MAX_CORNERS_FOR_LEAST_WEIGHT, 32];
/// The cubic steps for all loops together, about two seconds. Loops with up to `FREE_CORNERS` corners do not count.
const CUBIC_BUDGET: u64 = 20_000_000;
const FREE_CORNERS: usize = 16;
/// The steps for growth from sharp corners in one hole, where it is one of several methods.
const SHARP_BUDGET: u64 = 2_000_000;

/// How far a cone's apex lies behind the centre of its hole, in mean edge lengths.
const APEX_DEPTH: f64 = 0.05;

/// Fills holes within limits, with the given method.
#[derive(Debug, Clone, Copy)]
pub struct FillHoles {
    /// The most edges around a hole, including the edges around its islands; a million by default.
    pub max_edges: u32,
    /// The largest extent of a hole, as a share of the model's diagonal; 1 by default, which allows any size.
    pub max_size: f64,
    /// The most holes; of more the smallest are filled. A million by default.
    pub max_holes: u32,
    /// How the triangles of a patch are chosen.
    pub filling: HoleFilling,
    /// Whether non-planar patches get inner vertices, as dense as the surface around them.
    pub refine: bool,
    /// Whether patches are refined and then smoothed to continue the surface.
    pub fair: bool,
    /// The precision to which new positions are rounded.
    pub precision: Precision,
}

impl Default for FillHoles {
    fn default() -> Self {
        Self {
            max_edges: 1_000_000,
            max_size: 1.0,
            max_holes: 1_000_000,
            filling: HoleFilling::Auto,
            refine: false,
            fair: false,
            precision: Precision::F64,
        }
    }
}

/// A method to triangulate a hole.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Method {
    LeastFold,
    Planar,
    LeastArea,
    Sharp,
    Chords,
}

/// Triangles by corner index, and the number of corners that stay open.
type Triangulated = (Vec<[usize; 3]>, usize);

/// A candidate patch for a hole.
pub(super) struct PatchCandidate {
    /// The faces of the patch.
    pub faces: Vec<[u32; 3]>,
    /// The faults of the patch; `None` where the check exceeded its budget.
    pub faults: Option<Faults>,
    /// The number of the hole's edges that stay open, where growth from sharp corners stopped.
    pub open: usize,
}

/// Fills one hole after another, each against the surface and the patches before it.
pub(super) struct Filler<'a> {
    /// The operator's parameters.
    pub params: &'a FillHoles,
    /// The positions of the surface, then those that patches added.
    pub positions: Vec<DVec3>,
    /// The faces of the surface.
    pub faces: &'a [[u32; 3]],
    /// The edges of the surface.
    pub edges: &'a Edges,
    /// The intersection test.
    pub clearance: Clearance<'a>,
    /// Edges that patches added, smaller vertex first.
    pub new_edges: HashSet<(u32, u32)>,
    /// For each boundary vertex its neighbours on the surface; empty unless patches are refined.
    pub neighbours: HashMap<u32, Vec<u32>>,
    /// The context of the repair.
    pub context: &'a Context<'a>,
    cubic_budget: u64,
}

/// The corners of a hole: the vertices of its loops in sequence, with the end of each loop.
struct HoleCorners<'h> {
    vertices: Vec<u32>,
    points: Vec<DVec3>,
    ends: Vec<usize>,
    normal: DVec3,
    hole: &'h Hole,
}

impl<'a> Filler<'a> {
    /// Prepares to fill the holes of a surface.
    pub fn new(
        params: &'a FillHoles,
        surface: &'a Surface,
        edges: &'a Edges,
        clearance: Clearance<'a>,
        context: &'a Context<'a>,
    ) -> Self {
        let (positions, faces) = (surface.positions.clone(), surface.faces.as_slice());
        let neighbours = if params.refine || params.fair { boundary_neighbours(edges) } else { HashMap::new() };
        let new_edges = HashSet::new();
        Self { params, positions, faces, edges, clearance, new_edges, neighbours, context, cubic_budget: CUBIC_BUDGET }
    }

    /// The first candidate without a fault, or the one with the fewest faults; `None` where there is no candidate.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn choose(&mut self, hole: &Hole) -> Result<Option<PatchCandidate>, Cancelled> {
        if self.bounds_single_face(hole) {
            return Ok(None);
        }
        self.clearance.enter(hole);
        let vertices = hole.loops.concat();
        let points: Vec<DVec3> = vertices.iter().map(|&v| self.clearance.unit()[v as usize]).collect();
        let ends: Vec<usize> = hole
            .loops
            .iter()
            .scan(0, |end, border| {
                *end += border.len();
                Some(*end)
            })
            .collect();
        let normal = newell(&points[..ends[0]]);
        let corners = HoleCorners { vertices, points, ends, normal, hole };
        let planar_hole = corners.points.len() > 3 && coplanar(&corners.points);
        let mut best: Option<(PatchCandidate, Vec<[usize; 3]>)> = None;
        for &method in self.methods(&corners, planar_hole) {
            self.context.check()?;
            let Some((triangles, open)) = self.triangulate(method, &corners)? else { continue };
            let faces: Vec<[u32; 3]> = triangles.iter().map(|t| t.map(|i| corners.vertices[i])).collect();
            let fewest = best.as_ref().and_then(|(b, _)| b.faults).map(|f| f.crossings + f.degenerate);
            let faults = self.clearance.faults(&faces, method == Method::Planar, fewest.unwrap_or(u64::MAX));
            let better = match (faults, fewest) {
                (Some(faults), Some(fewest)) => faults.crossings + faults.degenerate < fewest,
                (_, fewest) => fewest.is_none() && best.is_none(),
            };
            if better {
                best = Some((PatchCandidate { faces, faults, open }, triangles));
            }
            if self.params.filling != HoleFilling::Auto || faults.is_none_or(Faults::is_empty) {
                break;
            }
        }
        let Some((mut candidate, triangles)) = best else {
            let is_single = hole.loops.len() == 1 && self.params.filling == HoleFilling::Auto;
            return Ok(if is_single { self.cone(&corners) } else { None });
        };
        let is_sound = candidate.open == 0 && candidate.faults.is_some_and(Faults::is_empty);
        if (self.params.refine || self.params.fair) && !planar_hole && is_sound && corners.points.len() > 3 {
            self.refine(&corners, triangles, &mut candidate);
        }
        Ok(Some(candidate))
    }

    /// A patch of faces with a common new apex, for a hole all of whose triangulations need an existing edge. The apex lies
    /// behind the centre of the hole, since the existing edge's faces may be in front.
    ///
    /// ```text
    ///    ____           ____
    ///   |    |         |\  /|
    ///   |    |   ->    | \/ |
    ///   |____|         |_/\_|
    /// ```
    fn cone(&mut self, corners: &HoleCorners<'_>) -> Option<PatchCandidate> {
        let points: Vec<DVec3> = corners.vertices.iter().map(|&v| self.positions[v as usize]).collect();
        let n = points.len();
        let middle = points.iter().sum::<DVec3>() / n as f64;
        let length = (0..n).map(|i| points[i].distance(points[(i + 1) % n])).sum::<f64>() / n as f64;
        let apex = self.params.precision.round(middle - corners.normal.normalize_or_zero() * (APEX_DEPTH * length));
        let new = u32::try_from(self.positions.len()).ok().filter(|_| apex.is_finite())?;
        let faces: Vec<[u32; 3]> = (0..n).map(|i| [corners.vertices[i], corners.vertices[(i + 1) % n], new]).collect();
        self.positions.push(apex);
        self.clearance.add_vertices(&[apex]);
        let faults = self.clearance.faults(&faces, false, u64::MAX);
        Some(PatchCandidate { faces, faults, open: 0 })
    }

    /// Whether a hole is the border of a single face: a patch would be the face's own back.
    pub fn bounds_single_face(&self, hole: &Hole) -> bool {
        let [border] = hole.loops.as_slice() else { return false };
        let &[a, b, c] = border.as_slice() else { return false };
        let of_edge = self.edges.find(a, b).map_or(&[][..], |e| self.edges.half_edges(e));
        of_edge.iter().any(|&h| self.faces[h as usize / 3].contains(&c))
    }

    /// The methods to try, in order.
    fn methods(&mut self, corners: &HoleCorners<'_>, planar_hole: bool) -> &'static [Method] {
        use Method::{Chords, LeastArea, LeastFold, Planar, Sharp};
        let n = corners.points.len();
        if corners.ends.len() > 1 {
            return &[Planar];
        }
        if n == 3 {
            return &[LeastFold];
        }
        let cubic = (n * n * n / 6) as u64;
        let short = n <= MAX_CORNERS_FOR_LEAST_WEIGHT && (n <= FREE_CORNERS || self.cubic_budget >= cubic);
        match self.params.filling {
            HoleFilling::Sharp => &[Sharp],
            HoleFilling::Planar if short => &[Planar, LeastArea],
            HoleFilling::Planar => &[Planar, Chords],
            HoleFilling::Smooth if short => &[LeastFold],
            HoleFilling::Smooth => &[Chords],
            HoleFilling::Auto if short && planar_hole => &[Planar, LeastFold, LeastArea, Sharp],
            HoleFilling::Auto if short => &[LeastFold, Planar, LeastArea, Sharp],
            HoleFilling::Auto => &[Planar, Sharp, Chords],
        }
    }

    /// Triangulates a hole with one method; `None` where the method gives no triangulation.
    fn triangulate(&mut self, method: Method, corners: &HoleCorners<'_>) -> Result<Option<Triangulated>, Cancelled> {
        let HoleCorners { vertices, points, ends, normal, .. } = corners;
        let n = points.len();
        if n == 3 {
            return Ok(Some((vec![[0, 1, 2]], 0)));
        }
        let (edges, new_edges, context) = (self.edges, &self.new_edges, self.context);
        let edge_exists = |i: usize, j: usize| {
            let (a, b) = (vertices[i], vertices[j]);
            edges.find(a, b).is_some() || new_edges.contains(&(a.min(b), a.max(b)))
        };
        let complete = |triangles: Option<Vec<[usize; 3]>>| triangles.map(|t| (t, 0));
        Ok(match method {
            Method::LeastFold | Method::LeastArea => {
                self.cubic_budget =
                    self.cubic_budget.saturating_sub(if n > FREE_CORNERS { (n * n * n / 6) as u64 } else { 0 });
                let criterion = if method == Method::LeastFold { Criterion::Fold } else { Criterion::Area };
                let sides: Vec<DVec3> = (0..n).map(|i| self.face_normal(vertices[i], vertices[(i + 1) % n])).collect();
                let triangulation = least_weight(points, &sides, criterion, edge_exists, || context.check().is_ok());
                context.check()?;
                complete(triangulation)
            }
            Method::Planar => complete(triangulated_area(points, ends, *normal).filter(|triangles| {
                let is_side = |i: usize, j: usize| corners.is_side(i, j);
                let free = |i: usize, j: usize| is_side(i, j) || !edge_exists(i, j);
                triangles.iter().all(|&[a, b, c]| free(a, b) && free(b, c) && free(c, a))
            })),
            Method::Sharp => {
                let clearance = &mut self.clearance;
                let start = clearance.patches().len();
                let stop_at = match self.params.filling {
                    HoleFilling::Sharp => 0,
                    _ => clearance.steps().saturating_sub(SHARP_BUDGET),
                };
                let mut queries = 0u32;
                let growth = grow_from_sharp_corners(points, *normal, |t, last| {
                    queries += 1;
                    if clearance.steps() <= stop_at || (queries.is_multiple_of(256) && context.check().is_err()) {
                        return false;
                    }
                    let face = t.map(|i| vertices[i]);
                    let free = last || !edge_exists(t[0], t[2]);
                    let is_allowed = free && clearance.faults(&[face], true, 0).is_some_and(Faults::is_empty);
                    if is_allowed {
                        clearance.add(&[face]);
                    }
                    is_allowed
                });
                clearance.truncate_patches(start);
                context.check()?;
                let is_partial = self.params.filling == HoleFilling::Sharp && growth.open < n;
                (growth.open == 0 || is_partial).then_some((growth.triangles, growth.open))
            }
            Method::Chords => complete(self.split_by_chords(corners, edge_exists)?),
        })
    }

    /// Splits a long loop by short chords into pieces, and triangulates these by least weight.
    fn split_by_chords(
        &self,
        corners: &HoleCorners<'_>,
        edge_exists: impl Fn(usize, usize) -> bool,
    ) -> Result<Option<Vec<[usize; 3]>>, Cancelled> {
        let n = corners.points.len();
        let longest = MAX_PIECE_CORNERS[usize::from(n > 1000)];
        let mut triangles = Vec::with_capacity(n - 2);
        let mut pieces: Vec<Vec<usize>> = vec![(0..n).collect()];
        while let Some(piece) = pieces.pop() {
            self.context.check()?;
            let m = piece.len();
            let points: Vec<DVec3> = piece.iter().map(|&i| corners.points[i]).collect();
            let forbidden = |i: usize, j: usize| edge_exists(piece[i], piece[j]);
            if m <= longest {
                let at = |i: usize| corners.vertices[piece[i % m]];
                let sides: Vec<DVec3> = (0..m).map(|i| self.face_normal(at(i), at(i + 1))).collect();
                let should_continue = || self.context.check().is_ok();
                let Some(triangulation) = least_weight(&points, &sides, Criterion::Fold, forbidden, should_continue)
                else {
                    return Ok(None);
                };
                triangles.extend(triangulation.into_iter().map(|t| t.map(|i| piece[i])));
            } else {
                let Some((i, j)) = shortest_cut(&points, forbidden) else { return Ok(None) };
                pieces.push(piece[i..=j].to_vec());
                pieces.push(piece[j..].iter().chain(&piece[..=i]).copied().collect());
            }
        }
        Ok(Some(triangles))
    }

    /// Replaces the candidate by the refined, and if requested smoothed, patch where that has no fault.
    fn refine(&mut self, corners: &HoleCorners<'_>, triangles: Vec<[usize; 3]>, candidate: &mut PatchCandidate) {
        let vertices = &corners.vertices;
        let points: Vec<DVec3> = vertices.iter().map(|&v| self.positions[v as usize]).collect();
        let no_neighbours = Vec::new();
        let neighbours = |v: &u32| self.neighbours.get(v).unwrap_or(&no_neighbours);
        let scale: Vec<f64> = vertices
            .iter()
            .zip(&points)
            .map(|(v, p)| {
                let lengths = neighbours(v).iter().map(|&w| p.distance(self.positions[w as usize]));
                lengths.sum::<f64>() / neighbours(v).len().max(1) as f64
            })
            .collect();
        let edge_exists = |i: usize, j: usize| self.edges.find(vertices[i], vertices[j]).is_some();
        let round = |p: DVec3| self.params.precision.round(p);
        let mut refined = Patch { fixed: points.len(), points, triangles };
        refined.refine(&scale, edge_exists, round);
        let mut candidates = vec![refined];
        if self.params.fair {
            let mut border: Vec<u32> = vertices.clone();
            border.sort_unstable();
            let outside = |w: &&u32| border.binary_search(w).is_err();
            let position = |w: &u32| self.positions[*w as usize];
            let beyond: Vec<Vec<DVec3>> =
                vertices.iter().map(|v| neighbours(v).iter().filter(outside).map(position).collect()).collect();
            let mut faired = candidates[0].clone();
            faired.fair(&beyond);
            for p in &mut faired.points[vertices.len()..] {
                *p = round(*p);
            }
            candidates.push(faired);
        }
        while let Some(patch) = candidates.pop() {
            let (first, fixed) = (self.positions.len(), patch.fixed);
            let Ok(numbers) =
                (first..first + patch.points.len() - fixed).map(u32::try_from).collect::<Result<Vec<_>, _>>()
            else {
                return;
            };
            if !patch.points.iter().all(|p| p.is_finite()) {
                continue;
            }
            self.clearance.add_vertices(&patch.points[fixed..]);
            let number = |i: usize| if i < fixed { vertices[i] } else { numbers[i - fixed] };
            let faces: Vec<[u32; 3]> = patch.triangles.iter().map(|t| t.map(number)).collect();
            if self.clearance.faults(&faces, false, 0).is_some_and(Faults::is_empty) {
                self.positions.extend(&patch.points[fixed..]);
                candidate.faces = faces;
                return;
            }
            self.clearance.drop_vertices(first);
        }
    }

    /// The unit normal of the face at a boundary edge, or zero.
    fn face_normal(&self, a: u32, b: u32) -> DVec3 {
        face_normal(self.clearance.unit(), self.faces, self.edges, a, b)
    }
}

impl HoleCorners<'_> {
    /// Whether two corners are adjacent on a loop.
    fn is_side(&self, i: usize, j: usize) -> bool {
        let (low, high) = (i.min(j), i.max(j));
        let end = self.ends[self.ends.partition_point(|&end| end <= low)];
        let length = self.hole.loops[self.ends.partition_point(|&end| end <= low)].len();
        high == low + 1 && high < end || (high + 1 == end && low + length == end)
    }
}

/// The unit normal of the first face at an edge; zero where there is no such edge or the face has no area.
pub(super) fn face_normal(positions: &[DVec3], faces: &[[u32; 3]], edges: &Edges, a: u32, b: u32) -> DVec3 {
    let Some(edge) = edges.find(a, b) else { return DVec3::ZERO };
    let [p, q, r] = faces[edges.half_edges(edge)[0] as usize / 3].map(|v| positions[v as usize]);
    (q - p).cross(r - p).normalize_or_zero()
}

/// Whether the points are exactly coplanar.
fn coplanar(points: &[DVec3]) -> bool {
    let first = points[0];
    if (0..3).any(|k| points.iter().all(|p| p[k] == first[k])) {
        return true;
    }
    let far = |i: &&DVec3, j: &&DVec3| first.distance_squared(**i).total_cmp(&first.distance_squared(**j));
    let Some(&second) = points.iter().max_by(far) else { return true };
    let Some(&third) = points.iter().find(|&&p| !collinear(first, second, p)) else { return true };
    points.iter().all(|&p| orient3d(first, second, third, p) == Sign::Zero)
}

/// For each boundary vertex its neighbours.
fn boundary_neighbours(edges: &Edges) -> HashMap<u32, Vec<u32>> {
    let mut neighbours: HashMap<u32, Vec<u32>> = HashMap::new();
    for e in (0..edges.len()).filter(|&e| edges.half_edges(e).len() == 1) {
        for v in edges.vertices(e) {
            neighbours.entry(v).or_default();
        }
    }
    for [a, b] in (0..edges.len()).map(|e| edges.vertices(e)) {
        for (v, w) in [(a, b), (b, a)] {
            if let Some(list) = neighbours.get_mut(&v) {
                list.push(w);
            }
        }
    }
    neighbours
}
