//! What grows together: pieces of faces, or whole flat regions.

use rustc_hash::FxHashMap;

use super::growth::Growths;
use super::refine::{FaceCorner, Refined};
use super::regions::Regions;

/// A surface that grows, in pieces or in flat regions without pieces.
pub struct Pieces {
    /// The surface with its growth.
    pub refined: Refined,
    /// The flat regions; none if pieces grow.
    pub regions: Option<Regions>,
}

impl Pieces {
    /// The pieces that are raised together are one group: each alone, or all of a region.
    pub fn group_of(&self, piece: u32) -> u32 {
        self.regions.as_ref().map_or(piece, |regions| regions.of(piece))
    }

    /// Raises the corners of groups, each corner by the most of its pieces. Regions grow as far as the gaps in front of them
    /// allow.
    pub fn raise(&mut self, groups: FxHashMap<u32, f64>, growths: &Growths<'_>) {
        let mut at: FxHashMap<FaceCorner, f64> = FxHashMap::default();
        for (group, more) in groups {
            let alone = [group];
            let pieces = self.regions.as_ref().map_or(&alone[..], |regions| regions.faces(group));
            let more = if self.regions.is_some() { self.limited(pieces, more, growths) } else { more };
            for &piece in pieces {
                for v in self.refined.faces[piece as usize] {
                    let most = at.entry(self.refined.corner(piece, v)).or_insert(0.0);
                    *most = most.max(more);
                }
            }
        }
        for (key, more) in at {
            *self.refined.growth.entry(key).or_insert(0.0) += more;
        }
    }

    /// How much more whole faces may grow, at most `more`.
    fn limited(&self, faces: &[u32], more: f64, growths: &Growths<'_>) -> f64 {
        let room = |more: f64, &face: &u32| {
            let growth = (0..3).map(|k| self.refined.corner_growth(face, k)).fold(0.0, f64::max);
            growths.limit_of_face(face, growth + more) - growth
        };
        faces.iter().fold(more, room).max(0.0)
    }
}
