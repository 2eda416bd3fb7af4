//! Lids over openings that a few missing faces left, so that no ball passes them, however large the faces are.

use glam::DVec3;
use rustc_hash::{FxHashMap, FxHashSet};

use crate::context::{Cancelled, Context};
use crate::math::{Box3, Tree};
use crate::mesh::{Edges, UnionFind};
use crate::printing::reach::{Reach, ReachOptions};

/// The most boundary edges around an opening of a few missing faces.
const MAX_EDGES: usize = 8;
/// Largest extent of such an opening times the number of its edges, as a share of the model's diagonal. Larger ones may be
/// the mouth of a vessel with few faces.
const MAX_LENGTH: f64 = 0.8;
/// The most boundary edges at a vertex of a single missing triangle.
const MAX_BESIDE: usize = 32;

/// A surface as triangles by corner, and their tree.
pub type Triangles<'a> = (&'a [DVec3], &'a [[u32; 3]], &'a Tree);

/// The lids of a surface.
pub struct Lids {
    /// The largest extent of an opening with a lid, in the model's unit; 0 without lids.
    pub widest: f64,
    /// The surface with its lids, and the tree of both; none if there are no lids.
    covered: Option<(Vec<DVec3>, Vec<[u32; 3]>, Tree)>,
}

impl Lids {
    /// No lids.
    pub fn none() -> Self {
        Self { widest: 0.0, covered: None }
    }

    /// The lids of a welded surface, over a triangulation of it. Winding plays no part.
    pub fn new(welded: (&[DVec3], &[[u32; 3]]), (positions, faces): (&[DVec3], &[[u32; 3]])) -> Self {
        let (lids, widest) = lids(welded.0, welded.1);
        if lids.is_empty() {
            return Self::none();
        }
        let (mut positions, mut faces) = (positions.to_vec(), faces.to_vec());
        for (corners, first) in lids.into_iter().zip((0u32..).skip(positions.len()).step_by(3)) {
            positions.extend(corners);
            faces.push([first, first + 1, first + 2]);
        }
        let tree = Tree::new(&positions, &faces);
        Self { widest, covered: Some((positions, faces, tree)) }
    }

    /// The air that a ball from outside can reach, as [`Reach::new`] finds it, around the triangulation with its lids.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn reach(
        &self,
        uncovered: Triangles<'_>,
        options: ReachOptions,
        context: &Context<'_>,
    ) -> Result<Option<Reach>, Cancelled> {
        let (positions, faces, tree) =
            self.covered.as_ref().map_or(uncovered, |(positions, faces, tree)| (positions, faces, tree));
        Reach::new(positions, faces, tree, options, context)
    }
}

/// Triangles from the boundary edges around each opening of a few missing faces to the opening's centre, and the largest
/// extent of such an opening.
fn lids(positions: &[DVec3], faces: &[[u32; 3]]) -> (Vec<[DVec3; 3]>, f64) {
    let edges = Edges::new(faces);
    let is_open = |edge: &usize| edges.half_edges(*edge).len() == 1;
    let mut open: Vec<[u32; 2]> = (0..edges.len()).filter(is_open).map(|edge| edges.vertices(edge)).collect();
    let mut rims = missing_triangles(&mut open);
    rims.extend(connected(open));
    let longest = MAX_LENGTH * Box3::of_faces(positions, faces).diagonal();
    let (mut lids, mut widest) = (Vec::new(), 0.0f64);
    for rim in rims.into_iter().filter(|rim| rim.len() <= MAX_EDGES) {
        let ends: Vec<[DVec3; 2]> = rim.iter().map(|edge| edge.map(|v| positions[v as usize])).collect();
        let extent = Box3::of(ends.iter().flatten().copied()).diagonal();
        let centre = ends.iter().flatten().copied().sum::<DVec3>() / (2.0 * ends.len() as f64);
        if extent * ends.len() as f64 <= longest {
            widest = widest.max(extent);
            lids.extend(ends.into_iter().map(|[a, b]| [a, b, centre]));
        }
    }
    (lids, widest)
}

/// Takes the edges around single missing triangles out of the boundary edges, also where such openings touch.
fn missing_triangles(open: &mut Vec<[u32; 2]>) -> Vec<Vec<[u32; 2]>> {
    let mut beside: FxHashMap<u32, Vec<u32>> = FxHashMap::default();
    for &[a, b] in &*open {
        beside.entry(a).or_default().push(b);
        beside.entry(b).or_default().push(a);
    }
    let mut taken: FxHashSet<[u32; 2]> = FxHashSet::default();
    let mut triangles = Vec::new();
    beside.retain(|_, others| others.len() <= MAX_BESIDE);
    for &[a, b] in &*open {
        let (Some(of_a), Some(of_b)) = (beside.get(&a), beside.get(&b)) else { continue };
        let Some(&c) = of_a.iter().filter(|c| of_b.contains(c)).min() else { continue };
        let triangle = [[a, b], [b, c], [c, a]].map(|[a, b]| [a.min(b), a.max(b)]);
        if triangle.iter().all(|edge| !taken.contains(edge)) {
            taken.extend(triangle);
            triangles.push(triangle.to_vec());
        }
    }
    open.retain(|edge| !taken.contains(edge));
    triangles
}

/// Groups edges that share vertices.
fn connected(edges: Vec<[u32; 2]>) -> Vec<Vec<[u32; 2]>> {
    let mut vertices: Vec<u32> = edges.iter().flatten().copied().collect();
    vertices.sort_unstable();
    vertices.dedup();
    let place: FxHashMap<u32, u32> = vertices.iter().copied().zip(0..).collect();
    let mut sets = UnionFind::new(vertices.len());
    for [a, b] in &edges {
        sets.unite(place[a], place[b]);
    }
    let mut by_set: Vec<(u32, [u32; 2])> = edges.into_iter().map(|edge| (sets.root(place[&edge[0]]), edge)).collect();
    by_set.sort_unstable();
    by_set.chunk_by(|a, b| a.0 == b.0).map(|set| set.iter().map(|&(_, edge)| edge).collect()).collect()
}
