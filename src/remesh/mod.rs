//! Remeshing: builds a closed, manifold surface without self-intersections around the inside of any input. This is the
//! fallback that always terminates.
//!
//! Generalized winding numbers decide what is inside (Jacobson, Kavan and Sorkine-Hornung 2013), summed fast as by
//! Barill et al. (2018). The input may therefore have holes, overlaps and internal faces. The winding numbers are
//! sampled on a sparse grid along the surface. Dual contouring (Ju, Losasso, Schaefer and Warren 2002) builds the
//! result in a variant with three guarantees by construction:
//!
//! - The result is **closed**, because it separates the inside samples from the outside samples.
//! - The result is **manifold**, because the inside samples are first made well-composed (`corrections`): the surface
//!   passes through each cell in one disc.
//! - The result has **no self-intersections**, because each piece stays in the envelope of its own grid edge
//!   (`contour`). A later move of a vertex is made only if exact tests confirm that no intersection arises.

mod balls;
mod band;
mod contour;
mod corrections;
mod field;
mod grid;
mod region;
mod vertices;

use crate::context::{Cancelled, Context};
use crate::math::{Box3, Precision, Rounding, to_unit_range, unit_scale};
use crate::mesh::{NO_SOURCE, Surface};
use band::{Sampling, SamplingLimits, cells_met};
use field::{Field, Stop, deviation};
use grid::{Grid, GridIndex, Samples};

pub use crate::math::WindingRule;
pub use balls::{BallGrid, BallUnion};
pub use field::{Deviation, Distances, RemeshError};

/// Options of a remesh.
#[derive(Debug, Clone, Copy)]
pub struct Remesh {
    /// Edge length of a grid cell in the model's unit; increased if a limit requires it. The default is the diagonal of
    /// the bounding box divided by 512.
    pub cell: Option<f64>,
    /// Maximum number of faces of the result.
    pub max_faces: u64,
    /// Maximum memory of the samples, in bytes.
    pub max_memory: u64,
    /// The rule that decides what is inside.
    pub winding_rule: WindingRule,
    /// The precision to which positions are rounded, such as f32 for STL.
    pub precision: Precision,
}

impl Default for Remesh {
    fn default() -> Self {
        Self {
            cell: None,
            max_faces: 1_000_000,
            max_memory: 1 << 30,
            winding_rule: WindingRule::Positive,
            precision: Precision::F32,
        }
    }
}

/// The result of a remesh.
#[derive(Debug, Clone)]
pub struct Remeshed {
    /// The new surface: closed, manifold, oriented outward and free of self-intersections. Its faces have no source.
    pub surface: Surface,
    /// Edge length of the grid cells used, in the model's unit.
    pub cell: f64,
    /// Distance between the result and the input.
    pub deviation: Deviation,
    /// Number of samples forced inside, to preserve thin parts and to keep the surface manifold.
    pub forced_inside: u64,
}

/// Cells along the diagonal by default.
const DEFAULT_RESOLUTION: f64 = 512.0;
/// Maximum number of cells along the diagonal.
pub(crate) const FINEST: f64 = 2048.0;
/// Minimum number of cells along the diagonal.
const MIN_RESOLUTION: f64 = 8.0;
/// Cells along the diagonal in the coarse trial that estimates the cost of finer ones.
const TRIAL: f64 = 48.0;
/// Maximum boxes and triangles visited in one attempt.
const STEPS: u64 = 6_000_000_000;
/// Factor by which cells grow after an attempt exceeded its budget.
const CELL_GROWTH: f64 = 1.5;

impl Remesh {
    /// Remeshes a surface.
    ///
    /// # Errors
    /// [`RemeshError`]. Any input with an inside gives a result unless the work is cancelled or the limits are too low.
    pub fn apply(&self, surface: &Surface, context: &Context<'_>) -> Result<Remeshed, RemeshError> {
        let points = to_unit_range(&surface.positions);
        let scale = unit_scale(&surface.positions);
        let has_area = |face: &[u32; 3]| {
            let [a, b, c] = face.map(|v| points[v as usize]);
            (b - a).cross(c - a).length_squared() > 0.0
        };
        let faces: Vec<[u32; 3]> = surface.faces.iter().copied().filter(has_area).collect();
        let bounds = Box3::of_faces(&points, &faces);
        let diagonal = bounds.diagonal();
        if faces.is_empty() || diagonal <= 0.0 {
            return Err(RemeshError::Empty);
        }
        context.check()?;
        let field = Field::new(&points, &faces, self.winding_rule);
        let input = Input { field, bounds, rounding: Rounding { scale, precision: self.precision } };
        let requested = self.cell.map_or(diagonal / DEFAULT_RESOLUTION, |cell| cell * scale);
        let requested = requested.clamp(diagonal / FINEST, diagonal / MIN_RESOLUTION);
        let mut cell = self.affordable(&input, requested, context)?;
        loop {
            match self.attempt(&input, cell, context) {
                Ok(Some(mut result)) => {
                    for p in &mut result.surface.positions {
                        *p /= scale;
                    }
                    result.cell /= scale;
                    let Deviation { lost, added } = &mut result.deviation;
                    (*lost, *added) = (lost.scaled(1.0 / scale), added.scaled(1.0 / scale));
                    return Ok(result);
                }
                Ok(None) => return Err(RemeshError::Empty),
                Err(Stop::Cancelled(canceled)) => return Err(canceled.into()),
                Err(_) if cell * MIN_RESOLUTION > diagonal => return Err(RemeshError::Limits),
                Err(Stop::Budget) => cell *= CELL_GROWTH,
                Err(Stop::Faces(faces)) => {
                    cell *= (faces as f64 / self.max_faces as f64).sqrt().max(1.0) * 1.02;
                }
            }
        }
    }

    /// One attempt with a given cell size; none if nothing is inside.
    fn attempt(&self, input: &Input<'_>, cell: f64, context: &Context<'_>) -> Result<Option<Remeshed>, Stop> {
        let Sampled { mut sampling, cells, forced } = self.sampled(input, cell, context)?;
        if cells.is_empty() {
            return Ok(None);
        }
        let rounding = input.rounding;
        let (vertices, mut contour) = contour::unmoved_contour(&mut sampling, &cells, self.max_faces, rounding)?;
        let faces = contour.faces.len() as u64;
        if faces > self.max_faces {
            return Err(Stop::Faces(faces));
        }
        contour::move_out(&sampling, &vertices, &mut contour, rounding)?;
        let cell = sampling.grid.cell;
        let deviation = deviation(&input.field, cell, &contour.points, &contour.faces, context)?;
        let source = vec![NO_SOURCE; contour.faces.len()];
        let mut surface = Surface { positions: contour.points, faces: contour.faces, source };
        surface.drop_unreferenced();
        Ok(Some(Remeshed { surface, cell, deviation, forced_inside: forced }))
    }

    /// Samples the inside on a grid and corrects the samples.
    fn sampled<'a>(&self, input: &'a Input<'a>, cell: f64, context: &'a Context<'a>) -> Result<Sampled<'a>, Stop> {
        let grid = Grid::around(&input.bounds, cell);
        let blocks = self.max_memory / Samples::BLOCK_BYTES;
        let [most, blocks] = [blocks * Samples::BLOCK_CELLS, blocks].map(|n| usize::try_from(n).unwrap_or(usize::MAX));
        let samples = Samples::new(&grid);
        let met = cells_met(&input.field, &grid, most, context)?;
        let limits = SamplingLimits { steps: STEPS, blocks };
        let mut sampling = Sampling { field: &input.field, grid, samples, limits, context };
        sampling.sample_around(met.clone())?;
        let mut forced = sampling.keep_thin_parts(&met)?;
        forced += sampling.compose()?;
        let cells = sampling.samples.mixed_cells();
        Ok(Sampled { sampling, cells, forced })
    }

    /// The cell size that keeps the limits on faces and work, estimated from a coarse trial.
    fn affordable(&self, input: &Input<'_>, cell: f64, context: &Context<'_>) -> Result<f64, Cancelled> {
        let coarse = input.bounds.diagonal() / TRIAL;
        if cell * 2.0 > coarse {
            return Ok(cell);
        }
        match self.sampled(input, coarse, context) {
            Ok(sampled) => {
                // Both grow with the square of the resolution.
                let faces = 2.0 * sampled.cells.len() as f64 / self.max_faces as f64;
                let steps = (STEPS - sampled.sampling.limits.steps) as f64 / STEPS as f64;
                Ok(cell.max(coarse * faces.max(steps).sqrt()))
            }
            Err(Stop::Cancelled(canceled)) => Err(canceled),
            Err(_) => Ok(coarse),
        }
    }
}

/// The input, scaled into the range of the exact predicates.
struct Input<'a> {
    field: Field<'a>,
    bounds: Box3,
    rounding: Rounding,
}

/// Samples with a well-composed inside, and the cells that the surface passes through.
struct Sampled<'a> {
    sampling: Sampling<'a, Field<'a>>,
    cells: Vec<GridIndex>,
    /// Number of samples forced inside.
    forced: u64,
}
