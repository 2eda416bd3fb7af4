use glam::DVec3;

use crate::math::{Sign, orient3d};

/// Bound of the rounding error of a 3 by 3 determinant of differences, for each unit of its permanent: `O3DERRBOUND_A`
/// of Shewchuk 1997, which holds for an expansion along any row or column.
const ERROR: f64 = 7.771_561_172_376_103e-16;

/// The plane of a triangle, ready to tell sides of many points.
pub(super) struct Plane {
    corners: [DVec3; 3],
    /// The normal, rounded.
    pub normal: DVec3,
    /// For each component of the normal the sum of the magnitudes that it is a difference of.
    magnitude: DVec3,
}

impl Plane {
    #[inline]
    pub fn through(&[a, b, c]: &[DVec3; 3]) -> Self {
        let (u, v) = (b - a, c - a);
        let left = DVec3::new(u.y * v.z, u.z * v.x, u.x * v.y);
        let right = DVec3::new(u.z * v.y, u.x * v.z, u.y * v.x);
        Self { corners: [a, b, c], normal: left - right, magnitude: left.abs() + right.abs() }
    }

    /// Positive where the normal points, exactly.
    #[inline]
    pub fn side(&self, p: DVec3, slow: &mut u64) -> Sign {
        let d = p - self.corners[0];
        let determinant = self.normal.x * d.x + self.normal.y * d.y + self.normal.z * d.z;
        let permanent = self.magnitude.x * d.x.abs() + self.magnitude.y * d.y.abs() + self.magnitude.z * d.z.abs();
        if determinant.abs() > ERROR * permanent {
            return if determinant > 0.0 { Sign::Positive } else { Sign::Negative };
        }
        // A sum of zeros is no rounded number; so it is with points of one plane along the axes.
        if permanent == 0.0 {
            return Sign::Zero;
        }
        *slow += 1;
        let [a, b, c] = self.corners;
        // `orient3d` is positive behind the face.
        orient3d(a, c, b, p)
    }

    /// The sides of three points, of which the one numbered `inside` is known to be in the plane.
    #[inline]
    pub fn sides(&self, points: &[DVec3; 3], inside: Option<usize>, slow: &mut u64) -> [Sign; 3] {
        let mut sides = [Sign::Zero; 3];
        for k in 0..3 {
            if inside != Some(k) {
                sides[k] = self.side(points[k], slow);
            }
        }
        sides
    }

    /// The corners that the plane goes through.
    pub fn corners(&self) -> [DVec3; 3] {
        self.corners
    }
}
