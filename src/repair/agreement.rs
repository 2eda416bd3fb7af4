use super::climb::remesh_of;
use super::verdict::Judged;
use super::{Assumption, AssumptionKind, Operator, RedFlag, RedFlagCode, Rung};

/// By how many percentage points two results may differ in the surface that they lost, or in the volume, and still agree.
const SAME_LOSS: f64 = 0.3;
const SAME_VOLUME: f64 = 1.0;

/// The kinds of method that tell inside from outside, each by its own means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Method {
    /// The exact arrangement, on the input's own faces.
    Arrangement,
    /// Winding numbers on a grid.
    Grid,
    /// Blender.
    Blender,
}

impl Method {
    /// The method of a rung; none where it decides nothing of the kind.
    pub fn of(rung: &Rung) -> Option<Self> {
        let runs = |operator| rung.actions.iter().any(|planned| planned.operators.contains(&operator));
        if remesh_of(rung).is_some() {
            Some(Self::Blender)
        } else if runs(Operator::Remesh) {
            Some(Self::Grid)
        } else {
            runs(Operator::Resolve).then_some(Self::Arrangement)
        }
    }
}

/// What a method found wrong with its own printable result.
#[derive(Debug, Clone)]
pub(super) struct Testimony {
    method: Method,
    flags: Vec<(RedFlagCode, f64)>,
}

impl Testimony {
    /// The flags of a result, where it is printable and they are of a kind on which methods may agree.
    pub fn of(rung: &Rung, judged: &Judged) -> Option<Self> {
        let flags = measured(judged);
        let comparable = !flags.is_empty() && flags.iter().all(|&(code, _)| tolerance(code).is_some());
        let method = Method::of(rung).filter(|_| comparable && judged.measures.printable())?;
        Some(Self { method, flags })
    }

    /// Whether a method of another kind came to the same measures.
    pub fn agrees_with(&self, other: &Self) -> bool {
        self.method != other.method && self.flags_agree(&other.flags)
    }

    /// Whether another result has the same flags with the same values, within what sampling tells.
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

/// The flags with their values, but for invented surface, on which methods need not agree.
fn measured(judged: &Judged) -> Vec<(RedFlagCode, f64)> {
    let flags = judged.red_flags.iter().filter(|flag| flag.code != RedFlagCode::SurfaceInvented);
    flags.map(|flag| (flag.code, flag.value)).collect()
}

fn tolerance(code: RedFlagCode) -> Option<f64> {
    match code {
        RedFlagCode::SurfaceLost => Some(SAME_LOSS),
        RedFlagCode::VolumeChange => Some(SAME_VOLUME),
        _ => None,
    }
}

/// Makes an assumption of the flag for lost surface, on which methods of different kind agree, where the surface still stands and is
/// only enclosed now. Any other flag stays: surface that is gone, or volume that changed, is for a person to look at.
pub(super) fn explain_by_agreement(judged: &mut Judged) {
    let (invented, flags): (Vec<RedFlag>, Vec<RedFlag>) =
        judged.red_flags.iter().cloned().partition(|flag| flag.code == RedFlagCode::SurfaceInvented);
    let encloses_only = |flag: &RedFlag| flag.code == RedFlagCode::SurfaceLost;
    if !judged.changes.keeps_visible_surface() || !flags.iter().all(encloses_only) {
        return;
    }
    judged.red_flags = invented;
    for flag in flags {
        let detail = format!(
            "{:.1} % of the surface lies within the result: methods of different kind agree that closing the input encloses it",
            flag.value
        );
        judged.assumptions.push(
            Assumption::new(AssumptionKind::MethodsAgree, 1, detail)
                .with_amount(flag.value)
                .unless(&format!("max_surface_lost_pct={}", flag.threshold)),
        );
    }
}

/// The assumption for a volume that would raise a flag by its figure, while winding numbers find the same inside before and after.
pub(super) fn same_inside(judged: &Judged, most_pct: f64) -> Option<Assumption> {
    let change = judged.changes.volume_change_pct.filter(|change| change.abs() > most_pct)?;
    let overlap = judged.changes.inside_overlap_pct?;
    let flagged = judged.red_flags.iter().any(|flag| flag.code == RedFlagCode::VolumeChange);
    (!flagged).then(|| {
        let detail = format!(
            "the volume by its faces changed by {change:.1} %, since it counts space twice where parts overlap; by winding numbers \
             {overlap:.1} % of the inside is the same"
        );
        Assumption::new(AssumptionKind::MethodsAgree, 1, detail).with_amount(change)
    })
}
