use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

use super::{Colour, RenderError};

/// The font's raster: Noto Sans Mono, 16 pixels high.
const HEIGHT: RasterHeight = RasterHeight::Size16;
const WEIGHT: FontWeight = FontWeight::Regular;

/// An image in RGB.
#[derive(Debug, Clone, PartialEq)]
pub struct Canvas {
    /// Width and height in pixels.
    pub size: [usize; 2],
    pixels: Vec<[u8; 3]>,
}

impl Canvas {
    /// An image of one colour.
    #[must_use]
    pub fn new(size: [usize; 2], colour: Colour) -> Self {
        Self { size, pixels: vec![colour.0; size[0] * size[1]] }
    }

    /// The colour of a pixel.
    #[must_use]
    #[cfg(test)]
    pub fn get(&self, x: usize, y: usize) -> Colour {
        Colour(self.pixels[y * self.size[0] + x])
    }

    /// Puts a pixel, where it is in the image.
    pub fn put(&mut self, x: usize, y: usize, colour: Colour) {
        if x < self.size[0] && y < self.size[1] {
            self.pixels[y * self.size[0] + x] = colour.0;
        }
    }

    /// The pixels of a row.
    ///
    /// # Panics
    /// When there is no such row.
    pub fn row(&mut self, y: usize) -> &mut [[u8; 3]] {
        &mut self.pixels[y * self.size[0]..(y + 1) * self.size[0]]
    }

    /// Fills a rectangle.
    pub fn fill(&mut self, [x, y]: [usize; 2], [width, height]: [usize; 2], colour: Colour) {
        let (left, right) = (x.min(self.size[0]), (x + width).min(self.size[0]));
        for row in y..(y + height).min(self.size[1]) {
            self.row(row)[left..right].fill(colour.0);
        }
    }

    /// Copies an image to a place.
    pub fn paste(&mut self, other: &Self, [x, y]: [usize; 2]) {
        let left = x.min(self.size[0]);
        let width = other.size[0].min(self.size[0] - left);
        for (row, from) in (y..self.size[1]).zip(other.pixels.chunks_exact(other.size[0].max(1))) {
            self.row(row)[left..][..width].copy_from_slice(&from[..width]);
        }
    }

    /// Writes a line of text with its upper left corner at a place; letters that the font lacks become `?`.
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

    /// The image as PNG; the same bytes for the same pixels.
    ///
    /// # Errors
    /// Those of the encoder.
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

/// The width of a text of `letters` letters, in pixels.
#[must_use]
pub fn text_width(letters: usize) -> usize {
    letters * get_raster_width(WEIGHT, HEIGHT)
}
