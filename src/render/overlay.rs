//! Lines and dots of defects, drawn over the rasterised surface of one view.

use std::ops::Range;

use glam::DVec3;

use super::image::{Camera, Projected, STEPS};
use super::palette::{Colour, colour};
use super::raster::{Fragment, Raster};
use super::scene::Scene;

/// Half widths of lines and dots, and width of the dark rim around both, in samples.
#[derive(Clone, Copy)]
struct Widths {
    line: f32,
    dot: f32,
    rim: f32,
}

/// Widths by number of markers: the more markers, the thinner, so that the surface stays visible.
const WIDE: Widths = Widths { line: 2.2, dot: 6.5, rim: 1.6 };
const MEDIUM: Widths = Widths { line: 1.7, dot: 4.2, rim: 1.0 };
const THIN: Widths = Widths { line: 1.2, dot: 3.0, rim: 0.7 };

const RIM_COLOUR: Colour = Colour([0x22, 0x22, 0x22]);
/// Depth tolerance in samples: a line or dot is hidden only by surface nearer by more than this.
const SLACK: f32 = 8.0;
/// Maximum number of samples that the lines and dots of one view may draw. The most severe ones of each strip come
/// first.
const MAX_SAMPLES: usize = 20_000_000;
/// Faces larger than this, in samples, are visible without a dot.
const MAX_DOT_EXTENT: f64 = 10.0;

/// Lines and dots of a scene, projected into one view.
pub struct Overlay {
    dots: Vec<(Projected, Colour)>,
    lines: Vec<([Projected; 2], Colour)>,
    widths: Widths,
    /// For each sample of the current strip, whether a marker covers it.
    covered: Vec<bool>,
    remaining: usize,
}

impl Overlay {
    /// Projects the markers of a scene.
    #[must_use]
    pub fn new(scene: &Scene, camera: &Camera) -> Self {
        let project = |p: DVec3| camera.project(scene.frame.to_cube(p).as_vec3());
        let small = |extent: f64| extent * f64::from(camera.scale) < MAX_DOT_EXTENT;
        let dots: Vec<_> =
            scene.dots.iter().filter(|d| small(d.extent)).map(|d| (project(d.at), colour(d.kind))).collect();
        let lines: Vec<_> = scene.segments.iter().map(|s| (s.ends.map(project), colour(s.kind))).collect();
        let widths = match dots.len() + lines.len() / 4 {
            0..=100 => WIDE,
            101..=1000 => MEDIUM,
            _ => THIN,
        };
        Self { dots, lines, widths, covered: Vec::new(), remaining: MAX_SAMPLES }
    }

    /// Draws the markers over the surface; nearer surface hides them. The most severe of several overlapping markers
    /// stays visible.
    pub fn draw(&mut self, raster: &mut Raster) {
        let Widths { line, dot, rim } = self.widths;
        self.covered.clear();
        self.covered.resize(raster.depth.len(), false);
        let mut strip = Strip { raster, covered: &mut self.covered, remaining: &mut self.remaining };
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
    covered: &'a mut [bool],
    remaining: &'a mut usize,
}

impl Strip<'_> {
    /// Draws a line segment with round ends, `half` samples wide to each side, sample by sample along its major axis.
    fn line(&mut self, ends: [Projected; 2], half: f32, colour: Colour) {
        let [a, b] = ends.map(|p| [in_samples(p.x), in_samples(p.y), p.z]);
        let major = usize::from((b[1] - a[1]).abs() > (b[0] - a[0]).abs());
        let (a, b) = if a[major] <= b[major] { (a, b) } else { (b, a) };
        let run = b[major] - a[major];
        let slope = if run > 0.0 { [0, 1, 2].map(|k| (b[k] - a[k]) / run) } else { [0.0; 3] };
        let minor = 1 - major;
        let across = half * slope[minor].hypot(1.0);
        let within = [0..self.raster.width, self.raster.rows.clone()];
        for along in samples(a[major] - half, b[major] + half, &within[major]) {
            let t = (centre(along) - a[major]).clamp(0.0, run);
            // Beyond the ends, the width follows a circle.
            let beyond = (centre(along) - a[major] - t).abs();
            let across = if beyond > 0.0 { (half * half - beyond * beyond).max(0.0).sqrt() } else { across };
            let line_centre = a[minor] + slope[minor] * t;
            let z = a[2] + slope[2] * t;
            for offset in samples(line_centre - across, line_centre + across, &within[minor]) {
                let [x, y] = if major == 0 { [along, offset] } else { [offset, along] };
                self.put(x, y, z, colour);
            }
        }
    }

    fn dot(&mut self, at: Projected, radius: f32, colour: Colour) {
        let [x, y] = [in_samples(at.x), in_samples(at.y)];
        for row in samples(y - radius, y + radius, &self.raster.rows.clone()) {
            let half = (radius * radius - (centre(row) - y).powi(2)).max(0.0).sqrt();
            for column in samples(x - half, x + half, &(0..self.raster.width)) {
                self.put(column, row, at.z, colour);
            }
        }
    }

    fn put(&mut self, x: usize, y: usize, z: f32, colour: Colour) {
        let sample = (y - self.raster.rows.start) * self.raster.width + x;
        *self.remaining = self.remaining.saturating_sub(1);
        if *self.remaining > 0 && !self.covered[sample] && z + SLACK >= self.raster.depth[sample] {
            self.covered[sample] = true;
            self.raster.fragments[sample] = Fragment::new(colour, false);
        }
    }
}

#[expect(clippy::cast_precision_loss, reason = "a place in an image")]
fn in_samples(steps: i32) -> f32 {
    steps as f32 / STEPS as f32
}

#[expect(clippy::cast_precision_loss, reason = "a place in an image")]
fn centre(sample: usize) -> f32 {
    sample as f32 + 0.5
}

/// The samples whose centres are between two coordinates, clamped to a range.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped by `as`, and to the range")]
fn samples(low: f32, high: f32, within: &Range<usize>) -> Range<usize> {
    let first = (low - 0.5).ceil().max(0.0) as usize;
    let end = ((high - 0.5).floor() + 1.0).max(0.0) as usize;
    first.max(within.start)..end.min(within.end)
}
