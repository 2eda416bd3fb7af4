//! The mesh that others are compared with.

use std::cell::{OnceCell, RefCell};

use serde::{Deserialize, Serialize};

use super::super::sampling::{Sample, samples, visible};
use super::super::{Analysis, Measures, Volume, measures};
use crate::context::{Cancelled, Context};

/// Surface farther than this from all of the other mesh is lost, as a share of the input's diagonal. A remesh with the
/// default 300 voxels along the diagonal stays within it.
pub(super) const FAR: f64 = 0.005;
/// What rounding to f32 and back moves at most, in coordinates of [`Analysis::unit`], which reach 2.
pub(super) const ROUNDING: f64 = 1.0 / (1u64 << 20) as f64;

/// How closely two meshes are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct CompareOptions {
    /// Points on each surface from which the other's distance is measured.
    pub samples: u32,
    /// Vertices of each mesh, at most, that are measured beside them.
    pub vertices: u32,
    /// Points at which both are asked what is inside; 0 leaves it out.
    pub inside: u32,
}

impl Default for CompareOptions {
    fn default() -> Self {
        Self { samples: 20_000, vertices: 20_000, inside: 20_000 }
    }
}

impl CompareOptions {
    /// What every result of a repair is judged with.
    pub const BRIEF: Self = Self { samples: 4000, vertices: 2000, inside: 0 };
}

/// The mesh that others are compared with, and what is looked at of it again and again: found once.
pub struct Original<'a> {
    pub(super) analysis: &'a Analysis<'a>,
    pub(super) measures: &'a Measures,
    pub(super) options: CompareOptions,
    pub(super) settled: Option<&'a Analysis<'a>>,
    samples: OnceCell<Vec<Sample>>,
    /// Of each sample whether it can be seen, where somebody asked.
    visible: RefCell<Vec<Asked>>,
}

/// Whether a sample can be seen.
#[derive(Clone, Copy)]
enum Asked {
    NotYet,
    /// None where the search was given up.
    Known(Option<bool>),
}

impl<'a> Original<'a> {
    /// A mesh with its measures. Costs nothing yet.
    #[must_use]
    pub fn new(analysis: &'a Analysis<'a>, measures: &'a Measures, options: CompareOptions) -> Self {
        let (samples, visible) = (OnceCell::new(), RefCell::default());
        Self { analysis, measures, options, settled: None, samples, visible }
    }

    /// The same mesh with its orientation settled, on which is measured what it encloses. None where it is settled as it is.
    #[must_use]
    pub fn with_settled(self, settled: Option<&'a Analysis<'a>>) -> Self {
        Self { settled, ..self }
    }

    /// The volume when the orientation is settled.
    ///
    /// # Errors
    /// [`Cancelled`] when the context says stop.
    pub fn settled_volume(&self, context: &Context<'_>) -> Result<Volume, Cancelled> {
        self.settled.map_or(Ok(self.measures.volume), |settled| Ok(measures(settled, context)?.volume))
    }

    /// The mesh itself.
    #[must_use]
    pub fn analysis(&self) -> &'a Analysis<'a> {
        self.analysis
    }

    /// The mesh's own measures.
    #[must_use]
    pub fn measures(&self) -> &'a Measures {
        self.measures
    }

    pub(super) fn samples(&self) -> &[Sample] {
        self.samples.get_or_init(|| samples(self.analysis, self.options.samples))
    }

    /// Whether each of the samples `wanted` can be seen; none where the search was given up.
    pub(super) fn visible(&self, wanted: &[usize], context: &Context<'_>) -> Result<Vec<Option<bool>>, Cancelled> {
        let mut asked = self.visible.borrow_mut();
        asked.resize(self.samples().len(), Asked::NotYet);
        let open: Vec<usize> = wanted.iter().copied().filter(|&i| matches!(asked[i], Asked::NotYet)).collect();
        let points: Vec<Sample> = open.iter().map(|&i| self.samples()[i]).collect();
        for (&i, seen) in open.iter().zip(visible(self.analysis, &points, context)?) {
            asked[i] = Asked::Known(seen);
        }
        let answer = |&i: &usize| if let Asked::Known(seen) = asked[i] { seen } else { None };
        Ok(wanted.iter().map(answer).collect())
    }
}
