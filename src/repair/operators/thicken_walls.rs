//! Thickens walls that are thinner than the options ask for.

use rustc_hash::FxHashSet;

use super::layer_union::LayerUnion;
use super::operator::{Applied, Counter, Operation, Scope};
use super::self_union::is_manifold_by_position;
use super::slivers::RemoveSlivers;
use crate::inspect::SearchedMesh;
use crate::mesh::{ClosedSurface, Surface};
use crate::printing::thickening::{
    Growth, PlaceResult, Thickened, ThickenedPlace, Thickening, ThickeningError, ThinReason,
};
use crate::printing::thickness::{
    FeatureKind, Space, ThinFeatures, ThinRegion, least_height, rounded_limit, thin_features,
};
use crate::repair::options::WallGrowth;
use crate::repair::{Cancelled, Change, ChangeKind, Context, ThinPlaceLeft, ThinPlaceReason, WallThickening};

/// Least gap without a process, as a share of the least wall.
const GAP: f64 = 0.5;
/// Most places that a step's note describes.
const MAX_NAMED: usize = 5;
/// Most places that a step lists.
const MAX_LISTED: usize = 100;

/// Unites a solid with a layer on its thin walls.
///
/// ```text
///                          +-----------------+
///    +-----------------+   |                 |
///    +-----------------+   |                 |
///                          +-----------------+
/// ```
///
/// Precondition: a closed surface without intersections, oriented outward. Result: no wall is thinner than the limit; faces
/// outside the layer stay. Leaves: walls that cannot grow, with the reasons.
#[derive(Debug, Clone, Copy)]
pub struct ThickenWalls {
    settings: Option<Thickening>,
    millimetres: f64,
}

impl Operation<'_> for ThickenWalls {
    const FIXES: &'static [Counter] = &[];
    const MAY_RAISE: &'static [Counter] = &[];
    const CHANGES_SOUND_MODEL: bool = true;

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let print = &scope.options.print;
        let settings = print.wall_to_reach_mm().map(|wall_mm| {
            let gap_mm = print.profile().map_or(GAP * wall_mm, |profile| profile.gap_mm.limit);
            Thickening {
                min_wall: wall_mm / scope.millimetres,
                growth: match print.wall_growth {
                    WallGrowth::Both => Growth::Both,
                    WallGrowth::Outward => Growth::Outward,
                    WallGrowth::Inward => Growth::Inward,
                },
                min_gap: gap_mm / scope.millimetres,
                precision: scope.format.precision(),
            }
        });
        Self { settings, millimetres: scope.millimetres }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let Some(settings) = self.settings else { return Ok(Applied::default()) };
        let closed = match ClosedSurface::try_from(&*surface) {
            Ok(closed) => closed,
            Err(open) => return Ok(Applied::unchanged(&open)),
        };
        let thickened = match settings.apply(closed, &LayerUnion, context) {
            Ok(thickened) => thickened,
            Err(ThickeningError::Cancelled(stop)) => return Err(stop),
            Err(error) => return Ok(Applied::unchanged(&error)),
        };
        let proved = thickened.places.iter().filter(|place| place.result == PlaceResult::Proved).count();
        let thin = if thickened.added_faces.is_empty() {
            measure(surface, &settings, context)?
        } else {
            let (result, thin) = measured_result(surface, &thickened, &settings, context)?;
            *surface = result;
            thin
        };
        let left = walls(&thin);
        let changes = Change::list([
            (ChangeKind::WallsThickened, proved as u64),
            (ChangeKind::ThroughHolesClosed, thickened.through_holes_closed),
            (ChangeKind::ThinWallsLeft, left as u64),
            (ChangeKind::FacesAdded, thickened.added_faces.len() as u64),
        ]);
        let named =
            thin.regions.iter().take(left.min(MAX_NAMED)).map(|region| self.in_words(region, &thickened.places));
        let mut named: Vec<String> = named.collect();
        if left > MAX_NAMED {
            named.push(format!("{} more places stay thin", left - MAX_NAMED));
        }
        if !thin.pairs.is_complete {
            named.push("some walls could not be measured: the model needs too many measurements".to_owned());
        }
        let left = (!named.is_empty()).then(|| named.join("; "));
        let thickening = Some(self.summary(&thickened, &thin.regions));
        let both = "walls with open air on both sides, such as plates, have no inner side and grew on both";
        let grew_on_both = thickened.grew_on_equal_sides && !thickened.added_faces.is_empty();
        let limited = grew_on_both.then(|| ("wall_growth", both.to_owned())).into_iter().collect();
        Ok(Applied { changes, left, limited, thickening, ..Applied::default() })
    }
}

/// The thin places of a result. A measurement that is independent of the thickening decides which walls are still thin.
fn measure(surface: &Surface, settings: &Thickening, context: &Context<'_>) -> Result<ThinFeatures, Cancelled> {
    thin_features(surface, rounded_limit(surface, settings.min_wall), Space::Material, context)
}

/// The number of thin walls. Sharp edges are none; they come last.
fn walls(thin: &ThinFeatures) -> usize {
    thin.regions.iter().filter(|region| region.kind != FeatureKind::SharpEdge).count()
}

/// A thickened surface with its thin places, without slivers if it is as good without them.
fn measured_result(
    input: &Surface,
    thickened: &Thickened,
    settings: &Thickening,
    context: &Context<'_>,
) -> Result<(Surface, ThinFeatures), Cancelled> {
    if let Some(result) = without_slivers(input, &thickened.surface, context)? {
        let thin = measure(&result, settings, context)?;
        if !thickened.is_proved || walls(&thin) == 0 {
            return Ok((result, thin));
        }
    }
    Ok((thickened.surface.clone(), measure(&thickened.surface, settings, context)?))
}

/// A thickened surface without the slivers that the union left: faces so thin that rounding decides where they face. The faces
/// of the input stay as they are. None if there are no slivers, or if the surface would not be as sound.
fn without_slivers(input: &Surface, thickened: &Surface, context: &Context<'_>) -> Result<Option<Surface>, Cancelled> {
    let of_input: FxHashSet<_> = (0..input.faces.len()).map(|face| input.face_key(face)).collect();
    let kept: Vec<bool> = (0..thickened.faces.len()).map(|face| of_input.contains(&thickened.face_key(face))).collect();
    let slivers = RemoveSlivers { tolerance: 1.0, max_deviation: least_height(thickened) };
    let mut result = thickened.clone();
    if slivers
        .apply_beside(&kept, &mut result, context)?
        .changes
        .iter()
        .all(|change| change.kind == ChangeKind::SliversLeft)
    {
        return Ok(None);
    }
    let searched = SearchedMesh::search(&result.to_soup(), None, context)?;
    let is_sound = searched.meeting_pairs().is_some_and(<[_]>::is_empty) && is_manifold_by_position(&result);
    Ok(is_sound.then_some(result))
}

impl ThickenWalls {
    /// What was added, and the regions that stay thin.
    fn summary(&self, thickened: &Thickened, regions: &[ThinRegion]) -> WallThickening {
        let left = |region: &ThinRegion| ThinPlaceLeft {
            at: region.at.to_array(),
            thickness_mm: region.least * self.millimetres,
            reason: code(reason_near(region, &thickened.places)),
        };
        WallThickening {
            added_faces: thickened.added_faces.len() as u64,
            added_volume_mm3: thickened.added_volume * self.millimetres.powi(3),
            max_deviation_mm: thickened.max_deviation * self.millimetres,
            through_holes_closed: thickened.through_holes_closed,
            left_count: regions.len() as u64,
            left: regions.iter().take(MAX_LISTED).map(left).collect(),
        }
    }

    /// The sentence about a wall that stays thin, with the reason at the nearest place that was not thickened.
    fn in_words(&self, region: &ThinRegion, places: &[ThickenedPlace]) -> String {
        let [x, y, z] = region.at.to_array();
        let wall = region.least * self.millimetres;
        let reason = reason_near(region, places).map(in_words);
        let reason = reason.map_or_else(String::new, |reason| format!(": {reason}"));
        format!("a wall stays {wall:.3} mm thick at ({x:.6}, {y:.6}, {z:.6}){reason}")
    }
}

/// Why a region stays thin: a sharp edge by its kind, a wall by the nearest place that the thickening left.
fn reason_near(region: &ThinRegion, places: &[ThickenedPlace]) -> Option<ThinReason> {
    if region.kind == FeatureKind::SharpEdge {
        return Some(ThinReason::SharpEdge);
    }
    let reasons = places.iter().filter_map(|place| match place.result {
        PlaceResult::LeftThin(ThinReason::SharpEdge) | PlaceResult::Proved => None,
        PlaceResult::LeftThin(reason) => Some((place.at.distance_squared(region.at), reason)),
    });
    reasons.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, reason)| reason)
}

/// The reason in the report; undecided if the thickening knows of no place.
fn code(reason: Option<ThinReason>) -> ThinPlaceReason {
    match reason {
        Some(ThinReason::Gap | ThinReason::Topology) => ThinPlaceReason::Gap,
        Some(ThinReason::SharpEdge) => ThinPlaceReason::SharpEdge,
        Some(ThinReason::Time) => ThinPlaceReason::OutOfTime,
        Some(ThinReason::Union | ThinReason::Rounds) | None => ThinPlaceReason::Undecided,
    }
}

/// The reason why a wall stays thin, in words.
fn in_words(reason: ThinReason) -> &'static str {
    match reason {
        ThinReason::Gap => "a thicker wall would close a gap",
        ThinReason::SharpEdge => "the wall ends in a sharp edge",
        ThinReason::Topology => "a thicker wall would join parts or close a hole",
        ThinReason::Union => "the added layer could not be united exactly",
        ThinReason::Rounds => "the wall was still thin after the last round",
        ThinReason::Time => "the time ran out",
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    use super::*;
    use crate::context::NoProgress;
    use crate::mesh::Soup;
    use glam::DVec3;

    fn region(kind: FeatureKind) -> ThinRegion {
        let (at, faces) = (DVec3::X, Vec::new());
        ThinRegion { kind, faces, area: 1.0, least: 0.5, mean: 0.5, at, is_decided: true }
    }

    fn place(x: f64, result: PlaceResult) -> ThickenedPlace {
        ThickenedPlace { at: DVec3::X * x, least_before: 0.5, least_after: 0.5, area: 1.0, result }
    }

    #[test]
    fn a_wall_has_the_reason_of_the_nearest_wall_that_was_left() {
        let places = [
            place(1.0, PlaceResult::Proved),
            place(2.0, PlaceResult::LeftThin(ThinReason::Time)),
            place(9.0, PlaceResult::LeftThin(ThinReason::Gap)),
        ];
        assert_eq!(code(reason_near(&region(FeatureKind::FreeWall), &places)), ThinPlaceReason::OutOfTime);
        assert_eq!(code(reason_near(&region(FeatureKind::FreeWall), &places[..1])), ThinPlaceReason::Undecided);
    }

    #[test]
    fn a_sharp_edge_is_never_reported_as_a_wall() {
        let places = [place(1.0, PlaceResult::LeftThin(ThinReason::Gap))];
        assert_eq!(code(reason_near(&region(FeatureKind::SharpEdge), &places)), ThinPlaceReason::SharpEdge);
    }

    #[test]
    fn the_summary_is_in_millimetres_and_lists_the_first_places() {
        let thickened = Thickened {
            surface: Surface::default(),
            added_volume: 2.0,
            max_deviation: 3.0,
            through_holes_closed: 0,
            grew_on_equal_sides: false,
            places: Vec::new(),
            added_faces: vec![4, 5],
            is_proved: false,
        };
        let operator = ThickenWalls { settings: None, millimetres: 10.0 };
        let summary = operator.summary(&thickened, &vec![region(FeatureKind::Pin); MAX_LISTED + 1]);
        assert_eq!((summary.added_faces, summary.added_volume_mm3, summary.max_deviation_mm), (2, 2000.0, 30.0));
        assert_eq!((summary.left_count, summary.left.len()), (101, 100));
        assert_eq!((summary.left[0].at, summary.left[0].thickness_mm), ([1.0, 0.0, 0.0], 5.0));
    }

    #[test]
    fn slivers_of_the_union_go_and_the_faces_of_the_input_stay() {
        let mut soup = Soup { positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z], faces: Vec::new() };
        soup.positions.iter_mut().for_each(|p| *p *= 8.0);
        soup.faces = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
        let (input, _) = Surface::from_soup(&soup);
        // A vertex on an edge, so near its start that rounding decides where the faces beside it face.
        let mut united = input.clone();
        let ([start, end, _], near) = (input.faces[0], 4);
        united.positions.push(input.positions[end as usize].normalize() * 1e-6);
        for face in (0..4).filter(|&face| [start, end].iter().all(|vertex| input.faces[face].contains(vertex))) {
            united.faces[face] = input.faces[face].map(|vertex| if vertex == start { near } else { vertex });
            united.push_patch(input.faces[face].map(|vertex| if vertex == end { near } else { vertex }));
        }
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(60));
        let without = |surface: &Surface| without_slivers(&input, surface, &context).expect("not cancelled");
        let result = without(&united).expect("a surface without slivers");
        let keys = |surface: &Surface| (0..surface.faces.len()).map(|face| surface.face_key(face)).collect();
        let [before, after]: [FxHashSet<_>; 2] = [&input, &result].map(keys);
        assert_eq!(before, after);
        assert_eq!(without(&input), None);
    }
}
