//! The interface of an operator: the settings it reads, the counters it claims to lower, and the result it returns.
//!
//! Each operator implements [`Operation`]; the pipeline checks the claims with [`Counts`] after every run.

use std::sync::Arc;

use glam::DVec3;

use super::face_pairs::Pairing;
use crate::arrange::{ArrangeError, WindingRule};
use crate::format::Format;
use crate::inspect::{Analysis, EdgeCounts, Measures, SearchedMesh, duplicate_faces};
use crate::math::{collinear, threads, to_unit_range};
use crate::mesh::{Edges, Fans, Surface};
use crate::remesh::RemeshError;
use crate::repair::{Cancelled, Change, Context, DrilledVent, Options, WallThickening};

/// The settings from which operators derive their parameters.
#[derive(Clone, Copy)]
pub(crate) struct Scope<'a> {
    /// The options of the repair.
    pub options: &'a Options,
    /// The input, whose intersecting faces are known.
    pub input: &'a Analysis<'a>,
    /// The format of the result.
    pub format: Format,
    /// How faces are paired around edges with more than two faces.
    pub pairing: Pairing,
    /// The winding rule that defines the inside where parts are inverted.
    pub winding_rule: WindingRule,
    /// Whether open sheets become solids.
    pub closes_sheets: bool,
    /// Length of the model's unit, in millimetres.
    pub millimetres: f64,
    /// The model's upward direction.
    pub up: DVec3,
    /// How far a vertex may still move, in the model's unit: the option minus the moves of earlier operators.
    pub max_deviation: f64,
}

/// An operator that the pipeline can run.
pub(crate) trait Operation<'a>: Sized {
    /// The counters that the operator claims to lower. The operator must not raise any of them.
    const FIXES: &'static [Counter];
    /// The counters that the operator may raise: a later operator lowers them, or they are the lesser defect.
    const MAY_RAISE: &'static [Counter];
    /// The counters that give the operator something to do: where all of them are 0, it changes nothing and is not run. An
    /// empty list means that counters don't tell.
    const ACTS_ON: &'static [Counter] = &[];
    /// Whether plans omit the operator unless the option `with` names it.
    const IS_ON_REQUEST: bool = false;
    /// Whether the operator changes a sound model because an option asks for the change. The signs of damage are then looked for in the
    /// surface before the change.
    const CHANGES_SOUND_MODEL: bool = false;

    /// Whether the operator takes so much memory that the edges of the surface are better not kept meanwhile.
    const IS_HEAVY: bool = false;

    /// Creates the operator for `surface` with parameters derived from `scope`.
    fn with_scope(scope: &Scope<'a>, surface: &Surface) -> Self;

    /// Runs the operator on `surface`. Every operator implements this method or [`Operation::run_shared`]; each defaults to the other.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface may then be half changed.
    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let edges = Arc::new(Edges::new(&surface.faces));
        as_shared(surface, |surface| self.run_shared(surface, edges, context))
    }

    /// [`Operation::run`] on a surface that others may share, and whose `edges` are known. An operator that changes nothing, or makes a
    /// new surface, need not copy the shared one first.
    ///
    /// # Errors
    /// As [`Operation::run`].
    fn run_shared(
        &self,
        surface: &mut Arc<Surface>,
        edges: Arc<Edges>,
        context: &Context<'_>,
    ) -> Result<Applied, Cancelled> {
        drop(edges);
        self.run(Arc::make_mut(surface), context)
    }
}

/// The result of running an operator.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Applied {
    /// The changes with their counts.
    pub changes: Vec<Change>,
    /// The largest vertex displacement in the model's unit, without hole patches; 0 where no vertex moved.
    pub moved: f64,
    /// What the operator left unfixed and why, as text for the report.
    pub left: Option<String>,
    /// Why the operator changed nothing where it should have.
    pub failed: Option<Failure>,
    /// Options that the operator could not follow in full: the option's name and the reason.
    pub limited: Vec<(&'static str, String)>,
    /// Faces that the operator could not fix, as indices into the resulting surface.
    pub unfixed: Vec<u32>,
    /// The edge length of a remesh's cells, in the model's unit.
    pub voxel_size: Option<f64>,
    /// For thickened walls: what was added and left.
    pub thickening: Option<WallThickening>,
    /// The vents that were drilled into sealed cavities.
    pub vents: Vec<DrilledVent>,
    /// A mesh with most faces of the result that was searched for intersecting faces.
    pub searched: Option<Arc<SearchedMesh>>,
    /// Whether the deadline came before the operator had finished.
    pub is_late: bool,
}

/// Why an operator changed nothing.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Failure {
    /// The self-union of overlapping volumes failed.
    #[error(transparent)]
    Arrange(#[from] ArrangeError),
    /// The remesh failed.
    #[error(transparent)]
    Remesh(#[from] RemeshError),
    /// The result would deviate from the input surface by more than the options allow.
    #[error("the result would deviate {away:.6} from the input surface, more than `max_deviation` allows")]
    TooFar {
        /// The deviation, in the model's unit.
        away: f64,
    },
}

impl Applied {
    /// The operator left everything unfixed for a reason.
    pub(super) fn unchanged(reason: &impl ToString) -> Self {
        Self { left: Some(reason.to_string()), ..Self::default() }
    }
}

impl From<Vec<Change>> for Applied {
    fn from(changes: Vec<Change>) -> Self {
        Self { changes, ..Self::default() }
    }
}

/// Runs `act` on a surface in an `Arc`, for operators that take one.
pub(super) fn as_shared<T>(surface: &mut Surface, act: impl FnOnce(&mut Arc<Surface>) -> T) -> T {
    let mut shared = Arc::new(std::mem::take(surface));
    let result = act(&mut shared);
    *surface = Arc::unwrap_or_clone(shared);
    result
}

/// A topological or geometric defect that is counted from the faces' vertex indices and positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Counter {
    /// Edges with exactly one face.
    BoundaryEdges,
    /// Edges with more than two faces.
    NonManifoldEdges,
    /// Edges whose two faces traverse them in the same direction.
    MisorientedEdges,
    /// Vertices whose faces form more than one fan.
    PinchedVertices,
    /// Faces whose corners are collinear.
    DegenerateFaces,
    /// Faces with the same three vertices as an earlier face.
    DuplicateFaces,
}

impl Counter {
    /// All counters, in the order of [`Counts`].
    pub const ALL: [Self; 6] = [
        Self::BoundaryEdges,
        Self::NonManifoldEdges,
        Self::MisorientedEdges,
        Self::PinchedVertices,
        Self::DegenerateFaces,
        Self::DuplicateFaces,
    ];

    /// The defect's name in the plural, as messages use it.
    #[must_use]
    pub fn in_words(self) -> &'static str {
        match self {
            Self::BoundaryEdges => "open edges",
            Self::NonManifoldEdges => "non-manifold edges",
            Self::MisorientedEdges => "edges between faces of opposite winding",
            Self::PinchedVertices => "pinched vertices",
            Self::DegenerateFaces => "faces without area",
            Self::DuplicateFaces => "duplicate faces",
        }
    }
}

/// The number of defects for each [`Counter`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts([u64; Counter::ALL.len()]);

impl Counts {
    /// Counts the defects by vertex index: vertices at one position with separate indices are distinct. O(n log n) time.
    #[must_use]
    pub fn of(surface: &Surface) -> Self {
        Self::with_edges(surface, &Edges::new(&surface.faces))
    }

    /// [`Counts::of`] a surface whose edges are known.
    #[must_use]
    pub fn with_edges(surface: &Surface, edges: &Edges) -> Self {
        let faces = &surface.faces;
        let unit = to_unit_range(&surface.positions);
        let is_degenerate = |face: usize| {
            let [a, b, c] = faces[face].map(|v| unit[v as usize]);
            collinear(a, b, c)
        };
        let of_faces = || (threads::count(faces.len(), is_degenerate), duplicate_faces(faces, edges));
        let pinched = || Fans::new(surface, edges).non_manifold_vertices;
        let (pinched, (degenerate, duplicate)) = threads::join(faces.len(), pinched, of_faces);
        let EdgeCounts { boundary, misoriented, non_manifold, .. } = EdgeCounts::of(surface, edges);
        Self::default().with([
            (Counter::BoundaryEdges, boundary),
            (Counter::MisorientedEdges, misoriented),
            (Counter::NonManifoldEdges, non_manifold),
            (Counter::PinchedVertices, pinched),
            (Counter::DegenerateFaces, degenerate),
            (Counter::DuplicateFaces, duplicate),
        ])
    }

    /// [`Counts::of`] the surface of an analysis with these measures.
    #[must_use]
    pub fn of_measured(analysis: &Analysis<'_>, measures: &Measures) -> Self {
        Self::default().with([
            (Counter::BoundaryEdges, measures.boundary_edges),
            (Counter::MisorientedEdges, measures.misoriented_edges),
            (Counter::NonManifoldEdges, measures.non_manifold_edges),
            (Counter::PinchedVertices, measures.non_manifold_vertices),
            // The measures also count faces whose area vanishes in f64.
            (Counter::DegenerateFaces, analysis.flat().iter().filter(|is_flat| **is_flat).count() as u64),
            (Counter::DuplicateFaces, measures.duplicate_faces),
        ])
    }

    fn with(mut self, counts: impl IntoIterator<Item = (Counter, u64)>) -> Self {
        counts.into_iter().for_each(|(counter, count)| self.0[counter as usize] = count);
        self
    }

    /// Whether any counter is higher than in `before`.
    pub(super) fn has_increase_over(&self, before: &Self) -> bool {
        self.0.iter().zip(&before.0).any(|(now, before)| now > before)
    }

    /// The count of one defect.
    #[must_use]
    pub fn get(&self, counter: Counter) -> u64 {
        self.0[counter as usize]
    }
}
