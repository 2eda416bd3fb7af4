use std::ops::Range;

use glam::DVec3;

use super::image::{Camera, Projected, STEPS};
use super::palette::{Colour, colour};
use super::raster::{Raster, Seen};
use super::scene::Scene;

/// Half widths in samples of a line, of a dot, and of the dark rim around both.
#[derive(Clone, Copy)]
struct Widths {
    line: f32,
    dot: f32,
    rim: f32,
}

/// Thinner the more there are, so that the surface is still seen.
const FEW: Widths = Widths { line: 2.2, dot: 6.5, rim: 1.6 };
const MANY: Widths = Widths { line: 1.7, dot: 4.2, rim: 1.0 };
const VERY_MANY: Widths = Widths { line: 1.2, dot: 3.0, rim: 0.7 };

const RIM_COLOUR: Colour = Colour([0x22, 0x22, 0x22]);
/// Lines and dots lie on the surface: they are seen unless it is nearer by more than this, in samples.
const SLACK: f32 = 8.0;
/// Samples that the lines and dots of one view may take; in each strip the gravest come first.
const MOST_SAMPLES: usize = 20_000_000;
/// Faces that are larger than this, in samples, are seen without a dot.
const SMALL: f64 = 10.0;

/// The lines and dots of a scene in one view.
pub struct Overlay {
    dots: Vec<(Projected, Colour)>,
    lines: Vec<([Projected; 2], Colour)>,
    widths: Widths,
    /// Samples of the strip that have their colour.
    taken: Vec<bool>,
    left: usize,
}

impl Overlay {
    /// Places them.
    #[must_use]
    pub fn new(scene: &Scene, camera: &Camera) -> Self {
        let project = |p: DVec3| camera.project(scene.frame.to_cube(p).as_vec3());
        let small = |extent: f64| extent * f64::from(camera.scale) < SMALL;
        let dots: Vec<_> =
            scene.dots.iter().filter(|d| small(d.extent)).map(|d| (project(d.at), colour(d.kind))).collect();
        let lines: Vec<_> = scene.segments.iter().map(|s| (s.ends.map(project), colour(s.kind))).collect();
        let widths = match dots.len() + lines.len() / 4 {
            0..=100 => FEW,
            101..=1000 => MANY,
            _ => VERY_MANY,
        };
        Self { dots, lines, widths, taken: Vec::new(), left: MOST_SAMPLES }
    }

    /// Draws them over the surface, hidden where it hides them. Of several at a place the gravest is seen.
    pub fn draw(&mut self, raster: &mut Raster) {
        let Widths { line, dot, rim } = self.widths;
        self.taken.clear();
        self.taken.resize(raster.depth.len(), false);
        let mut strip = Strip { raster, taken: &mut self.taken, left: &mut self.left };
        for &(at, colour) in &self.dots {
            strip.dot(at, dot, colour);
        }
        for &(at, _) in &self.dots {
            strip.dot(at, dot + rim, RIM_COLOUR);
        }
        for &(ends, colour) in &self.lines {
            strip.line(ends, line, colour);
        }
        for &(ends, _) in &self.lines {
            strip.line(ends, line + rim, RIM_COLOUR);
        }
    }
}

struct Strip<'a> {
    raster: &'a mut Raster,
    taken: &'a mut [bool],
    left: &'a mut usize,
}

impl Strip<'_> {
    /// A piece of a line with round ends, `half` samples wide to each side: along its steeper axis, sample by sample.
    fn line(&mut self, ends: [Projected; 2], half: f32, colour: Colour) {
        let [a, b] = ends.map(|p| [in_samples(p.x), in_samples(p.y), p.z]);
        let steep = usize::from((b[1] - a[1]).abs() > (b[0] - a[0]).abs());
        let (a, b) = if a[steep] <= b[steep] { (a, b) } else { (b, a) };
        let run = b[steep] - a[steep];
        let slope = if run > 0.0 { [0, 1, 2].map(|k| (b[k] - a[k]) / run) } else { [0.0; 3] };
        let flat = 1 - steep;
        let across = half * slope[flat].hypot(1.0);
        let within = [0..self.raster.width, self.raster.rows.clone()];
        for along in samples(a[steep] - half, b[steep] + half, &within[steep]) {
            let t = (middle(along) - a[steep]).clamp(0.0, run);
            // Beyond the ends the width follows a circle.
            let beyond = (middle(along) - a[steep] - t).abs();
            let across = if beyond > 0.0 { (half * half - beyond * beyond).max(0.0).sqrt() } else { across };
            let centre = a[flat] + slope[flat] * t;
            let z = a[2] + slope[2] * t;
            for aside in samples(centre - across, centre + across, &within[flat]) {
                let [x, y] = if steep == 0 { [along, aside] } else { [aside, along] };
                self.put(x, y, z, colour);
            }
        }
    }

    fn dot(&mut self, at: Projected, radius: f32, colour: Colour) {
        let [x, y] = [in_samples(at.x), in_samples(at.y)];
        for row in samples(y - radius, y + radius, &self.raster.rows.clone()) {
            let half = (radius * radius - (middle(row) - y).powi(2)).max(0.0).sqrt();
            for column in samples(x - half, x + half, &(0..self.raster.width)) {
                self.put(column, row, at.z, colour);
            }
        }
    }

    fn put(&mut self, x: usize, y: usize, z: f32, colour: Colour) {
        let sample = (y - self.raster.rows.start) * self.raster.width + x;
        *self.left = self.left.saturating_sub(1);
        if *self.left > 0 && !self.taken[sample] && z + SLACK >= self.raster.depth[sample] {
            self.taken[sample] = true;
            self.raster.seen[sample] = Seen::new(colour, false);
        }
    }
}

#[expect(clippy::cast_precision_loss, reason = "a place in an image")]
fn in_samples(steps: i32) -> f32 {
    steps as f32 / STEPS as f32
}

#[expect(clippy::cast_precision_loss, reason = "a place in an image")]
fn middle(sample: usize) -> f32 {
    sample as f32 + 0.5
}

/// The samples whose middles are between two places, within a range.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped by `as`, and to the range")]
fn samples(low: f32, high: f32, within: &Range<usize>) -> Range<usize> {
    let first = (low - 0.5).ceil().max(0.0) as usize;
    let end = ((high - 0.5).floor() + 1.0).max(0.0) as usize;
    first.max(within.start)..end.min(within.end)
}
