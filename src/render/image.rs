//! Image primitives of the renderer: views, cameras, and an RGB canvas with text.

use glam::{DVec3, Vec3};
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

use super::palette::Colour;
use super::scene::{Frame, RenderError};
use crate::mesh::Surface;

/// Font raster: Noto Sans Mono, 16 pixels high.
const HEIGHT: RasterHeight = RasterHeight::Size16;
const WEIGHT: FontWeight = FontWeight::Regular;

/// A fixed viewing direction with an up direction; views are parallel projections.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Caption of the view in the picture.
    pub name: &'static str,
    /// Direction from the model to the eye.
    pub towards_eye: DVec3,
    /// Up direction in the picture; not parallel to `towards_eye`.
    pub up: DVec3,
}

/// Views of a picture, the large one first. The first two together show all six sides.
pub const VIEWS: [View; 4] = [
    View { name: "from front, right, above", towards_eye: DVec3::new(0.7, -1.0, 0.65), up: DVec3::Z },
    View { name: "from back, left, below", towards_eye: DVec3::new(-0.7, 1.0, -0.65), up: DVec3::Z },
    View { name: "from the front", towards_eye: DVec3::NEG_Y, up: DVec3::Z },
    View { name: "from above", towards_eye: DVec3::Z, up: DVec3::Y },
];

/// Number of samples along a pixel's side.
pub const SAMPLES: usize = 2;
/// Fixed-point steps per sample. Integer coordinates make edge tests exact, so that neighbouring faces leave no gaps.
pub const STEPS: i32 = 256;

/// A view fitted to an image. Projects points of the scene's cube to samples of the image.
#[derive(Debug, Clone)]
pub struct Camera {
    axes: [Vec3; 3],
    /// Samples per unit of the cube.
    pub scale: f32,
    shift: [f32; 2],
    /// Width and height in samples.
    pub size: [usize; 2],
}

/// A projected point: `x` to the right and `y` down in [`STEPS`] of a sample, `z` towards the eye in samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projected {
    /// Coordinate to the right, in fixed-point steps.
    pub x: i32,
    /// Coordinate downward, in fixed-point steps.
    pub y: i32,
    /// Coordinate towards the eye, in samples.
    pub z: f32,
}

impl Camera {
    /// Fits a view of a surface to an image of `size` pixels, with a margin of `margin` pixels on each side. `points`
    /// are the surface's vertices in the cube.
    #[must_use]
    pub fn new(view: &View, surface: &Surface, points: &[Vec3], size: [usize; 2], margin: usize) -> Self {
        let eye = view.towards_eye.normalize();
        let right = view.up.cross(eye).normalize();
        let axes = [right, eye.cross(right), eye].map(DVec3::as_vec3);
        let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for &v in surface.faces.iter().flatten() {
            for k in 0..2 {
                let at = axes[k].dot(points[v as usize]);
                low[k] = low[k].min(at);
                high[k] = high[k].max(at);
            }
        }
        if surface.faces.is_empty() {
            (low, high) = ([-1.0; 2], [1.0; 2]);
        }
        #[expect(clippy::cast_precision_loss, reason = "an image's size")]
        let available: [f32; 2] = size.map(|s| s.saturating_sub(2 * margin).max(1) as f32 * SAMPLES as f32);
        let fit = |k: usize| available[k] / (high[k] - low[k]).max(1e-6);
        let scale = fit(0).min(fit(1));
        #[expect(clippy::cast_precision_loss, reason = "an image's size")]
        let middle = size.map(|s| (s * SAMPLES) as f32 / 2.0);
        let shift = [middle[0] - scale * (low[0] + high[0]) / 2.0, middle[1] + scale * (low[1] + high[1]) / 2.0];
        Self { axes, scale, shift, size: size.map(|s| s * SAMPLES) }
    }

    /// Projects a point of the cube into the image.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "an image's size")]
    pub fn project(&self, p: Vec3) -> Projected {
        let [x, y, z] = self.axes.map(|axis| axis.dot(p) * self.scale);
        let steps = STEPS as f32;
        Projected {
            x: ((x + self.shift[0]) * steps).round() as i32,
            y: ((self.shift[1] - y) * steps).round() as i32,
            z,
        }
    }

    /// Rotates a direction of the model into right, up and towards-eye components.
    #[must_use]
    pub fn rotate(&self, direction: Vec3) -> Vec3 {
        Vec3::from_array(self.axes.map(|axis| axis.dot(direction)))
    }

    /// Pixels per model unit.
    #[must_use]
    pub fn pixels_per_unit(&self, frame: &Frame) -> f64 {
        f64::from(self.scale) / SAMPLES as f64 * (frame.scale / frame.half)
    }
}

/// An RGB image.
#[derive(Debug, Clone, PartialEq)]
pub struct Canvas {
    /// Width and height in pixels.
    pub size: [usize; 2],
    pixels: Vec<[u8; 3]>,
}

impl Canvas {
    /// Creates an image filled with one colour.
    #[must_use]
    pub fn new(size: [usize; 2], colour: Colour) -> Self {
        Self { size, pixels: vec![colour.0; size[0] * size[1]] }
    }

    /// Colour of a pixel.
    #[must_use]
    #[cfg(test)]
    pub fn get(&self, x: usize, y: usize) -> Colour {
        Colour(self.pixels[y * self.size[0] + x])
    }

    /// Sets a pixel; ignores coordinates outside the image.
    pub fn put(&mut self, x: usize, y: usize, colour: Colour) {
        if x < self.size[0] && y < self.size[1] {
            self.pixels[y * self.size[0] + x] = colour.0;
        }
    }

    /// Pixels of a row.
    ///
    /// # Panics
    /// If the row does not exist.
    pub fn row(&mut self, y: usize) -> &mut [[u8; 3]] {
        &mut self.pixels[y * self.size[0]..(y + 1) * self.size[0]]
    }

    /// Fills a rectangle, clipped to the image.
    pub fn fill(&mut self, [x, y]: [usize; 2], [width, height]: [usize; 2], colour: Colour) {
        let (left, right) = (x.min(self.size[0]), (x + width).min(self.size[0]));
        for row in y..(y + height).min(self.size[1]) {
            self.row(row)[left..right].fill(colour.0);
        }
    }

    /// Copies another image to a position, clipped to this image.
    pub fn paste(&mut self, other: &Self, [x, y]: [usize; 2]) {
        let left = x.min(self.size[0]);
        let width = other.size[0].min(self.size[0] - left);
        for (row, from) in (y..self.size[1]).zip(other.pixels.chunks_exact(other.size[0].max(1))) {
            self.row(row)[left..][..width].copy_from_slice(&from[..width]);
        }
    }

    /// Writes a line of text with its upper left corner at a position. Characters missing from the font become `?`.
    pub fn text(&mut self, [x, y]: [usize; 2], text: &str, colour: Colour) {
        for (i, letter) in text.chars().enumerate() {
            let Some(raster) = get_raster(letter, WEIGHT, HEIGHT).or_else(|| get_raster('?', WEIGHT, HEIGHT)) else {
                continue;
            };
            for (row, line) in raster.rows().enumerate() {
                for (column, &ink) in line.iter().enumerate() {
                    let [px, py] = [x + i * text_width(1) + column, y + row];
                    if ink > 0 && px < self.size[0] && py < self.size[1] {
                        let below = Colour(self.pixels[py * self.size[0] + px]);
                        self.put(px, py, below.mixed(colour, f32::from(ink) / 255.0));
                    }
                }
            }
        }
    }

    /// Encodes the image as PNG. Equal pixels give equal bytes.
    ///
    /// # Errors
    /// [`RenderError::Png`] from the encoder, or [`RenderError::TooLarge`].
    pub fn png(&self) -> Result<Vec<u8>, RenderError> {
        let mut file = Vec::new();
        let side = |k: usize| u32::try_from(self.size[k]).map_err(|_| RenderError::TooLarge);
        let mut encoder = png::Encoder::new(&mut file, side(0)?, side(1)?);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Fast);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(self.pixels.as_flattened())?;
        writer.finish()?;
        Ok(file)
    }
}

/// Width of a text in pixels, given its number of characters.
#[must_use]
pub fn text_width(letters: usize) -> usize {
    letters * get_raster_width(WEIGHT, HEIGHT)
}
