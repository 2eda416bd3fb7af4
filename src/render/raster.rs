use std::ops::Range;

use glam::{Vec3, Vec4};

use super::image::{Camera, Projected, SAMPLES, STEPS};
use super::palette::{BY_GRAVITY, Colour, INSIDE, Paint};
use super::scene::Scene;
use crate::inspect::DefectKind;

/// Samples that the faces of one view may cover together. A mesh that covers more, which no real one does, is drawn
/// from every nth of its sound faces.
const MOST_COVERED: f64 = 6e7;
/// Where the light stands: right, up, towards the eye.
const LIGHT: Vec3 = Vec3::new(-0.32, 0.50, 0.80);
/// Light on a face that is turned away from the light; it grows smoothly to 1, so that faces in the shadow differ too.
const SHADOW: f32 = 0.44;
/// How far in front of its neighbours a face with a defect is taken to be, in samples for each step of gravity, so that
/// of faces at the same place the gravest is seen; and how far behind an inner side is.
const LIFT: f32 = 0.05;
const DROP: f32 = 0.03;
/// Width of the line along a face's edges in samples, and how dark it is where faces are large.
const WIRE: f32 = 1.0;
const WIRE_DARK: f32 = 0.22;

/// Rows of samples that are drawn together: few enough to stay in the processor's cache, whatever the size of the picture.
const STRIP: usize = 32 * SAMPLES;

/// A strip of the samples of one view: what is nearest, and its colour.
#[derive(Debug, Clone)]
pub struct Raster {
    /// Samples in a row.
    pub width: usize,
    /// The view's rows of samples that are in it.
    pub rows: Range<usize>,
    /// Depth of the nearest surface, larger towards the eye; minus infinity where there is none.
    pub depth: Vec<f32>,
    /// What is seen of it.
    pub seen: Vec<Seen>,
}

/// The faces of one view, ready to be drawn strip by strip.
pub struct Faces<'a> {
    scene: &'a Scene,
    points: &'a [Vec3],
    camera: &'a Camera,
    placed: Vec<Projected>,
    /// Those of each strip begin here in `order`, and end where those of the next begin.
    begin: Vec<usize>,
    order: Vec<u32>,
    lifts: [f32; DefectKind::ALL.len()],
    /// Only every nth of the sound faces is drawn.
    pub every: usize,
}

/// What is seen at a sample: a colour, and whether it is the inner side of a sound face. One number, so that many are chosen
/// from at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Seen(u32);

impl Seen {
    /// A colour, and whether it is that of an inner side.
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

    /// 1 where it is the inner side of a sound face, 0 elsewhere.
    fn inside(self) -> u32 {
        self.0 >> 24
    }

    /// The bits of four, to be chosen from at once; none are those of no number.
    fn bits(four: [Self; 4]) -> Vec4 {
        Vec4::from_array(four.map(|it| f32::from_bits(it.0)))
    }

    fn of_bits(bits: Vec4) -> [Self; 4] {
        bits.to_array().map(|it| Self(it.to_bits()))
    }
}

impl<'a> Faces<'a> {
    /// Places the faces of a scene. `points` are its vertices in the cube.
    #[must_use]
    pub fn new(scene: &'a Scene, points: &'a [Vec3], camera: &'a Camera) -> Self {
        let every = every(scene, points, camera);
        let placed: Vec<Projected> = points.iter().map(|&p| camera.project(p)).collect();
        let shown = || {
            (0u32..)
                .zip(&scene.paint)
                .filter(|&(f, paint)| !paint.is_plain() || (f as usize).is_multiple_of(every))
                .map(|it| it.0)
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

    /// Draws each strip of the view before a background, from above, and lets `done` have it.
    pub fn draw(&self, background: Colour, mut done: impl FnMut(&mut Raster)) {
        let [width, height] = self.camera.size;
        let mut raster = Raster { width, rows: 0..0, depth: Vec::new(), seen: Vec::new() };
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
        let normal = self.camera.turn((b - a).cross(c - a)).normalize_or_zero();
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
            Paint::Sound => 0.0,
            Paint::Defect(kind) => self.lifts[kind as usize],
            Paint::Provenance(provenance) => f32::from(provenance as u8) * LIFT,
        };
        let lift = if outer { lift } else { lift - DROP };
        let placed = vertices.map(|v| {
            let it = self.placed[v as usize];
            Projected { z: it.z + lift, ..it }
        });
        raster.triangle(placed, colour, !outer && paint == Paint::Sound);
    }
}

impl Raster {
    /// Begins some rows of a view anew.
    fn clear(&mut self, rows: Range<usize>, background: Colour) {
        let samples = rows.len() * self.width;
        self.rows = rows;
        self.depth.clear();
        self.depth.resize(samples, f32::NEG_INFINITY);
        self.seen.clear();
        self.seen.resize(samples, Seen::new(background, false));
    }

    /// How many samples show the inner side of a sound face.
    #[must_use]
    pub fn inside(&self) -> usize {
        // Below 2^32, as the samples of a strip are.
        self.seen.iter().map(|seen| seen.inside()).sum::<u32>() as usize
    }

    /// Fills a triangle, its borders included, and darkens it along its edges.
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
        let (plain, dark) = (Seen::new(colour, inside), Seen::new(colour.lit(1.0 - wire.dark), inside));
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

    /// Fills the columns of a row from one to another where the plane is the nearest so far.
    #[expect(clippy::cast_sign_loss, reason = "clamped to the image")]
    fn fill(&mut self, row: i64, [first, last]: [i64; 2], plane: &Plane, colour: Seen) {
        if first > last {
            return;
        }
        let begin = (row as usize - self.rows.start) * self.width;
        let samples = begin + first as usize..begin + last as usize + 1;
        let (depth, last_depth) = self.depth[samples.clone()].as_chunks_mut::<4>();
        let (seen, last_seen) = self.seen[samples].as_chunks_mut::<4>();
        // Four at a time, without a branch.
        let (mut depths, colours) = (plane.along(first, row), Seen::bits([colour; 4]));
        for ((depth, seen), z) in depth.iter_mut().zip(seen).zip(&mut depths) {
            let before = Vec4::from_array(*depth);
            *depth = z.max(before).to_array();
            *seen = Seen::of_bits(Vec4::select(z.cmpgt(before), colours, Seen::bits(*seen)));
        }
        let rest = depths.next().map_or([f32::NEG_INFINITY; 4], |it| it.to_array());
        for ((depth, seen), z) in last_depth.iter_mut().zip(last_seen).zip(rest) {
            if z > *depth {
                (*depth, *seen) = (z, colour);
            }
        }
    }

    /// The columns and rows of samples whose middles a triangle's box holds, those above and below this strip too.
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

/// For each kind, how far its faces are lifted.
fn lifts() -> [f32; DefectKind::ALL.len()] {
    let mut lifts = [0.0; DefectKind::ALL.len()];
    let mut lift = 0.0;
    for kind in BY_GRAVITY.into_iter().rev() {
        lift += LIFT;
        lifts[kind as usize] = lift;
    }
    lifts
}

/// From how many sound faces one is drawn, so that all together cover no more than [`MOST_COVERED`].
fn every(scene: &Scene, points: &[Vec3], camera: &Camera) -> usize {
    let doubled: f64 = scene
        .surface
        .faces
        .iter()
        .map(|face| {
            let [a, b, c] = face.map(|v| points[v as usize]);
            f64::from(camera.turn((b - a).cross(c - a)).z.abs())
        })
        .sum();
    let covered = doubled / 2.0 * f64::from(camera.scale).powi(2);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "above 0, and no more than there are faces"
    )]
    {
        (covered / MOST_COVERED).ceil().max(1.0) as usize
    }
}

/// Twice the signed area, positive where the three turn clockwise on the screen.
fn cross(a: Projected, b: Projected, c: Projected) -> i64 {
    let d = |p: i32, q: i32| i64::from(p) - i64::from(q);
    d(b.x, a.x) * d(c.y, a.y) - d(b.y, a.y) * d(c.x, a.x)
}

/// The function of one edge, which is not negative on the triangle's side: its value, and its change a sample.
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

    /// The value at the middle of a sample.
    fn at(&self, column: i64, row: i64) -> i64 {
        let steps = i64::from(STEPS);
        let [x, y] = [column * steps + steps / 2 - self.from[0], row * steps + steps / 2 - self.from[1]];
        (self.right * x + self.down * y) / steps
    }

    /// Length in steps.
    #[expect(clippy::cast_precision_loss, reason = "for a width only")]
    fn length(&self) -> f32 {
        (self.right as f32).hypot(self.down as f32) / STEPS as f32
    }
}

/// The columns of one row where no edge is negative.
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

/// The whole part of a quotient of numbers from 0 on. Exact: in an image edges' values are below 2^40 and their changes below 2^27,
/// so that no quotient is nearer to the next whole number than f64 tells. A processor divides these several times faster.
#[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "below 2^40")]
fn quotient(of: i64, by: i64) -> i64 {
    (of as f64 / by as f64) as i64
}

/// Depth over a triangle, kept within that of its corners, which a sliver's slope would leave.
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

    /// The depths of a row's samples from a column on, four at a time.
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

/// Where a triangle is darkened along its edges: the larger it is on the screen, the more.
struct Wire {
    near: [i64; 3],
    dark: f32,
}

impl Wire {
    #[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "a width")]
    fn new(edges: &[Edge; 3], doubled: i64) -> Self {
        let lengths = edges.map(|edge| edge.length());
        let longest = lengths[0].max(lengths[1]).max(lengths[2]);
        // The least height, in samples.
        let height = doubled as f32 / longest.max(1.0) / STEPS as f32;
        let share = ((height - 6.0) / 24.0).clamp(0.0, 1.0);
        let near = lengths.map(|length| if share > 0.0 { (length * WIRE * STEPS as f32 / 2.0) as i64 } else { 0 });
        Self { near, dark: WIRE_DARK * share }
    }

    /// The columns of one row that are not darkened.
    fn within(&self, edges: &[Edge; 3], begin: [i64; 3], columns: [i64; 2]) -> Option<[i64; 2]> {
        span(edges, [0, 1, 2].map(|e| begin[e] - self.near[e]), columns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quotient_has_the_whole_part_that_whole_numbers_give() {
        for by in [1, 3, 255, 256, 83_000_001, (1 << 27) - 1] {
            for times in [0, 1, 2, 1267, (1 << 40) / by - 1] {
                for beside in [-1, 0, 1, by / 2] {
                    let of = (by * times + beside).max(0);
                    assert_eq!(quotient(of, by), of / by, "{of} / {by}");
                }
            }
        }
    }
}
