use glam::DVec3;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::inspect::compare::unit_diagonal;
use crate::inspect::{Analysis, finite};

/// Angles for which the area is always told, in degrees from the vertical.
const DEGREES: [f64; 3] = [30.0, 45.0, 60.0];
/// How high above the lowest point a face still lies on the build plate, as a share of the diagonal.
const PLATE: f64 = 1e-6;
/// What the sine of a face's angle must exceed that of the limit by, so that faces at just the limit do not count.
const MORE: f64 = 1e-9;

/// Surface that faces down and may need support.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Overhang {
    /// The direction in which the model is built, of length 1.
    pub up: [f64; 3],
    /// The area that hangs over by more than each of some angles, by rising angle. What lies on the build plate is left out.
    pub beyond: Vec<OverhangArea>,
}

/// The area that hangs over by more than an angle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct OverhangArea {
    /// The angle from the vertical, in degrees: a wall has 0, a ceiling 90.
    pub degrees: f64,
    /// Area, in square units.
    pub area: f64,
    /// Share of the whole area, in percent.
    pub percent: f64,
}

/// Measures overhangs for the build direction `up`, of any length, at some fixed angles and at `degrees`. A direction that is
/// none counts as +z.
pub(super) fn overhang(analysis: &Analysis<'_>, up: [f64; 3], degrees: f64) -> Overhang {
    let up = DVec3::from(up);
    let largest = up.abs().max_element();
    let up = if largest > 0.0 && largest.is_finite() { (up / largest).normalize() } else { DVec3::Z };
    let mut limits = DEGREES.to_vec();
    limits.push(if degrees.is_nan() { DEGREES[1] } else { degrees.clamp(0.0, 90.0) });
    limits.sort_by(f64::total_cmp);
    limits.dedup();
    let unit = analysis.unit();
    let lowest = unit.iter().map(|p| p.dot(up)).fold(f64::INFINITY, f64::min);
    let plate = lowest + PLATE * unit_diagonal(analysis);
    let (mut whole, mut areas) = (0.0, vec![0.0; limits.len()]);
    let sines: Vec<f64> = limits.iter().map(|degrees| degrees.to_radians().sin() + MORE).collect();
    for face in &analysis.surface.faces {
        let [a, b, c] = face.map(|v| unit[v as usize]);
        let area = (b - a).cross(c - a) * 0.5;
        let size = area.length();
        whole += size;
        if size > 0.0 && [a, b, c].iter().any(|p| p.dot(up) > plate) {
            let down = -area.dot(up) / size;
            for (sum, _) in areas.iter_mut().zip(&sines).filter(|(_, sine)| down > **sine) {
                *sum += size;
            }
        }
    }
    let scale = analysis.scale();
    let beyond = limits.into_iter().zip(areas).map(|(degrees, area)| OverhangArea {
        degrees,
        area: finite(area / scale / scale),
        percent: if whole > 0.0 { area / whole * 100.0 } else { 0.0 },
    });
    Overhang { up: up.to_array(), beyond: beyond.collect() }
}
