//! Thickens walls that are thinner than the options ask for.

use rustc_hash::FxHashSet;

use super::layer_union::LayerUnion;
use super::operator::{Applied, Counter, Operation, Scope};
use super::self_union::is_manifold_by_position;
use super::slivers::RemoveSlivers;
use crate::inspect::SearchedMesh;
use crate::mesh::{ClosedSurface, Surface, position_key};
use crate::printing::thickening::{
    Growth, PlaceResult, Thickened, ThickenedPlace, Thickening, ThickeningError, ThinReason,
};
use crate::printing::thickness::{
    Earlier, FeatureKind, Space, ThinFeatures, ThinRegion, least_height, rounded_limit, thin_features_after,
};
use crate::repair::options::WallGrowth;
use crate::repair::{Cancelled, Change, ChangeKind, Context, ThinPlaceLeft, ThinPlaceReason, WallThickening};

/// Least gap without a process, as a share of the least wall.
const GAP: f64 = 0.5;
/// Most times that slivers are removed, each time without those whose removal did damage.
const MAX_SLIVER_ROUNDS: usize = 3;
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
    const IS_HEAVY: bool = true;
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
            measure(surface, &thickened, &settings, context)?
        } else {
            let (result, thin) = measured_result(surface, &thickened, &settings, context)?;
            *surface = result;
            thin
        };
        let left = walls(&thin).count();
        let changes = Change::list([
            (ChangeKind::WallsThickened, proved as u64),
            (ChangeKind::ThroughHolesClosed, thickened.through_holes_closed),
            (ChangeKind::NarrowGapsFilled, thickened.narrow_gaps_filled),
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

/// The thin places of a surface that differs from the thickened one in places.
fn measure(
    surface: &Surface,
    thickened: &Thickened,
    settings: &Thickening,
    context: &Context<'_>,
) -> Result<ThinFeatures, Cancelled> {
    let earlier = Earlier { surface: &thickened.surface, pairs: &thickened.thin };
    thin_features_after(earlier, surface, rounded_limit(surface, settings.min_wall), Space::Material, context)
}

/// The thin walls. Sharp edges are none; they come last.
fn walls(thin: &ThinFeatures) -> impl Iterator<Item = &ThinRegion> {
    thin.regions.iter().filter(|region| region.kind != FeatureKind::SharpEdge)
}

/// A thickened surface with its thin places, without slivers if it is as good without them. Their removal takes half of the
/// time that is left at most.
fn measured_result(
    input: &Surface,
    thickened: &Thickened,
    settings: &Thickening,
    context: &Context<'_>,
) -> Result<(Surface, ThinFeatures), Cancelled> {
    let limited = context.limited_to(context.remaining() / 2);
    match context.unless_late(result_without_slivers(input, thickened, settings, &limited))?.flatten() {
        Some(result) => Ok(result),
        None => Ok((thickened.surface.clone(), measure(&thickened.surface, thickened, settings, context)?)),
    }
}

/// A thickened surface without slivers, with its thin places. Slivers whose removal makes faces intersect or walls thin stay.
/// None if all do.
fn result_without_slivers(
    input: &Surface,
    thickened: &Thickened,
    settings: &Thickening,
    context: &Context<'_>,
) -> Result<Option<(Surface, ThinFeatures)>, Cancelled> {
    let with_slivers = &thickened.surface;
    let of_input: FxHashSet<_> = (0..input.faces.len()).map(|face| input.face_key(face)).collect();
    let is_of_input = |face| of_input.contains(&with_slivers.face_key(face));
    let mut kept: Vec<bool> = (0..with_slivers.faces.len()).map(is_of_input).collect();
    for _ in 0..MAX_SLIVER_ROUNDS {
        let Some(result) = without_slivers(with_slivers, &kept, context)? else { break };
        let Some(mut damaged) = meeting_faces(&result, context)? else { break };
        if damaged.is_empty() {
            if !is_manifold_by_position(&result) {
                break;
            }
            let thin = measure(&result, thickened, settings, context)?;
            if !thickened.is_proved() || walls(&thin).next().is_none() {
                return Ok(Some((result, thin)));
            }
            damaged.extend(walls(&thin).flat_map(|region| &region.faces));
        }
        // A collapse leaves a vertex where it was, so the damaged faces have corners of the faces that caused the damage.
        let corners = damaged.into_iter().flat_map(|face| result.corners(face as usize));
        let corners: FxHashSet<_> = corners.map(position_key).collect();
        for (face, kept) in kept.iter_mut().enumerate() {
            *kept |= with_slivers.corners(face).into_iter().any(|corner| corners.contains(&position_key(corner)));
        }
    }
    Ok(None)
}

/// A surface without the slivers that a union left: faces so thin that rounding decides where they face. Faces marked in
/// `kept` stay as they are. None if no sliver can go.
fn without_slivers(surface: &Surface, kept: &[bool], context: &Context<'_>) -> Result<Option<Surface>, Cancelled> {
    let slivers = RemoveSlivers { tolerance: 1.0, max_deviation: least_height(surface) };
    let mut result = surface.clone();
    let changes = slivers.apply_beside(kept, &mut result, context)?.changes;
    Ok(changes.iter().any(|change| change.kind != ChangeKind::SliversLeft).then_some(result))
}

/// The faces that intersect others; none if not all are known.
fn meeting_faces(surface: &Surface, context: &Context<'_>) -> Result<Option<Vec<u32>>, Cancelled> {
    let searched = SearchedMesh::search(surface.to_soup(), None, context)?;
    Ok(searched.meeting_pairs().map(|pairs| pairs.iter().flat_map(|pair| pair.faces).collect()))
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
            narrow_gaps_filled: thickened.narrow_gaps_filled,
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
    use crate::math::Precision;
    use crate::mesh::Soup;
    use crate::printing::thickness::OpposedPairs;
    use glam::DVec3;

    fn region(kind: FeatureKind) -> ThinRegion {
        let (at, faces) = (DVec3::X, Vec::new());
        ThinRegion { kind, faces, area: 1.0, least: 0.5, mean: 0.5, at, is_decided: true }
    }

    fn place(x: f64, result: PlaceResult) -> ThickenedPlace {
        ThickenedPlace { at: DVec3::X * x, least_before: 0.5, least_after: 0.5, area: 1.0, result }
    }

    /// A thickening to a surface, in which the walls are not proved.
    fn thickened(surface: Surface) -> Thickened {
        Thickened {
            surface,
            added_volume: 2.0,
            max_deviation: 3.0,
            through_holes_closed: 0,
            narrow_gaps_filled: 0,
            grew_on_equal_sides: false,
            places: Vec::new(),
            added_faces: vec![4, 5],
            thin: OpposedPairs::default(),
        }
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
        let thickened = thickened(Surface::default());
        let operator = ThickenWalls { settings: None, millimetres: 10.0 };
        let summary = operator.summary(&thickened, &vec![region(FeatureKind::Pin); MAX_LISTED + 1]);
        assert_eq!((summary.added_faces, summary.added_volume_mm3, summary.max_deviation_mm), (2, 2000.0, 30.0));
        assert_eq!((summary.left_count, summary.left.len()), (101, 100));
        assert_eq!((summary.left[0].at, summary.left[0].thickness_mm), ([1.0, 0.0, 0.0], 5.0));
    }

    /// A tetrahedron with a right angle at the first of four corners.
    fn tetrahedron(corners: [DVec3; 4]) -> Soup {
        Soup { positions: corners.to_vec(), faces: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]] }
    }

    /// Splits the faces at the edge between two vertices by a new vertex, which gets a position.
    fn split_edge(surface: &mut Surface, [start, end]: [u32; 2], at: DVec3) {
        let new = u32::try_from(surface.positions.len()).expect("few vertices");
        surface.positions.push(at);
        for face in 0..surface.faces.len() {
            let corners = surface.faces[face];
            if corners.contains(&start) && corners.contains(&end) {
                surface.faces[face] = corners.map(|vertex| if vertex == start { new } else { vertex });
                surface.push_patch(corners.map(|vertex| if vertex == end { new } else { vertex }));
            }
        }
    }

    /// The result of a thickening of `input` to a surface, in which the walls are not proved.
    fn result(input: &Surface, surface: &Surface) -> Surface {
        let settings = Thickening { min_wall: 1e-3, growth: Growth::Both, min_gap: 0.0, precision: Precision::F32 };
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(60));
        measured_result(input, &thickened(surface.clone()), &settings, &context).expect("not cancelled").0
    }

    fn face_keys(surface: &Surface) -> FxHashSet<[[u64; 3]; 3]> {
        (0..surface.faces.len()).map(|face| surface.face_key(face)).collect()
    }

    #[test]
    fn slivers_of_the_union_go_and_the_faces_of_the_input_stay() {
        let (input, _) = Surface::from_soup(&tetrahedron([DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|p| p * 8.0)));
        // A vertex on an edge, so near its start that rounding decides where the faces beside it face.
        let mut united = input.clone();
        let [start, end, _] = input.faces[0];
        let along = input.positions[end as usize] - input.positions[start as usize];
        split_edge(&mut united, [start, end], input.positions[start as usize] + along.normalize() * 1e-6);
        assert_eq!(face_keys(&result(&input, &united)), face_keys(&input));
        assert_eq!(face_keys(&result(&input, &input)), face_keys(&input));
    }

    #[test]
    fn slivers_whose_removal_makes_faces_intersect_stay_and_others_go() {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|p| p * 8.0);
        // The tip of a needle is in a dent of an edge of the first solid, which is as small as a sliver.
        let needle = [[5e-7, 1e-7, 1e-7], [0.0, -1.2, -1.0], [-0.1, -1.0, -1.2], [0.1, -1.0, -1.2]].map(DVec3::from);
        let mut soup = Soup { positions: Vec::new(), faces: Vec::new() };
        for solid in [corners, corners.map(|p| p + DVec3::X * 20.0), needle] {
            let (first, solid) = (u32::try_from(soup.positions.len()).expect("few vertices"), tetrahedron(solid));
            soup.positions.extend(solid.positions);
            soup.faces.extend(solid.faces.into_iter().map(|face| face.map(|vertex| vertex + first)));
        }
        let (input, _) = Surface::from_soup(&soup);
        let vertex = |p: DVec3| input.positions.iter().position(|&q| q == p).expect("a corner") as u32;
        let edge = |x: f64| [vertex(DVec3::X * x), vertex(DVec3::X * (x + 8.0))];
        let mut united = input.clone();
        split_edge(&mut united, edge(0.0), DVec3::new(1e-6, 4e-7, 4e-7));
        let with_dent = face_keys(&united);
        split_edge(&mut united, edge(20.0), DVec3::new(20.0 + 1e-6, 0.0, 0.0));
        assert_eq!(face_keys(&result(&input, &united)), with_dent);
    }
}
