use glam::DVec3;

use crate::context::{Cancelled, Context};
use crate::math::{Box3, Tree, ray_direction, within};
use crate::mesh::Soup;

/// Points that are looked at, spread over the input by area.
const SAMPLES: u32 = 4000;
/// Surface farther than this from all of the output is lost, as a share of the input's diagonal. A remesh with the
/// default 300 voxels along the diagonal stays within it.
const FAR: f64 = 0.005;
/// Directions in which a point may see the outside.
const DIRECTIONS: u32 = 32;
/// How far in front of its face a ray starts, as a share of the diagonal.
const LIFT: f64 = 1e-5;

/// Share of the input's visible surface, in percent, that has no surface of the output near it. Visible is what can be
/// seen from outside in one of some fixed directions, from either side: inner walls that a union removes are not.
///
/// `standing` says of each input face whether it is in the output as it was; such a face is not lost and costs nothing.
/// The points are the same for the same input. 0 where nothing is missing, none where the input has no area.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
pub fn surface_lost_pct(
    input: &Soup,
    output: &Soup,
    standing: &[bool],
    context: &Context<'_>,
) -> Result<Option<f64>, Cancelled> {
    let samples = sample(input);
    if samples.is_empty() {
        return Ok(None);
    }
    let missing = |sample: &&Sample| !standing.get(sample.face).copied().unwrap_or(false);
    if !samples.iter().any(|sample| missing(&sample)) {
        return Ok(Some(0.0));
    }
    let diagonal = Box3::of(finite_faces(input).iter().flatten().map(|&v| input.positions[v as usize])).diagonal();
    let faces = finite_faces(output);
    let tree = Tree::new(&output.positions, &faces);
    let mut far = Vec::new();
    for sample in samples.iter().filter(missing) {
        context.check()?;
        let mut near = false;
        tree.around(sample.point, FAR * diagonal, |face| {
            near = within(sample.point, corners(output, &faces, face), FAR * diagonal);
            !near
        });
        if !near {
            far.push(sample);
        }
    }
    if far.is_empty() {
        return Ok(Some(0.0));
    }
    let view = View::new(input, diagonal);
    let (mut visible, mut lost) = (0, 0);
    let mut far = far.into_iter().peekable();
    for sample in &samples {
        context.check()?;
        let seen = u32::from(view.sees_outside(sample));
        visible += seen;
        if far.next_if(|next| std::ptr::eq(*next, sample)).is_some() {
            lost += seen;
        }
    }
    Ok(Some(f64::from(lost) / f64::from(visible.max(1)) * 100.0))
}

/// A point on a face.
struct Sample {
    face: usize,
    point: DVec3,
    normal: DVec3,
}

/// Points spread by area: one in each of [`SAMPLES`] equal shares, placed in its face by the R2 sequence (Roberts 2018).
fn sample(soup: &Soup) -> Vec<Sample> {
    let crosses: Vec<DVec3> = (0..soup.faces.len())
        .map(|face| {
            let [a, b, c] = soup.corners(face);
            let cross = (b - a).cross(c - a);
            if cross.is_finite() { cross } else { DVec3::ZERO }
        })
        .collect();
    let total: f64 = crosses.iter().map(|cross| cross.length()).sum();
    if !(total > 0.0 && total.is_finite()) {
        return Vec::new();
    }
    let mut samples = Vec::with_capacity(SAMPLES as usize);
    let (mut passed, mut number) = (0.0, 0);
    for (face, cross) in crosses.iter().enumerate() {
        passed += cross.length();
        while number < SAMPLES && (f64::from(number) + 0.5) / f64::from(SAMPLES) * total < passed {
            let i = f64::from(number);
            let (u, v) = ((0.5 + i * 0.754_877_666_246_693).fract().sqrt(), (0.5 + i * 0.569_840_290_998_053).fract());
            let [a, b, c] = soup.corners(face);
            let point = a * (1.0 - u) + b * (u * (1.0 - v)) + c * (u * v);
            samples.push(Sample { face, point, normal: cross.normalize_or_zero() });
            number += 1;
        }
    }
    samples
}

fn finite_faces(soup: &Soup) -> Vec<[u32; 3]> {
    let finite = |face: &&[u32; 3]| face.iter().all(|&v| soup.positions[v as usize].is_finite());
    soup.faces.iter().filter(finite).copied().collect()
}

fn corners(soup: &Soup, faces: &[[u32; 3]], face: u32) -> [DVec3; 3] {
    faces[face as usize].map(|v| soup.positions[v as usize])
}

/// Looks from points of a mesh to the outside. A measure, not a decision: plain f64 will do.
struct View<'a> {
    soup: &'a Soup,
    faces: Vec<[u32; 3]>,
    tree: Tree,
    diagonal: f64,
}

impl<'a> View<'a> {
    fn new(soup: &'a Soup, diagonal: f64) -> Self {
        let faces = finite_faces(soup);
        Self { soup, tree: Tree::new(&soup.positions, &faces), faces, diagonal }
    }

    fn sees_outside(&self, sample: &Sample) -> bool {
        (0..DIRECTIONS).any(|number| {
            let direction = ray_direction(number);
            let side = sample.normal * sample.normal.dot(direction).signum();
            let from = sample.point + side * (LIFT * self.diagonal);
            let ray = direction * (2.0 * self.diagonal);
            let mut free = true;
            self.tree.along(from, from + ray, |face| {
                free = !hits(from, ray, corners(self.soup, &self.faces, face));
                free
            });
            free
        })
    }
}

/// Whether the segment from `origin` along `ray` meets the triangle (Moeller and Trumbore 1997).
fn hits(origin: DVec3, ray: DVec3, [a, b, c]: [DVec3; 3]) -> bool {
    let (e, f) = (b - a, c - a);
    let p = ray.cross(f);
    let determinant = e.dot(p);
    if determinant == 0.0 {
        return false;
    }
    let s = origin - a;
    let u = s.dot(p) / determinant;
    let q = s.cross(e);
    let v = ray.dot(q) / determinant;
    let t = f.dot(q) / determinant;
    u >= 0.0 && v >= 0.0 && u + v <= 1.0 && (0.0..=1.0).contains(&t)
}
