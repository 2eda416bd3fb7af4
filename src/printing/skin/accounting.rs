//! What became of each input face: kept, or dropped with a reason.

use glam::DVec3;

use crate::arrange::FacetSides;
use crate::inspect::solids;
use crate::mesh::{Edges, Parts, Surface, is_generated};

/// Least share of the input's area for an inner piece to be called a shell.
const SHELL_SHARE: f64 = 0.1;

/// Why a piece of the input is not in the result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DropReason {
    /// A large surface inside the solid.
    InnerShell,
    /// A small piece inside the solid.
    InnerJunk,
    /// A surface with air on both sides.
    Sheet,
}

/// A piece of the input that is not in the result.
#[derive(Debug, Clone, PartialEq)]
pub struct DroppedPiece {
    /// A point of the piece.
    pub at: DVec3,
    /// The faces of the input, in ascending order.
    pub faces: Vec<u32>,
    /// Why the piece was dropped.
    pub reason: DropReason,
    /// The enclosed volume if the piece is closed, otherwise 0; in cubic units.
    pub volume: f64,
}

/// Why the faces of the input that are not in the result were dropped.
pub struct Accounting {
    /// For each face the reason, if it is not kept.
    reason: Vec<Option<DropReason>>,
}

impl Accounting {
    /// Classes each face by the air in front of the sides of its facets. A face with several facets counts as kept if
    /// one of them is.
    pub(super) fn new(surface: &Surface, sides: &FacetSides, outer: &[bool]) -> Self {
        let mut reason: Vec<Option<DropReason>> = vec![None; surface.faces.len()];
        let mut is_kept = vec![false; surface.faces.len()];
        for (facet, &face) in sides.face.iter().enumerate() {
            match (outer[2 * facet], outer[2 * facet + 1]) {
                (true, true) => reason[face as usize] = Some(DropReason::Sheet),
                (false, false) => {
                    reason[face as usize].get_or_insert(DropReason::InnerJunk);
                }
                _ => is_kept[face as usize] = true,
            }
        }
        for (reason, is_kept) in reason.iter_mut().zip(is_kept) {
            if is_kept {
                *reason = None;
            }
        }
        Self { reason }
    }

    /// Records the reason of faces that were dropped later. `faces` may name faces several times.
    pub fn drop(&mut self, faces: &[u32], reason: DropReason) {
        for &face in faces.iter().filter(|&&face| !is_generated(face)) {
            self.reason[face as usize] = Some(reason);
        }
    }

    /// The dropped faces as connected pieces with one reason each, in the order of their first face.
    pub fn pieces(&self, surface: &Surface) -> Vec<DroppedPiece> {
        let mut pieces = Vec::new();
        let total: f64 = (0..surface.faces.len()).map(|f| surface.area_vector(f).length() / 2.0).sum();
        for reason in [DropReason::InnerJunk, DropReason::Sheet] {
            let faces: Vec<u32> =
                (0u32..).zip(&self.reason).filter(|(_, of_face)| **of_face == Some(reason)).map(|(f, _)| f).collect();
            let dropped = Surface {
                positions: surface.positions.clone(),
                faces: faces.iter().map(|&f| surface.faces[f as usize]).collect(),
                source: faces,
            };
            let edges = Edges::new(&dropped.faces);
            let parts = Parts::new(&dropped, &edges);
            let solids = solids(&dropped, &edges, &parts);
            for (of_part, solid) in parts.faces().iter().zip(solids) {
                let is_shell = reason == DropReason::InnerJunk && solid.area >= SHELL_SHARE * total;
                pieces.push(DroppedPiece {
                    at: dropped.corners(of_part[0] as usize).into_iter().sum::<DVec3>() / 3.0,
                    faces: of_part.iter().map(|&f| dropped.source[f as usize]).collect(),
                    reason: if is_shell { DropReason::InnerShell } else { reason },
                    volume: if solid.closed { solid.volume.abs() } else { 0.0 },
                });
            }
        }
        pieces.sort_by_key(|piece| piece.faces[0]);
        pieces
    }
}

/// The share of a surface's area in faces that equal a face of the input, corner by corner, in percent.
pub fn kept_exactly_pct(result: &Surface, input: &Surface) -> f64 {
    let (mut kept, mut all) = (0.0, 0.0);
    for (f, &source) in result.source.iter().enumerate() {
        let area = result.area_vector(f).length();
        all += area;
        let is_same = !is_generated(source) && {
            let corners = input.corners(source as usize);
            result.corners(f).iter().all(|p| corners.contains(p))
        };
        kept += if is_same { area } else { 0.0 };
    }
    if all > 0.0 { 100.0 * kept / all } else { 0.0 }
}
