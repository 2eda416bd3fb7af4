//! The expected effort of a repair, from the counts of the input's inspection.
//!
//! The constants are orders of magnitude for two cores of a 2025 server, from large models with holes. Estimates drive the progress
//! percentage, and decide which strategies start near the deadline. No estimate decides between results.

use std::time::Duration;

use super::operators::Operator;
use super::report::Strategy;
use crate::context::Estimate;
use crate::inspect::Measures;

/// Milliseconds that any repair takes.
const BASE_MS: f64 = 3.0;
/// Milliseconds per face for reading, inspecting and returning a file.
const FACE_MS: f64 = 0.002;
/// Milliseconds per face for repairing and verifying.
const REPAIR_MS: f64 = 0.003;
/// Milliseconds per pair of intersecting faces, for cutting them in the arrangement.
const PAIR_MS: f64 = 0.4;
/// Milliseconds per boundary edge, for stitching and for closing holes.
const BOUNDARY_MS: f64 = 0.05;

/// Bytes of memory that any repair takes.
const BASE_BYTES: f64 = 14e6;
/// Bytes of memory per face.
const FACE_BYTES: f64 = 500.0;
/// Bytes of memory per pair of intersecting faces.
const PAIR_BYTES: f64 = 3_000.0;

/// Factor by which a strategy may run faster than expected. A strategy is skipped only if it would overrun the deadline even at that speed.
const MAX_SPEED_UP: f64 = 10.0;

/// The expected effort of a repair of an input with these counts. `keeps_input` says whether the repair returns the input's mesh unchanged.
pub(super) fn estimate(before: &Measures, keeps_input: bool) -> Estimate {
    let faces = before.faces as f64;
    let repair = if keeps_input { 0.0 } else { repair_ms(before) };
    let pairs = before.self_intersections.pairs.unwrap_or(0) as f64;
    Estimate {
        milliseconds: (BASE_MS + FACE_MS * faces + repair).round() as u64,
        memory_bytes: (BASE_BYTES + FACE_BYTES * faces + PAIR_BYTES * pairs) as u64,
    }
}

/// Expected milliseconds of a strategy that runs all operators.
fn repair_ms(before: &Measures) -> f64 {
    let pairs = before.self_intersections.pairs.unwrap_or(0) as f64;
    REPAIR_MS * before.faces as f64 + BOUNDARY_MS * before.boundary_edges as f64 + PAIR_MS * pairs
}

/// The shortest duration to expect of a strategy on an input with these counts. Zero for a strategy without a self-union: its operators
/// are fast, or check the deadline themselves.
pub(super) fn least_duration(strategy: &Strategy, before: &Measures) -> Duration {
    let unites = strategy.actions.iter().any(|planned| planned.operators.contains(&Operator::SelfUnion));
    let milliseconds = if unites { repair_ms(before) / MAX_SPEED_UP } else { 0.0 };
    Duration::from_secs_f64(milliseconds / 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inspect::SelfIntersections;
    use crate::repair::options::{Category, Options};
    use crate::repair::plan::make_plan;

    fn input(faces: u64, pairs: u64) -> Measures {
        let self_intersections = SelfIntersections { pairs: Some(pairs), ..SelfIntersections::default() };
        Measures { faces, self_intersections, ..Measures::default() }
    }

    #[test]
    fn an_estimate_grows_with_faces_and_intersections_and_is_less_for_kept_inputs() {
        let of = |faces, pairs, keeps_input| estimate(&input(faces, pairs), keeps_input);
        assert!(of(12, 0, true).milliseconds < 20);
        assert!(of(1_000_000, 0, true).milliseconds > 100 * of(12, 0, true).milliseconds);
        assert!(of(10_000, 0, true).milliseconds < of(10_000, 0, false).milliseconds);
        assert!(of(10_000, 5_000, false).milliseconds > 2 * of(10_000, 0, false).milliseconds);
        assert!(of(1_000_000, 0, true).memory_bytes > 10 * of(12, 0, true).memory_bytes);
    }

    #[test]
    fn only_strategies_with_a_self_union_have_a_least_duration() {
        let before = input(10_000, 100_000);
        let plan = make_plan(&before, Category::SelfIntersecting, false, &Options::default());
        let durations: Vec<Duration> = plan.strategies.iter().map(|s| least_duration(s, &before)).collect();
        assert!(durations[0] > Duration::from_secs(3), "{durations:?}");
        assert!(durations.contains(&Duration::ZERO), "{durations:?}");
    }
}
