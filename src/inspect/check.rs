use serde::{Deserialize, Serialize};

use super::{DefectKind, Findings, Level, Measures};

/// A rule of Parasolid's mesh checking (seed 002, 86.4), as far as it concerns a mesh by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum CheckRule {
    /// From level basic on: no edge of more than two faces and no vertex of more than one fan.
    Manifold,
    /// From level basic on: no degenerate face, which has an edge of zero length.
    NoZeroLengthEdge,
    /// From level basic on: no flat face, which has zero area.
    NoZeroAreaFace,
    /// From level basic on: no vertex normal that is opposed to all faces that it belongs to.
    NoOpposedVertexNormal,
    /// At level full: no slit.
    NoSlit,
    /// At level full: no self-intersection.
    NoSelfIntersection,
}

impl CheckRule {
    /// The rules of a level.
    #[must_use]
    pub fn of(level: Level) -> &'static [Self] {
        const ALL: [CheckRule; 6] = [
            CheckRule::Manifold,
            CheckRule::NoZeroLengthEdge,
            CheckRule::NoZeroAreaFace,
            CheckRule::NoOpposedVertexNormal,
            CheckRule::NoSlit,
            CheckRule::NoSelfIntersection,
        ];
        match level {
            Level::None => &[],
            Level::Basic => &ALL[..4],
            Level::Full => &ALL,
        }
    }
}

/// Whether a mesh keeps the rules of a check level. A mesh that [`Measures::printable`] passes keeps them all.
///
/// A rule is broken by what is exactly so: an edge without length, a face without area, a slit. What is so within the tolerances only,
/// such as a face lower than a ten-millionth of the model, is advice: no reader takes it for broken, and to remove it may move surface
/// into other surface. Normals of the file are advice too, since slicers compute their own.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CheckVerdict {
    /// Every rule was checked, and none is broken.
    pub passes: bool,
    /// The rules that are broken.
    pub broken: Vec<CheckRule>,
    /// The rules that are kept exactly, but not within the tolerances, or by the normals that the file gives.
    #[serde(default)]
    pub advice: Vec<CheckRule>,
    /// The rules that could not be decided: nothing against them was found, but the search was not finished.
    pub undecided: Vec<CheckRule>,
}

impl CheckVerdict {
    /// Judges a mesh by what was found at a level; none at level none, which checks nothing.
    #[must_use]
    pub fn new(level: Level, measures: &Measures, findings: &Findings) -> Option<Self> {
        let rules = CheckRule::of(level);
        let found = |kinds: &[DefectKind]| kinds.iter().map(|&kind| findings.count(kind)).sum::<u64>();
        let finished = |kind| !findings.incomplete().contains(&kind);
        let (mut broken, mut advice, mut undecided) = (Vec::new(), Vec::new(), Vec::new());
        for &rule in rules {
            let near = match rule {
                CheckRule::NoZeroLengthEdge => found(&[DefectKind::DegenerateFace]),
                CheckRule::NoZeroAreaFace => found(&[DefectKind::FlatFace]),
                CheckRule::NoOpposedVertexNormal => found(&[DefectKind::BadVertexNormal]),
                _ => 0,
            };
            let (count, decided) = match rule {
                CheckRule::Manifold => (found(&[DefectKind::NonManifoldEdge, DefectKind::NonManifoldVertex]), true),
                CheckRule::NoZeroLengthEdge => (measures.near_coincident_defects + collapsed(findings), true),
                CheckRule::NoZeroAreaFace => (measures.degenerate_faces, true),
                CheckRule::NoOpposedVertexNormal => (0, true),
                CheckRule::NoSlit => {
                    (measures.unshared_edges.max(found(&[DefectKind::Slit])), finished(DefectKind::Slit))
                }
                CheckRule::NoSelfIntersection => {
                    let intersections = &measures.self_intersections;
                    let count = intersections.pairs.unwrap_or(0).max(found(&[DefectKind::SelfIntersection]));
                    (count, intersections.checked && finished(DefectKind::SelfIntersection))
                }
            };
            if count > 0 {
                broken.push(rule);
            } else if !decided {
                undecided.push(rule);
            } else if near > 0 {
                advice.push(rule);
            }
        }
        let passes = broken.is_empty() && undecided.is_empty();
        (!rules.is_empty()).then_some(Self { passes, broken, advice, undecided })
    }
}

/// Faces that have a vertex twice; there may be more where places were not kept.
fn collapsed(findings: &Findings) -> u64 {
    findings.places(DefectKind::DegenerateFace).iter().filter(|place| place.value == Some(0.0)).count() as u64
}

#[cfg(test)]
mod tests {
    use super::super::{Defect, SelfIntersections};
    use super::*;

    fn found(kinds: &[DefectKind]) -> Findings {
        let mut findings = Findings::new(1, 1);
        for &kind in kinds {
            let defect = Defect { at: [0.0; 3], faces: vec![0], line: Vec::new(), value: None, meeting: None };
            findings.push(kind, defect);
        }
        findings
    }

    fn verdict(level: Level, findings: &Findings) -> Option<CheckVerdict> {
        let self_intersections =
            SelfIntersections { checked: true, complete: true, pairs: Some(0), ..SelfIntersections::default() };
        CheckVerdict::new(level, &Measures { self_intersections, ..Measures::default() }, findings)
    }

    #[test]
    fn each_level_has_the_rules_of_its_table() {
        use DefectKind as K;
        let table = [
            (K::NonManifoldEdge, CheckRule::Manifold, true),
            (K::NonManifoldVertex, CheckRule::Manifold, true),
            (K::Slit, CheckRule::NoSlit, false),
            (K::SelfIntersection, CheckRule::NoSelfIntersection, false),
        ];
        for kind in K::ALL {
            let findings = found(&[kind]);
            let rule = table.iter().find(|row| row.0 == kind);
            let broken = |level| verdict(level, &findings).map(|v| (v.passes, v.broken));
            let expected = |holds: bool| rule.filter(|_| holds).map_or(vec![], |row| vec![row.1]);
            let [basic, full] = [expected(rule.is_some_and(|row| row.2)), expected(true)];
            assert_eq!(broken(Level::None), None);
            assert_eq!(broken(Level::Basic), Some((basic.is_empty(), basic)), "{kind:?}");
            assert_eq!(broken(Level::Full), Some((full.is_empty(), full)), "{kind:?}");
        }
    }

    #[test]
    fn what_is_so_within_the_tolerances_only_is_advice() {
        use DefectKind as K;
        for (kind, rule) in [
            (K::DegenerateFace, CheckRule::NoZeroLengthEdge),
            (K::FlatFace, CheckRule::NoZeroAreaFace),
            (K::BadVertexNormal, CheckRule::NoOpposedVertexNormal),
        ] {
            let full = verdict(Level::Full, &found(&[kind])).map(|v| (v.passes, v.broken, v.advice));
            assert_eq!(full, Some((true, vec![], vec![rule])));
        }
    }

    #[test]
    fn a_search_that_was_given_up_passes_nothing() {
        let mut findings = found(&[]);
        findings.mark_incomplete(DefectKind::Slit);
        let full = verdict(Level::Full, &findings);
        assert_eq!(full.map(|v| (v.passes, v.undecided)), Some((false, vec![CheckRule::NoSlit])));
        let unchecked = CheckVerdict::new(Level::Full, &Measures::default(), &found(&[]));
        assert_eq!(unchecked.map(|v| (v.passes, v.undecided)), Some((false, vec![CheckRule::NoSelfIntersection])));
    }
}
