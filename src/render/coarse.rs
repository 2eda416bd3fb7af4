//! A scene of a large mesh with few faces, to be looked at while the whole one is on its way.

use std::collections::hash_map::Entry;

use glam::DVec3;
use rustc_hash::{FxHashMap, FxHashSet};

use super::palette::Paint;
use super::{RenderError, Scene};
use crate::context::Context;
use crate::mesh::{NO_SOURCE, Surface};

/// Cells along the model's longest side that are tried first, and by what they are made fewer until the scene is small enough.
const CELLS: f64 = 640.0;
const FEWER: f64 = 0.75;
/// Most pieces of lines and most dots that a coarse scene keeps: the gravest, which come first.
const MOST_SEGMENTS: usize = 20_000;
const MOST_DOTS: usize = 5_000;

impl Scene {
    /// The scene with at most `most_faces` faces: vertices that share a cell of a grid become one in their middle, and faces that are
    /// left with less than three are gone (Rossignac and Borrel 1993). It asks nothing of the mesh and keeps each face's paint, but
    /// promises only that it looks alike. O(n) a try.
    ///
    /// # Errors
    /// [`RenderError::Cancelled`] when the work should stop.
    pub fn coarse(&self, most_faces: usize, context: &Context<'_>) -> Result<Self, RenderError> {
        let mut cells = CELLS;
        let (surface, paint) = loop {
            context.check()?;
            match self.gathered(cells, most_faces) {
                Some(gathered) => break gathered,
                None => cells *= FEWER,
            }
        };
        let segments = self.segments.iter().take(MOST_SEGMENTS).copied().collect();
        let dots = self.dots.iter().take(MOST_DOTS).copied().collect();
        let (frame, legend, shows) = (self.frame, self.legend.clone(), self.shows);
        Ok(Self { surface, paint, segments, dots, frame, legend, shows })
    }

    /// The faces between the cells of a grid with so many along the longest side; none where there are more than `most`.
    fn gathered(&self, cells: f64, most: usize) -> Option<(Surface, Vec<Paint>)> {
        let mut known: FxHashMap<[u32; 3], u32> = FxHashMap::default();
        let mut sums: Vec<(DVec3, f64)> = Vec::new();
        let mut cell_of = Vec::with_capacity(self.surface.positions.len());
        for &position in &self.surface.positions {
            let place = self.frame.to_cube(position);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "from 0 to the cells' count")]
            let cell = ((place + 1.0) * (0.5 * cells)).max(DVec3::ZERO).to_array().map(|x| x as u32);
            let number = match known.entry(cell) {
                Entry::Occupied(entry) => *entry.get(),
                Entry::Vacant(entry) => {
                    sums.push((DVec3::ZERO, 0.0));
                    *entry.insert(u32::try_from(sums.len()).ok()? - 1)
                }
            };
            let (sum, count) = &mut sums[number as usize];
            *sum += place;
            *count += 1.0;
            cell_of.push(number);
        }
        let (mut seen, mut faces, mut paint) = (FxHashSet::default(), Vec::new(), Vec::new());
        for (face, &shown) in self.surface.faces.iter().zip(&self.paint) {
            let [a, b, c] = face.map(|v| cell_of[v as usize]);
            if a == b || b == c || c == a {
                continue;
            }
            // The same face from its smallest corner on, so that it is found again however it is written, but not turned over.
            let first = if a < b && a < c {
                [a, b, c]
            } else if b < c {
                [b, c, a]
            } else {
                [c, a, b]
            };
            if seen.insert((first, shown.number())) {
                if faces.len() == most {
                    return None;
                }
                faces.push(first);
                paint.push(shown);
            }
        }
        let positions = sums.into_iter().map(|(sum, count)| self.frame.from_cube(sum / count)).collect();
        let source = vec![NO_SOURCE; faces.len()];
        Some((Surface { positions, faces, source }, paint))
    }
}
