//! Candidates for a patch, and which of them is taken.

use std::collections::{HashMap, HashSet};

use glam::DVec3;

use super::group::{Hole, newell};
use super::patch::{Clearance, Faults, Patch};
use super::triangulate::{Weigh, least_weight, planar, sharp, shortest_cut};
use crate::math::{Precision, Sign, collinear, orient3d};
use crate::mesh::Edges;
use crate::repair::operators::names::HoleFilling;
use crate::repair::{Cancelled, Context};

/// Longest loop for the cubic triangulation: about 0.03 s.
const MOST_FOR_LEAST_WEIGHT: usize = 128;
/// Longest piece that a longer loop is cut to, and that of one over a thousand edges.
const PIECES: [usize; 2] = [MOST_FOR_LEAST_WEIGHT, 32];
/// Cubic steps that all loops together may take: about two seconds. Loops this short count none.
const CUBIC_STEPS: u64 = 20_000_000;
const SHORT: usize = 16;
/// Steps that growth from sharp corners may take for one hole where it is one way of several.
const SHARP_STEPS: u64 = 2_000_000;

/// How far behind the middle of its hole the corner of a cone stands, in edges around it.
const CONE: f64 = 0.05;

/// Which holes are closed, and how.
#[derive(Debug, Clone, Copy)]
pub struct FillHoles {
    /// Most edges around a hole, those around islands in it counted; a million by default.
    pub max_edges: u32,
    /// Largest extent of a hole, as a share of the model's diagonal; 1, which is any, by default.
    pub max_size: f64,
    /// Most holes; of more the smallest are closed. A million by default.
    pub max_holes: u32,
    /// How patches are chosen.
    pub filling: HoleFilling,
    /// Whether patches that are not plane get inner vertices, as close as those around.
    pub refine: bool,
    /// Whether patches are refined and go on smoothly from the surface.
    pub fair: bool,
    /// Whether new positions are rounded to f32.
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

/// A way to triangulate a hole.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Way {
    LeastFold,
    Planar,
    LeastArea,
    Sharp,
    Chords,
}

/// Triangles by corner, and how many corners are left open.
type Triangulated = (Vec<[usize; 3]>, usize);

/// A patch for a hole: its faces, and what is known of it.
pub(super) struct Chosen {
    pub faces: Vec<[u32; 3]>,
    /// None where it was not looked at, since the steps were spent.
    pub faults: Option<Faults>,
    /// Edges of the hole that are left where a patch could not grow on.
    pub open: usize,
}

/// Finds patches one after another, each against the surface and the patches before it.
pub(super) struct Filler<'a> {
    pub params: &'a FillHoles,
    /// The surface's, and those that patches added.
    pub positions: Vec<DVec3>,
    pub faces: &'a [[u32; 3]],
    pub edges: &'a Edges,
    pub clearance: Clearance<'a>,
    /// Edges that patches added, the smaller vertex first.
    pub new_edges: HashSet<(u32, u32)>,
    /// For each boundary vertex its neighbours on the surface, where patches are refined.
    pub around: HashMap<u32, Vec<u32>>,
    pub context: &'a Context<'a>,
    cubic_steps: u64,
}

/// A hole as the triangulations see it.
struct Corners<'h> {
    vertices: Vec<u32>,
    points: Vec<DVec3>,
    ends: Vec<usize>,
    normal: DVec3,
    hole: &'h Hole,
}

impl<'a> Filler<'a> {
    pub fn new(
        params: &'a FillHoles,
        positions: Vec<DVec3>,
        faces: &'a [[u32; 3]],
        edges: &'a Edges,
        context: &'a Context<'a>,
    ) -> Self {
        let clearance = Clearance::new(&positions, faces);
        let around = if params.refine || params.fair { boundary_neighbours(edges) } else { HashMap::new() };
        let new_edges = HashSet::new();
        Self { params, positions, faces, edges, clearance, new_edges, around, context, cubic_steps: CUBIC_STEPS }
    }

    /// The first candidate without a fault, the prettier first, or that with the fewest. None where there is none.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn choose(&mut self, hole: &Hole) -> Result<Option<Chosen>, Cancelled> {
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
        let corners = Corners { vertices, points, ends, normal, hole };
        let flat = corners.points.len() > 3 && coplanar(&corners.points);
        let mut best: Option<(Chosen, Vec<[usize; 3]>)> = None;
        for &way in self.ways(&corners, flat) {
            self.context.check()?;
            let Some((triangles, open)) = self.triangulate(way, &corners)? else { continue };
            let faces: Vec<[u32; 3]> = triangles.iter().map(|t| t.map(|i| corners.vertices[i])).collect();
            let fewest = best.as_ref().and_then(|(b, _)| b.faults).map(|f| f.crossings + f.flat);
            let faults = self.clearance.faults(&faces, way == Way::Planar, fewest.unwrap_or(u64::MAX));
            let better = match (faults, fewest) {
                (Some(faults), Some(fewest)) => faults.crossings + faults.flat < fewest,
                (_, fewest) => fewest.is_none() && best.is_none(),
            };
            if better {
                best = Some((Chosen { faces, faults, open }, triangles));
            }
            if self.params.filling != HoleFilling::Auto || faults.is_none_or(Faults::none) {
                break;
            }
        }
        let Some((mut chosen, triangles)) = best else {
            let single = hole.loops.len() == 1 && self.params.filling == HoleFilling::Auto;
            return Ok(if single { self.cone(&corners) } else { None });
        };
        let sound = chosen.open == 0 && chosen.faults.is_some_and(Faults::none);
        if (self.params.refine || self.params.fair) && !flat && sound && corners.points.len() > 3 {
            self.refine(&corners, triangles, &mut chosen);
        }
        Ok(Some(chosen))
    }

    /// A patch of which every face has the same new corner, for a hole all of whose triangulations need an edge that is there
    /// already. The corner stands behind the middle of the hole, since before it the surface may be that of the edge.
    ///
    /// ```text
    ///    ____           ____
    ///   |    |         |\  /|
    ///   |    |   ->    | \/ |
    ///   |____|         |_/\_|
    /// ```
    fn cone(&mut self, corners: &Corners<'_>) -> Option<Chosen> {
        let points: Vec<DVec3> = corners.vertices.iter().map(|&v| self.positions[v as usize]).collect();
        let n = points.len();
        let middle = points.iter().sum::<DVec3>() / n as f64;
        let length = (0..n).map(|i| points[i].distance(points[(i + 1) % n])).sum::<f64>() / n as f64;
        let apex = self.params.precision.round(middle - corners.normal.normalize_or_zero() * (CONE * length));
        let new = u32::try_from(self.positions.len()).ok().filter(|_| apex.is_finite())?;
        let faces: Vec<[u32; 3]> = (0..n).map(|i| [corners.vertices[i], corners.vertices[(i + 1) % n], new]).collect();
        self.positions.push(apex);
        self.clearance.add_vertices(&[apex]);
        let faults = self.clearance.faults(&faces, false, u64::MAX);
        Some(Chosen { faces, faults, open: 0 })
    }

    /// The ways that are tried, in order.
    fn ways(&mut self, corners: &Corners<'_>, flat: bool) -> &'static [Way] {
        use Way::{Chords, LeastArea, LeastFold, Planar, Sharp};
        let n = corners.points.len();
        if corners.ends.len() > 1 {
            return &[Planar];
        }
        if n == 3 {
            return if is_a_face(self.faces, self.edges, &corners.vertices) { &[] } else { &[LeastFold] };
        }
        let cubic = (n * n * n / 6) as u64;
        let short = n <= MOST_FOR_LEAST_WEIGHT && (n <= SHORT || self.cubic_steps >= cubic);
        match self.params.filling {
            HoleFilling::Sharp => &[Sharp],
            HoleFilling::Planar if short => &[Planar, LeastArea],
            HoleFilling::Planar => &[Planar, Chords],
            HoleFilling::Smooth if short => &[LeastFold],
            HoleFilling::Smooth => &[Chords],
            HoleFilling::Auto if short && flat => &[Planar, LeastFold, LeastArea, Sharp],
            HoleFilling::Auto if short => &[LeastFold, Planar, LeastArea, Sharp],
            HoleFilling::Auto => &[Planar, Sharp, Chords],
        }
    }

    /// Triangles by corner, and how many corners are left open. None where there are none of this kind.
    fn triangulate(&mut self, way: Way, corners: &Corners<'_>) -> Result<Option<Triangulated>, Cancelled> {
        let Corners { vertices, points, ends, normal, .. } = corners;
        let n = points.len();
        if n == 3 {
            return Ok(Some((vec![[0, 1, 2]], 0)));
        }
        let (edges, new_edges, context) = (self.edges, &self.new_edges, self.context);
        let taken = |i: usize, j: usize| {
            let (a, b) = (vertices[i], vertices[j]);
            edges.find(a, b).is_some() || new_edges.contains(&(a.min(b), a.max(b)))
        };
        let all = |triangles: Option<Vec<[usize; 3]>>| triangles.map(|t| (t, 0));
        Ok(match way {
            Way::LeastFold | Way::LeastArea => {
                self.cubic_steps = self.cubic_steps.saturating_sub(if n > SHORT { (n * n * n / 6) as u64 } else { 0 });
                let weigh = if way == Way::LeastFold { Weigh::Fold } else { Weigh::Area };
                let sides: Vec<DVec3> = (0..n).map(|i| self.face_normal(vertices[i], vertices[(i + 1) % n])).collect();
                let found = least_weight(points, &sides, weigh, taken, || context.check().is_ok());
                context.check()?;
                all(found)
            }
            Way::Planar => all(planar(points, ends, *normal).filter(|triangles| {
                let is_side = |i: usize, j: usize| corners.is_side(i, j);
                let free = |i: usize, j: usize| is_side(i, j) || !taken(i, j);
                triangles.iter().all(|&[a, b, c]| free(a, b) && free(b, c) && free(c, a))
            })),
            Way::Sharp => {
                let clearance = &mut self.clearance;
                let start = clearance.patches().len();
                let enough = match self.params.filling {
                    HoleFilling::Sharp => 0,
                    _ => clearance.steps().saturating_sub(SHARP_STEPS),
                };
                let mut asked = 0u32;
                let grown = sharp(points, *normal, |t, last| {
                    asked += 1;
                    if clearance.steps() <= enough || (asked.is_multiple_of(256) && context.check().is_err()) {
                        return false;
                    }
                    let face = t.map(|i| vertices[i]);
                    let free = last || !taken(t[0], t[2]);
                    let may = free && clearance.faults(&[face], true, 0).is_some_and(Faults::none);
                    if may {
                        clearance.put(&[face]);
                    }
                    may
                });
                clearance.take_out(start);
                context.check()?;
                let partly = self.params.filling == HoleFilling::Sharp && grown.open < n;
                (grown.open == 0 || partly).then_some((grown.triangles, grown.open))
            }
            Way::Chords => all(self.by_chords(corners, taken)?),
        })
    }

    /// Cuts a long loop by short chords to pieces that are triangulated by least weight.
    fn by_chords(
        &self,
        corners: &Corners<'_>,
        taken: impl Fn(usize, usize) -> bool,
    ) -> Result<Option<Vec<[usize; 3]>>, Cancelled> {
        let n = corners.points.len();
        let longest = PIECES[usize::from(n > 1000)];
        let mut triangles = Vec::with_capacity(n - 2);
        let mut pieces: Vec<Vec<usize>> = vec![(0..n).collect()];
        while let Some(piece) = pieces.pop() {
            self.context.check()?;
            let m = piece.len();
            let points: Vec<DVec3> = piece.iter().map(|&i| corners.points[i]).collect();
            let forbidden = |i: usize, j: usize| taken(piece[i], piece[j]);
            if m <= longest {
                let at = |i: usize| corners.vertices[piece[i % m]];
                let sides: Vec<DVec3> = (0..m).map(|i| self.face_normal(at(i), at(i + 1))).collect();
                let go_on = || self.context.check().is_ok();
                let Some(found) = least_weight(&points, &sides, Weigh::Fold, forbidden, go_on) else {
                    return Ok(None);
                };
                triangles.extend(found.into_iter().map(|t| t.map(|i| piece[i])));
            } else {
                let Some((i, j)) = shortest_cut(&points, forbidden) else { return Ok(None) };
                pieces.push(piece[i..=j].to_vec());
                pieces.push(piece[j..].iter().chain(&piece[..=i]).copied().collect());
            }
        }
        Ok(Some(triangles))
    }

    /// Takes the patch refined, and faired, where that has no fault.
    fn refine(&mut self, corners: &Corners<'_>, triangles: Vec<[usize; 3]>, chosen: &mut Chosen) {
        let vertices = &corners.vertices;
        let points: Vec<DVec3> = vertices.iter().map(|&v| self.positions[v as usize]).collect();
        let none = Vec::new();
        let around = |v: &u32| self.around.get(v).unwrap_or(&none);
        let scale: Vec<f64> = vertices
            .iter()
            .zip(&points)
            .map(|(v, p)| {
                let lengths = around(v).iter().map(|&w| p.distance(self.positions[w as usize]));
                lengths.sum::<f64>() / around(v).len().max(1) as f64
            })
            .collect();
        let taken = |i: usize, j: usize| self.edges.find(vertices[i], vertices[j]).is_some();
        let round = |p: DVec3| self.params.precision.round(p);
        let mut refined = Patch { fixed: points.len(), points, triangles };
        refined.refine(&scale, taken, round);
        let mut candidates = vec![refined];
        if self.params.fair {
            let mut border: Vec<u32> = vertices.clone();
            border.sort_unstable();
            let outside = |w: &&u32| border.binary_search(w).is_err();
            let place = |w: &u32| self.positions[*w as usize];
            let beyond: Vec<Vec<DVec3>> =
                vertices.iter().map(|v| around(v).iter().filter(outside).map(place).collect()).collect();
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
            if self.clearance.faults(&faces, false, 0).is_some_and(Faults::none) {
                self.positions.extend(&patch.points[fixed..]);
                chosen.faces = faces;
                return;
            }
            self.clearance.drop_vertices(first);
        }
    }

    /// The unit normal of the face at a border's edge, or zero.
    fn face_normal(&self, a: u32, b: u32) -> DVec3 {
        face_normal(self.clearance.unit(), self.faces, self.edges, a, b)
    }
}

impl Corners<'_> {
    /// Whether two corners follow one another on a loop.
    fn is_side(&self, i: usize, j: usize) -> bool {
        let (low, high) = (i.min(j), i.max(j));
        let end = self.ends[self.ends.partition_point(|&end| end <= low)];
        let length = self.hole.loops[self.ends.partition_point(|&end| end <= low)].len();
        high == low + 1 && high < end || (high + 1 == end && low + length == end)
    }
}

/// The unit normal of the first face at an edge, or zero.
pub(super) fn face_normal(positions: &[DVec3], faces: &[[u32; 3]], edges: &Edges, a: u32, b: u32) -> DVec3 {
    let Some(edge) = edges.find(a, b) else { return DVec3::ZERO };
    let [p, q, r] = faces[edges.half_edges(edge)[0] as usize / 3].map(|v| positions[v as usize]);
    (q - p).cross(r - p).normalize_or_zero()
}

/// Whether the loop is the border of a single face, whose patch would be the face's own back.
fn is_a_face(faces: &[[u32; 3]], edges: &Edges, vertices: &[u32]) -> bool {
    let &[a, b, c] = vertices else { return false };
    edges.find(a, b).is_some_and(|e| edges.half_edges(e).iter().any(|&h| faces[h as usize / 3].contains(&c)))
}

/// Whether points lie in one plane, exactly.
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

/// For each vertex on the boundary the vertices that it shares an edge with.
fn boundary_neighbours(edges: &Edges) -> HashMap<u32, Vec<u32>> {
    let mut around: HashMap<u32, Vec<u32>> = HashMap::new();
    for e in (0..edges.len()).filter(|&e| edges.half_edges(e).len() == 1) {
        for v in edges.vertices(e) {
            around.entry(v).or_default();
        }
    }
    for [a, b] in (0..edges.len()).map(|e| edges.vertices(e)) {
        for (v, w) in [(a, b), (b, a)] {
            if let Some(list) = around.get_mut(&v) {
                list.push(w);
            }
        }
    }
    around
}
