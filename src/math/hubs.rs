//! Vertices of very many triangles. All boxes of such triangles meet at the vertex, so that a search for pairs by boxes
//! alone would test each triangle against all others; the directions in which they leave the vertex tell them apart.

use glam::DVec3;

use super::boxes::Box3;
use super::tree::Tree;

/// The least number of triangles of a hub. Below it, testing all pairs is faster.
const LEAST_TRIANGLES: u32 = 128;

/// Fills the list of a triangle's hubs.
const NO_HUB: u32 = u32::MAX;

/// Widens the box of a triangle's directions: far more than the rounding of directions of length 1.
const MARGIN: f64 = 1e-12;

/// The hubs among the corners of a triangle, or those that all triangles of a set have in common: ascending, filled with
/// [`NO_HUB`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct HubSet([u32; 3]);

impl HubSet {
    pub const EMPTY: Self = Self([NO_HUB; 3]);

    /// The hubs that are in both sets.
    pub fn common(self, other: Self) -> Self {
        let mut common = self.0.map(|hub| if other.0.contains(&hub) { hub } else { NO_HUB });
        common.sort_unstable();
        Self(common)
    }

    /// Whether both sets have a hub in common.
    #[inline]
    pub fn meets(self, other: Self) -> bool {
        self.0[0] != NO_HUB && other.0[0] != NO_HUB && self.common(other).0[0] != NO_HUB
    }
}

/// The vertices of very many triangles, each with its triangles.
pub struct Hubs {
    /// For each triangle, the hubs among its corners.
    pub(super) of_triangle: Vec<HubSet>,
    pub(super) list: Vec<Hub>,
}

/// A vertex of very many triangles.
pub(super) struct Hub {
    vertex: u32,
    /// Its triangles, ascending.
    pub triangles: Vec<u32>,
    /// A tree over the directions in which the triangles leave the vertex, numbered as in `triangles`.
    pub directions: Tree,
}

impl Hubs {
    /// Finds the vertices of at least 128 triangles; `None` if there are none. Positions must be in the range of
    /// [`super::to_unit_range`].
    ///
    /// # Panics
    /// If an index is out of range.
    #[must_use]
    pub fn find(positions: &[DVec3], faces: &[[u32; 3]]) -> Option<Self> {
        let mut counts = vec![0u32; positions.len()];
        faces.iter().flatten().for_each(|&v| counts[v as usize] += 1);
        if counts.iter().all(|&count| count < LEAST_TRIANGLES) {
            return None;
        }
        let is_hub = |v: u32| counts[v as usize] >= LEAST_TRIANGLES;
        let mut corners: Vec<(u32, u32)> = Vec::new();
        for (triangle, face) in (0u32..).zip(faces) {
            corners.extend(face.iter().filter(|&&v| is_hub(v)).map(|&v| (v, triangle)));
        }
        corners.sort_unstable();
        corners.dedup();
        let set_of = |face: &[u32; 3]| {
            let mut hubs = face.map(|v| if is_hub(v) { v } else { NO_HUB });
            hubs.sort_unstable();
            HubSet(hubs)
        };
        let list = corners
            .chunk_by(|a, b| a.0 == b.0)
            .map(|group| {
                let triangles: Vec<u32> = group.iter().map(|(_, triangle)| *triangle).collect();
                let vertex = group[0].0;
                Hub { vertex, directions: directions(positions, faces, vertex, &triangles), triangles }
            })
            .collect();
        Some(Self { of_triangle: faces.iter().map(set_of).collect(), list })
    }

    /// For each node of a tree over the triangles, the hubs that all triangles of its subtree have in common.
    pub(super) fn of_nodes(&self, tree: &Tree) -> Vec<HubSet> {
        let of_leaf = |triangles: &[u32]| {
            triangles.iter().map(|&t| self.of_triangle[t as usize]).reduce(HubSet::common).unwrap_or(HubSet::EMPTY)
        };
        tree.summaries(HubSet::EMPTY, |_, triangles| of_leaf(triangles), |_, [left, right]| left.common(right))
    }

    /// Whether a hub is the first one that two triangles have in common, so that each pair belongs to one hub.
    pub(super) fn is_first_common(&self, hub: &Hub, [f, g]: [u32; 2]) -> bool {
        self.of_triangle[f as usize].common(self.of_triangle[g as usize]).0[0] == hub.vertex
    }
}

/// The direction of a side; `None` if its square is so small that rounding would turn it.
fn direction(side: DVec3) -> Option<DVec3> {
    (side.length_squared() > 1e-280).then(|| side.normalize())
}

/// A tree over boxes of the unit directions in which triangles leave a common corner. Two triangles that have a point in
/// common besides that corner have a whole segment from it in common, so their boxes meet.
fn directions(positions: &[DVec3], faces: &[[u32; 3]], vertex: u32, triangles: &[u32]) -> Tree {
    let at = positions[vertex as usize];
    let bounds = |&triangle: &u32| {
        let face = faces[triangle as usize];
        let sides = face.map(|v| direction(positions[v as usize] - at));
        let corner = face.iter().position(|&v| v == vertex).unwrap_or(0);
        let (Some(a), Some(b)) = (sides[(corner + 1) % 3], sides[(corner + 2) % 3]) else {
            return Box3::of([DVec3::NEG_ONE, DVec3::ONE]);
        };
        // The arc between both lies beyond its chord by at most one less the cosine of half its angle.
        let bulge = 1.0 - ((a + b).length() / 2.0).min(1.0);
        Box3::of([a, b]).grown(bulge + MARGIN)
    };
    Tree::of_boxes(&triangles.iter().map(bounds).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use proptest::prelude::*;

    use super::*;
    use crate::math::{Contact, PairSearch, contact, ray_direction, to_unit_range};

    /// The pairs with more in common than a vertex or an edge, of all triangles or with a `changed` one, and whether the
    /// budget was enough.
    fn meeting_pairs(
        (positions, faces): (&[DVec3], &[[u32; 3]]),
        hubs: Option<&Hubs>,
        changed: Option<&[bool]>,
        budget: u64,
    ) -> (Vec<([u32; 2], Contact)>, bool) {
        let look = |f: u32, g: u32, _: &mut u64| {
            let found = contact(positions, faces[f as usize], faces[g as usize], &mut 0);
            (!found.is_apart()).then_some(found)
        };
        let (mut all, tree) = (Vec::new(), Tree::new(positions, faces));
        let search = PairSearch { look, budget, hubs };
        let take = |hits| {
            all.extend(hits);
            Ok(())
        };
        let Ok(complete) = match changed {
            None => search.within::<_, Infallible>(&tree, take),
            Some(changed) => search.within_changed(&tree, changed, take),
        };
        all.sort_unstable_by_key(|(pair, _)| *pair);
        (all, complete)
    }

    /// Triangles around some hubs at random directions, and a few elsewhere, without flat ones.
    fn fans(hubs: usize, sizes: &[(u32, u32, u32)]) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let mut positions: Vec<DVec3> = (0..hubs).map(|hub| DVec3::new(hub as f64 * 0.7, 0.1, 0.0)).collect();
        let mut faces = Vec::new();
        for (i, &(first, second, width)) in sizes.iter().enumerate() {
            let at = positions[i % hubs];
            let [a, b] = [first, second].map(|n| ray_direction(n % 97) * (1.0 + f64::from(n % 5) * 0.3));
            let n = positions.len() as u32;
            positions.extend([at + a, at + a + (b - a) * f64::from(width % 10 + 1) / 10.0]);
            if (b - a).length() > 0.1 && a.cross(b).length() > 0.1 {
                faces.push([(i % hubs) as u32, n, n + 1]);
                // A second triangle on the same edge, and one between two hubs.
                let other = ((i + 1) % hubs) as u32;
                faces.extend((i % 7 == 0 && hubs > 1).then_some([other, n, (i % hubs) as u32]));
            }
        }
        let unit = to_unit_range(&positions);
        faces.retain(|&[a, b, c]| {
            let [a, b, c] = [a, b, c].map(|v| unit[v as usize]);
            (b - a).cross(c - a).length() > 1e-3
        });
        (unit, faces)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn a_search_with_hubs_finds_the_same_pairs_as_one_without(
            hubs in 1usize..4,
            sizes in proptest::collection::vec((0u32..1000, 0u32..1000, 0u32..10), 400..900),
            changed in 1usize..30,
        ) {
            let (positions, faces) = fans(hubs, &sizes);
            let found = Hubs::find(&positions, &faces).expect("hubs");
            prop_assert_eq!(found.list.len(), hubs);
            let (with, _) = meeting_pairs((&positions, &faces), Some(&found), None, u64::MAX);
            let (without, _) = meeting_pairs((&positions, &faces), None, None, u64::MAX);
            prop_assert!(with.len() > 100);
            prop_assert_eq!(&with, &without);
            let marked: Vec<bool> = (0..faces.len()).map(|f| f % changed == 0).collect();
            let (of_marked, _) = meeting_pairs((&positions, &faces), Some(&found), Some(&marked), u64::MAX);
            let is_marked = |[f, g]: [u32; 2]| marked[f as usize] || marked[g as usize];
            let expected: Vec<_> = without.iter().filter(|(pair, _)| is_marked(*pair)).collect();
            prop_assert_eq!(of_marked.iter().collect::<Vec<_>>(), expected);
        }
    }

    #[test]
    fn a_fan_of_many_triangles_takes_few_steps() {
        let count = 50_000u32;
        let mut positions = vec![DVec3::ZERO];
        positions.extend((0..count).map(|i| {
            let angle = std::f64::consts::TAU * f64::from(i) / f64::from(count);
            DVec3::new(angle.cos(), angle.sin(), 0.3)
        }));
        let faces: Vec<[u32; 3]> = (0..count).map(|i| [0, 1 + i, 1 + (i + 1) % count]).collect();
        let positions = to_unit_range(&positions);
        let hubs = Hubs::find(&positions, &faces).expect("a hub");
        assert_eq!(meeting_pairs((&positions, &faces), Some(&hubs), None, 40 * u64::from(count)), (Vec::new(), true));
        assert!(!meeting_pairs((&positions, &faces), None, None, 40 * u64::from(count)).1);
    }

    #[test]
    fn a_mesh_without_vertices_of_many_triangles_has_no_hubs() {
        let positions = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        assert!(Hubs::find(&positions, &[[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]).is_none());
        assert!(Hubs::find(&[], &[]).is_none());
    }
}
