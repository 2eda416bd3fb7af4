use glam::{DMat3, DVec3};

/// Share of the trace by which a quadric is made round, so that it has one lowest point even where its planes meet in a
/// line or are one plane; that point is then the nearest to where the search starts.
const ROUNDNESS: f64 = 1e-4;

/// The sum of weighted squared distances to planes, as a function of the point (Garland and Heckbert 1997).
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Quadric {
    /// The six different entries of the matrix: xx, xy, xz, yy, yz, zz.
    a: [f64; 6],
    b: DVec3,
    c: f64,
    /// The weights' sum.
    pub weight: f64,
}

impl Quadric {
    /// The squared distance to the plane through `point` with the unit normal `normal`.
    pub fn plane(normal: DVec3, point: DVec3, weight: f64) -> Self {
        let n = normal;
        let d = -n.dot(point);
        Self {
            a: [n.x * n.x, n.x * n.y, n.x * n.z, n.y * n.y, n.y * n.z, n.z * n.z].map(|x| x * weight),
            b: n * (d * weight),
            c: d * d * weight,
            weight,
        }
    }

    pub fn add(&mut self, other: &Self) {
        for (x, y) in self.a.iter_mut().zip(&other.a) {
            *x += y;
        }
        self.b += other.b;
        self.c += other.c;
        self.weight += other.weight;
    }

    fn times(&self, p: DVec3) -> DVec3 {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        DVec3::new(xx * p.x + xy * p.y + xz * p.z, xy * p.x + yy * p.y + yz * p.z, xz * p.x + yz * p.y + zz * p.z)
    }

    /// The value at a point, not below 0 however it is rounded.
    pub fn at(&self, p: DVec3) -> f64 {
        (p.dot(self.times(p)) + 2.0 * self.b.dot(p) + self.c).max(0.0)
    }

    /// The lowest point, with a slight pull to `start`; none where there is no plane.
    pub fn lowest(&self, start: DVec3) -> Option<DVec3> {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        let round = ROUNDNESS * (xx + yy + zz);
        let matrix = DMat3::from_cols(
            DVec3::new(xx + round, xy, xz),
            DVec3::new(xy, yy + round, yz),
            DVec3::new(xz, yz, zz + round),
        );
        // Half of the gradient at the start is what the step must undo.
        let slope = self.times(start) + self.b;
        let step = matrix.determinant().is_normal().then(|| matrix.inverse() * -slope)?;
        step.is_finite().then_some(start + step)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;

    #[test]
    fn three_planes_are_lowest_where_they_meet_and_one_plane_where_the_search_starts() {
        let corner = DVec3::new(0.3, -0.2, 0.9);
        let mut three = Quadric::default();
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            three.add(&Quadric::plane(axis, corner, 2.0));
        }
        let found = three.lowest(DVec3::ZERO).unwrap();
        assert!(found.distance(corner) < 1e-3 && three.at(corner) < 1e-15, "{found}");
        assert!((three.at(corner + DVec3::X) - 2.0).abs() < 1e-12);
        let one = Quadric::plane(DVec3::Z, corner, 1.0);
        let found = one.lowest(DVec3::ZERO).unwrap();
        assert!(found.distance(DVec3::Z * corner.z) < 1e-3, "{found}");
        assert_eq!(Quadric::default().lowest(DVec3::ZERO), None);
    }
}
