use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{Measures, Turning};

/// An answer to a question that can't always be asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Answer {
    /// The mesh has the attribute.
    Yes,
    /// It has not.
    No,
    /// An attribute that this one assumes is missing, or it can't be told.
    NotMeasurable,
}

impl From<bool> for Answer {
    fn from(yes: bool) -> Self {
        if yes { Self::Yes } else { Self::No }
    }
}

/// Why something can't be measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Unmeasurable {
    /// There is a boundary edge.
    NotClosed,
    /// There is a non-manifold edge or vertex.
    NotManifold,
    /// Faces are turned against each other.
    NotConsistent,
    /// There is no element of the kind.
    NoElement,
}

/// The four attributes of a mesh as meshalyzer defines them (seed 004), each one assuming those before it where its
/// definition does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Attributes {
    /// Each edge is shared by two or more faces. Edges of more than two are allowed.
    pub closed: Answer,
    /// All faces at a vertex are reached from one another across edges, of which each has at most two faces. The mesh
    /// may be open.
    pub manifold: Answer,
    /// No edge is crossed twice in the same direction. Assumes manifold; the mesh may be open.
    pub consistent: Answer,
    /// A ray from a face to the outside passes an even number of faces, for each part of the mesh: outer shells are
    /// turned outward and cavities into their hollow. Assumes closed, manifold and consistent. Unlike the field of
    /// [`Measures`] it is not given to a part turned outward inside another.
    pub outward: Answer,
}

impl Attributes {
    /// The attributes, from what was counted and how the parts are turned.
    #[must_use]
    pub fn new(measures: &Measures, turning: &Turning) -> Self {
        let closed = measures.closed.into();
        let manifold = measures.manifold.into();
        let consistent = if measures.manifold { measures.consistent.into() } else { Answer::NotMeasurable };
        let outward = if !(measures.closed && measures.manifold && measures.consistent) {
            Answer::NotMeasurable
        } else if turning.inward > 0 {
            Answer::No
        } else if turning.unknown > 0 {
            Answer::NotMeasurable
        } else {
            Answer::Yes
        };
        Self { closed, manifold, consistent, outward }
    }

    /// Why what assumes manifold and consistent can't be measured.
    #[must_use]
    pub fn why_not_oriented(&self) -> Option<Unmeasurable> {
        if self.manifold != Answer::Yes {
            Some(Unmeasurable::NotManifold)
        } else if self.consistent != Answer::Yes {
            Some(Unmeasurable::NotConsistent)
        } else {
            None
        }
    }
}
