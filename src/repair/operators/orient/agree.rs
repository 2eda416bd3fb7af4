//! Which faces to turn so that neighbours agree.

use glam::DVec3;

use crate::mesh::{Edges, Surface};
use crate::repair::{Cancelled, Context};

const NONE: u32 = u32::MAX;
/// Weight of one edge in conflict; how well its faces agree in direction adds up to [`FLAT`] and so only decides ties.
const EDGE: i64 = 1 << 20;
const FLAT: f64 = 255.0;
/// Faces that may be turned one by one in a patch with conflicts, for each of its faces.
const TURNS_A_FACE: usize = 64;

/// Which faces to turn so that neighbours agree.
pub(crate) struct Agreement {
    pub turn: Vec<bool>,
    /// Edges of two faces that still disagree: those along which one-sided patches would have to be cut.
    pub conflicts: u64,
    /// Patches with such edges.
    pub one_sided: u64,
}

/// Which faces to turn so that each patch (faces joined across edges of two faces) agrees with the larger area.
///
/// A one-sided patch can't agree everywhere. Of two ways to turn its faces, by carrying the winding from face to face
/// and by leaving all as they are, each first bettered by turning single faces, the one with fewer edges in conflict is
/// taken, and of equals the one whose conflicts lie on the sharper folds. So there are never more than before.
pub(crate) fn agree(
    surface: &Surface,
    edges: &Edges,
    areas: &[f64],
    context: &Context<'_>,
) -> Result<Agreement, Cancelled> {
    let across = Across::new(surface, edges);
    let faces = surface.faces.len();
    let mut agreement = Agreement { turn: vec![false; faces], conflicts: 0, one_sided: 0 };
    let turn = &mut agreement.turn;
    let mut seen = vec![false; faces];
    let mut patch = Vec::new();
    for first in 0..faces {
        if first % 4096 == 0 {
            context.check()?;
        }
        if seen[first] {
            continue;
        }
        seen[first] = true;
        patch.clear();
        patch.push(first);
        let (mut at, mut agrees) = (0, true);
        while at < patch.len() {
            let f = patch[at];
            at += 1;
            for (g, same) in across.of(f) {
                if !seen[g] {
                    seen[g] = true;
                    turn[g] = turn[f] ^ same;
                    patch.push(g);
                } else {
                    agrees &= turn[g] == turn[f] ^ same;
                }
            }
        }
        if !agrees {
            let carried = across.better(surface, &patch, turn, context)?;
            let found: Vec<bool> = patch.iter().map(|&f| std::mem::take(&mut turn[f])).collect();
            let kept = across.better(surface, &patch, turn, context)?;
            if carried <= kept {
                for (&f, found) in patch.iter().zip(found) {
                    turn[f] = found;
                }
            }
            #[expect(clippy::cast_sign_loss, reason = "a sum of weights")]
            {
                agreement.conflicts += (carried.min(kept) / EDGE) as u64;
            }
            agreement.one_sided += 1;
        }
        let area = |turned: bool| patch.iter().filter(|&&f| turn[f] == turned).map(|&f| areas[f]).sum::<f64>();
        if area(true) > area(false) {
            for &f in &patch {
                turn[f] = !turn[f];
            }
        }
    }
    Ok(agreement)
}

/// For each half-edge the face across an edge of two faces and whether the two run the same way, packed as
/// `2 * face + same`.
struct Across(Vec<u32>);

impl Across {
    fn new(surface: &Surface, edges: &Edges) -> Self {
        let faces = &surface.faces;
        let mut across = vec![NONE; faces.len() * 3];
        for half_edges in edges.iter() {
            if let &[x, y] = half_edges {
                let same = u32::from(Edges::is_forward(faces, x) == Edges::is_forward(faces, y));
                across[x as usize] = (y / 3) << 1 | same;
                across[y as usize] = (x / 3) << 1 | same;
            }
        }
        Self(across)
    }

    /// The neighbours of a face, and whether it must be turned against each.
    fn of(&self, f: usize) -> impl Iterator<Item = (usize, bool)> {
        self.0[3 * f..3 * f + 3].iter().filter(|&&p| p != NONE).map(|&p| ((p >> 1) as usize, p & 1 == 1))
    }

    /// Turns single faces of a patch as long as that lowers the weight of its edges in conflict, which is answered.
    fn better(
        &self,
        surface: &Surface,
        patch: &[usize],
        turn: &mut [bool],
        context: &Context<'_>,
    ) -> Result<i64, Cancelled> {
        let normal = |f: usize| DVec3::normalize_or_zero(surface.area_vector(f));
        #[expect(clippy::cast_possible_truncation, reason = "between 0 and 255")]
        let weight = |f: usize, g: usize, same: bool| {
            let cosine = normal(f).dot(normal(g)) * if same { -1.0 } else { 1.0 };
            EDGE + ((1.0 + cosine).clamp(0.0, 2.0) * 0.5 * FLAT) as i64
        };
        let disagree = |turn: &[bool], f: usize, g: usize, same: bool| turn[g] != turn[f] ^ same;
        let in_conflict = |turn: &[bool], f: usize| self.of(f).any(|(g, same)| disagree(turn, f, g, same));
        let mut next: Vec<usize> = patch.iter().rev().copied().filter(|&f| in_conflict(turn, f)).collect();
        let mut turns = 0;
        while let Some(f) = next.pop().filter(|_| turns < TURNS_A_FACE * patch.len()) {
            let gain: i64 = self
                .of(f)
                .map(|(g, same)| if disagree(turn, f, g, same) { weight(f, g, same) } else { -weight(f, g, same) })
                .sum();
            if gain > 0 {
                turn[f] = !turn[f];
                turns += 1;
                if turns % 4096 == 0 {
                    context.check()?;
                }
                next.extend(self.of(f).map(|(g, _)| g));
            }
        }
        let left = |f: usize| -> i64 {
            self.of(f)
                .filter(|&(g, same)| f < g && disagree(turn, f, g, same))
                .map(|(g, same)| weight(f, g, same))
                .sum()
        };
        Ok(patch.iter().map(|&f| left(f)).sum())
    }
}

/// Turns the faces that are marked. Answers how many.
pub(crate) fn turn_faces(surface: &mut Surface, turn: &[bool]) -> u64 {
    let mut turned = 0;
    for (face, _) in surface.faces.iter_mut().zip(turn).filter(|(_, t)| **t) {
        face.swap(1, 2);
        turned += 1;
    }
    turned
}
