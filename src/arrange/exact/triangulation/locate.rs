//! Where a point is.

use smallvec::SmallVec;

use super::{NONE, Triangulation};
use crate::math::Sign;

/// Where a point is.
pub(super) enum Spot {
    Inside(u32),
    On(u32, usize),
    Corner(u32),
}

impl Triangulation<'_> {
    /// Finds where a point is by walking towards it.
    pub(super) fn locate(&self, p: u32) -> Spot {
        let mut t = self.last;
        let mut from = NONE;
        for step in 0..4 * self.triangles.len() + 8 {
            let triangle = &self.triangles[t as usize];
            let mut next = None;
            let mut zero: SmallVec<[usize; 3]> = SmallVec::new();
            for k in 0..3 {
                // Which edge is looked at first changes, so that the walk can't go in circles for ever.
                let i = (k + step) % 3;
                if triangle.across[i] == from && from != NONE {
                    continue;
                }
                match self.turn(triangle.corners[i], triangle.corners[(i + 1) % 3], p) {
                    Sign::Negative if triangle.across[i] != NONE => {
                        next = Some(triangle.across[i]);
                        break;
                    }
                    Sign::Zero => zero.push(i),
                    _ => {}
                }
            }
            if let Some(next) = next {
                (from, t) = (t, next);
                continue;
            }
            return match zero.as_slice() {
                [] => Spot::Inside(t),
                [i] => Spot::On(t, *i),
                [i, j, ..] => {
                    let (i, j) = (*i.min(j), *i.max(j));
                    Spot::Corner(triangle.corners[if (i, j) == (0, 2) { 0 } else { j }])
                }
            };
        }
        self.search(p)
    }

    /// Finds where a point is by looking everywhere.
    fn search(&self, p: u32) -> Spot {
        for (t, triangle) in (0u32..).zip(&self.triangles) {
            let [a, b, c] = triangle.corners;
            let turns = [self.turn(a, b, p), self.turn(b, c, p), self.turn(c, a, p)];
            if turns.contains(&Sign::Negative) {
                continue;
            }
            return match turns.iter().position(|&s| s == Sign::Zero) {
                Some(i) => Spot::On(t, i),
                None => Spot::Inside(t),
            };
        }
        Spot::Inside(self.last)
    }
}
