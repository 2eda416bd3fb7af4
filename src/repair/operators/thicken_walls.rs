//! Thickens walls that are thinner than the options ask for.

use super::layer_union::LayerUnion;
use super::operator::{Applied, Counter, Operation, Scope};
use crate::mesh::Surface;
use crate::printing::thickening::{Growth, PlaceResult, ThickenedPlace, Thickening, ThickeningError, ThinReason};
use crate::printing::thickness::{FeatureKind, Space, ThinRegion, rounded_limit, thin_features};
use crate::repair::options::WallGrowth;
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// Least gap without a process, as a share of the least wall.
const GAP: f64 = 0.5;
/// Most places that a step's note describes.
const MAX_NAMED: usize = 5;

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

impl Operation for ThickenWalls {
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
        let thickened = match settings.apply(surface, &LayerUnion, context) {
            Ok(thickened) => thickened,
            Err(ThickeningError::Cancelled(stop)) => return Err(stop),
            Err(error) => return Ok(Applied { left: Some(error.to_string()), ..Applied::default() }),
        };
        let proved = thickened.places.iter().filter(|place| place.result == PlaceResult::Proved).count();
        if !thickened.added_faces.is_empty() {
            *surface = thickened.surface;
        }
        // A measurement that is independent of the thickening decides which walls are still thin.
        let limit = rounded_limit(surface, settings.min_wall);
        let thin = thin_features(surface, limit, Space::Material, context)?;
        let left: Vec<&ThinRegion> =
            thin.regions.iter().filter(|region| region.kind != FeatureKind::SharpEdge).collect();
        let changes = Change::list([
            (ChangeKind::WallsThickened, proved as u64),
            (ChangeKind::ThinWallsLeft, left.len() as u64),
            (ChangeKind::FacesAdded, thickened.added_faces.len() as u64),
        ]);
        let named = left.iter().take(MAX_NAMED).map(|region| self.thin_in_words(region, &thickened.places));
        let mut named: Vec<String> = named.collect();
        if left.len() > MAX_NAMED {
            named.push(format!("{} more places stay thin", left.len() - MAX_NAMED));
        }
        if !thin.pairs.is_complete {
            named.push("some walls could not be measured: the model needs too many measurements".to_owned());
        }
        let left = (!named.is_empty()).then(|| named.join("; "));
        Ok(Applied { changes, left, ..Applied::default() })
    }
}

impl ThickenWalls {
    /// The sentence about a wall that stays thin, with the reason at the nearest place that was not thickened.
    fn thin_in_words(&self, region: &ThinRegion, places: &[ThickenedPlace]) -> String {
        let [x, y, z] = region.at.to_array();
        let wall = region.least * self.millimetres;
        let reasons = places.iter().filter_map(|place| match place.result {
            PlaceResult::LeftThin(reason) => Some((place.at.distance_squared(region.at), reason)),
            PlaceResult::Proved => None,
        });
        let reason = reasons.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, reason)| in_words(reason));
        let reason = reason.map_or_else(String::new, |reason| format!(": {reason}"));
        format!("a wall stays {wall:.3} mm thick at ({x:.6}, {y:.6}, {z:.6}){reason}")
    }
}

/// The reason why a wall stays thin, in words.
fn in_words(reason: ThinReason) -> &'static str {
    match reason {
        ThinReason::Gap => "a thicker wall would close a gap",
        ThinReason::SharpEdge => "the wall ends in a sharp edge",
        ThinReason::Topology => "a thicker wall would join parts or close a hole",
        ThinReason::Union => "the added layer could not be united exactly",
        ThinReason::Rounds => "the wall was still thin after three rounds",
    }
}
