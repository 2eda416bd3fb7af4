//! Keeps the outer skin of a model and fills the space inside, as the option `interior` asks.

use super::operator::{Applied, Counter, Operation, Scope};
use super::solid_skin::{SkinError, SkinOptions, solid_skin};
use crate::math::Precision;
use crate::mesh::Surface;
use crate::printing::skin::{DropReason, OuterSkinError};
use crate::repair::{Cancelled, Change, ChangeKind, Context, Interior, Preset};

/// Replaces a model by the boundary of all that air cannot reach from outside through openings wider than the seal.
///
/// ```text
///    +--- ---+        +-------+
///    |+--- -+|        |       |
///    ||     ||   ->   |       |
///    |+-----+|        |       |
///    +-------+        +-------+
/// ```
///
/// Precondition: welded; the surface may be open, intersect itself and have any orientation. Result: closed, oriented
/// outward, without intersections; faces of the outer skin stay. Leaves: a surface that encloses nothing.
#[derive(Debug, Clone, Copy)]
pub struct FillInterior {
    seal: Option<f64>,
    precision: Precision,
    /// Millimetres per unit of the model.
    millimetres: f64,
    /// The option that asks for a filled interior; `None` if the model itself called for it.
    requested_by: Option<&'static str>,
}

impl Operation<'_> for FillInterior {
    const FIXES: &'static [Counter] = &[
        Counter::BoundaryEdges,
        Counter::NonManifoldEdges,
        Counter::MisorientedEdges,
        Counter::PinchedVertices,
        Counter::DuplicateFaces,
    ];
    const MAY_RAISE: &'static [Counter] = &[Counter::DegenerateFaces];
    const IS_HEAVY: bool = true;

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let seal = scope.options.print.seal_mm.map(|seal| seal / scope.millimetres);
        let requested_by = match (scope.options.print.interior, scope.options.preset) {
            (Interior::Fill, _) => Some("interior"),
            (_, Preset::Generated) => Some("preset"),
            _ => None,
        };
        Self { seal, precision: scope.format.precision(), millimetres: scope.millimetres, requested_by }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let options = SkinOptions { seal: self.seal, precision: self.precision };
        let result = match solid_skin(surface, &options, context) {
            Ok(result) => result,
            Err(SkinError::Cancelled(stop) | SkinError::OuterSkin(OuterSkinError::Cancelled(stop))) => {
                return Err(stop);
            }
            Err(error) => return Ok(Applied { left: Some(self.refusal(&error)), ..Applied::default() }),
        };
        let is_inner = |reason| matches!(reason, DropReason::InnerShell | DropReason::InnerJunk);
        let inner = result.dropped.iter().filter(|piece| is_inner(piece.reason)).count() as u64;
        let sheets = result.dropped.iter().filter(|piece| piece.reason == DropReason::Sheet).count() as u64;
        let widest = result.sealed.iter().map(|place| place.width).fold(0.0, f64::max);
        let left = format!(
            "openings up to {:.4} wide were to be sealed; the widest sealed one is {widest:.4}; {:.2} % of the result's area is faces \
             of the input, unchanged",
            result.seal, result.kept_exactly_pct
        );
        let changes = Change::list([
            (ChangeKind::OpeningsSealed, result.sealed.len() as u64),
            (ChangeKind::InnerPiecesDropped, inner),
            (ChangeKind::SheetsInsideSolidsRemoved, sheets),
        ]);
        let reason = |filling: f64| {
            format!(
                "the model stays hollow, because its inside is open to the air through openings wider than {:.3} mm{}",
                result.seal * self.millimetres,
                self.advice(filling)
            )
        };
        let limited = self.requested_by.zip(result.filling_seal.map(reason)).into_iter().collect();
        *surface = result.surface;
        Ok(Applied { changes, left: Some(left), limited, ..Applied::default() })
    }
}

impl FillInterior {
    /// Why the interior is not filled, with lengths in millimetres, and what fills it.
    fn refusal(&self, error: &SkinError) -> String {
        match *error {
            SkinError::Wide { width, seal, filling } => {
                let [width, seal] = [width, seal].map(|length| length * self.millimetres);
                let advice = filling.map_or_else(|| format!("; try one above {width:.3}"), |seal| self.advice(seal));
                format!(
                    "an opening {width:.3} mm wide would have to be closed, which is too wide for a `seal_mm` of {seal:.3}{advice}"
                )
            }
            SkinError::Empty(seal) => SkinError::Empty(seal * self.millimetres).to_string() + " mm",
            _ => error.to_string(),
        }
    }

    /// Advice to set the seal that fills the model.
    fn advice(&self, filling: f64) -> String {
        format!("; set `seal_mm` to {:.3} to fill it", filling * self.millimetres)
    }
}
