//! The agreement of independent methods on a red flag, which shows that the input causes the flag.
//!
//! Such a flag becomes an assumption, and methods that would raise the same flag again need not run.

use super::judge::Judged;
use super::options::Operator;
use super::presets::remesh_of;
use super::report::{Assumption, AssumptionKind, RedFlag, RedFlagCode, Strategy};

/// Percentage points by which two results may differ in lost surface, or in volume, and still agree.
const SAME_LOSS: f64 = 0.3;
const SAME_VOLUME: f64 = 1.0;

/// The independent methods that separate inside from outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Method {
    /// The exact arrangement of the input's faces.
    Arrangement,
    /// Winding numbers on a grid.
    Grid,
    /// A remesh with Blender.
    Blender,
}

impl Method {
    /// The method of a strategy; none if the strategy uses no such method.
    pub fn of(strategy: &Strategy) -> Option<Self> {
        let runs = |operator| strategy.actions.iter().any(|planned| planned.operators.contains(&operator));
        if remesh_of(strategy).is_some() {
            Some(Self::Blender)
        } else if runs(Operator::Remesh) {
            Some(Self::Grid)
        } else {
            runs(Operator::SelfUnion).then_some(Self::Arrangement)
        }
    }
}

/// The red flags, with their values, that a method raised on its own printable result.
#[derive(Debug, Clone)]
pub(super) struct MethodFinding {
    method: Method,
    flags: Vec<(RedFlagCode, f64)>,
}

impl MethodFinding {
    /// The finding on a result; none if the result is not printable, has no red flags, or has flags that methods cannot agree on.
    pub fn of(strategy: &Strategy, judged: &Judged) -> Option<Self> {
        let flags = measured(judged);
        let comparable = !flags.is_empty() && flags.iter().all(|&(code, _)| tolerance(code).is_some());
        let method = Method::of(strategy).filter(|_| comparable && judged.measures.printable())?;
        Some(Self { method, flags })
    }

    /// Whether the other finding is of another method and has the same red flags with about the same values.
    pub fn agrees_with(&self, other: &Self) -> bool {
        self.method != other.method && self.flags_agree(&other.flags)
    }

    /// Whether a result has the same red flags with the same values, within the precision of sampling.
    pub fn is_of(&self, judged: &Judged) -> bool {
        self.flags_agree(&measured(judged))
    }

    fn flags_agree(&self, other: &[(RedFlagCode, f64)]) -> bool {
        let same = |(a, b): (&(RedFlagCode, f64), &(RedFlagCode, f64))| {
            a.0 == b.0 && tolerance(a.0).is_some_and(|most| (a.1 - b.1).abs() <= most)
        };
        self.flags.len() == other.len() && self.flags.iter().zip(other).all(same)
    }
}

/// The red flags with their values. New surface is left out, because methods need not agree on it.
fn measured(judged: &Judged) -> Vec<(RedFlagCode, f64)> {
    let flags = judged.red_flags.iter().filter(|flag| flag.code != RedFlagCode::SurfaceInvented);
    flags.map(|flag| (flag.code, flag.value)).collect()
}

/// The tolerance for values of a red flag, in percentage points; none if methods cannot agree on this kind of flag.
fn tolerance(code: RedFlagCode) -> Option<f64> {
    match code {
        RedFlagCode::SurfaceLost => Some(SAME_LOSS),
        RedFlagCode::VolumeChange => Some(SAME_VOLUME),
        _ => None,
    }
}

/// Turns the red flag for lost surface into an assumption if independent methods agree on it and the surface still exists, now enclosed.
/// Other red flags stay: a person should look at missing surface or a changed volume.
pub(super) fn explain_by_agreement(judged: &mut Judged) {
    let (added_surface, flags): (Vec<RedFlag>, Vec<RedFlag>) =
        judged.red_flags.iter().cloned().partition(|flag| flag.code == RedFlagCode::SurfaceInvented);
    let encloses_only = |flag: &RedFlag| flag.code == RedFlagCode::SurfaceLost;
    if !judged.changes.keeps_visible_surface() || !flags.iter().all(encloses_only) {
        return;
    }
    judged.red_flags = added_surface;
    for flag in flags {
        let detail = format!(
            "{:.1} % of the surface now lies inside the result. Independent methods agree that closing the input encloses this surface.",
            flag.value
        );
        judged.assumptions.push(
            Assumption::new(AssumptionKind::MethodsAgree, 1, detail)
                .with_amount(flag.value)
                .unless(&format!("max_surface_lost_pct={}", flag.threshold)),
        );
    }
}
