use glam::DVec3;

/// Point `i` of a low-discrepancy sequence in the unit square, for `i` from 0: R2 (Roberts 2018, "The Unreasonable
/// Effectiveness of Quasirandom Sequences"). Every prefix of the sequence covers the square evenly.
#[must_use]
pub fn r2(i: f64) -> [f64; 2] {
    [0.754_877_666_246_692_8, 0.569_840_290_998_053_2].map(|step| (0.5 + i * step).fract())
}

/// Point `i` of the corresponding sequence in the unit cube.
#[must_use]
pub fn r3(i: f64) -> [f64; 3] {
    [0.819_172_513_396_164_5, 0.671_043_606_703_789_3, 0.549_700_477_901_970_2].map(|step| (0.5 + i * step).fract())
}

/// Direction of ray `attempt`: unit vectors, spread evenly, that no designed surface is aligned with.
#[must_use]
pub fn ray_direction(attempt: u32) -> DVec3 {
    // A golden-angle spiral with an irrational height step spreads points evenly on the sphere.
    let i = f64::from(attempt) + 1.0;
    let z = (i * std::f64::consts::SQRT_2 + 0.123_456_789).fract() * 1.9 - 0.95;
    let angle = i * 2.399_963_229_728_653;
    let r = (1.0 - z * z).sqrt();
    DVec3::new(r * angle.cos(), r * angle.sin(), z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_octant_gets_an_equal_share_of_points() {
        let mut shares = [0u32; 8];
        for i in 0..4000 {
            let octant = r3(f64::from(i)).iter().fold(0, |octant, &x| 2 * octant + usize::from(x >= 0.5));
            shares[octant] += 1;
        }
        assert!(shares.iter().all(|share| share.abs_diff(500) < 30), "{shares:?}");
        let low = (0..4000).filter(|&i| r2(f64::from(i)).iter().all(|&x| x < 0.5)).count();
        assert!(low.abs_diff(1000) < 20, "{low}");
    }

    #[test]
    fn directions_have_unit_length_and_differ() {
        for i in 0..32 {
            assert!((ray_direction(i).length() - 1.0).abs() < 1e-12);
            assert!(ray_direction(i).dot(ray_direction(i + 1)) < 0.999);
        }
    }
}
