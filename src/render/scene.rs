use std::collections::hash_map::Entry;

use glam::DVec3;
use rustc_hash::{FxHashMap, FxHashSet};

use super::palette::{BY_GRAVITY, LegendEntry, Paint, Shape, gravest, legend, legend_of_change, shape};
use crate::context::Context;
use crate::inspect::{Defect, DefectKind, Findings, Provenance, SurfaceProvenance};
use crate::math::{Box3, to_unit_range};
use crate::mesh::{NO_SOURCE, Soup, Surface};

/// Most segments of lines, and most dots, that are shown, however many places were kept.
const MOST_SEGMENTS: usize = 300_000;
const MOST_DOTS: usize = 100_000;
/// Cells along the model's longest side that are tried first, and by what they are made fewer until the scene is small enough.
const CELLS: f64 = 640.0;
const FEWER: f64 = 0.75;
/// Most pieces of lines and most dots that a coarse scene keeps: the gravest, which come first.
const COARSE_SEGMENTS: usize = 20_000;
const COARSE_DOTS: usize = 5_000;

/// Why a picture or a coloured mesh could not be made.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The work was asked to stop, or its time ran out.
    #[error(transparent)]
    Cancelled(#[from] crate::context::Cancelled),
    /// The mesh has more in it than the format can say.
    #[error("the mesh is too large for the format")]
    TooLarge,
    /// The PNG could not be made.
    #[error("the picture could not be encoded: {0}")]
    Png(#[from] png::EncodingError),
}

/// A mesh with its defects, laid out to be drawn: each face with its colour, each line and dot with its kind.
#[derive(Debug, Clone)]
pub struct Scene {
    /// The finite faces, welded at equal positions.
    pub surface: Surface,
    /// For each face of `surface` what it is shown as.
    pub paint: Vec<Paint>,
    /// Pieces of lines, gravest kind first.
    pub segments: Vec<Segment>,
    /// Dots, gravest kind first.
    pub dots: Vec<Dot>,
    /// Where the mesh lies.
    pub frame: Frame,
    /// What was found.
    pub legend: Vec<LegendEntry>,
    /// What it is about.
    pub shows: Shows,
}

/// What a scene is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shows {
    /// What is wrong with a mesh.
    Defects,
    /// What became of one mesh in another.
    Change,
}

/// One straight piece of a defect's line, in the model's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// The kind of the defect.
    pub kind: DefectKind,
    /// Its two ends, which differ.
    pub ends: [DVec3; 2],
}

/// The place of a defect that is a point, or of faces that may be too small to be seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dot {
    /// The kind of the defect.
    pub kind: DefectKind,
    /// Where, in the model's unit.
    pub at: DVec3,
    /// The largest extent of its faces as a share of the model's half extent; 0 for a point.
    pub extent: f64,
}

/// Where a mesh lies, and how to bring it into the cube from -1 to 1 whatever its size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// The box, in the model's unit.
    pub bounds: Box3,
    /// A power of two that brings coordinates to where sums and squares neither overflow nor vanish.
    pub scale: f64,
    /// The middle of the box, scaled.
    pub centre: DVec3,
    /// Half of the box's longest side, scaled; above 0.
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

    /// A point of the model in the cube from -1 to 1.
    #[must_use]
    pub fn to_cube(&self, p: DVec3) -> DVec3 {
        (p * self.scale - self.centre) / self.half
    }

    /// Back from the cube to the model's unit.
    #[must_use]
    pub fn from_cube(&self, p: DVec3) -> DVec3 {
        (p * self.half + self.centre) / self.scale
    }

    /// The box's sides, in the model's unit.
    #[must_use]
    pub fn sides(&self) -> DVec3 {
        if self.bounds.is_empty() {
            return DVec3::ZERO;
        }
        let sides = (self.bounds.max * 0.5 - self.bounds.min * 0.5) * 2.0;
        sides.min(DVec3::splat(f64::MAX))
    }

    /// Whether a point lies in the box, or beside it by no more than rounding.
    fn holds(&self, p: DVec3) -> bool {
        // False for what is not a number.
        self.to_cube(p).abs().cmple(DVec3::splat(1.001)).all()
    }
}

impl Scene {
    /// Lays out a mesh with what was found on it. O(n log n) in the faces.
    ///
    /// # Errors
    /// [`RenderError::Cancelled`] when the work should stop.
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
        for kind in BY_GRAVITY {
            for defect in findings.places(kind) {
                scene.place(kind, defect, soup);
            }
            context.check()?;
        }
        Ok(scene)
    }

    /// Lays out what became of a mesh: the faces of `after` by their provenance, and what was removed. O(n log n).
    ///
    /// # Errors
    /// [`RenderError::Cancelled`] when the work should stop, [`RenderError::TooLarge`] beyond 2^32 vertices.
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

    /// Adds the line or the dot of one defect.
    fn place(&mut self, kind: DefectKind, defect: &Defect, soup: &Soup) {
        if !defect.line.is_empty() {
            let points = || defect.line.iter().map(|&p| DVec3::from_array(p));
            for (a, b) in points().zip(points().skip(1)) {
                self.segment(kind, a, b);
            }
            // The chain of a hole is closed, whether its first point is said twice or not.
            if let (DefectKind::Hole, Some(first), Some(last)) = (kind, points().next(), points().next_back()) {
                self.segment(kind, last, first);
            }
            return;
        }
        if shape(kind) == Shape::Parts && kind != DefectKind::TinyPart {
            return;
        }
        let points = defect.faces.iter().filter_map(|&f| corners(soup, f)).flatten();
        let extent = Box3::of(points.map(|p| self.frame.to_cube(p)));
        let extent = if extent.is_empty() { 0.0 } else { (extent.max - extent.min).max_element() };
        // A face without area shows only as its edges.
        if matches!(kind, DefectKind::FlatFace | DefectKind::DegenerateFace) {
            for [a, b, c] in defect.faces.iter().filter_map(|&f| corners(soup, f)) {
                self.segment(kind, a, b);
                self.segment(kind, b, c);
                self.segment(kind, c, a);
            }
        }
        let at = DVec3::from_array(defect.at);
        if self.dots.len() < MOST_DOTS && self.frame.holds(at) {
            let extent = if shape(kind) == Shape::Point { 0.0 } else { extent };
            self.dots.push(Dot { kind, at, extent });
        }
    }

    fn segment(&mut self, kind: DefectKind, a: DVec3, b: DVec3) {
        if self.segments.len() < MOST_SEGMENTS && a != b && self.frame.holds(a) && self.frame.holds(b) {
            self.segments.push(Segment { kind, ends: [a, b] });
        }
    }

    /// The faces grouped by what they are shown as: sound ones first, then by kind, or by provenance; no group is empty.
    #[must_use]
    pub fn groups(&self) -> Vec<(Paint, Vec<u32>)> {
        let paints: Vec<Paint> = match self.shows {
            Shows::Defects => std::iter::once(Paint::Sound).chain(DefectKind::ALL.map(Paint::Defect)).collect(),
            Shows::Change => Provenance::ALL.map(Paint::Provenance).to_vec(),
        };
        let mut groups = vec![Vec::new(); paints.len()];
        for (paint, f) in self.paint.iter().zip(0u32..) {
            groups[usize::from(paint.number())].push(f);
        }
        paints.into_iter().zip(groups).filter(|(_, faces)| !faces.is_empty()).collect()
    }

    /// The scene with at most `most_faces` faces: vertices that share a cell of a grid become one in their middle, and faces that are
    /// left with less than three are gone (Rossignac and Borrel 1993). It asks nothing of the mesh and keeps each face's paint, but
    /// promises only that it looks alike. O(n) a try.
    ///
    /// # Errors
    /// [`RenderError::Cancelled`] when the work should stop.
    pub fn coarse(&self, most_faces: usize, context: &Context<'_>) -> Result<Self, RenderError> {
        let mut cells = CELLS;
        let (surface, paint) = loop {
            context.check()?;
            match self.gathered(cells, most_faces) {
                Some(gathered) => break gathered,
                None => cells *= FEWER,
            }
        };
        let segments = self.segments.iter().take(COARSE_SEGMENTS).copied().collect();
        let dots = self.dots.iter().take(COARSE_DOTS).copied().collect();
        let (frame, legend, shows) = (self.frame, self.legend.clone(), self.shows);
        Ok(Self { surface, paint, segments, dots, frame, legend, shows })
    }

    /// The faces between the cells of a grid with so many along the longest side; none where there are more than `most`.
    fn gathered(&self, cells: f64, most: usize) -> Option<(Surface, Vec<Paint>)> {
        let mut known: FxHashMap<[u32; 3], u32> = FxHashMap::default();
        let mut sums: Vec<(DVec3, f64)> = Vec::new();
        let mut cell_of = Vec::with_capacity(self.surface.positions.len());
        for &position in &self.surface.positions {
            let place = self.frame.to_cube(position);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "from 0 to the cells' count")]
            let cell = ((place + 1.0) * (0.5 * cells)).max(DVec3::ZERO).to_array().map(|x| x as u32);
            let number = match known.entry(cell) {
                Entry::Occupied(entry) => *entry.get(),
                Entry::Vacant(entry) => {
                    sums.push((DVec3::ZERO, 0.0));
                    *entry.insert(u32::try_from(sums.len()).ok()? - 1)
                }
            };
            let (sum, count) = &mut sums[number as usize];
            *sum += place;
            *count += 1.0;
            cell_of.push(number);
        }
        let (mut seen, mut faces, mut paint) = (FxHashSet::default(), Vec::new(), Vec::new());
        for (face, &shown) in self.surface.faces.iter().zip(&self.paint) {
            let [a, b, c] = face.map(|v| cell_of[v as usize]);
            if a == b || b == c || c == a {
                continue;
            }
            // The same face from its smallest corner on, so that it is found again however it is written, but not turned over.
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

/// The vertices that some faces use, in order of first use, and the faces in terms of them.
pub struct Compacted {
    /// Indices of the vertices in the surface.
    pub vertices: Vec<u32>,
    /// The faces as indices into `vertices`.
    pub faces: Vec<[u32; 3]>,
}

/// Numbers the vertices of groups of faces anew, one group after the other.
pub struct Compactor {
    number: Vec<u32>,
}

impl Compactor {
    /// For a surface of `vertices` vertices.
    #[must_use]
    pub fn new(vertices: usize) -> Self {
        Self { number: vec![u32::MAX; vertices] }
    }

    /// Numbers the vertices of one group.
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
