//! Verdict whether a mesh keeps the rules of an inspection level.

use serde::{Deserialize, Serialize};

use super::{DefectKind, Findings, Level, Measures};

/// A rule of Parasolid's mesh check that applies to a single mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum CheckRule {
    /// From level `basic`: no edge with more than two faces and no vertex with more than one fan.
    Manifold,
    /// From level `basic`: no degenerate face, that is, no edge of zero length.
    NoZeroLengthEdge,
    /// From level `basic`: no flat face, that is, no face of zero area.
    NoZeroAreaFace,
    /// From level `basic`: no vertex normal that opposes the normals of all faces at the vertex.
    NoOpposedVertexNormal,
    /// At level `full`: no slit.
    NoSlit,
    /// At level `full`: no self-intersection.
    NoSelfIntersection,
}

impl CheckRule {
    /// The rules that a level checks.
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

/// Result of checking a mesh against the rules of its inspection level. A printable mesh breaks no rule.
///
/// Only an exact violation breaks a rule: an edge of zero length, a face of zero area, a slit. A violation within the
/// tolerances, such as a face lower than 1e-7 of the diagonal, is advice. No reader rejects such a face, and removing
/// the face can move surface into other surface. Bad normals are advice too, since slicers compute their own.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CheckVerdict {
    /// Whether every rule was checked and none is broken.
    pub passes: bool,
    /// Broken rules.
    pub broken: Vec<CheckRule>,
    /// Rules that hold exactly but fail within the tolerances, or that the file's normals violate.
    #[serde(default)]
    pub advice: Vec<CheckRule>,
    /// Rules without a verdict: the search found no violation but stopped early.
    pub undecided: Vec<CheckRule>,
}

impl CheckVerdict {
    /// Judges a mesh by its measures and findings. Returns `None` at level `none`, which has no rules.
    #[must_use]
    pub fn new(level: Level, measures: &Measures, findings: &Findings) -> Option<Self> {
        let rules = CheckRule::of(level);
        let count_of = |kinds: &[DefectKind]| kinds.iter().map(|&kind| findings.count(kind)).sum::<u64>();
        let finished = |kind| !findings.incomplete().contains(&kind);
        let (mut broken, mut advice, mut undecided) = (Vec::new(), Vec::new(), Vec::new());
        for &rule in rules {
            let within_tolerance = match rule {
                CheckRule::NoZeroLengthEdge => count_of(&[DefectKind::DegenerateFace]),
                CheckRule::NoZeroAreaFace => count_of(&[DefectKind::FlatFace]),
                CheckRule::NoOpposedVertexNormal => count_of(&[DefectKind::BadVertexNormal]),
                _ => 0,
            };
            let (count, decided) = match rule {
                CheckRule::Manifold => (count_of(&[DefectKind::NonManifoldEdge, DefectKind::NonManifoldVertex]), true),
                CheckRule::NoZeroLengthEdge => (measures.near_coincident_defects + collapsed(findings), true),
                CheckRule::NoZeroAreaFace => (measures.degenerate_faces, true),
                CheckRule::NoOpposedVertexNormal => (0, true),
                CheckRule::NoSlit => {
                    (measures.unshared_edges.max(count_of(&[DefectKind::Slit])), finished(DefectKind::Slit))
                }
                CheckRule::NoSelfIntersection => {
                    let intersections = &measures.self_intersections;
                    let count = intersections.pairs.unwrap_or(0).max(count_of(&[DefectKind::SelfIntersection]));
                    (count, intersections.checked && finished(DefectKind::SelfIntersection))
                }
            };
            if count > 0 {
                broken.push(rule);
            } else if !decided {
                undecided.push(rule);
            } else if within_tolerance > 0 {
                advice.push(rule);
            }
        }
        let passes = broken.is_empty() && undecided.is_empty();
        (!rules.is_empty()).then_some(Self { passes, broken, advice, undecided })
    }
}

/// Number of listed faces with a repeated vertex. A lower bound where the findings do not keep all places.
fn collapsed(findings: &Findings) -> u64 {
    findings.places(DefectKind::DegenerateFace).iter().filter(|place| place.value == Some(0.0)).count() as u64
}

#[cfg(test)]
mod tests {
    use super::super::{Defect, SelfIntersections};
    use super::*;

    fn findings_with(kinds: &[DefectKind]) -> Findings {
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
            let findings = findings_with(&[kind]);
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
    fn violations_within_the_tolerances_are_advice() {
        use DefectKind as K;
        for (kind, rule) in [
            (K::DegenerateFace, CheckRule::NoZeroLengthEdge),
            (K::FlatFace, CheckRule::NoZeroAreaFace),
            (K::BadVertexNormal, CheckRule::NoOpposedVertexNormal),
        ] {
            let full = verdict(Level::Full, &findings_with(&[kind])).map(|v| (v.passes, v.broken, v.advice));
            assert_eq!(full, Some((true, vec![], vec![rule])));
        }
    }

    #[test]
    fn an_incomplete_search_leaves_its_rule_undecided() {
        let mut findings = findings_with(&[]);
        findings.mark_incomplete(DefectKind::Slit);
        let full = verdict(Level::Full, &findings);
        assert_eq!(full.map(|v| (v.passes, v.undecided)), Some((false, vec![CheckRule::NoSlit])));
        let unchecked = CheckVerdict::new(Level::Full, &Measures::default(), &findings_with(&[]));
        assert_eq!(unchecked.map(|v| (v.passes, v.undecided)), Some((false, vec![CheckRule::NoSelfIntersection])));
    }
}
