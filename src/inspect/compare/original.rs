//! The reference mesh of comparisons, with cached samples and their visibility.

use std::borrow::Cow;
use std::cell::{OnceCell, RefCell};

use serde::{Deserialize, Serialize};

use super::super::sampling::{Sample, samples, visible};
use super::super::{Analysis, Measures, Volume, group_faces, measures};
use crate::context::{Cancelled, Context};
use crate::mesh::Edges;

/// Surface farther than this from the other mesh is lost, as a fraction of the input's diagonal. A remesh with the
/// default 300 voxels along the diagonal stays within this distance.
pub(super) const FAR: f64 = 0.005;
/// Largest displacement by rounding to f32 and back, in coordinates of [`Analysis::unit`], which reach 2.
pub(super) const ROUNDING: f64 = 1.0 / (1u64 << 20) as f64;

/// Sampling density of a comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct CompareOptions {
    /// Number of sample points on each surface, from which the distance to the other surface is measured.
    pub samples: u32,
    /// Largest number of vertices of each mesh that are measured in addition to the samples.
    pub vertices: u32,
    /// Number of points at which both meshes are tested for inside or outside; 0 skips the test.
    pub inside: u32,
}

impl Default for CompareOptions {
    fn default() -> Self {
        Self { samples: 20_000, vertices: 20_000, inside: 20_000 }
    }
}

impl CompareOptions {
    /// The reduced density with which a repair judges every candidate.
    pub const BRIEF: Self = Self { samples: 4000, vertices: 2000, inside: 0 };
}

/// The reference mesh of comparisons. Caches its samples and their visibility across comparisons.
pub struct Original<'a> {
    /// The reference mesh.
    pub(super) analysis: &'a Analysis<'a>,
    /// Its measures.
    pub(super) measures: &'a Measures,
    /// Sampling density.
    pub(super) options: CompareOptions,
    /// The mesh with settled orientation, if different.
    pub(super) settled: Option<&'a Analysis<'a>>,
    is_open: OnceCell<bool>,
    samples: OnceCell<Vec<Sample>>,
    /// For each sample its visibility, if already computed.
    visible: RefCell<Vec<Visibility>>,
}

/// Cached visibility of a sample.
#[derive(Clone, Copy)]
enum Visibility {
    NotComputed,
    /// `None` if the search ran out of its budget.
    Known(Option<bool>),
}

impl<'a> Original<'a> {
    /// Wraps a measured mesh. All caches are filled on demand.
    #[must_use]
    pub fn new(analysis: &'a Analysis<'a>, measures: &'a Measures, options: CompareOptions) -> Self {
        let (is_open, samples, visible) = (OnceCell::new(), OnceCell::new(), RefCell::default());
        Self { analysis, measures, options, settled: None, is_open, samples, visible }
    }

    /// Sets a copy of the mesh with settled orientation, which measures the enclosed volume. `None` if the mesh needs
    /// no settling.
    #[must_use]
    pub fn with_settled(self, settled: Option<&'a Analysis<'a>>) -> Self {
        Self { settled, ..self }
    }

    /// Enclosed volume after the orientation is settled.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn settled_volume(&self, context: &Context<'_>) -> Result<Volume, Cancelled> {
        self.settled.map_or(Ok(self.measures.volume), |settled| Ok(measures(settled, context)?.volume))
    }

    /// The analysed reference mesh.
    #[must_use]
    pub fn analysis(&self) -> &'a Analysis<'a> {
        self.analysis
    }

    /// The measures of the reference mesh.
    #[must_use]
    pub fn measures(&self) -> &'a Measures {
        self.measures
    }

    /// Whether the mesh has openings: an edge has one face, if faces at the same vertices count once. A sheet with a
    /// face for each side has no boundary edge, but it encloses nothing.
    #[must_use]
    pub fn is_open(&self) -> bool {
        let has_open_sheet = || {
            let faces = &self.analysis.surface.faces;
            let once: Vec<[u32; 3]> = group_faces(faces).iter().map(|group| faces[group[0] as usize]).collect();
            Edges::new(&once).iter().any(|half_edges| half_edges.len() == 1)
        };
        let find = || !self.measures.closed || (self.measures.duplicate_faces > 0 && has_open_sheet());
        *self.is_open.get_or_init(find)
    }

    /// Samples of the reference mesh, computed once.
    pub(super) fn samples(&self) -> &[Sample] {
        self.samples.get_or_init(|| samples(self.analysis, self.options.samples))
    }

    /// Samples of a mesh that is compared with the reference mesh; its own samples if the two are one.
    pub(super) fn samples_of(&self, other: &Analysis<'_>) -> Cow<'_, [Sample]> {
        if std::ptr::eq(self.analysis, other) {
            Cow::Borrowed(self.samples())
        } else {
            Cow::Owned(samples(other, self.options.samples))
        }
    }

    /// Visibility of each requested sample; `None` if its search ran out of its budget.
    pub(super) fn visible(&self, requested: &[usize], context: &Context<'_>) -> Result<Vec<Option<bool>>, Cancelled> {
        let mut cache = self.visible.borrow_mut();
        cache.resize(self.samples().len(), Visibility::NotComputed);
        let missing: Vec<usize> =
            requested.iter().copied().filter(|&i| matches!(cache[i], Visibility::NotComputed)).collect();
        let points: Vec<Sample> = missing.iter().map(|&i| self.samples()[i]).collect();
        for (&i, is_visible) in missing.iter().zip(visible(self.analysis, &points, None, context)?) {
            cache[i] = Visibility::Known(is_visible);
        }
        let cached = |&i: &usize| if let Visibility::Known(is_visible) = cache[i] { is_visible } else { None };
        Ok(requested.iter().map(cached).collect())
    }
}
