use glam::DVec3;

use super::Contact;
use super::plane::Plane;
use crate::math::{Sign, orient2d};

/// A coordinate plane on which a plane is projected without losing a dimension.
pub(super) struct Flat {
    axes: [usize; 2],
}

impl Flat {
    /// For the plane of a triangle whose corners are not on a line: exact, as its corners are not on a line in the
    /// projection either.
    pub fn of(plane: &Plane) -> Self {
        let normal = plane.normal.abs();
        let largest = (0..3).max_by(|&i, &j| normal[i].total_cmp(&normal[j])).unwrap_or(0);
        let [a, b, c] = plane.corners();
        let candidates = [0, 1, 2].map(|k| Self { axes: [(largest + k + 1) % 3, (largest + k + 2) % 3] });
        let [first, ..] = &candidates;
        let axes = candidates.iter().find(|f| f.turn(a, b, c) != Sign::Zero).unwrap_or(first).axes;
        Self { axes }
    }

    /// How three points turn in the projection.
    pub fn turn(&self, a: DVec3, b: DVec3, c: DVec3) -> Sign {
        let [i, j] = self.axes;
        orient2d([a[i], a[j]], [b[i], b[j]], [c[i], c[j]])
    }

    /// Two triangles of the plane with at most one vertex in common.
    ///
    /// Convex polygons have no inside in common where the line of an edge of one of them parts them, and no point
    /// where it does so strictly.
    pub fn overlap(&self, p: &[DVec3; 3], q: &[DVec3; 3], shared: Option<(usize, usize)>) -> Contact {
        match shared {
            Some((i, j)) => self.overlap_at_a_vertex(p, i, q, j),
            None => self.overlap_without_a_vertex(p, q),
        }
    }

    fn overlap_without_a_vertex(&self, p: &[DVec3; 3], q: &[DVec3; 3]) -> Contact {
        let mut parted = false;
        for (t, other) in [(p, q), (q, p)] {
            let inner = self.turn(t[0], t[1], t[2]);
            for k in 0..3 {
                let sides = other.map(|x| self.turn(t[k], t[(k + 1) % 3], x));
                if sides.iter().all(|side| side.opposes(inner)) {
                    return Contact::Disjoint;
                }
                parted |= !sides.contains(&inner);
            }
        }
        if parted { Contact::Touching } else { Contact::Coplanar }
    }

    /// Corner `i` of `p` is corner `j` of `q`. A line that parts them goes through it, so it is that of an edge there. In a fan
    /// of needles every two have such a corner, so this is kept short.
    fn overlap_at_a_vertex(&self, p: &[DVec3; 3], i: usize, q: &[DVec3; 3], j: usize) -> Contact {
        let at = p[i];
        let ends = [[p[(i + 1) % 3], p[(i + 2) % 3]], [q[(j + 1) % 3], q[(j + 2) % 3]]];
        let mut parted = false;
        for (own, other) in [(ends[0], ends[1]), (ends[1], ends[0])] {
            for (end, third) in [(own[0], own[1]), (own[1], own[0])] {
                let inner = self.turn(at, end, third);
                let sides = other.map(|x| self.turn(at, end, x));
                if sides.iter().all(|side| side.opposes(inner)) {
                    return Contact::Neighbours;
                }
                parted |= !sides.contains(&inner);
            }
        }
        // Parted by a line through the vertex, they have more in common where edges run along it together.
        match parted {
            false => Contact::Coplanar,
            true if self.edges_run_together(p, i, q, j) => Contact::Touching,
            true => Contact::Neighbours,
        }
    }

    /// Whether of the edges at corner `i` of `p` and those at the same point of `q` two have the same direction.
    fn edges_run_together(&self, p: &[DVec3; 3], i: usize, q: &[DVec3; 3], j: usize) -> bool {
        let at = p[i];
        let after = |x: DVec3| self.axes.map(|k| x[k].partial_cmp(&at[k]));
        [1, 2].into_iter().any(|k| {
            [1, 2].into_iter().any(|l| {
                let (x, y) = (p[(i + k) % 3], q[(j + l) % 3]);
                self.turn(at, x, y) == Sign::Zero && after(x) == after(y)
            })
        })
    }
}
