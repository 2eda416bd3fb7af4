//! Evidence for each side of a facet: whether a ball that touches it comes from outside.

use glam::DVec3;

use crate::arrange::FacetSides;
use crate::context::{Cancelled, Context};
use crate::math::{Tree, hit};
use crate::printing::reach::{Reach, Reached};

/// Least clearance of a touching ball's centre, as a share of its radius: rough surface intrudes a little.
const MIN_CLEARANCE: f64 = 0.9;
/// Distances from a facet at which centres of balls are looked for, in radii.
const DISTANCES: [f64; 3] = [1.0, 1.5, 2.0];
/// Barycentric weights of the points at which a ball may touch a facet.
const TOUCHES: [[f64; 3]; 4] = [[1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0], [0.6, 0.2, 0.2], [0.2, 0.6, 0.2], [0.2, 0.2, 0.6]];
/// Boxes and facets that one query may visit.
const STEPS: u64 = 1 << 20;

/// What the ball says about a side.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Evidence {
    /// A ball from outside touches the side.
    Outer,
    /// A ball that fits, but cannot come from outside, touches the side.
    Hidden,
    /// No ball touches the side, but the centre of one from outside is in sight straight ahead, within a diameter.
    SeesOuter,
    /// No ball touches the side, but the centre of one that cannot come from outside is in sight.
    SeesHidden,
    /// No ball is near in front of the side.
    None,
}

impl Evidence {
    /// How strong the evidence is, positive for outside air.
    pub fn weight(self) -> f64 {
        match self {
            Self::Outer => 1.0,
            Self::SeesOuter => 0.25,
            Self::None => 0.0,
            Self::SeesHidden => -0.25,
            Self::Hidden => -1.0,
        }
    }
}

/// The evidence for each side.
pub fn evidence(
    sides: &FacetSides,
    tree: &Tree,
    reach: &Reach,
    context: &Context<'_>,
) -> Result<Vec<Evidence>, Cancelled> {
    let facets: Vec<u32> = (0u32..).take(sides.corners.len()).collect();
    let found = context.map_in_parallel(&facets, |&facet| of_facet(sides, tree, reach, facet))?;
    Ok(found.into_iter().flatten().collect())
}

/// The evidence in front of and behind a facet.
fn of_facet(sides: &FacetSides, tree: &Tree, reach: &Reach, facet: u32) -> [Evidence; 2] {
    let normal = sides.area_vector(facet).normalize_or_zero();
    if normal == DVec3::ZERO {
        return [Evidence::None; 2];
    }
    let corners = sides.triangle(facet);
    let is_large = corners[0].distance(corners[1]).max(corners[1].distance(corners[2])) > reach.diameter();
    let touches = if is_large { &TOUCHES[..] } else { &TOUCHES[..1] };
    [normal, -normal].map(|direction| {
        let at = |weights: &[f64; 3]| (0..3).map(|i| corners[i] * weights[i]).sum::<DVec3>();
        let all = touches.iter().map(|weights| at_point(sides, tree, reach, (facet, at(weights), direction)));
        // Stronger evidence counts; of two kinds as strong, air from outside.
        all.fold(Evidence::None, |before, now| {
            let [a, b] = [before, now].map(Evidence::weight);
            if b.abs() > a.abs() || (b.abs() == a.abs() && b > a) { now } else { before }
        })
    })
}

/// The evidence at a point of a facet in a direction.
fn at_point(
    sides: &FacetSides,
    tree: &Tree,
    reach: &Reach,
    (facet, point, direction): (u32, DVec3, DVec3),
) -> Evidence {
    let radius = reach.diameter() / 2.0;
    let triangle = |f: u32| sides.triangle(f);
    let is_clear = |to: DVec3| {
        let mut is_clear = true;
        tree.along(point, to, |f| {
            is_clear = f == facet || hit(point, to - point, triangle(f)).is_none();
            is_clear
        });
        is_clear
    };
    for times in DISTANCES {
        let centre = point + direction * (radius * times);
        let [touches, sees] = match reach.at(centre) {
            Reached::Outside | Reached::Doubtful => [Evidence::Outer, Evidence::SeesOuter],
            Reached::Hidden(_) => [Evidence::Hidden, Evidence::SeesHidden],
            Reached::Blocked => continue,
        };
        if !is_clear(centre) {
            return Evidence::None;
        }
        let mut steps = STEPS;
        let is_near = tree.nearest(centre, radius * MIN_CLEARANCE, &mut steps, triangle).is_some() || steps == 0;
        return if times > 1.0 || is_near { sees } else { touches };
    }
    Evidence::None
}
