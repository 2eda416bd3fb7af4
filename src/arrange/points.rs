//! The points of an arrangement, defined implicitly, and exact predicates on them.

use std::cmp::Ordering;
use std::sync::OnceLock;

use dashu_int::IBig;
use glam::DVec3;
use rustc_hash::FxHashMap;
use smallvec::SmallVec;

use super::grid::{Plane, ULP, Whole, minus, turn};
use crate::math::Sign;

/// Maximum error of a point's rounded position along each axis, in grid steps.
const ERROR: f64 = 1.0 / 256.0;
/// Side of a hash cell for finding equal points, in grid steps.
const CELL: f64 = 1.0 / 16.0;

/// The sine of the angle between two planes from which they are certainly not parallel, far above the rounding errors of
/// their normals.
const MIN_SINE: f64 = 1e-6;

/// The exact definition of a point.
#[derive(Debug, Clone, Copy)]
enum Definition {
    /// A grid position.
    Place(Whole),
    /// The intersection of the line through two positions with a plane.
    LineAndPlane([Whole; 2], u32),
    /// The intersection of three planes.
    Planes([u32; 3]),
}

/// A [`Definition`] as it is stored, in little memory.
#[derive(Debug, Clone, Copy)]
enum StoredDefinition {
    /// The point's place, which is a grid position.
    Place,
    /// The intersection of the line through two points at grid positions with a plane.
    LineAndPlane([u32; 2], u32),
    /// The intersection of three planes.
    Planes([u32; 3]),
}

/// A point in homogeneous integer coordinates, `[x, y, z, w]` for `(x, y, z) / w` with `w > 0`.
type Homogeneous = [IBig; 4];

/// The points of an arrangement, each stored once: grid positions, and intersection points stored by their definition.
/// All signs are exact: floating point decides if its error bound allows, otherwise integers of arbitrary length.
///
/// After Attene 2020, "Indirect Predicates for Geometric Constructions".
#[derive(Default)]
pub(super) struct Points {
    definitions: Vec<StoredDefinition>,
    /// Rounded positions in grid steps. Grid positions are exact: they are whole numbers below 2^53.
    places: Vec<DVec3>,
    exact: Vec<OnceLock<Box<Homogeneous>>>,
    /// All planes, referenced by index.
    pub planes: Vec<Plane>,
    /// Points by the hash cell of their rounded position.
    cells: FxHashMap<[i64; 3], Vec<u32>>,
    /// Intersection points on edges, by the edge's vertices and the plane.
    on_edges: FxHashMap<[u32; 3], u32>,
    /// Planes through an edge and parallel to an axis, by edge and axis.
    uprights: FxHashMap<([u32; 2], usize), u32>,
    /// The corners of the enclosing triangle, by axis.
    outer: FxHashMap<usize, [u32; 3]>,
}

impl Points {
    /// Makes room for more points.
    pub fn reserve_exact(&mut self, more: usize) {
        self.definitions.reserve_exact(more);
        self.places.reserve_exact(more);
        self.exact.reserve_exact(more);
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// The rounded position of a point in grid steps.
    pub fn place(&self, point: u32) -> DVec3 {
        self.places[point as usize]
    }

    /// The exact grid position of a vertex.
    ///
    /// # Panics
    /// If the point is an intersection point.
    pub fn whole(&self, point: u32) -> Whole {
        match self.definitions[point as usize] {
            StoredDefinition::Place => self.place(point).to_array().map(|x| x as i64),
            _ => unreachable!("only vertices have a grid position"),
        }
    }

    fn definition(&self, point: u32) -> Definition {
        match self.definitions[point as usize] {
            StoredDefinition::Place => Definition::Place(self.whole(point)),
            other => self.definition_of(other),
        }
    }

    /// The definition of an intersection point.
    fn definition_of(&self, stored: StoredDefinition) -> Definition {
        match stored {
            StoredDefinition::Place => unreachable!("a vertex is no intersection point"),
            StoredDefinition::LineAndPlane(ends, plane) => {
                Definition::LineAndPlane(ends.map(|end| self.whole(end)), plane)
            }
            StoredDefinition::Planes(planes) => Definition::Planes(planes),
        }
    }

    /// Adds a position that is known to be new. Lookups find the point only after [`Points::enter_once`].
    pub fn push(&mut self, p: Whole) -> u32 {
        self.add(StoredDefinition::Place, DVec3::from_array(p.map(|x| x as f64)))
    }

    /// Makes a vertex available to lookups of equal points.
    pub fn enter_once(&mut self, point: u32) {
        let among = self.cells.entry(cell(self.places[point as usize])).or_default();
        if !among.contains(&point) {
            among.push(point);
        }
    }

    /// Three corners of an enclosing triangle, counter-clockwise seen from the end of an axis (or against the axis).
    /// The triangle contains everything within a quarter of `out` of the grid's origin.
    pub fn outer(&mut self, axis: usize, upward: bool, out: i64) -> [u32; 3] {
        if let Some(&known) = self.outer.get(&axis) {
            let [a, b, c] = known;
            return if upward { known } else { [a, c, b] };
        }
        let known = [[-1, -1], [1, -1], [0, 1]].map(|[x, y]| {
            let mut corner = [0; 3];
            corner[(axis + 1) % 3] = x * out;
            corner[(axis + 2) % 3] = y * out;
            self.push(corner)
        });
        self.outer.insert(axis, known);
        let [a, b, c] = known;
        if upward { known } else { [a, c, b] }
    }

    /// Enters a point into its hash cell.
    fn enter(&mut self, point: u32) {
        self.cells.entry(cell(self.place(point))).or_default().push(point);
    }

    /// The intersection of the edge between two vertices with a plane that separates the vertices or contains one of
    /// them.
    pub fn on_edge(&mut self, [u, v]: [u32; 2], plane: u32) -> u32 {
        let [u, v] = [u.min(v), u.max(v)];
        if let Some(&known) = self.on_edges.get(&[u, v, plane]) {
            return known;
        }
        let ends = [self.whole(u), self.whole(v)];
        let along = self.planes[plane as usize];
        // Both heights are exact and their ratio lies in [0, 1], so the position errs by a few units in the last place.
        let [from, to] = ends.map(|p| along.height(p));
        let share = from as f64 / (from - to) as f64;
        let [a, b] = [self.place(u), self.place(v)];
        let point = self.intern(StoredDefinition::LineAndPlane([u, v], plane), a + (b - a) * share);
        self.on_edges.insert([u, v, plane], point);
        point
    }

    /// The intersection of three planes.
    pub fn of_planes(&mut self, planes: [u32; 3]) -> u32 {
        let exact = || rounded(&self.homogeneous_of(&Definition::Planes(planes)));
        let place = self.place_of_planes(planes).unwrap_or_else(exact);
        self.intern(StoredDefinition::Planes(planes), place)
    }

    /// The plane through the edge between two vertices and parallel to an axis.
    pub fn upright(&mut self, [u, v]: [u32; 2], axis: usize) -> u32 {
        let ends = [self.whole(u.min(v)), self.whole(u.max(v))];
        *self.uprights.entry(([u.min(v), u.max(v)], axis)).or_insert_with(|| {
            #[expect(clippy::cast_possible_truncation, reason = "fewer than there are pairs of faces")]
            let plane = self.planes.len() as u32;
            self.planes.push(Plane::along_axis(ends, axis));
            plane
        })
    }

    fn add(&mut self, definition: StoredDefinition, place: DVec3) -> u32 {
        #[expect(clippy::cast_possible_truncation, reason = "points are counted in u32")]
        let point = self.places.len() as u32;
        self.definitions.push(definition);
        self.places.push(place);
        self.exact.push(OnceLock::new());
        point
    }

    /// The point with this definition: an equal known point, or a new one.
    fn intern(&mut self, definition: StoredDefinition, place: DVec3) -> u32 {
        let near = [0, 1, 2].map(|k| {
            let low = ((place[k] - 2.0 * ERROR) / CELL).floor();
            let high = ((place[k] + 2.0 * ERROR) / CELL).floor();
            (low as i64, high as i64)
        });
        let mut exact = None;
        for x in near[0].0..=near[0].1 {
            for y in near[1].0..=near[1].1 {
                for z in near[2].0..=near[2].1 {
                    for &other in self.cells.get(&[x, y, z]).map_or(&[][..], Vec::as_slice) {
                        if (self.place(other) - place).abs().max_element() > 2.0 * ERROR {
                            continue;
                        }
                        let own = exact.get_or_insert_with(|| self.homogeneous_of(&self.definition_of(definition)));
                        if equal(own, self.homogeneous(other)) {
                            return other;
                        }
                    }
                }
            }
        }
        let point = self.add(definition, place);
        if let Some(exact) = exact {
            let _ = self.exact[point as usize].set(Box::new(exact));
        }
        self.enter(point);
        point
    }

    fn homogeneous(&self, point: u32) -> &Homogeneous {
        self.exact[point as usize].get_or_init(|| Box::new(self.homogeneous_of(&self.definition(point))))
    }

    fn homogeneous_of(&self, definition: &Definition) -> Homogeneous {
        match *definition {
            Definition::Place(p) => {
                let [x, y, z] = p.map(IBig::from);
                [x, y, z, IBig::ONE]
            }
            Definition::LineAndPlane([a, b], plane) => {
                let plane = &self.planes[plane as usize];
                let [from, to] = [a, b].map(|p| plane.height(p));
                // from - to = normal . (a - b), which fits in `i128` like the normal times any difference.
                let (mut share, mut w) = (IBig::from(from), IBig::from(from - to));
                if w < IBig::ZERO {
                    (share, w) = (-share, -w);
                }
                let d = minus(b, a);
                let [x, y, z] = [0, 1, 2].map(|k| IBig::from(a[k]) * &w + IBig::from(d[k]) * &share);
                [x, y, z, w]
            }
            Definition::Planes(planes) => {
                let [p, q, r] = planes.map(|plane| &self.planes[plane as usize]);
                let big = |plane: &Plane| plane.normal.map(IBig::from);
                let normals = [big(p), big(q), big(r)];
                let base = p.base;
                let heights = [p, q, r].map(|plane| IBig::from(-plane.height(base)));
                let crosses = [[1, 2], [2, 0], [0, 1]].map(|[i, j]| cross(&normals[i], &normals[j]));
                let mut w = dot(&normals[0], &crosses[0]);
                let mut sum = [0, 1, 2].map(|k| (0..3).map(|i| &heights[i] * &crosses[i][k]).sum::<IBig>());
                if w < IBig::ZERO {
                    w = -w;
                    sum = sum.map(|x| -x);
                }
                let [x, y, z] = sum;
                let at = |x: IBig, k: usize| x + IBig::from(base[k]) * &w;
                [at(x, 0), at(y, 1), at(z, 2), w]
            }
        }
    }

    /// The intersection of three planes in floating point; none if the error bound is too large.
    fn place_of_planes(&self, planes: [u32; 3]) -> Option<DVec3> {
        let [p, q, r] = planes.map(|plane| &self.planes[plane as usize]);
        let base = p.base;
        let heights = [p, q, r].map(|plane| -(plane.height(base) as f64));
        let normals = [p, q, r].map(|plane| DVec3::from_array(plane.rounded));
        let pairs = [[1, 2], [2, 0], [0, 1]];
        let crosses = pairs.map(|[i, j]| normals[i].cross(normals[j]));
        let sizes = pairs.map(|[i, j]| {
            let (u, v) = (normals[i].abs(), normals[j].abs());
            DVec3::new(u.y * v.z + u.z * v.y, u.z * v.x + u.x * v.z, u.x * v.y + u.y * v.x)
        });
        let w = normals[0].dot(crosses[0]);
        let w_error = 16.0 * ULP * normals[0].abs().dot(sizes[0]);
        let sum: DVec3 = (0..3).map(|i| crosses[i] * heights[i]).sum();
        let sum_error: DVec3 = (0..3).map(|i| sizes[i] * (heights[i].abs() * 16.0 * ULP)).sum();
        let left = w.abs() - w_error;
        if left <= 0.0 {
            return None;
        }
        let offset = sum / w;
        let error = (sum_error + offset.abs() * w_error) / left;
        let place = DVec3::from_array(base.map(|x| x as f64)) + offset;
        (error.max_element() < ERROR / 4.0).then_some(place)
    }

    /// The orientation of three points in a plane, given by its index, exactly: projected along the plane's axis.
    pub fn turn(&self, plane: u32, axis: usize, [a, b, c]: [u32; 3]) -> Sign {
        let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
        let [p, q, r] = [self.place(a), self.place(b), self.place(c)];
        let (u, v) = ([p[i] - r[i], p[j] - r[j]], [q[i] - r[i], q[j] - r[j]]);
        let determinant = u[0] * v[1] - u[1] * v[0];
        let size = u[0].abs() + u[1].abs() + v[0].abs() + v[1].abs();
        // Each difference errs by at most twice a position's error, plus a smaller rounding error.
        let error = 3.0 * ERROR;
        let products = (u[0] * v[1]).abs() + (u[1] * v[0]).abs();
        if determinant.abs() > error * size + 2.0 * error * error + 8.0 * ULP * products {
            return Sign::of(determinant);
        }
        let definitions = [a, b, c].map(|x| self.definition(x));
        if let [Definition::Place(p), Definition::Place(q), Definition::Place(r)] = definitions {
            return turn(axis, p, q, r);
        }
        if are_on_one_edge(&definitions)
            || self.are_on_one_level(&definitions, plane)
            || self.are_on_one_cut(&definitions, plane)
        {
            return Sign::Zero;
        }
        let [p, q, r] = [a, b, c].map(|x| self.homogeneous(x));
        let minor = |s: &Homogeneous, t: &Homogeneous| &s[i] * &t[j] - &s[j] * &t[i];
        let sum = minor(p, q) * &r[3] + minor(q, r) * &p[3] + minor(r, p) * &q[3];
        sign_of(&sum)
    }

    /// Whether it follows from the definitions of three points in a plane that they agree in a coordinate in which the
    /// plane's points differ, so that they are on one line: as the edges of solids that stand on one level.
    fn are_on_one_level(&self, points: &[Definition; 3], plane: u32) -> bool {
        let normal = self.planes[plane as usize].normal;
        (0..3).any(|k| {
            let level = |point: &Definition| match point {
                Definition::Place(p) => Some(p[k]),
                Definition::LineAndPlane([a, b], _) => Some(a[k]).filter(|level| *level == b[k]),
                Definition::Planes(_) => None,
            };
            let first = level(&points[0]);
            first.is_some()
                && points.iter().all(|point| level(point) == first)
                && (0..3).any(|other| other != k && normal[other] != 0)
        })
    }

    /// Whether it follows from the definitions of three points in a plane that another plane contains them all, so that
    /// they are on one line.
    fn are_on_one_cut(&self, points: &[Definition; 3], plane: u32) -> bool {
        let contains = |cut: u32, point: &Definition| {
            let side = |p: Whole| self.planes[cut as usize].side(p);
            match point {
                Definition::Place(p) => side(*p) == Sign::Zero,
                Definition::LineAndPlane(ends, other) => {
                    *other == cut || ends.iter().all(|&end| side(end) == Sign::Zero)
                }
                Definition::Planes(planes) => planes.contains(&cut),
            }
        };
        let cuts = points.iter().flat_map(|point| match *point {
            Definition::Place(_) => SmallVec::<[u32; 3]>::new(),
            Definition::LineAndPlane(_, cut) => SmallVec::from_slice(&[cut]),
            Definition::Planes(planes) => SmallVec::from(planes),
        });
        cuts.into_iter().any(|cut| self.is_oblique([cut, plane]) && points.iter().all(|point| contains(cut, point)))
    }

    /// Whether two planes are certainly not parallel. Coplanar faces have planes of their own.
    fn is_oblique(&self, planes: [u32; 2]) -> bool {
        let [p, q] = planes.map(|plane| DVec3::from_array(self.planes[plane as usize].rounded).normalize_or_zero());
        p.cross(q).length() > MIN_SINE
    }

    /// The side of a plane on which a point lies, exactly.
    pub fn side(&self, plane: &Plane, point: u32) -> Sign {
        if let StoredDefinition::Place = self.definitions[point as usize] {
            return plane.side(self.whole(point));
        }
        let d = self.place(point) - DVec3::from_array(plane.base.map(|x| x as f64));
        let (mut sum, mut error) = (0.0, 0.0);
        for k in 0..3 {
            sum += plane.rounded[k] * d[k];
            error += plane.rounded[k].abs() * (2.0 * ERROR + 8.0 * ULP * d[k].abs());
        }
        if sum.abs() > error {
            return Sign::of(sum);
        }
        let p = self.homogeneous(point);
        let of = |k: usize| IBig::from(plane.normal[k]) * (&p[k] - IBig::from(plane.base[k]) * &p[3]);
        sign_of(&(of(0) + of(1) + of(2)))
    }

    /// Compares two points along an axis, exactly.
    pub fn compare(&self, axis: usize, a: u32, b: u32) -> Ordering {
        let (p, q) = (self.place(a)[axis], self.place(b)[axis]);
        if (p - q).abs() > 3.0 * ERROR {
            return p.total_cmp(&q);
        }
        let (p, q) = (self.homogeneous(a), self.homogeneous(b));
        (&p[axis] * &q[3]).cmp(&(&q[axis] * &p[3]))
    }
}

/// Whether it follows from the definitions of points that all are on the line through one edge.
fn are_on_one_edge(points: &[Definition; 3]) -> bool {
    let edge = points.iter().find_map(|point| match point {
        Definition::LineAndPlane(ends, _) => Some(ends),
        _ => None,
    });
    edge.is_some_and(|edge| {
        points.iter().all(|point| match point {
            Definition::Place(p) => edge.contains(p),
            Definition::LineAndPlane(ends, _) => ends == edge,
            Definition::Planes(_) => false,
        })
    })
}

fn cell(place: DVec3) -> [i64; 3] {
    #[expect(clippy::cast_possible_truncation, reason = "positions are within 2^43 steps")]
    place.to_array().map(|x| (x / CELL).floor() as i64)
}

fn sign_of(value: &IBig) -> Sign {
    Sign::from(value.cmp(&IBig::ZERO))
}

fn cross(u: &[IBig; 3], v: &[IBig; 3]) -> [IBig; 3] {
    let m = |i: usize, j: usize| &u[i] * &v[j] - &u[j] * &v[i];
    [m(1, 2), m(2, 0), m(0, 1)]
}

fn dot(u: &[IBig; 3], v: &[IBig; 3]) -> IBig {
    (0..3).map(|k| &u[k] * &v[k]).sum()
}

fn equal(p: &Homogeneous, q: &Homogeneous) -> bool {
    (0..3).all(|k| &p[k] * &q[3] == &q[k] * &p[3])
}

/// The point rounded to f64, within 2^-16 steps and half a unit in the last place.
fn rounded([x, y, z, w]: &Homogeneous) -> DVec3 {
    let at = |x: &IBig| {
        let shifted: IBig = (x << 16) / w;
        i128::try_from(shifted).map_or(f64::MAX, |x| x as f64) / f64::from(1u32 << 16)
    };
    DVec3::new(at(x), at(y), at(z))
}

#[cfg(test)]
mod tests;
