//! A closed, manifold surface without intersections around whatever is inside of the input: the fallback that always ends.
//!
//! What is inside is told by generalized winding numbers (Jacobson et al. 2013; summed fast as by Barill et al. 2018), so the
//! input may have holes, overlaps and inner walls. They are asked for on a sparse grid along the surface, and the surface
//! is made by dual contouring (Ju et al. 2002) in a form that keeps three promises by construction:
//!
//! - It is **closed**, since it parts the samples inside from those outside.
//! - It is **manifold**, since the samples inside are made well-composed first (`corrections`): every cell has one disc of it.
//! - It does **not intersect** itself, since every piece stays in the envelope of its own edge of the grid (`contour`). Later
//!   moves are made only where exact tests say that this stays so.

mod band;
mod contour;
mod corrections;
mod field;
mod grid;
mod vertices;

use crate::context::{Cancelled, Context};
use crate::math::{Box3, Precision, Rounding, to_unit_range, unit_scale};
use crate::mesh::{NO_SOURCE, Surface};
use band::{Limits, Sampling, cells_met};
use field::{Field, Stop, deviation};
use grid::{Grid, Place, Samples};

pub use field::{Deviation, Distances, WindingRule};

/// Makes a surface anew, from what is inside of it.
#[derive(Debug, Clone, Copy)]
pub struct Remesh {
    /// The edge of a cell in the model's unit, made larger where a limit asks for it. Without it the diagonal of the box
    /// over 512.
    pub cell: Option<f64>,
    /// Most faces of the result.
    pub max_faces: u64,
    /// Most bytes that the samples may take.
    pub max_memory: u64,
    /// What is inside.
    pub winding_rule: WindingRule,
    /// Whether positions are to be those that an STL file can hold.
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

/// A surface made anew.
#[derive(Debug, Clone)]
pub struct Remeshed {
    /// Closed, manifold, oriented outward, and free of intersections. No face has a source.
    pub surface: Surface,
    /// The edge of the cells that it was made with, in the model's unit.
    pub cell: f64,
    /// How far it is from the input.
    pub deviation: Deviation,
    /// Samples that were put inside so that thin parts stay and the surface is manifold.
    pub made_inside: u64,
}

/// Why there is no new surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RemeshError {
    /// Nothing is inside.
    #[error("nothing is inside of the surface, at any size of cell that was tried")]
    Empty,
    /// The limits allow no cells that are small enough to tell anything.
    #[error("the limits of faces, memory and work allow no remesh")]
    Limits,
    /// The work was stopped.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Cells along the diagonal where nothing else is asked for, ...
const RESOLUTION: f64 = 512.0;
/// ... at most, ...
pub(crate) const FINEST: f64 = 2048.0;
/// ... and at least.
const COARSEST: f64 = 8.0;
/// Cells along the diagonal in the try that tells what others cost.
const SCOUT: f64 = 48.0;
/// Boxes and triangles that may be looked at in one try.
const STEPS: u64 = 6_000_000_000;
/// How much larger cells become where they were too many.
const LARGER: f64 = 1.5;

impl Remesh {
    /// Makes the surface anew.
    ///
    /// # Errors
    /// [`RemeshError`]; an input of any kind that has an inside gives a result unless the work is stopped.
    pub fn apply(&self, surface: &Surface, context: &Context<'_>) -> Result<Remeshed, RemeshError> {
        let points = to_unit_range(&surface.positions);
        let scale = unit_scale(&surface.positions);
        let has_area = |face: &[u32; 3]| {
            let [a, b, c] = face.map(|v| points[v as usize]);
            (b - a).cross(c - a).length_squared() > 0.0
        };
        let faces: Vec<[u32; 3]> = surface.faces.iter().copied().filter(has_area).collect();
        let bounds = Box3::of(faces.iter().flatten().map(|&v| points[v as usize]));
        let diagonal = bounds.diagonal();
        if faces.is_empty() || diagonal <= 0.0 {
            return Err(RemeshError::Empty);
        }
        context.check()?;
        let field = Field::new(&points, &faces, self.winding_rule);
        let input = Input { field, bounds, rounding: Rounding { scale, precision: self.precision } };
        let wanted = self.cell.map_or(diagonal / RESOLUTION, |cell| cell * scale);
        let wanted = wanted.clamp(diagonal / FINEST, diagonal / COARSEST);
        let mut cell = self.affordable(&input, wanted, context)?;
        loop {
            match self.attempt(&input, cell, context) {
                Ok(Some(mut made)) => {
                    for p in &mut made.surface.positions {
                        *p /= scale;
                    }
                    made.cell /= scale;
                    let Deviation { lost, made: added } = &mut made.deviation;
                    (*lost, *added) = (lost.scaled(1.0 / scale), added.scaled(1.0 / scale));
                    return Ok(made);
                }
                Ok(None) => return Err(RemeshError::Empty),
                Err(Stop::Cancelled(canceled)) => return Err(canceled.into()),
                Err(_) if cell * COARSEST > diagonal => return Err(RemeshError::Limits),
                Err(Stop::Budget) => cell *= LARGER,
                Err(Stop::Faces(faces)) => {
                    cell *= (faces as f64 / self.max_faces as f64).sqrt().max(1.0) * 1.02;
                }
            }
        }
    }

    /// One try with cells of one size; none where nothing is inside.
    fn attempt(&self, input: &Input<'_>, cell: f64, context: &Context<'_>) -> Result<Option<Remeshed>, Stop> {
        let Sampled { mut sampling, cells, made } = self.sampled(input, cell, context)?;
        if cells.is_empty() {
            return Ok(None);
        }
        // A surface of V vertices with four edges each has 2 V triangles.
        let least = 2 * cells.len() as u64;
        if least > self.max_faces {
            return Err(Stop::Faces(least));
        }
        let rounding = input.rounding;
        let crossings = sampling.crossings()?;
        let vertices = vertices::place(&sampling.grid, &mut sampling.samples, &cells, &crossings, rounding);
        let crossings: Vec<_> = crossings
            .into_iter()
            .map(|crossing| vertices::Crossing { point: rounding.of(crossing.point), ..crossing })
            .collect();
        let mut contour = contour::contour(&sampling.grid, &sampling.samples, &vertices, &crossings);
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
        Ok(Some(Remeshed { surface, cell, deviation, made_inside: made }))
    }

    /// Samples what is inside.
    fn sampled<'a>(&self, input: &'a Input<'a>, cell: f64, context: &'a Context<'a>) -> Result<Sampled<'a>, Stop> {
        let grid = Grid::around(&input.bounds, cell);
        let blocks = self.max_memory / Samples::BLOCK_BYTES;
        let [most, blocks] = [blocks * Samples::BLOCK_CELLS, blocks].map(|n| usize::try_from(n).unwrap_or(usize::MAX));
        let samples = Samples::new(&grid);
        let met = cells_met(&input.field, &grid, most, context)?;
        let limits = Limits { steps: STEPS, blocks };
        let mut sampling = Sampling { field: &input.field, grid, samples, limits, context };
        sampling.reach(met.clone())?;
        let mut made = sampling.keep_thin_parts(&met)?;
        made += sampling.compose()?;
        let cells = sampling.samples.mixed_cells();
        Ok(Sampled { sampling, cells, made })
    }

    /// The size of cells for which a coarse try says that the limits of faces and work are kept.
    fn affordable(&self, input: &Input<'_>, cell: f64, context: &Context<'_>) -> Result<f64, Cancelled> {
        let coarse = input.bounds.diagonal() / SCOUT;
        if cell * 2.0 > coarse {
            return Ok(cell);
        }
        match self.sampled(input, coarse, context) {
            Ok(sampled) => {
                // Both grow by the square of how much finer cells are.
                let faces = 2.0 * sampled.cells.len() as f64 / self.max_faces as f64;
                let steps = (STEPS - sampled.sampling.limits.steps) as f64 / STEPS as f64;
                Ok(cell.max(coarse * faces.max(steps).sqrt()))
            }
            Err(Stop::Cancelled(canceled)) => Err(canceled),
            Err(_) => Ok(coarse),
        }
    }
}

/// The input in the range of exact predicates.
struct Input<'a> {
    field: Field<'a>,
    bounds: Box3,
    rounding: Rounding,
}

/// Samples whose inside is well-composed, and the cells that the surface passes.
struct Sampled<'a> {
    sampling: Sampling<'a>,
    cells: Vec<Place>,
    /// Samples that were put inside.
    made: u64,
}
