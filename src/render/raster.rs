//! Software rasteriser for the faces of one view. Fixed-point coordinates make pictures identical on all machines.

use std::ops::Range;

use glam::{Vec3, Vec4};

use super::image::{Camera, Projected, SAMPLES, STEPS};
use super::palette::{BY_SEVERITY, Colour, INSIDE, Paint};
use super::scene::Scene;
use crate::inspect::DefectKind;

/// Maximum number of samples that the faces of one view may cover in total. A view that covers more, which only
/// adversarial meshes do, draws only every nth sound face: a face without a defect.
const MAX_COVERED: f64 = 6e7;
/// Direction to the light: right, up, towards the eye.
const LIGHT: Vec3 = Vec3::new(-0.32, 0.50, 0.80);
/// Intensity on a face turned away from the light. Intensity rises smoothly to 1, so that shaded faces differ too.
const SHADOW: f32 = 0.44;
/// Depth offset of a face per severity step, in samples, so that the most severe of coincident faces is visible.
const LIFT: f32 = 0.05;
/// Depth offset away from the eye of inner sides, in samples.
const DROP: f32 = 0.03;
/// Width of the line along a face's edges in samples, and its darkness on large faces.
const WIRE: f32 = 1.0;
const WIRE_DARK: f32 = 0.22;

/// Number of sample rows drawn together: few enough to fit in the processor's cache, whatever the picture's size.
const STRIP: usize = 32 * SAMPLES;

/// A strip of one view's samples, with depth and colour of the nearest surface.
#[derive(Debug, Clone)]
pub struct Raster {
    /// Number of samples per row.
    pub width: usize,
    /// Rows of the view in this strip.
    pub rows: Range<usize>,
    /// Depth of the nearest surface, increasing towards the eye; minus infinity for background.
    pub depth: Vec<f32>,
    /// Visible fragment at each sample.
    pub fragments: Vec<Fragment>,
}

/// The faces of one view, sorted by strip.
pub struct Faces<'a> {
    scene: &'a Scene,
    points: &'a [Vec3],
    camera: &'a Camera,
    placed: Vec<Projected>,
    /// Start of each strip's faces in `order`; the end is the start of the next strip.
    begin: Vec<usize>,
    order: Vec<u32>,
    lifts: [f32; DefectKind::ALL.len()],
    /// Interval of drawn sound faces: every nth is drawn.
    pub every: usize,
}

/// Visible fragment at a sample: a colour, and whether it is the inner side of a sound face. Packed in one number,
/// for selection with SIMD.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fragment(u32);

impl Fragment {
    /// Packs a colour and whether it belongs to an inner side.
    #[must_use]
    pub fn new(Colour([r, g, b]): Colour, inside: bool) -> Self {
        Self(u32::from_be_bytes([u8::from(inside), r, g, b]))
    }

    /// The colour.
    #[must_use]
    pub fn colour(self) -> Colour {
        let [_, r, g, b] = self.0.to_be_bytes();
        Colour([r, g, b])
    }

    /// 1 for the inner side of a sound face, otherwise 0.
    fn inside(self) -> u32 {
        self.0 >> 24
    }

    /// Bits of four fragments for SIMD selection. No bit pattern is a NaN.
    fn bits(four: [Self; 4]) -> Vec4 {
        Vec4::from_array(four.map(|fragment| f32::from_bits(fragment.0)))
    }

    fn of_bits(bits: Vec4) -> [Self; 4] {
        bits.to_array().map(|bits| Self(bits.to_bits()))
    }
}

impl<'a> Faces<'a> {
    /// Projects and sorts the faces of a scene. `points` are the scene's vertices, scaled to the cube that all views share.
    #[must_use]
    pub fn new(scene: &'a Scene, points: &'a [Vec3], camera: &'a Camera) -> Self {
        let every = every(scene, points, camera);
        let placed: Vec<Projected> = points.iter().map(|&p| camera.project(p)).collect();
        let shown = || {
            (0u32..)
                .zip(&scene.paint)
                .filter(|&(f, paint)| !paint.is_plain() || (f as usize).is_multiple_of(every))
                .map(|(f, _)| f)
        };
        let count = camera.size[1].div_ceil(STRIP);
        let strips = |f: u32| {
            let heights = scene.surface.faces[f as usize].map(|v| placed[v as usize].y);
            let strip = |y: i32| usize::try_from(y / STEPS).unwrap_or(0) / STRIP;
            let [low, high] = [heights.iter().min(), heights.iter().max()].map(|y| y.map_or(0, |&y| strip(y)));
            low..(high + 1).min(count)
        };
        let mut begin = vec![0; count + 1];
        shown().flat_map(strips).for_each(|strip| begin[strip + 1] += 1);
        for strip in 0..count {
            begin[strip + 1] += begin[strip];
        }
        let (mut order, mut next) = (vec![0; begin[count]], begin.clone());
        for f in shown() {
            for strip in strips(f) {
                order[next[strip]] = f;
                next[strip] += 1;
            }
        }
        Self { scene, points, camera, placed, begin, order, lifts: lifts(), every }
    }

    /// Draws the view strip by strip from the top over a background, and passes each strip to `done`.
    pub fn draw(&self, background: Colour, mut done: impl FnMut(&mut Raster)) {
        let [width, height] = self.camera.size;
        let mut raster = Raster { width, rows: 0..0, depth: Vec::new(), fragments: Vec::new() };
        for (top, faces) in (0..height).step_by(STRIP).zip(self.begin.windows(2)) {
            raster.clear(top..(top + STRIP).min(height), background);
            for &f in &self.order[faces[0]..faces[1]] {
                self.face(f as usize, &mut raster);
            }
            done(&mut raster);
        }
    }

    fn face(&self, f: usize, raster: &mut Raster) {
        let (vertices, paint) = (self.scene.surface.faces[f], self.scene.paint[f]);
        let [a, b, c] = vertices.map(|v| self.points[v as usize]);
        let normal = self.camera.rotate((b - a).cross(c - a)).normalize_or_zero();
        if normal.z == 0.0 {
            return;
        }
        let outer = normal.z > 0.0;
        let towards_light = normal.dot(if outer { LIGHT } else { -LIGHT });
        let light = SHADOW + (1.0 - SHADOW) * ((towards_light + 1.0) / 2.0).powi(2);
        let colour = match (outer, paint) {
            (true, _) => paint.colour().lit(light),
            (false, Paint::Sound) => INSIDE.lit(light),
            (false, _) => paint.colour().mixed(INSIDE, 0.3).lit(0.8 * light),
        };
        let lift = match paint {
            Paint::Sound | Paint::Thickness(_) => 0.0,
            Paint::Defect(kind) => self.lifts[kind as usize],
            Paint::Provenance(provenance) => f32::from(provenance as u8) * LIFT,
        };
        let lift = if outer { lift } else { lift - DROP };
        let placed = vertices.map(|v| {
            let p = self.placed[v as usize];
            Projected { z: p.z + lift, ..p }
        });
        raster.triangle(placed, colour, !outer && paint == Paint::Sound);
    }
}

impl Raster {
    /// Resets the strip to other rows of the view.
    fn clear(&mut self, rows: Range<usize>, background: Colour) {
        let samples = rows.len() * self.width;
        self.rows = rows;
        self.depth.clear();
        self.depth.resize(samples, f32::NEG_INFINITY);
        self.fragments.clear();
        self.fragments.resize(samples, Fragment::new(background, false));
    }

    /// Number of samples that show the inner side of a sound face.
    #[must_use]
    pub fn inside(&self) -> usize {
        // A strip has fewer than 2^32 samples.
        self.fragments.iter().map(|fragment| fragment.inside()).sum::<u32>() as usize
    }

    /// Fills a triangle including its border, and darkens the samples along its edges.
    fn triangle(&mut self, corners: [Projected; 3], colour: Colour, inside: bool) {
        let [a, mut b, mut c] = corners;
        let mut doubled = cross(a, b, c);
        if doubled == 0 {
            return;
        }
        if doubled < 0 {
            std::mem::swap(&mut b, &mut c);
            doubled = -doubled;
        }
        let corners = [a, b, c];
        let Some([columns, rows]) = self.covered(corners) else { return };
        let edges = [Edge::new(b, c), Edge::new(c, a), Edge::new(a, b)];
        let plane = Plane::new(corners, edges, doubled, [columns[0], rows[0]]);
        let wire = Wire::new(&edges, doubled);
        let (plain, dark) = (Fragment::new(colour, inside), Fragment::new(colour.lit(1.0 - wire.dark), inside));
        #[expect(clippy::cast_possible_wrap, reason = "an image's size")]
        let [top, end] = [self.rows.start as i64, self.rows.end as i64];
        for row in rows[0].max(top)..=rows[1].min(end - 1) {
            let begin = edges.map(|edge| edge.at(columns[0], row));
            let Some([first, last]) = span(&edges, begin, columns) else { continue };
            let [from, to] = wire.within(&edges, begin, columns).unwrap_or([last + 1, last]);
            self.fill(row, [first, from - 1], &plane, dark);
            self.fill(row, [from, to], &plane, plain);
            self.fill(row, [to + 1, last], &plane, dark);
        }
    }

    /// Fills a range of columns of a row where the plane is nearer than the current depth.
    #[expect(clippy::cast_sign_loss, reason = "clamped to the image")]
    fn fill(&mut self, row: i64, [first, last]: [i64; 2], plane: &Plane, colour: Fragment) {
        if first > last {
            return;
        }
        let begin = (row as usize - self.rows.start) * self.width;
        let samples = begin + first as usize..begin + last as usize + 1;
        let (depth, last_depth) = self.depth[samples.clone()].as_chunks_mut::<4>();
        let (fragments, last_fragments) = self.fragments[samples].as_chunks_mut::<4>();
        // Four samples at a time, without branches.
        let (mut depths, colours) = (plane.along(first, row), Fragment::bits([colour; 4]));
        for ((depth, fragment), z) in depth.iter_mut().zip(fragments).zip(&mut depths) {
            let before = Vec4::from_array(*depth);
            *depth = z.max(before).to_array();
            *fragment = Fragment::of_bits(Vec4::select(z.cmpgt(before), colours, Fragment::bits(*fragment)));
        }
        let rest = depths.next().map_or([f32::NEG_INFINITY; 4], |z| z.to_array());
        for ((depth, fragment), z) in last_depth.iter_mut().zip(last_fragments).zip(rest) {
            if z > *depth {
                (*depth, *fragment) = (z, colour);
            }
        }
    }

    /// Columns and rows of samples whose centres are in a triangle's bounding box, including rows outside this strip.
    fn covered(&self, corners: [Projected; 3]) -> Option<[[i64; 2]; 2]> {
        let range = |of: fn(&Projected) -> i32, end: usize| {
            let (low, high) = corners.iter().fold((i32::MAX, i32::MIN), |(l, h), p| (l.min(of(p)), h.max(of(p))));
            let half = i64::from(STEPS / 2);
            let first = (i64::from(low) - half + i64::from(STEPS) - 1).div_euclid(i64::from(STEPS)).max(0);
            #[expect(clippy::cast_possible_wrap, reason = "an image's size")]
            let last = (i64::from(high) - half).div_euclid(i64::from(STEPS)).min(end as i64 - 1);
            (first <= last).then_some([first, last])
        };
        Some([range(|p| p.x, self.width)?, range(|p| p.y, self.rows.end)?])
    }
}

/// Depth offset of each kind's faces.
fn lifts() -> [f32; DefectKind::ALL.len()] {
    let mut lifts = [0.0; DefectKind::ALL.len()];
    let mut lift = 0.0;
    for kind in BY_SEVERITY.into_iter().rev() {
        lift += LIFT;
        lifts[kind as usize] = lift;
    }
    lifts
}

/// Interval of drawn sound faces that keeps the total coverage within [`MAX_COVERED`].
fn every(scene: &Scene, points: &[Vec3], camera: &Camera) -> usize {
    let doubled: f64 = scene
        .surface
        .faces
        .iter()
        .map(|face| {
            let [a, b, c] = face.map(|v| points[v as usize]);
            f64::from(camera.rotate((b - a).cross(c - a)).z.abs())
        })
        .sum();
    let covered = doubled / 2.0 * f64::from(camera.scale).powi(2);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "above 0, and no more than there are faces"
    )]
    {
        (covered / MAX_COVERED).ceil().max(1.0) as usize
    }
}

/// Twice the signed area; positive if the corners are clockwise on the screen.
fn cross(a: Projected, b: Projected, c: Projected) -> i64 {
    let d = |p: i32, q: i32| i64::from(p) - i64::from(q);
    d(b.x, a.x) * d(c.y, a.y) - d(b.y, a.y) * d(c.x, a.x)
}

/// Edge function of a triangle, non-negative on the inner side, with its increments per sample.
#[derive(Debug, Clone, Copy)]
struct Edge {
    from: [i64; 2],
    right: i64,
    down: i64,
}

impl Edge {
    fn new(from: Projected, to: Projected) -> Self {
        let d = |p: i32, q: i32| (i64::from(p) - i64::from(q)) * i64::from(STEPS);
        Self { from: [i64::from(from.x), i64::from(from.y)], right: -d(to.y, from.y), down: d(to.x, from.x) }
    }

    /// Value at the centre of a sample.
    fn at(&self, column: i64, row: i64) -> i64 {
        let steps = i64::from(STEPS);
        let [x, y] = [column * steps + steps / 2 - self.from[0], row * steps + steps / 2 - self.from[1]];
        (self.right * x + self.down * y) / steps
    }

    /// Length in fixed-point steps.
    #[expect(clippy::cast_precision_loss, reason = "for a width only")]
    fn length(&self) -> f32 {
        (self.right as f32).hypot(self.down as f32) / STEPS as f32
    }
}

/// Columns of one row where no edge function is negative.
fn span(edges: &[Edge; 3], begin: [i64; 3], columns: [i64; 2]) -> Option<[i64; 2]> {
    let (mut first, mut last) = (0, columns[1] - columns[0]);
    for (edge, begin) in edges.iter().zip(begin) {
        match edge.right {
            0 if begin < 0 => return None,
            0 => {}
            right if right > 0 && begin < 0 => first = first.max(quotient(right - 1 - begin, right)),
            right if right > 0 => {}
            _ if begin < 0 => return None,
            right => last = last.min(quotient(begin, -right)),
        }
    }
    (first <= last).then_some([columns[0] + first, columns[0] + last])
}

/// Integer quotient of non-negative numbers by f64 division, which is several times faster. Exact: edge values are
/// below 2^40 and increments below 2^27, so that rounding never reaches the next integer.
#[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "below 2^40")]
fn quotient(of: i64, by: i64) -> i64 {
    (of as f64 / by as f64) as i64
}

/// Depth over a triangle, clamped to the depths of its corners because a sliver's slope can exceed them.
struct Plane {
    origin: [i64; 2],
    base: f32,
    right: f32,
    down: f32,
    low: f32,
    high: f32,
}

impl Plane {
    #[expect(clippy::cast_precision_loss, reason = "a depth")]
    fn new(corners: [Projected; 3], edges: [Edge; 3], doubled: i64, origin: [i64; 2]) -> Self {
        let z = corners.map(|p| p.z);
        let weigh = |of: [i64; 3]| (0..3).map(|i| z[i] * (of[i] as f64 / doubled as f64) as f32).sum::<f32>();
        Self {
            origin,
            base: weigh(edges.map(|edge| edge.at(origin[0], origin[1]))),
            right: weigh(edges.map(|edge| edge.right)),
            down: weigh(edges.map(|edge| edge.down)),
            low: z[0].min(z[1]).min(z[2]),
            high: z[0].max(z[1]).max(z[2]),
        }
    }

    /// Depths of a row's samples from a column on, four at a time.
    #[expect(clippy::cast_precision_loss, reason = "a place in an image")]
    fn along(&self, column: i64, row: i64) -> impl Iterator<Item = Vec4> {
        let (right, down) = ((column - self.origin[0]) as f32, (row - self.origin[1]) as f32);
        let [base, slope, below] = [self.base, self.right, self.down * down].map(Vec4::splat);
        let [low, high] = [self.low, self.high].map(Vec4::splat);
        let mut right = Vec4::splat(right) + Vec4::new(0.0, 1.0, 2.0, 3.0);
        std::iter::repeat_with(move || {
            let depths = (base + slope * right + below).max(low).min(high);
            right += 4.0;
            depths
        })
    }
}

/// Darkening along a triangle's edges, stronger for triangles that are larger on the screen.
struct Wire {
    near: [i64; 3],
    dark: f32,
}

impl Wire {
    #[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "a width")]
    fn new(edges: &[Edge; 3], doubled: i64) -> Self {
        let lengths = edges.map(|edge| edge.length());
        let longest = lengths[0].max(lengths[1]).max(lengths[2]);
        // The smallest altitude, in samples.
        let height = doubled as f32 / longest.max(1.0) / STEPS as f32;
        let share = ((height - 6.0) / 24.0).clamp(0.0, 1.0);
        let near = lengths.map(|length| if share > 0.0 { (length * WIRE * STEPS as f32 / 2.0) as i64 } else { 0 });
        Self { near, dark: WIRE_DARK * share }
    }

    /// Columns of one row that are not darkened.
    fn within(&self, edges: &[Edge; 3], begin: [i64; 3], columns: [i64; 2]) -> Option<[i64; 2]> {
        span(edges, [0, 1, 2].map(|e| begin[e] - self.near[e]), columns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_f64_quotient_equals_the_integer_quotient() {
        for by in [1, 3, 255, 256, 83_000_001, (1 << 27) - 1] {
            for times in [0, 1, 2, 1267, (1 << 40) / by - 1] {
                for offset in [-1, 0, 1, by / 2] {
                    let of = (by * times + offset).max(0);
                    assert_eq!(quotient(of, by), of / by, "{of} / {by}");
                }
            }
        }
    }
}
