/// The point with number `i` of a sequence that fills the unit square evenly, whatever its length: R2 (Roberts 2018, "The
/// Unreasonable Effectiveness of Quasirandom Sequences").
#[must_use]
pub fn r2(i: f64) -> [f64; 2] {
    [0.754_877_666_246_692_8, 0.569_840_290_998_053_2].map(|step| (0.5 + i * step).fract())
}

/// The same in the unit cube.
#[must_use]
pub fn r3(i: f64) -> [f64; 3] {
    [0.819_172_513_396_164_5, 0.671_043_606_703_789_3, 0.549_700_477_901_970_2].map(|step| (0.5 + i * step).fract())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_eighth_of_the_cube_gets_its_share() {
        let mut shares = [0u32; 8];
        for i in 0..4000 {
            let octant = r3(f64::from(i)).iter().fold(0, |octant, &x| 2 * octant + usize::from(x >= 0.5));
            shares[octant] += 1;
        }
        assert!(shares.iter().all(|share| share.abs_diff(500) < 30), "{shares:?}");
        let low = (0..4000).filter(|&i| r2(f64::from(i)).iter().all(|&x| x < 0.5)).count();
        assert!(low.abs_diff(1000) < 20, "{low}");
    }
}
