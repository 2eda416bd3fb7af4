//! Splits non-orientable parts along edges, so that each part has a front and a back.

use glam::DVec3;

use super::free_positions::{FreePositions, keeps_orientation};
use super::operator::{Applied, Counter, Operation, Scope};
use super::orient::{consistent_winding, flip_faces};
use crate::inspect::doubled_areas;
use crate::math::Precision;
use crate::mesh::{Edges, HalfEdge, Surface, UnionFind};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

const NONE: u32 = u32::MAX;

/// Splits non-orientable patches, such as a Möbius band, along the edges where the winding of the two faces conflicts.
///
/// ```text
///    a->-+->-a           a->-+->-a'
///    |   |   |           |   |   |       the ends were joined with a twist: a to b', b to a'
///    b-<-+-<-b    ->     b-<-+-<-b'
/// ```
///
/// The split edges are chosen as by [`super::orient`]: few, and along sharp folds where there is a choice. Vertices on the
/// split are copied for each fan of faces beside it. The copies of the smaller fans move into their faces by the smallest
/// distance that f32 can represent, since a reader of STL would merge them again.
///
/// Precondition: none; faces with inconsistent winding are flipped first. Result: the split is a boundary, and no edge with
/// two faces has a winding conflict. Leaves: conflicts that end at non-manifold edges, which must be split before, counted as
/// `orientation_conflicts_left`; copies that cannot move without flipping a face or exceeding `max_deviation`, counted as
/// `coincident_vertices_left`.
///
/// After Guéziec et al. 2001, "Cutting and Stitching: Converting Sets of Polygons to Manifold Surfaces".
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutNonOrientable {
    /// How far a copy may move, in the model's unit. Default: infinite.
    pub max_deviation: f64,
    /// The precision to which positions are rounded. Default: f32.
    pub precision: Precision,
}

impl Default for CutNonOrientable {
    fn default() -> Self {
        Self { max_deviation: f64::INFINITY, precision: Precision::F32 }
    }
}

impl CutNonOrientable {
    /// Runs the operator on `surface`.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface may then be half changed.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let edges = Edges::new(&surface.faces);
        if !edges.iter().any(|h| in_conflict(&surface.faces, h)) {
            return Ok(Applied::default());
        }
        let winding = consistent_winding(surface, &edges, &doubled_areas(surface), context)?;
        flip_faces(surface, &winding.flip);
        let edges = Edges::new(&surface.faces);
        let copies = cut(surface, &edges);
        let (mut moved, mut coincident) = (0.0f64, 0u64);
        if !copies.is_empty() {
            let mut fans = CopyFans::new(surface, &copies, self.precision);
            for &v in &copies {
                match fans.move_apart(surface, v, self) {
                    Some(distance) => moved = moved.max(distance),
                    None => coincident += 1,
                }
            }
        }
        let after = Edges::new(&surface.faces);
        let left = after.iter().filter(|h| in_conflict(&surface.faces, h)).count() as u64;
        let changes = Change::list([
            (ChangeKind::NonOrientablePartsCut, if copies.is_empty() { 0 } else { winding.non_orientable }),
            (ChangeKind::EdgesCut, winding.conflicts.saturating_sub(left)),
            (ChangeKind::VerticesDuplicated, copies.len() as u64),
            (ChangeKind::CoincidentVerticesLeft, coincident),
            (ChangeKind::OrientationConflictsLeft, left),
        ]);
        let reason =
            || format!("{left} edges between faces of opposite winding were not split: they end at non-manifold edges");
        Ok(Applied { changes, moved, left: (left > 0).then(reason), ..Applied::default() })
    }
}

fn in_conflict(faces: &[[u32; 3]], half_edges: &[u32]) -> bool {
    matches!(*half_edges, [x, y] if Edges::is_forward(faces, x) == Edges::is_forward(faces, y))
}

/// For each vertex whether it lies on a split, and the face corners beside splits. A chain of conflicting edges that meets a
/// non-manifold edge is skipped, since a split there would separate no faces.
fn cut_corners(surface: &Surface, edges: &Edges) -> (Vec<bool>, Vec<u32>) {
    let faces = &surface.faces;
    let mut chains = UnionFind::new(surface.positions.len());
    for (e, _) in edges.iter().enumerate().filter(|(_, h)| in_conflict(faces, h)) {
        let [a, b] = edges.vertices(e);
        chains.unite(a, b);
    }
    let chains = chains.into_roots();
    let mut is_blocked = vec![false; chains.len()];
    for (e, _) in edges.iter().enumerate().filter(|(_, h)| h.len() > 2) {
        for v in edges.vertices(e) {
            is_blocked[chains[v as usize] as usize] = true;
        }
    }
    let (mut on_cut, mut beside) = (vec![false; surface.positions.len()], Vec::new());
    for (e, half_edges) in edges.iter().enumerate().filter(|(_, h)| in_conflict(faces, h)) {
        let ends = edges.vertices(e);
        if is_blocked[chains[ends[0] as usize] as usize] {
            continue;
        }
        for v in ends {
            on_cut[v as usize] = true;
            beside.extend(half_edges.iter().map(|&h| corner_of(faces, HalfEdge(h), v)));
        }
    }
    (on_cut, beside)
}

/// The corner at vertex `v` of the face with a half-edge. It has the number of the half-edge that starts there.
fn corner_of(faces: &[[u32; 3]], half_edge: HalfEdge, v: u32) -> u32 {
    if half_edge.ends(faces)[0] == v { half_edge.0 } else { half_edge.next().0 }
}

/// Copies the vertices along conflicting edges, once for each adjacent fan but the one with the most faces. Fans that do not
/// touch a conflicting edge stay with the largest fan. Returns the copies.
fn cut(surface: &mut Surface, edges: &Edges) -> Vec<u32> {
    let faces = &surface.faces;
    let (on_cut, beside) = cut_corners(surface, edges);
    let mut sets = UnionFind::new(faces.len() * 3);
    for (e, half_edges) in edges.iter().enumerate().filter(|(_, h)| !in_conflict(faces, h)) {
        for v in edges.vertices(e).into_iter().filter(|&v| on_cut[v as usize]) {
            for pair in half_edges.windows(2) {
                sets.unite(corner_of(faces, HalfEdge(pair[0]), v), corner_of(faces, HalfEdge(pair[1]), v));
            }
        }
    }
    let roots = sets.into_roots();
    let mut touches = vec![false; roots.len()];
    for corner in beside {
        touches[roots[corner as usize] as usize] = true;
    }
    // The fans along the split: vertex, number of faces, root.
    let mut corners: Vec<(u32, u32)> = Vec::new();
    for (face, corner) in faces.iter().zip((0usize..).step_by(3)) {
        for (i, &v) in face.iter().enumerate() {
            if on_cut[v as usize] && touches[roots[corner + i] as usize] {
                corners.push((v, roots[corner + i]));
            }
        }
    }
    corners.sort_unstable();
    let mut fans: Vec<(u32, std::cmp::Reverse<usize>, u32)> =
        corners.chunk_by(|x, y| x == y).map(|c| (c[0].0, std::cmp::Reverse(c.len()), c[0].1)).collect();
    fans.sort_unstable();
    let mut copy_of = vec![NONE; roots.len()];
    let mut copies = Vec::new();
    for of_vertex in fans.chunk_by(|x, y| x.0 == y.0) {
        for &(v, _, root) in &of_vertex[1..] {
            #[expect(clippy::cast_possible_truncation, reason = "no more vertices than corners")]
            let copy = surface.positions.len() as u32;
            surface.positions.push(surface.positions[v as usize]);
            copy_of[root as usize] = copy;
            copies.push(copy);
        }
    }
    for (face, corner) in surface.faces.iter_mut().zip((0usize..).step_by(3)) {
        for (i, v) in face.iter_mut().enumerate() {
            let copy = copy_of[roots[corner + i] as usize];
            if copy != NONE {
                *v = copy;
            }
        }
    }
    copies
}

/// The fans of faces at the copied vertices, and the positions in use.
struct CopyFans {
    /// The copies and their faces, sorted.
    corners: Vec<(u32, u32)>,
    free_positions: FreePositions,
}

impl CopyFans {
    fn new(surface: &Surface, copies: &[u32], precision: Precision) -> Self {
        let first = copies[0];
        let mut corners: Vec<(u32, u32)> = Vec::new();
        for (face, f) in surface.faces.iter().zip(0u32..) {
            corners.extend(face.iter().filter(|&&v| v >= first).map(|&v| (v, f)));
        }
        corners.sort_unstable();
        Self { corners, free_positions: FreePositions::new(surface, precision) }
    }

    /// Moves a copy into its faces by the smallest step that f32 can represent. Returns the distance, or `None` if no position fits.
    fn move_apart(&mut self, surface: &mut Surface, v: u32, limits: &CutNonOrientable) -> Option<f64> {
        let begin = self.corners.partition_point(|&(w, _)| w < v);
        let end = self.corners.partition_point(|&(w, _)| w <= v);
        let fan = &self.corners[begin..end];
        let p = surface.positions[v as usize];
        let others = |f: u32| surface.faces[f as usize].into_iter().filter(move |&w| w != v);
        let inward: DVec3 = fan
            .iter()
            .flat_map(|&(_, f)| others(f))
            .map(|w| (surface.positions[w as usize] - p).normalize_or_zero())
            .sum();
        let fits = |q: DVec3| keeps_orientation(surface, fan.iter().map(|&(_, f)| f), v, q);
        let directions = [inward.try_normalize()].into_iter().flatten().chain([
            DVec3::X,
            DVec3::NEG_X,
            DVec3::Y,
            DVec3::NEG_Y,
            DVec3::Z,
            DVec3::NEG_Z,
        ]);
        for direction in directions {
            if let Some(q) = self.free_positions.find(surface, (p, direction), limits.max_deviation, fits) {
                surface.positions[v as usize] = q;
                return Some(p.distance(q));
            }
        }
        None
    }
}

impl Operation<'_> for CutNonOrientable {
    const FIXES: &'static [Counter] = &[Counter::MisorientedEdges];
    const MAY_RAISE: &'static [Counter] = &[Counter::BoundaryEdges];
    const ACTS_ON: &'static [Counter] = &[Counter::MisorientedEdges, Counter::NonManifoldEdges];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { max_deviation: scope.max_deviation, precision: scope.format.precision() }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
