//! Pictures as PNG: four views of a scene with header, legend and scale bars.

use glam::Vec3;
use rayon::prelude::*;

use super::image::{Camera, Canvas, SAMPLES, VIEWS, View, text_width};
use super::overlay::Overlay;
use super::palette::{Colour, INSIDE, LegendEntry, Paint};
use super::raster::{Faces, Fragment, Raster};
use super::scene::{RenderError, Scene, Shows};
use crate::context::Context;
use crate::inspect::Provenance;

/// Width and height of a picture, in pixels.
const SIZE: [usize; 2] = [960, 720];
/// Width of the large view, in percent of the picture.
const LARGE_PCT: usize = 66;
/// Heights of the header and of a legend line, in pixels.
const HEADER: usize = 30;
const LINE: usize = 20;
/// Most columns of a legend, and width of a text's place for its colour and the space beside it, in pixels.
const MAX_COLUMNS: usize = 3;
const SWATCH: usize = 30;
/// Space between views, and margin around the mesh in a view, in pixels.
const GAP: usize = 4;
const MARGIN: usize = 22;
/// Number of samples of one view from which the legend mentions the inner side.
const MIN_INSIDE_SAMPLES: usize = 40;

const PAPER: Colour = Colour([0xFF; 3]);
const PANEL: Colour = Colour([0xF1, 0xF3, 0xF6]);
const INK: Colour = Colour([0x1E, 0x24, 0x2C]);
const FAINT: Colour = Colour([0x6B, 0x75, 0x82]);

/// Draws a scene as PNG: four fixed views with defects in colour, a legend with counts, a scale bar, and the size of
/// the bounding box. `title` starts the header.
///
/// # Errors
/// [`RenderError::Cancelled`] on cancellation or timeout, [`RenderError::Png`] from the encoder.
pub fn write_picture(scene: &Scene, title: &str, context: &Context<'_>) -> Result<Vec<u8>, RenderError> {
    context.check()?;
    let points: Vec<Vec3> = scene.surface.positions.iter().map(|&p| scene.frame.to_cube(p).as_vec3()).collect();
    let footer = (scene.legend.len() + 1).div_ceil(legend_columns(scene)) * LINE + 8;
    let rectangles = layout([SIZE[0], SIZE[1] - HEADER - footer]);
    // Each view is drawn by one thread, so that the picture does not depend on the number of threads.
    let drawn: Vec<RenderedView> =
        VIEWS.par_iter().zip(&rectangles).map(|(view, &[_, size])| draw_view(scene, &points, view, size)).collect();
    context.check()?;
    let mut canvas = Canvas::new(SIZE, PAPER);
    for (view, [[x, y], _]) in drawn.iter().zip(rectangles) {
        canvas.paste(&view.canvas, [x, y + HEADER]);
    }
    draw_header(&mut canvas, scene, title, drawn.iter().map(|view| view.every).max().unwrap_or(1));
    draw_legend(&mut canvas, scene, drawn.iter().any(|view| view.inside), SIZE[1] - footer + 4);
    canvas.png()
}

/// Positions and sizes of the views: the large one on the left, the others stacked on the right.
fn layout([width, height]: [usize; 2]) -> [[[usize; 2]; 2]; 4] {
    let large = width * LARGE_PCT / 100;
    let small = (height - 2 * GAP) / 3;
    let at = |i: usize| [[large + GAP, i * (small + GAP)], [width - large - GAP, small]];
    [[[0, 0], [large, 3 * small + 2 * GAP]], at(0), at(1), at(2)]
}

/// One rendered view.
struct RenderedView {
    canvas: Canvas,
    inside: bool,
    every: usize,
}

fn draw_view(scene: &Scene, points: &[Vec3], view: &View, size: [usize; 2]) -> RenderedView {
    let camera = Camera::new(view, &scene.surface, points, size, MARGIN);
    let (faces, mut overlay) = (Faces::new(scene, points, &camera), Overlay::new(scene, &camera));
    let (mut canvas, mut inside) = (Canvas::new(size, PANEL), 0);
    faces.draw(PANEL, |raster| {
        overlay.draw(raster);
        average_samples(raster, &mut canvas);
        inside += raster.inside();
    });
    canvas.text([8, 4], view.name, FAINT);
    if !scene.surface.faces.is_empty() {
        scale_bar(&mut canvas, camera.pixels_per_unit(&scene.frame));
    }
    RenderedView { canvas, inside: inside >= MIN_INSIDE_SAMPLES, every: faces.every }
}

/// Averages each pixel's samples.
fn average_samples(raster: &Raster, canvas: &mut Canvas) {
    for (y, rows) in (raster.rows.start / SAMPLES..).zip(raster.fragments.chunks_exact(SAMPLES * raster.width)) {
        let (upper, lower) = rows.split_at(raster.width);
        let samples = upper.as_chunks::<SAMPLES>().0.iter().zip(lower.as_chunks::<SAMPLES>().0);
        for (pixel, (&[a, b], &[c, d])) in canvas.row(y).iter_mut().zip(samples) {
            let colour = if a == b && a == c && a == d { a.colour() } else { mean([a, b, c, d].map(Fragment::colour)) };
            *pixel = colour.0;
        }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "the mean of bytes")]
fn mean(four: [Colour; 4]) -> Colour {
    Colour([0, 1, 2].map(|k| ((four.iter().map(|colour| u16::from(colour.0[k])).sum::<u16>() + 2) / 4) as u8))
}

/// Draws a scale bar with a round length, at most a quarter of the view's width, and the length next to it.
fn scale_bar(canvas: &mut Canvas, pixels_per_unit: f64) {
    #[expect(clippy::cast_precision_loss, reason = "an image's size")]
    let available = canvas.size[0] as f64 / 4.0;
    let longest = available / pixels_per_unit;
    if !longest.is_finite() || longest <= 0.0 {
        return;
    }
    let decade = 10f64.powf(longest.log10().floor());
    let length = [5.0, 2.0, 1.0].into_iter().map(|d| d * decade).find(|&l| l <= longest).unwrap_or(decade);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "no more than a quarter of the view")]
    let pixels = (length * pixels_per_unit).round() as usize;
    let y = canvas.size[1] - 12;
    canvas.fill([10, y], [pixels, 2], INK);
    canvas.fill([10, y - 3], [2, 8], INK);
    canvas.fill([8 + pixels, y - 3], [2, 8], INK);
    canvas.text([16 + pixels, y - 8], &number(length), INK);
}

fn draw_header(canvas: &mut Canvas, scene: &Scene, title: &str, every: usize) {
    let faces = scene.surface.faces.len();
    let suffix = match scene.shows {
        Shows::Defects => {
            let count: u64 = scene.legend.iter().map(|entry| entry.count).sum();
            format!(", {count} finding{}", plural(count))
        }
        // The drawn faces are those of the result and the removed ones.
        Shows::Change
            if scene
                .legend
                .iter()
                .any(|entry| entry.kind == Paint::Provenance(Provenance::Removed) && entry.count > 0) =>
        {
            ", including removed faces".to_owned()
        }
        Shows::Change | Shows::Thickness => String::new(),
    };
    let part = if every > 1 { format!(" (1 in {every} drawn)") } else { String::new() };
    let text = format!("{title}: {faces} face{}{part}{suffix}", plural(faces as u64));
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

/// The text of a legend's entry.
fn legend_text(entry: &LegendEntry) -> String {
    format!("{} {}", entry.count, entry.name)
}

/// The number of legend columns in which each text has enough width.
fn legend_columns(scene: &Scene) -> usize {
    let longest = scene.legend.iter().map(|entry| legend_text(entry).chars().count()).max().unwrap_or(0);
    (SIZE[0] / (SWATCH + text_width(longest))).clamp(1, MAX_COLUMNS)
}

/// Draws the legend column by column, with further hints for reading the picture.
fn draw_legend(canvas: &mut Canvas, scene: &Scene, inside: bool, top: usize) {
    let mut lines: Vec<(Option<Colour>, String)> =
        scene.legend.iter().map(|entry| (Some(entry.colour), legend_text(entry))).collect();
    if scene.surface.faces.is_empty() {
        lines.push((None, "no faces to draw".to_owned()));
    } else if inside {
        lines.push((Some(INSIDE), "inner side of the surface".to_owned()));
    } else if lines.is_empty() {
        lines.push((None, "no defects found".to_owned()));
    }
    let columns = legend_columns(scene);
    let rows = lines.len().div_ceil(columns);
    for (i, (colour, text)) in lines.iter().enumerate() {
        let [x, y] = [8 + i / rows * (SIZE[0] / columns), top + i % rows * LINE];
        if let Some(colour) = colour {
            canvas.fill([x, y + 2], [14, 14], INK);
            canvas.fill([x + 1, y + 3], [12, 12], *colour);
        }
        canvas.text([x + if colour.is_some() { 22 } else { 0 }, y + 1], text, INK);
    }
}

/// Formats a length with few digits: at most five, or in scientific notation.
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

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    use glam::DVec3;

    use super::*;
    use crate::context::NoProgress;
    use crate::inspect::{Defect, DefectKind, Findings};
    use crate::mesh::Soup;
    use crate::render::palette::legend_of_thickness;

    const FRONT: usize = 2;
    const ABOVE: usize = 3;
    const BELOW: usize = 1;

    /// A cube of side 2 around the origin; its last two faces are the top.
    fn cube() -> Soup {
        let positions = (0..8).map(|i| DVec3::new(side(i & 1), side(i >> 1 & 1), side(i >> 2))).collect();
        let quads = [[0, 2, 3, 1], [0, 1, 5, 4], [1, 3, 7, 5], [3, 2, 6, 7], [2, 0, 4, 6], [4, 5, 7, 6]];
        Soup { positions, faces: quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect() }
    }

    fn side(bit: u32) -> f64 {
        f64::from(bit) * 2.0 - 1.0
    }

    fn defect(faces: &[u32], line: &[[f64; 3]]) -> Defect {
        Defect { at: [0.0; 3], faces: faces.to_vec(), line: line.to_vec(), value: None, meeting: None }
    }

    fn with_context<T>(run: impl FnOnce(&Context<'_>) -> T) -> T {
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        run(&Context::new(&NoProgress, &cancel, &clock, Duration::MAX))
    }

    fn render_view(soup: &Soup, findings: &Findings, view: usize) -> RenderedView {
        let scene = with_context(|context| Scene::new(soup, findings, context)).unwrap();
        let points: Vec<Vec3> = scene.surface.positions.iter().map(|&p| scene.frame.to_cube(p).as_vec3()).collect();
        draw_view(&scene, &points, &VIEWS[view], [100, 80])
    }

    /// Number of pixels that satisfy `is`, excluding the caption and the scale bar.
    fn count(drawn: &RenderedView, is: impl Fn([u8; 3]) -> bool) -> usize {
        let [width, height] = drawn.canvas.size;
        (24..height - 20)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .filter(|&(x, y)| is(drawn.canvas.get(x, y).0))
            .count()
    }

    fn red([r, g, b]: [u8; 3]) -> bool {
        r > 60 && g < r / 3 && b < r / 3
    }

    fn sound([r, g, b]: [u8; 3]) -> bool {
        r == g && g == b && (120..200).contains(&r)
    }

    fn blue([r, g, b]: [u8; 3]) -> bool {
        b > 90 && r < b / 3 && g < b
    }

    #[test]
    fn a_marked_face_shows_its_colour_from_the_front_only() {
        let mut findings = Findings::new(12, 10);
        findings.push(DefectKind::SelfIntersection, defect(&[10, 11], &[]));
        let above = render_view(&cube(), &findings, ABOVE);
        assert!(count(&above, red) > 900, "{} pixels of the top", count(&above, red));
        assert_eq!(count(&above, sound), 0);
        for view in [BELOW, FRONT] {
            assert_eq!(count(&render_view(&cube(), &findings, view), red), 0);
        }
        assert_eq!(count(&render_view(&cube(), &Findings::new(12, 10), ABOVE), red), 0);
        assert!(count(&render_view(&cube(), &Findings::new(12, 10), ABOVE), sound) > 900);
    }

    #[test]
    fn a_line_is_visible_on_the_surface_and_hidden_behind_it() {
        let mut findings = Findings::new(12, 10);
        findings.push(DefectKind::MisorientedEdge, defect(&[], &[[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0]]));
        findings.push(DefectKind::MisorientedEdge, defect(&[], &[[-0.5, 0.0, -1.0], [0.5, 0.0, -1.0]]));
        assert!(count(&render_view(&cube(), &findings, FRONT), blue) > 10);
        let mut hidden = Findings::new(12, 10);
        hidden.push(DefectKind::MisorientedEdge, defect(&[], &[[-0.5, 0.0, -1.0], [0.5, 0.0, -1.0]]));
        assert_eq!(count(&render_view(&cube(), &hidden, ABOVE), blue), 0);
        assert!(count(&render_view(&cube(), &hidden, BELOW), blue) > 10);
    }

    #[test]
    fn the_inner_side_is_visible_only_through_a_hole() {
        let open = Soup { faces: cube().faces[..10].to_vec(), ..cube() };
        assert!(render_view(&open, &Findings::new(10, 1), ABOVE).inside);
        for view in 0..VIEWS.len() {
            assert!(!render_view(&cube(), &Findings::new(12, 1), view).inside);
        }
    }

    #[test]
    fn the_most_severe_of_coincident_faces_is_visible() {
        for marked in [0, 1] {
            let mut soup = cube();
            soup.faces = vec![soup.faces[10], soup.faces[10]];
            let mut findings = Findings::new(2, 10);
            findings.push(DefectKind::SelfIntersection, defect(&[marked], &[]));
            findings.push(DefectKind::Disjoint, defect(&[1 - marked], &[]));
            assert!(count(&render_view(&soup, &findings, ABOVE), red) > 400);
        }
    }

    #[test]
    fn a_legend_of_long_texts_has_fewer_columns() {
        let mut scene = with_context(|context| Scene::new(&cube(), &Findings::new(12, 10), context)).unwrap();
        assert_eq!(legend_columns(&scene), MAX_COLUMNS);
        scene.legend = legend_of_thickness(&[(1_234_567, 1.0); 8], 100.0);
        let width = SIZE[0] / legend_columns(&scene);
        assert!(scene.legend.iter().all(|entry| SWATCH + text_width(legend_text(entry).len()) <= width));
        assert_eq!(legend_columns(&scene), 2);
    }

    #[test]
    fn a_defect_too_small_to_see_gets_a_dot() {
        let mut soup = cube();
        let n = 8;
        soup.positions.extend([[0.0, 0.0], [1e-4, 0.0], [0.0, 1e-4]].map(|[x, y]| DVec3::new(x, y, 1.0 + 1e-4)));
        soup.faces.push([n, n + 1, n + 2]);
        let mut findings = Findings::new(13, 10);
        findings.push(DefectKind::SelfIntersection, Defect { at: [0.0, 0.0, 1.0], ..defect(&[12], &[]) });
        assert!(count(&render_view(&soup, &findings, ABOVE), red) > 10);
        assert_eq!(count(&render_view(&soup, &findings, BELOW), red), 0);
    }

    #[test]
    fn a_dense_surface_leaves_no_pixel_bare() {
        let n = 200u32;
        let mut soup = Soup::default();
        for i in 0..=n {
            for j in 0..=n {
                let (x, y) = (f64::from(i), f64::from(j));
                soup.positions.push(DVec3::new(
                    x + (y * 0.7).sin() * 0.3,
                    y + (x * 1.3).sin() * 0.3,
                    (x * y).sin() * 0.1,
                ));
            }
        }
        for i in 0..n {
            for j in 0..n {
                let at = |i: u32, j: u32| i * (n + 1) + j;
                soup.faces.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                soup.faces.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
        let drawn = render_view(&soup, &Findings::new(soup.faces.len(), 1), ABOVE);
        let [width, height] = drawn.canvas.size;
        let bare = (26..height - 26).flat_map(|y| (width / 2 - 14..width / 2 + 14).map(move |x| (x, y)));
        assert_eq!(bare.filter(|&(x, y)| drawn.canvas.get(x, y).0[0] > 205).count(), 0);
    }

    #[test]
    fn excessive_overdraw_samples_sound_faces_but_draws_all_defects() {
        let mut soup = cube();
        let top = soup.faces[10];
        soup.faces = vec![top; 200_000];
        let mut findings = Findings::new(soup.faces.len(), 10);
        findings.push(DefectKind::SelfIntersection, defect(&[123_457], &[]));
        let drawn = render_view(&soup, &findings, ABOVE);
        assert!(drawn.every > 1, "no face is skipped");
        assert!(count(&drawn, red) > 400);
    }

    #[test]
    fn numbers_are_short_at_any_size() {
        let numbers = [0.0, 1.0, 49.6, 0.120_74, 1234.56, 1e-12, 3e200, f64::MAX].map(number);
        assert_eq!(numbers, ["0", "1", "49.6", "0.1207", "1235", "1.00e-12", "3.00e200", "1.80e308"]);
    }
}
