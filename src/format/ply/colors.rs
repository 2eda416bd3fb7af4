use std::ops::Range;

use super::super::content::Paints;
use super::super::palettes::Palettes;
use crate::scene::{PAINTLESS, Paint};

/// The colours of vertices and of triangles, as they are read. Where vertices have some, those of triangles are not used.
#[derive(Default)]
pub(super) struct Colors {
    pub of_vertices: Vec<[u8; 4]>,
    /// Of the first triangles, up to the last that has one.
    of_triangles: Vec<Option<[u8; 4]>>,
}

impl Colors {
    /// Gives some triangles, which come in order, a colour.
    pub fn of_triangles(&mut self, triangles: Range<usize>, color: [u8; 4]) {
        self.of_triangles.resize(triangles.start, None);
        self.of_triangles.resize(triangles.end, Some(color));
    }

    /// The paint of all triangles.
    pub fn paint(self, triangles: &[[u32; 3]]) -> Paints {
        let mut palettes = Palettes::default();
        let of_faces = if !self.of_vertices.is_empty() {
            let entries: Vec<u32> = self.of_vertices.iter().map(|&color| palettes.color(color).1).collect();
            let palette = palettes.colors();
            triangles.iter().map(|corners| Paint { palette, at: corners.map(|v| entries[v as usize]) }).collect()
        } else if self.of_triangles.is_empty() {
            Vec::new()
        } else {
            let mut paint = |color| {
                let (palette, entry) = palettes.color(color);
                Paint { palette, at: [entry; 3] }
            };
            let colors = self.of_triangles.iter().copied().chain(std::iter::repeat(None));
            triangles.iter().zip(colors).map(|(_, color)| color.map_or(PAINTLESS, &mut paint)).collect()
        };
        Paints { of_faces, palettes: palettes.finish(), textures: Vec::new() }
    }
}
