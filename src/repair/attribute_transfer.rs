//! The transfer of colours, materials and texture coordinates from the input to a result.

use std::collections::HashMap;

use glam::DVec3;

use crate::context::{Cancelled, Context};
use crate::math::{Tree, nearest_on_triangle};
use crate::mesh::{NO_SOURCE, Soup, Surface};
use crate::scene::{PAINTLESS, Paint, Palette};

/// Distance within which a point counts as a triangle's corner, as a share of the triangle's longest side.
const SAME: f64 = 1e-6;
/// Faces between two checks for cancellation.
const STRIDE: usize = 4096;

/// A surface with the attributes of its source faces.
#[derive(Clone, Copy)]
pub(super) struct Painted<'a> {
    /// The surface.
    pub surface: &'a Surface,
    /// The attributes of each source face, by index.
    pub paint: &'a [Paint],
}

/// A mesh whose faces come from the faces of another mesh.
#[derive(Clone, Copy)]
pub(super) struct SoupWithSource<'a> {
    /// The mesh.
    pub soup: &'a Soup,
    /// For each face, the index of its source face in the other mesh, or [`NO_SOURCE`].
    pub source: &'a [u32],
}

/// Transfers attributes from the input to a result. A face cut from an input face gets that face's attributes at its corners. A new face
/// gets those of the nearest input face.
///
/// Interpolated colours and texture coordinates are added to `palettes`. Faces without attributes nearby get none.
///
/// # Errors
/// [`Cancelled`] if the job was canceled or the deadline passed.
pub(super) fn transfer_paint(
    Painted { surface: input, paint }: Painted<'_>,
    SoupWithSource { soup: result, source }: SoupWithSource<'_>,
    palettes: &mut [Palette],
    context: &Context<'_>,
) -> Result<Vec<Paint>, Cancelled> {
    if paint.is_empty() {
        return Ok(Vec::new());
    }
    let mut transfer = AttributeTransfer::new(input, paint, palettes);
    let mut painted = Vec::with_capacity(result.faces.len());
    for face in 0..result.faces.len() {
        if face % STRIDE == 0 {
            context.check()?;
        }
        let corners = result.corners(face);
        let source = source.get(face).copied().unwrap_or(NO_SOURCE);
        painted.push(match transfer.face_of(source) {
            Some(old) => transfer.attributes_of(old, corners),
            None => transfer.attributes_nearby(corners),
        });
    }
    Ok(painted)
}

/// The transfer of attributes from one input.
struct AttributeTransfer<'a> {
    input: &'a Surface,
    /// The attributes of each face of the input's surface.
    paint: Vec<Paint>,
    /// For each source, the face of the input's surface that comes from it.
    of_source: Vec<u32>,
    /// A search tree over the input, built on first use.
    tree: Option<Tree>,
    palettes: &'a mut [Palette],
    /// The indices of interpolated entries, by palette and value.
    colors: HashMap<(u32, [u8; 4]), u32>,
    places: HashMap<(u32, [u64; 2]), u32>,
}

impl<'a> AttributeTransfer<'a> {
    fn new(input: &'a Surface, paint: &[Paint], palettes: &'a mut [Palette]) -> Self {
        let mut of_source = vec![u32::MAX; paint.len()];
        for (face, &source) in (0u32..).zip(&input.source) {
            if let Some(slot) = of_source.get_mut(source as usize) {
                *slot = face;
            }
        }
        let paint =
            input.source.iter().map(|&source| paint.get(source as usize).copied().unwrap_or(PAINTLESS)).collect();
        let (colors, places) = (HashMap::new(), HashMap::new());
        Self { input, paint, of_source, tree: None, palettes, colors, places }
    }

    fn face_of(&self, source: u32) -> Option<u32> {
        self.of_source.get(source as usize).copied().filter(|&face| face != u32::MAX)
    }

    /// The attributes of the input face `old` at these corners.
    fn attributes_of(&mut self, old: u32, corners: [DVec3; 3]) -> Paint {
        let Paint { palette, at } = self.paint[old as usize];
        let triangle = self.input.corners(old as usize);
        Paint { palette, at: corners.map(|p| self.entry(palette, at, weights(p, triangle))) }
    }

    /// The attributes of the nearest input surface for a face with these corners. Material and texture are those nearest to the face's
    /// centre; colours are those nearest to each corner.
    fn attributes_nearby(&mut self, corners: [DVec3; 3]) -> Paint {
        let Some(old) = self.nearest((corners[0] + corners[1] + corners[2]) / 3.0) else { return PAINTLESS };
        let Paint { palette, at } = self.paint[old as usize];
        if !matches!(self.palettes.get(palette as usize), Some(Palette::Colors(_))) {
            return self.attributes_of(old, corners);
        }
        let triangle = self.input.corners(old as usize);
        let at = corners.map(|p| {
            // All corners of a face must use the same palette.
            let own = self.nearest(p).filter(|&own| self.paint[own as usize].palette == palette);
            let (at, triangle) =
                own.map_or((at, triangle), |own| (self.paint[own as usize].at, self.input.corners(own as usize)));
            self.entry(palette, at, weights(p, triangle))
        });
        Paint { palette, at }
    }

    /// The input face nearest to a point.
    fn nearest(&mut self, point: DVec3) -> Option<u32> {
        let input = self.input;
        let tree = self.tree.get_or_insert_with(|| Tree::new(&input.positions, &input.faces));
        let corners = |face: u32| input.corners(face as usize);
        tree.nearest(point, f64::INFINITY, &mut u64::MAX.clone(), corners).map(|nearest| nearest.face)
    }

    /// The index of the palette entry that interpolates three entries with these weights, added if it is new.
    fn entry(&mut self, palette: u32, at: [u32; 3], weights: [f64; 3]) -> u32 {
        let mut counting = at.into_iter().zip(weights).filter(|&(_, weight)| weight > SAME).map(|(at, _)| at);
        let first = counting.next().unwrap_or(at[0]);
        if counting.all(|at| at == first) {
            return first;
        }
        match self.palettes.get_mut(palette as usize) {
            None | Some(Palette::Materials(_)) => at[0],
            Some(Palette::Colors(colors)) => {
                let corner_colors = at.map(|index| colors.get(index as usize).copied().unwrap_or([255; 4]));
                let mixed = std::array::from_fn(|channel| {
                    let weighted = corner_colors.iter().zip(weights);
                    let sum: f64 = weighted.map(|(color, weight)| f64::from(color[channel]) * weight).sum();
                    sum.round().clamp(0.0, 255.0) as u8
                });
                *self.colors.entry((palette, mixed)).or_insert_with(|| added(colors, mixed))
            }
            Some(Palette::Textured { places, .. }) => {
                let corner_places = at.map(|index| places.get(index as usize).copied().unwrap_or_default());
                let mixed: [f64; 2] = std::array::from_fn(|axis| {
                    corner_places.iter().zip(weights).map(|(place, weight)| place[axis] * weight).sum()
                });
                // Every format can store f32.
                let mixed = mixed.map(|x| f64::from(x as f32));
                *self.places.entry((palette, mixed.map(f64::to_bits))).or_insert_with(|| added(places, mixed))
            }
        }
    }
}

/// Appends an entry to a palette and returns its index.
fn added<T>(entries: &mut Vec<T>, entry: T) -> u32 {
    entries.push(entry);
    u32::try_from(entries.len() - 1).unwrap_or(0)
}

/// The barycentric weights of the point of a triangle nearest to `p`. A point at a corner has exactly the weight 1 there.
fn weights(p: DVec3, triangle: [DVec3; 3]) -> [f64; 3] {
    let [a, b, c] = triangle;
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    let q = nearest_on_triangle(p, triangle);
    for (corner, only) in triangle.iter().zip([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) {
        if q.distance(*corner) <= SAME * longest {
            return only;
        }
    }
    let normal = (b - a).cross(c - a);
    let area = normal.length_squared();
    if area == 0.0 {
        // A degenerate triangle is a line: interpolates along its longest side.
        let (d, e) = (q.distance(a), q.distance(b));
        return if d + e > 0.0 { [e / (d + e), d / (d + e), 0.0] } else { [1.0, 0.0, 0.0] };
    }
    let share = |u: DVec3, v: DVec3| ((u - q).cross(v - q).dot(normal) / area).clamp(0.0, 1.0);
    let (wa, wb) = (share(b, c), share(c, a));
    [wa, wb, (1.0 - wa - wb).max(0.0)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::context::{NoProgress, monotonic_clock};
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    /// A square of two triangles in the plane z = 0, from (0, 0) to (2, 2).
    fn square() -> Surface {
        let positions = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]].map(|[x, y]| DVec3::new(x, y, 0.0)).to_vec();
        Surface { positions, faces: vec![[0, 1, 2], [0, 2, 3]], source: vec![5, 6] }
    }

    fn painted(paint: [Paint; 2], palettes: &mut [Palette], face: [[f64; 2]; 3], source: u32) -> Paint {
        let mut of_sources = vec![PAINTLESS; 5];
        of_sources.extend(paint);
        let positions = face.map(|[x, y]| DVec3::new(x, y, 0.0)).to_vec();
        let result = Soup { positions, faces: vec![[0, 1, 2]] };
        let (cancel, clock) = (AtomicBool::new(false), monotonic_clock());
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
        let input = Painted { surface: &square(), paint: &of_sources };
        let result = SoupWithSource { soup: &result, source: &[source] };
        transfer_paint(input, result, palettes, &context).expect("not stopped")[0]
    }

    const RED: [u8; 4] = [255, 0, 0, 255];
    const BLUE: [u8; 4] = [0, 0, 255, 255];

    fn colors() -> ([Paint; 2], Vec<Palette>) {
        let paint = [Paint { palette: 0, at: [0, 1, 1] }, Paint { palette: 0, at: [0, 1, 0] }];
        (paint, vec![Palette::Colors(vec![RED, BLUE])])
    }

    #[test]
    fn an_unchanged_face_keeps_its_colours_whatever_its_first_corner() {
        let (paint, mut palettes) = colors();
        let turned = painted(paint, &mut palettes, [[2.0, 2.0], [0.0, 0.0], [2.0, 0.0]], 5);
        assert_eq!(turned, Paint { palette: 0, at: [1, 0, 1] });
        assert_eq!(palettes[0].len(), 2, "nothing was added");
    }

    #[test]
    fn a_piece_of_a_face_gets_interpolated_colours() {
        let (paint, mut palettes) = colors();
        let piece = painted(paint, &mut palettes, [[0.0, 0.0], [1.0, 0.0], [2.0, 2.0]], 5);
        assert_eq!(piece, Paint { palette: 0, at: [0, 2, 1] });
        let Palette::Colors(colors) = &palettes[0] else { panic!("colours") };
        assert_eq!(colors[2], [128, 0, 128, 255]);
    }

    #[test]
    fn a_piece_of_a_textured_face_gets_interpolated_texture_coordinates() {
        let places = vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let mut palettes = vec![Palette::Textured { texture: 0, name: None, tint: [255; 4], places }];
        let paint = [Paint { palette: 0, at: [0, 1, 2] }, Paint { palette: 0, at: [0, 2, 3] }];
        let piece = painted(paint, &mut palettes, [[0.0, 0.0], [2.0, 0.0], [2.0, 0.5]], 5);
        let Palette::Textured { places, .. } = &palettes[0] else { panic!("a texture") };
        assert_eq!(piece.at.map(|at| places[at as usize]), [[0.0, 0.0], [1.0, 0.0], [1.0, 0.25]]);
    }

    #[test]
    fn a_new_face_gets_the_attributes_of_the_nearest_input_face() {
        let materials = ["body", "lid"].map(|name| crate::scene::Material { name: name.into(), color: RED }).to_vec();
        let mut palettes = vec![Palette::Materials(materials)];
        let paint = [Paint { palette: 0, at: [0; 3] }, Paint { palette: 0, at: [1; 3] }];
        let by_the_lid = [[0.0, 2.0], [0.5, 2.5], [0.0, 3.0]];
        assert_eq!(painted(paint, &mut palettes, by_the_lid, NO_SOURCE).at, [1; 3]);
        let (paint, mut palettes) = colors();
        let patch = painted(paint, &mut palettes, [[2.0, 0.0], [3.0, 1.0], [2.0, 2.0]], NO_SOURCE);
        assert_eq!(patch, Paint { palette: 0, at: [1; 3] }, "blue all along that side");
    }

    #[test]
    fn a_new_face_next_to_a_face_without_attributes_gets_none() {
        let mut palettes = vec![];
        let face = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
        assert_eq!(painted([PAINTLESS; 2], &mut palettes, face, NO_SOURCE), PAINTLESS);
        assert_eq!(painted([PAINTLESS; 2], &mut palettes, face, 5).palette, PAINTLESS.palette);
    }
}
