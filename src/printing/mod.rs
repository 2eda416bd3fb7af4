//! Printing with a named process: the processes' rules, the measures that the rules need, and whether a model meets
//! the rules.
//!
//! [`profile`] holds each process's limits. [`readiness`] measures a file against the limits.

pub mod cups;
pub mod designed_sizes;
mod features;
pub mod fill;
pub mod hollows;
pub mod profile;
pub mod reach;
pub mod readiness;
pub mod rules;
#[cfg(test)]
pub(crate) mod shapes;
pub mod skin;
pub mod target_size;
pub mod thickening;
pub mod thickness;
pub mod traps;
pub mod unit_candidates;
pub mod vents;
pub mod voids;
