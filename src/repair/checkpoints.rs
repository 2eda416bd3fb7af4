use rustc_hash::FxHashMap;

use super::Step;
use super::tiers::{Key, Place};

/// Surfaces that are kept, beside the one that every rung starts from.
const MOST_KEPT: usize = 4;

/// The surface that every rung starts from, as a number.
pub(super) const START: u32 = 0;

/// What rungs came by, so that no rung does again what one before it did.
///
/// ```text
///    start --stitch--> 1 --mend--> 2 --fill holes--> 3 --resolve--> 4      the first rung
///                      |                             +--close sheets--> 6  a later one, from the surface that is kept at 3
///                      +--mend otherwise--> 5
/// ```
///
/// Surfaces have numbers: what an operator leaves as it is keeps its number, and what it changes gets a new one. What an
/// operator makes of a surface is known once it ran on it, and is the same in every rung that asks for the same. The
/// surfaces themselves are kept only where later rungs turn off, and of those the ones farthest on, which saves most.
#[derive(Default)]
pub(super) struct Checkpoints {
    known: FxHashMap<(u32, Key), (u32, Step)>,
    /// With the number of each, and how many tasks led there.
    kept: Vec<(u32, usize, Place)>,
    last: u32,
}

impl Checkpoints {
    /// What an operator makes of a surface, if it ran on it before, and the step that tells of it.
    pub fn known(&self, surface: u32, key: Key) -> Option<&(u32, Step)> {
        self.known.get(&(surface, key))
    }

    /// A number for a surface of which nothing else is known.
    pub fn fresh(&mut self) -> u32 {
        self.last += 1;
        self.last
    }

    /// Writes down what an operator made of a surface. Answers the number of what it made.
    pub fn learn(&mut self, surface: u32, key: Key, changed: bool, step: &Step) -> u32 {
        if let Some(&(made, _)) = self.known(surface, key) {
            return made;
        }
        let made = if changed { self.fresh() } else { surface };
        self.known.insert((surface, key), (made, step.clone()));
        made
    }

    /// Keeps a surface, to which so many tasks led.
    pub fn keep(&mut self, surface: u32, tasks: usize, place: &Place) {
        if surface == START || self.kept(surface).is_some() {
            return;
        }
        self.kept.push((surface, tasks, place.clone()));
        if self.kept.len() > MOST_KEPT
            && let Some(nearest) = (0..self.kept.len()).min_by_key(|&at| self.kept[at].1)
        {
            self.kept.remove(nearest);
        }
    }

    /// A surface, where it is kept.
    pub fn kept(&self, surface: u32) -> Option<&Place> {
        self.kept.iter().find(|&&(number, ..)| number == surface).map(|(.., place)| place)
    }
}
