//! Layout of a mesh and its findings for drawing: paint of faces, line segments, dots, and coordinate mapping.

use std::collections::hash_map::Entry;

use glam::DVec3;
use rustc_hash::{FxHashMap, FxHashSet};

use super::palette::{
    BY_SEVERITY, LegendEntry, Paint, Shape, THICK, gravest, legend, legend_of_change, legend_of_thickness, shape,
    thickness_band,
};
use crate::context::Context;
use crate::inspect::{Defect, DefectKind, Findings, Provenance, SurfaceProvenance};
use crate::math::{Box3, to_unit_range};
use crate::mesh::{NO_SOURCE, Soup, Surface};

/// Maximum number of line segments, and of dots, that a scene shows.
const MAX_SEGMENTS: usize = 300_000;
const MAX_DOTS: usize = 100_000;
/// Number of grid cells along the model's longest side for a coarse scene, and the factor that reduces it until the
/// scene is small enough.
const CELLS: f64 = 640.0;
const CELL_REDUCTION: f64 = 0.75;
/// Maximum number of line segments and dots of a coarse scene. The most severe kinds come first.
const COARSE_SEGMENTS: usize = 20_000;
const COARSE_DOTS: usize = 5_000;

/// Why a picture or a coloured mesh could not be made.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// Rendering was cancelled or exceeded its time limit.
    #[error(transparent)]
    Cancelled(#[from] crate::context::Cancelled),
    /// The mesh exceeds the limits of the format.
    #[error("the mesh is too large for the drawing's format")]
    TooLarge,
    /// The PNG encoder failed.
    #[error("encoding the picture failed: {0}")]
    Png(#[from] png::EncodingError),
}

/// A mesh laid out for drawing: each face with its paint, each line and dot with its defect kind.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Faces with finite corners, with vertices merged at equal positions.
    pub surface: Surface,
    /// Paint of each face of `surface`.
    pub paint: Vec<Paint>,
    /// Line segments, most severe kind first.
    pub segments: Vec<Segment>,
    /// Dots, most severe kind first.
    pub dots: Vec<Dot>,
    /// Position and size of the mesh.
    pub frame: Frame,
    /// Legend of the drawing.
    pub legend: Vec<LegendEntry>,
    /// Subject of the drawing.
    pub shows: Shows,
}

/// Subject of a drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shows {
    /// Defects of a mesh.
    Defects,
    /// Changes from one mesh to another.
    Change,
    /// Wall thickness.
    Thickness,
}

/// One straight segment of a defect's line, in the model's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Defect kind.
    pub kind: DefectKind,
    /// The two distinct end points.
    pub ends: [DVec3; 2],
}

/// Marker for a defect at a point, or on faces that may be too small to see.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dot {
    /// Defect kind.
    pub kind: DefectKind,
    /// Position, in the model's unit.
    pub at: DVec3,
    /// Largest extent of the defect's faces, as a fraction of the model's half extent; 0 for a point.
    pub extent: f64,
}

/// Bounding box of a mesh, and the mapping to the cube from -1 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Bounding box, in the model's unit.
    pub bounds: Box3,
    /// A power of two that scales coordinates so that sums and squares neither overflow nor underflow.
    pub scale: f64,
    /// Centre of the scaled box.
    pub centre: DVec3,
    /// Half of the scaled box's longest side; above 0.
    pub half: f64,
}

impl Frame {
    fn new(bounds: Box3) -> Self {
        if bounds.is_empty() {
            return Self { bounds, scale: 1.0, centre: DVec3::ZERO, half: 1.0 };
        }
        let largest = bounds.min.abs().max(bounds.max.abs()).max_element();
        let scale = if largest > 0.0 { to_unit_range(&[DVec3::splat(largest)])[0].x / largest } else { 1.0 };
        let (min, max) = (bounds.min * scale, bounds.max * scale);
        let half = ((max - min) * 0.5).max_element();
        Self { bounds, scale, centre: (min + max) * 0.5, half: if half > 0.0 { half } else { 1.0 } }
    }

    /// Maps a point from the model's unit to the cube.
    #[must_use]
    pub fn to_cube(&self, p: DVec3) -> DVec3 {
        (p * self.scale - self.centre) / self.half
    }

    /// Maps a point from the cube to the model's unit.
    #[must_use]
    pub fn from_cube(&self, p: DVec3) -> DVec3 {
        (p * self.half + self.centre) / self.scale
    }

    /// Side lengths of the box, in the model's unit.
    #[must_use]
    pub fn sides(&self) -> DVec3 {
        if self.bounds.is_empty() {
            return DVec3::ZERO;
        }
        let sides = (self.bounds.max * 0.5 - self.bounds.min * 0.5) * 2.0;
        sides.min(DVec3::splat(f64::MAX))
    }

    /// Whether a point is in the box, up to rounding.
    fn holds(&self, p: DVec3) -> bool {
        // False for NaN.
        self.to_cube(p).abs().cmple(DVec3::splat(1.001)).all()
    }
}

impl Scene {
    /// Lays out a mesh with its findings. O(n log n) in the number of faces.
    ///
    /// # Errors
    /// [`RenderError::Cancelled`] on cancellation or timeout.
    pub fn new(soup: &Soup, findings: &Findings, context: &Context<'_>) -> Result<Self, RenderError> {
        let (surface, _) = Surface::from_soup(soup);
        context.check()?;
        let mark = |source: u32| findings.marks.get(source as usize).copied().unwrap_or(0);
        let paint =
            surface.source.iter().map(|&source| gravest(mark(source)).map_or(Paint::Sound, Paint::Defect)).collect();
        let frame = Frame::new(surface.bounds());
        context.check()?;
        let mut scene = Self {
            surface,
            paint,
            segments: Vec::new(),
            dots: Vec::new(),
            frame,
            legend: legend(findings),
            shows: Shows::Defects,
        };
        for kind in BY_SEVERITY {
            for defect in findings.places(kind) {
                scene.add_defect(kind, defect, soup);
            }
            context.check()?;
        }
        Ok(scene)
    }

    /// Lays out the changes to a mesh: the faces of `after` by provenance, and the removed surface. O(n log n).
    ///
    /// # Errors
    /// [`RenderError::Cancelled`] on cancellation or timeout, [`RenderError::TooLarge`] beyond 2^32 vertices.
    pub fn of_change(after: &Soup, provenance: &SurfaceProvenance, context: &Context<'_>) -> Result<Self, RenderError> {
        let mut both = after.clone();
        for corners in &provenance.removed {
            let first = u32::try_from(both.positions.len() + 2).map_err(|_| RenderError::TooLarge)? - 2;
            both.positions.extend(corners);
            both.faces.push([first, first + 1, first + 2]);
        }
        let (surface, _) = Surface::from_soup(&both);
        context.check()?;
        let of_source = |source: u32| {
            let of_face = provenance.of_face.get(source as usize);
            of_face.map_or(Provenance::Removed, |kind| kind.unwrap_or(Provenance::Kept))
        };
        let paint = surface.source.iter().map(|&source| Paint::Provenance(of_source(source))).collect();
        let frame = Frame::new(surface.bounds());
        let legend = legend_of_change(&provenance.shares);
        let (segments, dots) = (Vec::new(), Vec::new());
        Ok(Self { surface, paint, segments, dots, frame, legend, shows: Shows::Change })
    }

    /// Lays out the wall thickness of a mesh. `thickness` has a value for each face of `soup`, in the model's unit; `limit`
    /// is the least wall that the process accepts, and `mm` the unit's length in millimetres. O(n log n).
    ///
    /// # Errors
    /// [`RenderError::Cancelled`] on cancellation or timeout.
    pub fn of_thickness(
        soup: &Soup,
        thickness: &[f32],
        [limit, mm]: [f64; 2],
        context: &Context<'_>,
    ) -> Result<Self, RenderError> {
        let (surface, _) = Surface::from_soup(soup);
        context.check()?;
        let mut faces = [(0, 0.0); 8];
        let paint = surface.source.iter().enumerate().map(|(face, &source)| {
            let value = thickness.get(source as usize).copied().unwrap_or(f32::INFINITY);
            let band = thickness_band(f64::from(value) / limit);
            let (count, area) = &mut faces[usize::from(band)];
            *count += 1;
            *area += surface.area_vector(face).length() / 2.0;
            Paint::Thickness(band)
        });
        let paint = paint.collect();
        let frame = Frame::new(surface.bounds());
        let legend = legend_of_thickness(&faces, limit * mm);
        let (segments, dots) = (Vec::new(), Vec::new());
        Ok(Self { surface, paint, segments, dots, frame, legend, shows: Shows::Thickness })
    }

    /// Adds the line or the dot of one defect.
    fn add_defect(&mut self, kind: DefectKind, defect: &Defect, soup: &Soup) {
        if !defect.line.is_empty() {
            let points = || defect.line.iter().map(|&p| DVec3::from_array(p));
            for (a, b) in points().zip(points().skip(1)) {
                self.add_segment(kind, a, b);
            }
            // The chain of a hole is closed, whether or not it repeats its first point.
            if let (DefectKind::Hole, Some(first), Some(last)) = (kind, points().next(), points().next_back()) {
                self.add_segment(kind, last, first);
            }
            return;
        }
        if shape(kind) == Shape::Parts && kind != DefectKind::TinyPart {
            return;
        }
        let points = defect.faces.iter().filter_map(|&f| corners(soup, f)).flatten();
        let extent = Box3::of(points.map(|p| self.frame.to_cube(p)));
        let extent = if extent.is_empty() { 0.0 } else { (extent.max - extent.min).max_element() };
        // A face without area is visible only by its edges.
        if matches!(kind, DefectKind::FlatFace | DefectKind::DegenerateFace) {
            for [a, b, c] in defect.faces.iter().filter_map(|&f| corners(soup, f)) {
                self.add_segment(kind, a, b);
                self.add_segment(kind, b, c);
                self.add_segment(kind, c, a);
            }
        }
        let at = DVec3::from_array(defect.at);
        if self.dots.len() < MAX_DOTS && self.frame.holds(at) {
            let extent = if shape(kind) == Shape::Point { 0.0 } else { extent };
            self.dots.push(Dot { kind, at, extent });
        }
    }

    fn add_segment(&mut self, kind: DefectKind, a: DVec3, b: DVec3) {
        if self.segments.len() < MAX_SEGMENTS && a != b && self.frame.holds(a) && self.frame.holds(b) {
            self.segments.push(Segment { kind, ends: [a, b] });
        }
    }

    /// Non-empty groups of faces by paint: sound faces first, then by defect kind; or by provenance.
    #[must_use]
    pub fn groups(&self) -> Vec<(Paint, Vec<u32>)> {
        let paints: Vec<Paint> = match self.shows {
            Shows::Defects => std::iter::once(Paint::Sound).chain(DefectKind::ALL.map(Paint::Defect)).collect(),
            Shows::Change => Provenance::ALL.map(Paint::Provenance).to_vec(),
            Shows::Thickness => (0..=THICK).map(Paint::Thickness).collect(),
        };
        let mut groups = vec![Vec::new(); paints.len()];
        for (paint, f) in self.paint.iter().zip(0u32..) {
            groups[usize::from(paint.number())].push(f);
        }
        paints.into_iter().zip(groups).filter(|(_, faces)| !faces.is_empty()).collect()
    }

    /// Simplifies the scene to at most `most_faces` faces by vertex clustering (Rossignac and Borrel 1993). Vertices
    /// in one grid cell merge at their mean, and faces with fewer than three distinct vertices disappear. Works for
    /// any mesh and keeps the paint of faces, but guarantees only visual similarity. O(n) per grid size.
    ///
    /// # Errors
    /// [`RenderError::Cancelled`] on cancellation or timeout.
    pub fn coarse(&self, most_faces: usize, context: &Context<'_>) -> Result<Self, RenderError> {
        let mut cells = CELLS;
        let (surface, paint) = loop {
            context.check()?;
            match self.clustered(cells, most_faces) {
                Some(clustered) => break clustered,
                None => cells *= CELL_REDUCTION,
            }
        };
        let segments = self.segments.iter().take(COARSE_SEGMENTS).copied().collect();
        let dots = self.dots.iter().take(COARSE_DOTS).copied().collect();
        let (frame, legend, shows) = (self.frame, self.legend.clone(), self.shows);
        Ok(Self { surface, paint, segments, dots, frame, legend, shows })
    }

    /// Clusters vertices in a grid with `cells` cells along the longest side. Returns `None` if more than `most`
    /// faces remain.
    fn clustered(&self, cells: f64, most: usize) -> Option<(Surface, Vec<Paint>)> {
        let mut known: FxHashMap<[u32; 3], u32> = FxHashMap::default();
        let mut sums: Vec<(DVec3, f64)> = Vec::new();
        let mut cell_of = Vec::with_capacity(self.surface.positions.len());
        for &position in &self.surface.positions {
            let in_cube = self.frame.to_cube(position);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "from 0 to the cells' count")]
            let cell = ((in_cube + 1.0) * (0.5 * cells)).max(DVec3::ZERO).to_array().map(|x| x as u32);
            let number = match known.entry(cell) {
                Entry::Occupied(entry) => *entry.get(),
                Entry::Vacant(entry) => {
                    sums.push((DVec3::ZERO, 0.0));
                    *entry.insert(u32::try_from(sums.len()).ok()? - 1)
                }
            };
            let (sum, count) = &mut sums[number as usize];
            *sum += in_cube;
            *count += 1.0;
            cell_of.push(number);
        }
        let (mut seen, mut faces, mut paint) = (FxHashSet::default(), Vec::new(), Vec::new());
        for (face, &shown) in self.surface.faces.iter().zip(&self.paint) {
            let [a, b, c] = face.map(|v| cell_of[v as usize]);
            if a == b || b == c || c == a {
                continue;
            }
            // Rotated to start at the smallest corner, so that equal faces compare equal and flipped faces do not.
            let first = if a < b && a < c {
                [a, b, c]
            } else if b < c {
                [b, c, a]
            } else {
                [c, a, b]
            };
            if seen.insert((first, shown.number())) {
                if faces.len() == most {
                    return None;
                }
                faces.push(first);
                paint.push(shown);
            }
        }
        let positions = sums.into_iter().map(|(sum, count)| self.frame.from_cube(sum / count)).collect();
        let source = vec![NO_SOURCE; faces.len()];
        Some((Surface { positions, faces, source }, paint))
    }
}

fn corners(soup: &Soup, face: u32) -> Option<[DVec3; 3]> {
    let [a, b, c] = *soup.faces.get(face as usize)?;
    let at = |v: u32| soup.positions.get(v as usize).copied().filter(|p| p.is_finite());
    Some([at(a)?, at(b)?, at(c)?])
}

/// Faces with their own compact vertex numbering, in order of first use.
pub struct Compacted {
    /// Vertex indices in the surface.
    pub vertices: Vec<u32>,
    /// Faces as indices into `vertices`.
    pub faces: Vec<[u32; 3]>,
}

/// Renumbers the vertices of several groups of faces, one group at a time.
pub struct Compactor {
    number: Vec<u32>,
}

impl Compactor {
    /// Creates a compactor for a surface with `vertices` vertices.
    #[must_use]
    pub fn new(vertices: usize) -> Self {
        Self { number: vec![u32::MAX; vertices] }
    }

    /// Renumbers the vertices of one group.
    pub fn compact(&mut self, surface: &Surface, group: &[u32]) -> Compacted {
        let mut vertices: Vec<u32> = Vec::new();
        let mut number_of = |v: u32| {
            let slot = &mut self.number[v as usize];
            if *slot == u32::MAX {
                #[expect(clippy::cast_possible_truncation, reason = "no more than there are vertices")]
                {
                    *slot = vertices.len() as u32;
                }
                vertices.push(v);
            }
            *slot
        };
        let faces = group.iter().map(|&f| surface.faces[f as usize].map(&mut number_of)).collect();
        for &v in &vertices {
            self.number[v as usize] = u32::MAX;
        }
        Compacted { vertices, faces }
    }
}
