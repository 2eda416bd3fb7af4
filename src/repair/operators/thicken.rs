//! Turns open sheets into thin solids.
//!
//! The skins come from the double cover of the sheet, so that non-orientable sheets and non-manifold edges work too.

use glam::DVec3;

use super::border::{OpenParts, open_parts};
use super::face_pairs::{NONE, Pairing, pair_faces};
use super::operator::{Applied, Counter, Operation, Scope};
use super::sheets::almost_closed;
use crate::math::Precision;
use crate::mesh::{Edges, SKIN_SOURCE, Surface, UnionFind};
use crate::repair::{Cancelled, Change, ChangeKind, Context, OpenSheets};

/// The default thickness of a sheet, as a share of the model's diagonal. On a print of 200 mm it is 0.6 mm: wider than the
/// usual nozzle of 0.4 mm, and hardly visible on the whole model.
pub const THICKNESS: f64 = 3e-3;
/// The least thickness, in f32 steps at the largest coordinate. Below that, rounding would merge the two skins.
const MIN_STEPS: f64 = 64.0;

/// The largest displacement of a vertex, in multiples of the thickness, to keep the thickness on all adjacent faces.
const MITER: f64 = 2.0;

/// Where the two skins of a thickened sheet lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Skins {
    /// The front stays on the sheet, bit for bit. The back lies behind it, against the sheet's normal.
    Behind,
    /// Each skin is half the thickness away, so that the sheet is the middle of the solid.
    BothSides,
}

/// Turns each open part into a solid: two skins and a rim between them.
#[derive(Debug, Clone, Copy)]
pub struct ThickenSheets {
    /// The distance between the skins, in the model's unit; `None` is [`THICKNESS`] of the diagonal.
    pub thickness: Option<f64>,
    /// Where the skins lie.
    pub skins: Skins,
    /// Whether almost closed parts ([`almost_closed`]) stay open: a thin shell is not the solid whose surface they are.
    pub spares_solids: bool,
    /// The farthest that a skin may be from the sheet, in the model's unit.
    pub max_deviation: f64,
    /// The precision to which positions are rounded.
    pub precision: Precision,
}

impl ThickenSheets {
    /// Replaces each open part by the boundary of a thin solid around it.
    ///
    /// ```text
    ///                          front  .______.______.
    ///    .______.______.   ->         |             |  rim
    ///                           back  .______.______.
    /// ```
    ///
    /// The skins are the part's double cover: two copies of each face, one for each side. Across an edge each copy continues
    /// into the copy for the same side of the surface, and a rim joins the copies along the boundary. So a non-orientable
    /// part, such as a Möbius band, gets one skin that goes around twice, and any part gives a closed, consistently wound
    /// surface. A vertex moves along the mean normal of its faces, weighted by angle. It moves far enough to keep the thickness
    /// on all of them, up to twice the thickness at sharp folds.
    ///
    /// Precondition: non-manifold edges are split and holes are filled, since every part that is open now counts as a sheet.
    /// Result: no part has a boundary; with [`Skins::Behind`] every face stays, except at the seam of a non-orientable part.
    /// Skins may intersect each other and other parts where the sheet bends sharply or parts touch;
    /// [`super::self_union`] unites them. Leaves: every part where rounding would cancel the thickness or the thickness
    /// would exceed `max_deviation`.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let mut open = open_parts(surface);
        let spared = if self.spares_solids { exclude_almost_closed(surface, &mut open, context)? } else { 0 };
        let spared_note = |spared: u64| {
            let plural =
                if spared == 1 { "open part is an almost closed solid" } else { "open parts are almost closed solids" };
            format!("{spared} {plural} and got no thickness")
        };
        if open.count == 0 {
            let left = (spared > 0).then(|| spared_note(spared));
            return Ok(Applied {
                changes: Change::list([(ChangeKind::SolidsLeftOpen, spared)]),
                left,
                ..Applied::default()
            });
        }
        let bounds = surface.bounds();
        let requested = self.thickness.unwrap_or(THICKNESS * bounds.diagonal());
        let farthest = if self.skins == Skins::Behind { MITER } else { MITER / 2.0 };
        let thickness = requested.min(self.max_deviation / farthest);
        let largest = bounds.min.abs().max(bounds.max.abs()).max_element();
        let least = MIN_STEPS * f64::from(f32::EPSILON) * largest;
        if !thickness.is_finite() || thickness <= least {
            let left =
                format!("{} open parts stay open: rounding to f32 would cancel a thickness of {thickness}", open.count);
            return Ok(Applied { left: Some(left), ..Applied::default() });
        }
        let cover = Cover::new(surface, &open.faces, context)?;
        let offsets = Offsets::new(surface, &cover);
        context.check()?;
        let (front, back) = match self.skins {
            Skins::Behind => (0.0, thickness),
            Skins::BothSides => (thickness / 2.0, thickness / 2.0),
        };
        let vertices = create_vertices(surface, &cover, |fan, side| {
            let step = offsets.of(fan) * if side == 0 { front } else { -back };
            let p = surface.positions[cover.vertex(fan) as usize] + step;
            let q = self.precision.round(p);
            if q.is_finite() { q } else { p }
        });
        let rim = cover.boundary.len() as u64;
        replace_faces(surface, &cover, &vertices);
        let changes = Change::list([
            (ChangeKind::SheetsThickened, open.count),
            (ChangeKind::RimEdgesClosed, rim),
            (ChangeKind::SolidsLeftOpen, spared),
        ]);
        let moved = if front > 0.0 { front * MITER } else { 0.0 };
        let mut left = format!("thickness {thickness:.6}");
        if spared > 0 {
            left = format!("{left}; {}", spared_note(spared));
        }
        Ok(Applied { changes, moved, left: Some(left), ..Applied::default() })
    }
}

/// Removes the almost closed parts from the open parts. Returns their number.
fn exclude_almost_closed(surface: &Surface, open: &mut OpenParts, context: &Context<'_>) -> Result<u64, Cancelled> {
    let spared = almost_closed(surface, open, context)?;
    let keep: Vec<bool> = open.part.iter().map(|&part| !spared[part as usize]).collect();
    let mut kept = keep.iter();
    open.faces.retain(|_| kept.next() == Some(&true));
    let mut kept = keep.iter();
    open.part.retain(|_| kept.next() == Some(&true));
    let count = spared.iter().filter(|&&spared| spared).count() as u64;
    open.count -= count;
    Ok(count)
}

/// The vertices on the two sides of each fan.
struct SideVertices {
    of_fan: Vec<[u32; 2]>,
    positions: Vec<DVec3>,
}

/// Creates the vertices of the skins. The first front at a vertex reuses the vertex if the position is the same. All others are
/// new, since other faces may use the old vertex.
fn create_vertices(surface: &Surface, cover: &Cover, position_of: impl Fn(usize, usize) -> DVec3) -> SideVertices {
    let mut positions = surface.positions.clone();
    let mut taken = vec![false; positions.len()];
    let mut of_fan = Vec::with_capacity(cover.fans());
    for fan in 0..cover.fans() {
        let v = cover.vertex(fan) as usize;
        let mut vertices = [0; 2];
        for (side, id) in vertices.iter_mut().enumerate() {
            let p = position_of(fan, side);
            #[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
            if side == 0 && p == positions[v] && !std::mem::replace(&mut taken[v], true) {
                *id = v as u32;
            } else {
                *id = positions.len() as u32;
                positions.push(p);
            }
        }
        of_fan.push(vertices);
    }
    SideVertices { of_fan, positions }
}

/// Replaces the sheet's faces by the skins and the rim.
fn replace_faces(surface: &mut Surface, cover: &Cover, vertices: &SideVertices) {
    let id = |corner: usize, side: usize| {
        let (fan, flipped) = cover.fan_of(corner);
        vertices.of_fan[fan][side ^ usize::from(flipped)]
    };
    surface.positions.clone_from(&vertices.positions);
    for (i, &f) in cover.faces.iter().enumerate() {
        surface.faces[f as usize] = [0, 1, 2].map(|c| id(3 * i + c, 0));
    }
    for i in 0..cover.faces.len() {
        surface.push_generated([0, 2, 1].map(|c| id(3 * i + c, 1)), SKIN_SOURCE);
    }
    for &h in &cover.boundary {
        let (u, v) = (h as usize, Edges::next(h) as usize);
        surface.push_generated([id(v, 0), id(u, 0), id(u, 1)], SKIN_SOURCE);
        surface.push_generated([id(v, 0), id(u, 1), id(v, 1)], SKIN_SOURCE);
    }
}

impl Operation<'_> for ThickenSheets {
    const FIXES: &'static [Counter] = &[Counter::BoundaryEdges, Counter::MisorientedEdges];
    // A non-manifold edge of the sheet is non-manifold on both skins.
    const MAY_RAISE: &'static [Counter] =
        &[Counter::NonManifoldEdges, Counter::PinchedVertices, Counter::DegenerateFaces, Counter::DuplicateFaces];
    const ACTS_ON: &'static [Counter] = &[Counter::BoundaryEdges];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let requested = scope.options.open_sheets == OpenSheets::Thicken;
        Self {
            thickness: scope.options.thickness,
            skins: if requested { Skins::BothSides } else { Skins::Behind },
            spares_solids: !requested,
            max_deviation: scope.max_deviation,
            precision: scope.format.precision(),
        }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}

/// The double cover of a part of a surface, by corners: two sides of each corner, joined to those of its neighbours across
/// edges. Connected corners at a vertex form a fan. A fan has two sides even where the part is non-orientable, since the
/// faces of a fan form a disc.
struct Cover {
    /// The covered faces. A corner is `3 * i + c` for the `i`-th of them.
    pub faces: Vec<u32>,
    /// The half-edges without a mate, as corners.
    pub boundary: Vec<u32>,
    /// For each corner its fan in the upper bits, and in the lowest bit whether the corner's front is the fan's back.
    of_corner: Vec<u32>,
    /// The vertex of each fan.
    vertices: Vec<u32>,
}

impl Cover {
    /// Builds the double cover of `faces`.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn new(surface: &Surface, faces: &[u32], context: &Context<'_>) -> Result<Self, Cancelled> {
        let of = |f: &u32| surface.faces[*f as usize];
        let part = Surface {
            positions: surface.positions.clone(),
            faces: faces.iter().map(of).collect(),
            source: vec![0; faces.len()],
        };
        let edges = Edges::new(&part.faces);
        let mates = pair_faces(&part, &edges, Pairing::Angular, context)?.mate;
        let node = |corner: u32, side: u32| 2 * corner + side;
        let mut sets = UnionFind::new(part.faces.len() * 6);
        let mut boundary = Vec::new();
        for (h, &mate) in (0u32..).zip(&mates) {
            if mate == NONE {
                boundary.push(h);
            } else if mate > h {
                let same_way = Edges::ends(&part.faces, h) == Edges::ends(&part.faces, mate);
                let (start, end) = if same_way { (mate, Edges::next(mate)) } else { (Edges::next(mate), mate) };
                for side in 0..2 {
                    let other = side ^ u32::from(same_way);
                    sets.unite(node(h, side), node(start, other));
                    sets.unite(node(Edges::next(h), side), node(end, other));
                }
            }
        }
        let roots = sets.into_roots();
        let mut number = vec![NONE; roots.len()];
        let (mut of_corner, mut vertices) = (Vec::with_capacity(mates.len()), Vec::new());
        for (corner, sides) in roots.as_chunks::<2>().0.iter().enumerate() {
            // The smaller root is the front of the fan's first corner.
            let [front, back] = *sides;
            let (root, flipped) = if front <= back { (front, false) } else { (back, true) };
            let fan = &mut number[root as usize];
            if *fan == NONE {
                #[expect(clippy::cast_possible_truncation, reason = "no more fans than corners")]
                {
                    *fan = vertices.len() as u32;
                }
                vertices.push(part.faces[corner / 3][corner % 3]);
            }
            of_corner.push(*fan << 1 | u32::from(flipped));
        }
        Ok(Self { faces: faces.to_vec(), boundary, of_corner, vertices })
    }

    /// The number of fans.
    pub fn fans(&self) -> usize {
        self.vertices.len()
    }

    /// The fan of a corner, and whether the front of the corner's face is on the fan's back.
    pub fn fan_of(&self, corner: usize) -> (usize, bool) {
        let packed = self.of_corner[corner];
        ((packed >> 1) as usize, packed & 1 == 1)
    }

    /// The vertex of a fan.
    pub fn vertex(&self, fan: usize) -> u32 {
        self.vertices[fan]
    }
}

/// For each fan the displacement of its vertex, toward the fan's front, for a thickness of 1.
struct Offsets(Vec<DVec3>);

impl Offsets {
    /// Computes the displacements.
    pub fn new(surface: &Surface, cover: &Cover) -> Self {
        let mut sums = vec![DVec3::ZERO; cover.fans()];
        let mut any = vec![DVec3::ZERO; cover.fans()];
        each_corner(surface, cover, |fan, normal, angle| {
            sums[fan] += normal * angle;
            if any[fan] == DVec3::ZERO {
                any[fan] = normal;
            }
        });
        // Where normals cancel, the normal of any face serves. A vertex with only zero-area faces moves along z.
        let mut ahead: Vec<DVec3> = sums
            .iter()
            .zip(&any)
            .map(|(sum, any)| if sum.length() > 1e-6 { sum.normalize() } else { *any })
            .map(|n| if n == DVec3::ZERO { DVec3::Z } else { n })
            .collect();
        let mut least = vec![1.0f64; cover.fans()];
        each_corner(surface, cover, |fan, normal, _| least[fan] = least[fan].min(ahead[fan].dot(normal)));
        for (ahead, least) in ahead.iter_mut().zip(least) {
            *ahead /= least.max(1.0 / MITER);
        }
        Self(ahead)
    }

    /// The displacement of a fan's vertex.
    pub fn of(&self, fan: usize) -> DVec3 {
        self.0[fan]
    }
}

/// Calls `each` for every corner of a face with area: the fan, the unit normal on the fan's front, and the angle.
fn each_corner(surface: &Surface, cover: &Cover, mut each: impl FnMut(usize, DVec3, f64)) {
    for (i, &f) in cover.faces.iter().enumerate() {
        let corners = surface.corners(f as usize);
        // Scaled, so that the area of the smallest face does not underflow.
        let size = corners[1].distance(corners[0]).max(corners[2].distance(corners[0]));
        let [p, q] = [(corners[1] - corners[0]) / size, (corners[2] - corners[0]) / size];
        let Some(normal) = p.cross(q).try_normalize() else { continue };
        for c in 0..3 {
            let (to, from) = (corners[(c + 1) % 3] - corners[c], corners[(c + 2) % 3] - corners[c]);
            let (fan, flipped) = cover.fan_of(3 * i + c);
            let angle = to.normalize_or_zero().angle_between(from.normalize_or_zero());
            if angle.is_finite() {
                each(fan, if flipped { -normal } else { normal }, angle);
            }
        }
    }
}
