//! The places that a measurement of thickness finds, and what they are.

use glam::DVec3;

/// What is measured: the solid, or the space around it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Space {
    /// Walls, wires and pins.
    Material,
    /// Gaps, slots and holes.
    Air,
}

/// Two points on two faces that face away from each other across material, or towards each other across air.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OpposedPair {
    /// The two faces; the first one is the face that this pair is the thinnest place of.
    pub faces: [u32; 2],
    /// A point on each face. The segment between them lies in the material, or in air.
    pub points: [DVec3; 2],
    /// The distance between the points.
    pub distance: f64,
    /// The thickness at the points, at least `distance`: the diameter of the ball that touches both faces.
    pub thickness: f64,
}

/// The thinnest places of the faces of a surface.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct OpposedPairs {
    /// For each face that is part of a thin wall, its thinnest place, in the order of the faces.
    pub walls: Vec<OpposedPair>,
    /// For each face that is thin towards a sharp edge or point, its thinnest place there. A face may be in both lists.
    pub tips: Vec<OpposedPair>,
    /// Faces whose search ended at its budget; they may be thinner than found.
    pub undecided_faces: Vec<u32>,
    /// Whether all faces are decided.
    pub is_complete: bool,
}

/// What a thin place is. The kind decides which limit of a process applies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum FeatureKind {
    /// A wall that is held on two opposite sides, or supports itself by bending around.
    SupportedWall,
    /// A wall with at most one held side.
    FreeWall,
    /// Material thin in two directions, held at both ends or closed to a ring.
    Wire,
    /// Material thin in two directions with a free end.
    Pin,
    /// Material or air that narrows to an edge or a point of less than 36.87 degrees.
    SharpEdge,
    /// A gap thin in one direction within one solid.
    Slot,
    /// A gap thin in two directions, open at both ends.
    ThroughHole,
    /// A gap thin in two directions, closed at one end at least.
    BlindHole,
    /// A gap between two separate surfaces, such as those of two solids.
    Clearance,
}

/// A connected thin place.
#[derive(Debug, Clone, PartialEq)]
pub struct ThinRegion {
    /// What it is.
    pub kind: FeatureKind,
    /// Its faces, in ascending order. A large face may be thin only in part.
    pub faces: Vec<u32>,
    /// The surface area that is thin, on all sides together, from samples.
    pub area: f64,
    /// The least thickness.
    pub least: f64,
    /// The mean thickness by area, from samples.
    pub mean: f64,
    /// The point of least thickness, in the middle between the surfaces.
    pub at: DVec3,
    /// Whether `kind` and `least` are certain. If not, `kind` is the one with the stricter limit.
    pub is_decided: bool,
}

/// The thin places of a surface.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ThinFeatures {
    /// The thin places, in the order of their first face; those of kind [`FeatureKind::SharpEdge`] come last.
    pub regions: Vec<ThinRegion>,
    /// The thinnest place of each thin face.
    pub pairs: OpposedPairs,
}

/// The thinnest wall, or the narrowest gap, of a whole surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeastThickness {
    /// The place; None if no two faces are opposed. Sharp edges do not count.
    pub pair: Option<OpposedPair>,
    /// Whether no thinner place exists.
    pub is_complete: bool,
}

/// The thickness at every vertex and every face, in the model's unit; infinity where there is no wall, such as at an
/// edge of a thick solid.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ThicknessField {
    /// At each vertex.
    pub at_vertices: Vec<f32>,
    /// At the centre of each face.
    pub at_faces: Vec<f32>,
    /// Whether all values are measured by inscribed balls; otherwise some are lengths of perpendiculars.
    pub is_complete: bool,
}
