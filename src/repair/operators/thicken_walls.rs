//! Thickens walls that are thinner than the options ask for.

use super::layer_union::LayerUnion;
use super::operator::{Applied, Counter, Operation, Scope};
use crate::mesh::Surface;
use crate::printing::thickening::{Growth, PlaceResult, Thickening, ThickeningError, ThinReason};
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
        let places = &thickened.places;
        let left = places.iter().filter_map(|place| match place.result {
            PlaceResult::Proved => None,
            PlaceResult::LeftThin(reason) => {
                let [x, y, z] = place.at.to_array();
                let wall = place.least_after * self.millimetres;
                Some(format!("a wall stays {wall:.3} mm thick at ({x:.6}, {y:.6}, {z:.6}): {}", in_words(reason)))
            }
        });
        let left: Vec<String> = left.collect();
        let changes = Change::list([
            (ChangeKind::WallsThickened, (places.len() - left.len()) as u64),
            (ChangeKind::ThinWallsLeft, left.len() as u64),
            (ChangeKind::FacesAdded, thickened.added_faces.len() as u64),
        ]);
        let named = left.into_iter().take(MAX_NAMED).reduce(|all, one| format!("{all}; {one}"));
        if !thickened.added_faces.is_empty() {
            *surface = thickened.surface;
        }
        Ok(Applied { changes, left: named, ..Applied::default() })
    }
}

/// Why a wall stays thin.
fn in_words(reason: ThinReason) -> &'static str {
    match reason {
        ThinReason::Gap => "a thicker wall would close a gap",
        ThinReason::SharpEdge => "the wall ends in a sharp edge",
        ThinReason::Topology => "a thicker wall would join parts or close a hole",
        ThinReason::Union => "the added layer could not be united exactly",
        ThinReason::Rounds => "three rounds did not suffice",
    }
}
