//! Which patches look outward, as rays from their faces tell.

use glam::DVec3;

use crate::math::ray_direction;
use crate::mesh::{Parts, Surface};
use crate::repair::operators::inside::RayCaster;
use crate::repair::operators::names::Nested;
use crate::repair::{Cancelled, Context};

/// Faces that vote for a patch.
const VOTERS: usize = 16;
/// Times that the voters of a patch are asked, each time in another direction, until they agree well enough.
const ROUNDS: u32 = 4;
/// The share of the voters' area by which one side must lead before the last round.
const CLEAR: f64 = 0.25;
/// What a vote counts where both sides meet surface, so that only whether they meet an even number tells them apart.
const COVERED: f64 = 0.25;
/// Faces that all rays together may look at: this many, and as many again for each face. Enough for a soup of single
/// triangles; a fan of thousands of sheets around one axis, where each ray meets them all, runs out of it.
const BUDGET: u64 = 5_000_000;
const BUDGET_A_FACE: u64 = 8;

/// How a patch faces the outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Looks {
    Outward,
    Inward,
    /// As much the one as the other, as a sheet alone does, or the budget is spent.
    Untold,
}

/// The patches of a surface, to tell which of them show their back to the outside.
pub(super) struct Outside<'a> {
    pub surface: &'a Surface,
    pub patches: &'a Parts,
    /// The patches that are asked about.
    pub asked: &'a [bool],
    /// The patches that are closed.
    pub closed: &'a [bool],
    /// Twice the area of each face.
    pub areas: &'a [f64],
}

/// What the rays from one face meet.
struct Sight {
    /// Whether the face lies in an odd number of closed patches.
    within: bool,
    /// Surface that is not around it, before and behind.
    met: [usize; 2],
}

impl Outside<'_> {
    /// The faces of all patches, for the rays of all that is asked.
    pub fn rays(&self) -> RayCaster {
        let faces = &self.surface.faces;
        RayCaster::new(self.surface, faces.clone(), BUDGET + BUDGET_A_FACE * faces.len() as u64)
    }

    /// How each patch that is asked about looks.
    ///
    /// From the middle of each of its largest faces a ray goes out to the front and another to the back. Closed patches
    /// around the face count as its surroundings. Of what else is met, the side that meets nothing is outside, and where both
    /// meet something the one that meets an even number; the faces' areas are the votes. What lies in a solid has no vote
    /// unless layers are to alternate, and then the opposite one.
    pub fn looks(&self, nested: Nested, rays: &mut RayCaster, context: &Context<'_>) -> Result<Vec<Looks>, Cancelled> {
        let mut voters = self.voters(self.asked);
        let mut votes = vec![0.0; self.patches.count];
        for round in 0..ROUNDS {
            for (patch, faces) in voters.iter_mut().enumerate().filter(|(_, faces)| !faces.is_empty()) {
                if patch % 256 == 0 {
                    context.check()?;
                }
                let (mut all, mut covered) = (0.0, false);
                for &f in &*faces {
                    all += self.areas[f as usize];
                    let Some(Sight { within, met }) = self.sight(rays, f, round) else {
                        covered = true;
                        continue;
                    };
                    covered |= met != [0, 0];
                    let outward = match met {
                        [0, 0] => 0.0,
                        [0, _] => 1.0,
                        [_, 0] => -1.0,
                        [front, back] if front % 2 == back % 2 => 0.0,
                        [front, _] => COVERED * if front % 2 == 0 { 1.0 } else { -1.0 },
                    };
                    let sign = match (within, nested) {
                        (false, _) => 1.0,
                        (true, Nested::Keep) => 0.0,
                        (true, Nested::Alternate) => -1.0,
                    };
                    votes[patch] += outward * sign * self.areas[f as usize];
                }
                // Askance even hills see one another; so what sees the open on both sides is not asked again.
                if !covered || f64::abs(votes[patch]) >= CLEAR * all {
                    faces.clear();
                }
            }
            if rays.is_spent() {
                break;
            }
        }
        let looks = |vote: f64| match vote {
            vote if vote > 0.0 => Looks::Outward,
            vote if vote < 0.0 => Looks::Inward,
            _ => Looks::Untold,
        };
        Ok(votes.into_iter().map(looks).collect())
    }

    /// The largest faces of each patch that is asked about; of equal ones some from all over it.
    pub fn voters(&self, asked: &[bool]) -> Vec<Vec<u32>> {
        let scattered = |f: u32| f.wrapping_mul(0x9e37_79b9).reverse_bits();
        let by_area = |x: &u32, y: &u32| {
            let size = |f: &u32| self.areas[*f as usize];
            size(y).total_cmp(&size(x)).then(scattered(*x).cmp(&scattered(*y)))
        };
        let mut lists = self.patches.faces();
        for (faces, asked) in lists.iter_mut().zip(asked) {
            if !asked {
                faces.clear();
            } else if faces.len() > VOTERS {
                faces.select_nth_unstable_by(VOTERS, by_area);
                faces.truncate(VOTERS);
            }
            faces.sort_unstable_by(by_area);
        }
        lists
    }

    /// What a face sees, in the first round along its normal; none where that can't be told.
    fn sight(&self, rays: &mut RayCaster, f: u32, round: u32) -> Option<Sight> {
        let [a, b, c] = self.surface.faces[f as usize].map(|v| rays.unit[v as usize]);
        // The smallest cross product of numbers around 1 may underflow; such a face has no say.
        let normal = (b - a).cross(c - a).try_normalize()?;
        let from = (a + b + c) / 3.0;
        let aside = if round == 0 { DVec3::ZERO } else { ray_direction(round) * 0.9 };
        let direction = (normal + aside).normalize();
        let of_face = &self.patches.of_face;
        let own = of_face[f as usize];
        let mut look = |direction: DVec3| {
            let mut met = Vec::new();
            let clear = rays.each_crossing(from, from + direction * 8.0, Some(f), |g| met.push(of_face[g as usize]));
            met.sort_unstable();
            clear.then_some(met)
        };
        let [front, back] = [look(direction)?, look(-direction)?];
        // A face is in a closed patch where a ray to either side meets that an odd number of times; so both tell it.
        let around = |part: &u32| *part != own && *part != Parts::NONE && self.closed[*part as usize];
        let containers: Vec<u32> =
            front.chunk_by(|x, y| x == y).filter(|c| c.len() % 2 == 1 && around(&c[0])).map(|c| c[0]).collect();
        let met = [front, back].map(|met| {
            let mut beyond = met.len();
            for of_part in met.chunk_by(|x, y| x == y).filter(|c| containers.binary_search(&c[0]).is_ok()) {
                beyond -= of_part.len();
            }
            beyond
        });
        Some(Sight { within: containers.len() % 2 == 1, met })
    }
}
