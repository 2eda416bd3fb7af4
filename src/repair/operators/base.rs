//! Adds a solid base below open sheets that are height fields.

use glam::DVec3;

use super::border::open_parts;
use super::operator::{Applied, Counter, Operation, Scope};
use super::thicken::THICKNESS;
use crate::math::{Precision, Sign, orient2d, to_unit_range};
use crate::mesh::{BASE_SOURCE, Edges, Surface};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// Extrudes open sheets down to a plane.
#[derive(Debug, Clone, Copy)]
pub struct AddBase {
    /// Distance from the lowest point to the plane, in the model's unit; `None` is [`THICKNESS`] of the diagonal.
    pub thickness: Option<f64>,
    /// The farthest that the base may be from the sheet, in the model's unit.
    pub max_deviation: f64,
    /// The precision to which the plane's coordinate is rounded.
    pub precision: Precision,
}

/// The direction along which a part is a height field.
struct HeightField {
    /// The axis: 0 to 2 for x to z.
    axis: usize,
    /// 1 where up is along the axis, -1 where up is against it.
    up: f64,
    /// Whether the faces point down and must be flipped.
    flipped: bool,
}

impl AddBase {
    /// Adds a base to each open part that is a height field: vertical skirts along the boundary and a flat bottom.
    ///
    /// ```text
    ///     __/\__/\_            __/\__/\_
    ///    /         \    ->    |         |  skirt
    ///                         |_________|  bottom
    /// ```
    ///
    /// Up is z where the part is a height field over the xy plane. Otherwise up is the axis closest to the part's mean
    /// normal, in the normal's direction. The bottom is the projection of the sheet's own faces onto the plane. So the
    /// bottom is exact, matches every hole of the sheet, and needs no triangulation that could fail.
    ///
    /// Precondition: consistent winding. Result: each height field is closed; no vertex moves; parts that pointed down
    /// are flipped. Leaves: parts with a vertical or overhanging face, and parts whose base would be farther away than
    /// `max_deviation`.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let open = open_parts(surface);
        if open.count == 0 {
            return Ok(Applied::default());
        }
        let diagonal = surface.bounds().diagonal();
        let thickness = self.thickness.unwrap_or(THICKNESS * diagonal);
        let unit = to_unit_range(&surface.positions);
        let mut by_part: Vec<Vec<u32>> = Vec::new();
        by_part.resize_with(usize::try_from(open.count).unwrap_or(0), Vec::new);
        for (&f, &part) in open.faces.iter().zip(&open.part) {
            by_part[part as usize].push(f);
        }
        let (mut with_base, mut flipped, mut not_height_field, mut too_far) = (0, 0, 0u64, 0u64);
        for faces in &by_part {
            context.check()?;
            let Some(view) = HeightField::of(surface, &unit, faces) else {
                not_height_field += 1;
                continue;
            };
            let heights = || faces.iter().flat_map(|&f| surface.corners(f as usize)).map(|p| p[view.axis] * view.up);
            let (lowest, highest) = heights().fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(x), h.max(x)));
            let mut plane = DVec3::splat((lowest - thickness) * view.up);
            if self.precision == Precision::F32 {
                plane = Precision::F32.round(plane);
            }
            let plane = plane.x;
            if highest - plane * view.up > self.max_deviation || plane * view.up >= lowest || !plane.is_finite() {
                too_far += 1;
                continue;
            }
            if !extrude(surface, faces, &view, plane) {
                not_height_field += 1;
                continue;
            }
            with_base += 1;
            flipped += u64::from(view.flipped);
        }
        let reasons = [
            (not_height_field, "are not height fields over a plane, so no base fits below them"),
            (too_far, "got no base: it would be too far away or too thin"),
        ];
        let reasons: Vec<_> =
            reasons.into_iter().filter(|r| r.0 > 0).map(|(n, reason)| format!("{n} open parts {reason}")).collect();
        let changes = Change::list([(ChangeKind::BasesAdded, with_base), (ChangeKind::OpenPartsFlipped, flipped)]);
        Ok(Applied { changes, left: (!reasons.is_empty()).then(|| reasons.join("; ")), ..Applied::default() })
    }
}

impl HeightField {
    /// Finds the direction along which a part is a height field.
    fn of(surface: &Surface, unit: &[DVec3], faces: &[u32]) -> Option<Self> {
        let normal: DVec3 = faces.iter().map(|&f| surface.area_vector(f as usize)).sum();
        let main = (0..3).fold(2, |best, axis| if normal[axis].abs() > normal[best].abs() { axis } else { best });
        let signs = |axis: usize| {
            let sign = |f: &u32| projected_orientation(unit, surface.faces[*f as usize], axis);
            let first = sign(faces.first()?);
            (first != Sign::Zero && faces.iter().all(|f| sign(f) == first)).then_some(first == Sign::Positive)
        };
        if let Some(looks_up) = signs(2) {
            return Some(Self { axis: 2, up: 1.0, flipped: !looks_up });
        }
        let looks_along = signs(main)?;
        Some(Self { axis: main, up: if looks_along { 1.0 } else { -1.0 }, flipped: false })
    }
}

/// The two coordinates across an axis, in the order that is counter-clockwise seen from the axis' positive end.
fn flat(p: DVec3, axis: usize) -> [f64; 2] {
    [p[(axis + 1) % 3], p[(axis + 2) % 3]]
}

/// The orientation of a face projected along an axis.
fn projected_orientation(unit: &[DVec3], face: [u32; 3], axis: usize) -> Sign {
    let [a, b, c] = face.map(|v| flat(unit[v as usize], axis));
    orient2d(a, b, c)
}

/// Adds skirts and bottom. Returns `false` where the part has a non-manifold edge, without changing the surface.
fn extrude(surface: &mut Surface, faces: &[u32], view: &HeightField, plane: f64) -> bool {
    let of_part: Vec<[u32; 3]> = faces.iter().map(|&f| surface.faces[f as usize]).collect();
    let part = Surface { positions: surface.positions.clone(), source: vec![0; faces.len()], faces: of_part };
    let edges = Edges::new(&part.faces);
    if edges.iter().any(|h| h.len() > 2) {
        return false;
    }
    // Projected faces of one orientation cover the area below the sheet and have no zero-area face.
    let bottom: Vec<[u32; 3]> = part.faces.iter().map(|&[a, b, c]| [a, c, b]).collect();
    let mut below = vec![u32::MAX; surface.positions.len()];
    let mut project = |surface: &mut Surface, v: u32| {
        if below[v as usize] == u32::MAX {
            #[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
            {
                below[v as usize] = surface.positions.len() as u32;
            }
            let mut p = surface.positions[v as usize];
            p[view.axis] = plane;
            surface.positions.push(p);
        }
        below[v as usize]
    };
    let mut new_faces = Vec::new();
    for half_edges in edges.iter() {
        if let &[h] = half_edges {
            let [u, v] = Edges::ends(&part.faces, h);
            let [u1, v1] = [u, v].map(|v| project(surface, v));
            new_faces.extend([[v, u, u1], [v, u1, v1]]);
        }
    }
    new_faces.extend(bottom.into_iter().map(|face| face.map(|v| project(surface, v))));
    for mut face in new_faces {
        if view.flipped {
            face.swap(1, 2);
        }
        surface.push_generated(face, BASE_SOURCE);
    }
    if view.flipped {
        for &f in faces {
            surface.faces[f as usize].swap(1, 2);
        }
    }
    true
}

impl Operation<'_> for AddBase {
    const FIXES: &'static [Counter] = &[Counter::BoundaryEdges];
    const MAY_RAISE: &'static [Counter] = &[Counter::NonManifoldEdges, Counter::PinchedVertices];
    const ACTS_ON: &'static [Counter] = &[Counter::BoundaryEdges];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self {
            thickness: scope.options.thickness,
            max_deviation: scope.max_deviation,
            precision: scope.format.precision(),
        }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
