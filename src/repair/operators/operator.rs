//! What an operator is: what its parameters follow from, which counters it claims to lower, and what it answers.

use super::inside::Pairing;
use crate::arrange::{ArrangeError, WindingRule};
use crate::format::Format;
use crate::inspect::group_faces;
use crate::math::{collinear, to_unit_range};
use crate::mesh::{Edges, Fans, Surface};
use crate::remesh::RemeshError;
use crate::repair::{Cancelled, Change, Context, Options};

/// What an operator's parameters follow from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scope<'a> {
    pub options: &'a Options,
    /// The format of the result.
    pub format: Format,
    /// How faces are paired around edges of more than two.
    pub pairing: Pairing,
    /// What is inside where parts are turned inside out.
    pub winding_rule: WindingRule,
    /// Whether open sheets are made solid.
    pub closes_sheets: bool,
    /// How far a vertex may still move, in the model's unit, after what operators before it used up.
    pub max_deviation: f64,
}

/// An operator as the pipeline runs it.
pub(crate) trait Operation: Sized {
    /// What it claims to fix. None of these may rise by it.
    const FIXES: &'static [Counter];
    /// What may rise by it, since a later operator takes it up or since it is the lesser evil.
    const MAY_RAISE: &'static [Counter];
    /// Whether a plan leaves it out unless the options ask for it with `with`.
    const IS_ON_REQUEST: bool = false;

    /// The operator with the parameters that follow from the scope, for a surface.
    fn with_scope(scope: &Scope<'_>, surface: &Surface) -> Self;

    /// Runs it.
    ///
    /// # Errors
    /// [`Cancelled`]; the surface may then be half done.
    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled>;
}

/// What an operator did.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Applied {
    /// What it changed, counted.
    pub changes: Vec<Change>,
    /// The farthest that it moved a vertex, in the model's unit, hole patches apart; 0 where every vertex is where it was.
    pub moved: f64,
    /// What it left and why, in words.
    pub left: Option<String>,
    /// Why it did nothing at all, where it should have.
    pub failed: Option<Failure>,
    /// What kept it from following an option to the full: the option's name and the reason.
    pub limited: Vec<(&'static str, String)>,
    /// Faces that it could not fix, of the surface as it left it.
    pub unfixed: Vec<u32>,
    /// The edge of the cells of a remesh, in the model's unit.
    pub voxel_size: Option<f64>,
    /// Whether the time was over before it had done all that it could.
    pub is_late: bool,
}

/// Why an operator did nothing.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Failure {
    /// What overlaps could not be resolved.
    #[error(transparent)]
    Arrange(#[from] ArrangeError),
    /// The surface could not be remeshed.
    #[error(transparent)]
    Remesh(#[from] RemeshError),
    /// What it made is farther from what was there than it may be.
    #[error("the result would be {away:.6} away from what was there")]
    TooFar {
        /// How far, in the model's unit.
        away: f64,
    },
}

impl From<Vec<Change>> for Applied {
    fn from(changes: Vec<Change>) -> Self {
        Self { changes, ..Self::default() }
    }
}

/// What can be wrong with a mesh as far as its faces' indices tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Counter {
    /// Edges of one face.
    BoundaryEdges,
    /// Edges of more than two faces.
    NonManifoldEdges,
    /// Edges of two faces that run along them in the same direction.
    MisorientedEdges,
    /// Vertices whose faces form more than one fan.
    PinchedVertices,
    /// Faces whose corners lie on a line.
    DegenerateFaces,
    /// Faces with the same three vertices as an earlier one.
    DuplicateFaces,
}

impl Counter {
    /// All of them, in the order of [`Counts`].
    pub const ALL: [Self; 6] = [
        Self::BoundaryEdges,
        Self::NonManifoldEdges,
        Self::MisorientedEdges,
        Self::PinchedVertices,
        Self::DegenerateFaces,
        Self::DuplicateFaces,
    ];

    /// In words, for many.
    #[must_use]
    pub fn in_words(self) -> &'static str {
        match self {
            Self::BoundaryEdges => "open edges",
            Self::NonManifoldEdges => "non-manifold edges",
            Self::MisorientedEdges => "edges between faces that are turned against one another",
            Self::PinchedVertices => "pinched vertices",
            Self::DegenerateFaces => "faces without area",
            Self::DuplicateFaces => "duplicate faces",
        }
    }
}

/// How much of each is wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts([u64; Counter::ALL.len()]);

impl Counts {
    /// Counts by index: what stands at one position with indices of its own is apart here. Linear but for sorting.
    #[must_use]
    pub fn of(surface: &Surface) -> Self {
        let faces = &surface.faces;
        let edges = Edges::new(faces);
        let mut counts = Self::default();
        for half_edges in edges.iter() {
            let counter = match *half_edges {
                [_] => Counter::BoundaryEdges,
                [x, y] if Edges::is_forward(faces, x) == Edges::is_forward(faces, y) => Counter::MisorientedEdges,
                [_, _] => continue,
                _ => Counter::NonManifoldEdges,
            };
            counts.0[counter as usize] += 1;
        }
        let unit = to_unit_range(&surface.positions);
        let flat = |face: &&[u32; 3]| {
            let [a, b, c] = face.map(|v| unit[v as usize]);
            collinear(a, b, c)
        };
        counts.0[Counter::PinchedVertices as usize] = Fans::new(surface, &edges).non_manifold_vertices;
        counts.0[Counter::DegenerateFaces as usize] = faces.iter().filter(flat).count() as u64;
        counts.0[Counter::DuplicateFaces as usize] = (faces.len() - group_faces(faces).len()) as u64;
        counts
    }

    /// Whether there is more of any kind than before.
    pub(super) fn rose_from(&self, before: &Self) -> bool {
        self.0.iter().zip(&before.0).any(|(now, before)| now > before)
    }

    /// How much of one kind.
    #[must_use]
    pub fn get(&self, counter: Counter) -> u64 {
        self.0[counter as usize]
    }
}
