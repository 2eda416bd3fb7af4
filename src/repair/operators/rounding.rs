//! Vertices taken to positions that f32 can hold without making faces meet.

use glam::DVec3;
use smallvec::SmallVec;

use super::clear::{Clear, NEW};
use super::places::spacing;
use crate::math::to_single;
use crate::mesh::Surface;
use crate::repair::{Cancelled, Context};

/// Times that all vertices that are left are tried again, since the move of one may make room for another.
const ROUNDS: usize = 4;
/// How far a vertex may be merged into another, in units of the last place.
const MERGE: f64 = 64.0;
/// The least step beside zero, in units of the last place of the model's largest coordinate.
const FINEST: f64 = 1.0 / (1 << 20) as f64;

/// The least step between positions that readers tell apart which round to eight decimals: a power of two above 1e-8.
pub(super) const TOLD_APART: f64 = 1.0 / (1 << 26) as f64;

/// What became of the vertices.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Rounded {
    /// Vertices that were rounded so that faces met, since there was no other way.
    pub forced: u64,
    /// Vertices that were merged into neighbours.
    pub merged: u64,
}

/// Takes vertices for which `is_free` is true to positions that f32 can hold, each by a move after which no two faces meet that
/// did not before, by exact signs: to the nearest such position, or to one beside it, or into a neighbour that stands on one.
///
/// ```text
///     o . o . o            o   o   o
///     .  /|\  .     ->        /|\            o: positions of f32
///     o /.|.\ o            o / o \ o
/// ```
///
/// Precondition: no two faces meet but in shared vertices and edges. Result: the same, but around vertices that are counted as
/// `forced`. A vertex moves by a unit or two of the last place, or merges within 64 of them. Edges may come to have more than two
/// faces, and vertices several fans, where sheets are that near one another.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub(super) fn round_apart(
    surface: &mut Surface,
    is_free: impl Fn(DVec3) -> bool,
    context: &Context<'_>,
) -> Result<Rounded, Cancelled> {
    let lattice = Lattice::of(surface);
    let to_do = |p: DVec3| is_free(p) && lattice.nearest(p) != p;
    let mut left: Vec<u32> = (0u32..).zip(&surface.positions).filter(|&(_, &p)| to_do(p)).map(|(v, _)| v).collect();
    let mut done = Rounded::default();
    if left.is_empty() {
        return Ok(done);
    }
    let mut stars = vec![SmallVec::<[u32; 8]>::new(); surface.positions.len()];
    for (face, f) in surface.faces.iter().zip(0u32..) {
        face.iter().for_each(|&v| stars[v as usize].push(f));
    }
    let mut it = Rounding { clear: Clear::new(surface), lattice, stars, surface };
    for _ in 0..ROUNDS {
        let before = left.len();
        let mut again = Vec::new();
        for (at, v) in left.into_iter().enumerate() {
            if at % 64 == 0 {
                context.check()?;
            }
            if it.shift(v) {
                continue;
            }
            if it.merge(v) {
                done.merged += 1;
            } else {
                again.push(v);
            }
        }
        left = again;
        if left.is_empty() || left.len() == before {
            break;
        }
    }
    done.forced = left.len() as u64;
    for v in left {
        let p = &mut surface.positions[v as usize];
        *p = lattice.nearest(*p);
    }
    let live: Vec<bool> = surface.faces.iter().map(|&[a, b, c]| a != b && b != c && c != a).collect();
    surface.retain_faces(&live);
    surface.drop_unreferenced();
    Ok(done)
}

struct Rounding<'a> {
    surface: &'a mut Surface,
    clear: Clear,
    lattice: Lattice,
    /// The faces at each vertex.
    stars: Vec<SmallVec<[u32; 8]>>,
}

impl Rounding<'_> {
    /// Moves a vertex to a position of f32 near it.
    fn shift(&mut self, v: u32) -> bool {
        let p = self.surface.positions[v as usize];
        let new: Vec<([u32; 3], u32)> = self.stars[v as usize]
            .iter()
            .map(|&f| (self.surface.faces[f as usize].map(|w| if w == v { NEW } else { w }), f))
            .collect();
        let found = self.lattice.around(p).into_iter().find(|&q| self.clear.is_clear(self.surface, &new, &[], q));
        if let Some(q) = found {
            self.clear.moved(v, q);
            self.surface.positions[v as usize] = q;
        }
        found.is_some()
    }

    /// Merges a vertex into a neighbour that stands on a position of f32.
    fn merge(&mut self, v: u32) -> bool {
        let p = self.surface.positions[v as usize];
        let most = MERGE * spacing(p);
        let at = |w: u32| self.surface.positions[w as usize];
        let mut ends: Vec<u32> = self.stars[v as usize]
            .iter()
            .flat_map(|&f| self.surface.faces[f as usize])
            .filter(|&w| w != v && at(w).distance(p) <= most && to_single(at(w)) == at(w))
            .collect();
        ends.sort_unstable();
        ends.dedup();
        ends.sort_by(|&a, &b| at(a).distance_squared(p).total_cmp(&at(b).distance_squared(p)).then(a.cmp(&b)));
        for u in ends {
            let (gone, kept): (Vec<u32>, Vec<u32>) =
                self.stars[v as usize].iter().partition(|&&f| self.surface.faces[f as usize].contains(&u));
            let new: Vec<([u32; 3], u32)> =
                kept.iter().map(|&f| (self.surface.faces[f as usize].map(|w| if w == v { u } else { w }), f)).collect();
            let to = self.surface.positions[u as usize];
            if !self.clear.is_clear(self.surface, &new, &gone, to) {
                continue;
            }
            self.clear.moved(v, to);
            for &(face, f) in &new {
                self.surface.faces[f as usize] = face;
                self.stars[u as usize].push(f);
            }
            for f in gone {
                let face = self.surface.faces[f as usize];
                face.iter().filter(|&&w| w != v).for_each(|&w| self.stars[w as usize].retain(|g| *g != f));
                self.surface.faces[f as usize] = [u; 3];
            }
            self.stars[v as usize].clear();
            return true;
        }
        false
    }
}

/// Positions that f32 can hold, and no finer beside zero than a model is worth. There f32 has numbers so near one another that no
/// program could tell the normal of a face between them.
#[derive(Debug, Clone, Copy)]
struct Lattice {
    /// The least step, a power of two.
    least: f64,
}

impl Lattice {
    fn of(surface: &Surface) -> Self {
        let largest = surface.positions.iter().fold(DVec3::ZERO, |most, p| most.max(p.abs()));
        Self { least: (spacing(largest) * FINEST).max(TOLD_APART.min(spacing(largest))) }
    }

    /// The nearest number, and those next to it.
    fn near(self, x: f64) -> [f64; 3] {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "rounding is the purpose, and what is too large stays as it is"
        )]
        let single = x as f32;
        if !single.is_finite() {
            return [x; 3];
        }
        let step = f64::from(single.abs().next_up()) - f64::from(single.abs());
        if step >= self.least {
            return [single, single.next_up(), single.next_down()].map(f64::from);
        }
        let nearest = (x / self.least).round() * self.least;
        [nearest, nearest + self.least, nearest - self.least]
    }

    fn nearest(self, p: DVec3) -> DVec3 {
        DVec3::from_array(p.to_array().map(|x| self.near(x)[0]))
    }

    /// The positions around one, the nearest first: those of the cell that it is in, and those next to the nearest.
    fn around(self, p: DVec3) -> SmallVec<[DVec3; 27]> {
        let [x, y, z] = p.to_array().map(|x| self.near(x));
        let mut all: SmallVec<[DVec3; 27]> = SmallVec::new();
        for i in x {
            for j in y {
                all.extend(z.into_iter().map(|k| DVec3::new(i, j, k)).filter(|q| q.is_finite()));
            }
        }
        all.sort_by(|a, b| a.distance_squared(p).total_cmp(&b.distance_squared(p)));
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_are_those_of_f32_but_beside_zero_no_finer_than_the_model_is_worth() {
        let lattice = Lattice { least: 2f64.powi(-40) };
        let third = 1.0f32 / 3.0;
        assert_eq!(lattice.near(1.0 / 3.0), [third, third.next_up(), third.next_down()].map(f64::from));
        assert_eq!(lattice.near(1e-17), [0.0, 2f64.powi(-40), -2f64.powi(-40)]);
        assert_eq!(lattice.near(-1e-40), [0.0, 2f64.powi(-40), -2f64.powi(-40)]);
        assert_eq!(lattice.near(1e39), [1e39; 3]);
        let huge = Lattice { least: spacing(DVec3::new(0.0, 1e50, -f64::from(f32::MAX))) * FINEST };
        assert_eq!(huge.near(1.0), [0.0, huge.least, -huge.least]);
        assert_eq!(huge.near(f64::from(f32::MAX))[0], f64::from(f32::MAX));
        for x in lattice.near(1e-7) {
            assert_eq!((x as f32).to_bits(), (x as f32 + 0.0).to_bits());
            assert_eq!(f64::from(x as f32), x, "f32 can hold it");
            assert!((x - 1e-7).abs() < 2f64.powi(-39));
        }
    }
}
