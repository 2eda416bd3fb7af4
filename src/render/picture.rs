use glam::Vec3;
use rayon::prelude::*;

use super::camera::{Camera, SAMPLES, VIEWS, View};
use super::canvas::{Canvas, text_width};
use super::overlay::draw_overlay;
use super::palette::INSIDE;
use super::raster::Raster;
use super::{Colour, RenderError, Scene};
use crate::context::Context;

/// Width and height of a picture in pixels.
const SIZE: [usize; 2] = [960, 720];
/// Share of the width that the large view has, in percent.
const LARGE_PCT: usize = 66;
/// Heights of the line above the views and of a line of the legend.
const HEADER: usize = 30;
const LINE: usize = 20;
/// Width of a column of the legend.
const COLUMN: usize = 320;
/// Space between views, and around the mesh in its view.
const GAP: usize = 4;
const MARGIN: usize = 22;

const PAPER: Colour = Colour([0xFF; 3]);
const PANEL: Colour = Colour([0xF1, 0xF3, 0xF6]);
const INK: Colour = Colour([0x1E, 0x24, 0x2C]);
const FAINT: Colour = Colour([0x6B, 0x75, 0x82]);

/// Draws a mesh from four fixed sides with its defects in colour, a legend with counts, a scale and the size of its
/// box, as PNG. `title` stands above.
///
/// # Errors
/// [`RenderError::Cancelled`] when the work should stop, [`RenderError::Png`] from the encoder.
pub fn write_picture(scene: &Scene, title: &str, context: &Context<'_>) -> Result<Vec<u8>, RenderError> {
    context.check()?;
    let points: Vec<Vec3> = scene.surface.positions.iter().map(|&p| scene.frame.to_cube(p).as_vec3()).collect();
    let key_lines = (scene.legend.len() + 1).div_ceil(SIZE[0] / COLUMN);
    let footer = key_lines * LINE + 8;
    let places = layout([SIZE[0], SIZE[1] - HEADER - footer]);
    // Each view is drawn by itself, so that the picture is the same for any number of threads.
    let drawn: Vec<Drawn> =
        VIEWS.par_iter().zip(&places).map(|(view, &[_, size])| draw_view(scene, &points, view, size)).collect();
    context.check()?;
    let mut canvas = Canvas::new(SIZE, PAPER);
    for (it, [[x, y], _]) in drawn.iter().zip(places) {
        canvas.paste(&it.canvas, [x, y + HEADER]);
    }
    header(&mut canvas, scene, title, drawn.iter().map(|it| it.every).max().unwrap_or(1));
    key(&mut canvas, scene, drawn.iter().any(|it| it.inside), SIZE[1] - footer + 4);
    canvas.png()
}

/// Where the views are: the large one at the left, the others below one another at the right.
fn layout([width, height]: [usize; 2]) -> [[[usize; 2]; 2]; 4] {
    let large = width * LARGE_PCT / 100;
    let small = (height - 2 * GAP) / 3;
    let at = |i: usize| [[large + GAP, i * (small + GAP)], [width - large - GAP, small]];
    [[[0, 0], [large, 3 * small + 2 * GAP]], at(0), at(1), at(2)]
}

/// One view.
struct Drawn {
    canvas: Canvas,
    inside: bool,
    every: usize,
}

fn draw_view(scene: &Scene, points: &[Vec3], view: &View, size: [usize; 2]) -> Drawn {
    let camera = Camera::new(view, &scene.surface, points, size, MARGIN);
    let mut raster = Raster::new(scene, points, &camera);
    draw_overlay(scene, &camera, &mut raster);
    let mut canvas = resolve(&raster);
    canvas.text([8, 4], view.name, FAINT);
    if !scene.surface.faces.is_empty() {
        scale_bar(&mut canvas, camera.pixels_a_unit(&scene.frame));
    }
    Drawn { canvas, inside: raster.shows_inside(), every: raster.every }
}

/// Takes the mean of each pixel's samples.
fn resolve(raster: &Raster) -> Canvas {
    let size = raster.size.map(|s| s / SAMPLES);
    let mut canvas = Canvas::new(size, PANEL);
    for y in 0..size[1] {
        for x in 0..size[0] {
            let mut sum = [0u16; 3];
            for (i, j) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let sample = (y * SAMPLES + j) * raster.size[0] + x * SAMPLES + i;
                let colour = if raster.depth[sample] > f32::NEG_INFINITY { raster.seen[sample].colour } else { PANEL };
                for (s, c) in sum.iter_mut().zip(colour.0) {
                    *s += u16::from(c);
                }
            }
            #[expect(clippy::cast_possible_truncation, reason = "the mean of bytes")]
            canvas.put(x, y, Colour(sum.map(|s| ((s + 2) / 4) as u8)));
        }
    }
    canvas
}

/// A bar of a round length, at most a quarter of the view, with the length beside it.
fn scale_bar(canvas: &mut Canvas, pixels_a_unit: f64) {
    #[expect(clippy::cast_precision_loss, reason = "an image's size")]
    let room = canvas.size[0] as f64 / 4.0;
    let longest = room / pixels_a_unit;
    if !longest.is_finite() || longest <= 0.0 {
        return;
    }
    let decade = 10f64.powf(longest.log10().floor());
    let length = [5.0, 2.0, 1.0].into_iter().map(|d| d * decade).find(|&l| l <= longest).unwrap_or(decade);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "no more than a quarter of the view")]
    let pixels = (length * pixels_a_unit).round() as usize;
    let y = canvas.size[1] - 12;
    canvas.fill([10, y], [pixels, 2], INK);
    canvas.fill([10, y - 3], [2, 8], INK);
    canvas.fill([8 + pixels, y - 3], [2, 8], INK);
    canvas.text([16 + pixels, y - 8], &number(length), INK);
}

fn header(canvas: &mut Canvas, scene: &Scene, title: &str, every: usize) {
    let faces = scene.surface.faces.len();
    let found: u64 = scene.legend.iter().map(|entry| entry.count).sum();
    let part = if every > 1 { format!(" (one of {every} drawn)") } else { String::new() };
    let text = format!("{title}: {faces} face{}{part}, {found} finding{}", plural(faces as u64), plural(found));
    canvas.text([8, 7], &text, INK);
    if faces > 0 {
        let [x, y, z] = scene.frame.sides().to_array().map(number);
        let text = format!("box {x} x {y} x {z}");
        let left = SIZE[0].saturating_sub(8 + text_width(text.len()));
        canvas.text([left, 7], &text, INK);
    }
}

fn plural(count: u64) -> &'static str {
    if count == 1 { "" } else { "s" }
}

/// The legend, column by column, and what else must be known to read the picture.
fn key(canvas: &mut Canvas, scene: &Scene, inside: bool, top: usize) {
    let mut lines: Vec<(Option<Colour>, String)> =
        scene.legend.iter().map(|e| (Some(e.colour), format!("{} {}", e.count, e.name))).collect();
    if scene.surface.faces.is_empty() {
        lines.push((None, "there is no face to draw".to_owned()));
    } else if inside {
        lines.push((Some(INSIDE), "inner side of the surface".to_owned()));
    } else if lines.is_empty() {
        lines.push((None, "nothing was found".to_owned()));
    }
    let columns = SIZE[0] / COLUMN;
    let rows = lines.len().div_ceil(columns);
    for (i, (colour, text)) in lines.iter().enumerate() {
        let [x, y] = [8 + i / rows * COLUMN, top + i % rows * LINE];
        if let Some(colour) = colour {
            canvas.fill([x, y + 2], [14, 14], INK);
            canvas.fill([x + 1, y + 3], [12, 12], *colour);
        }
        canvas.text([x + if colour.is_some() { 22 } else { 0 }, y + 1], text, INK);
    }
}

/// A length in at most five digits.
fn number(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    if !(1e-4..1e7).contains(&value) {
        return format!("{value:.2e}");
    }
    #[expect(clippy::cast_possible_truncation, reason = "between -4 and 7")]
    let digits = (3 - value.log10().floor() as i32).clamp(0, 8);
    #[expect(clippy::cast_sign_loss, reason = "clamped above")]
    let text = format!("{value:.*}", digits as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}
