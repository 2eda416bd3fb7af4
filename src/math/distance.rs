use glam::DVec3;

/// Whether a point lies within `reach` of a triangle (the nearest point by regions, Ericson 2005, 5.1.5). In f64: a
/// measure, not a decision of topology.
#[must_use]
pub fn within(p: DVec3, [a, b, c]: [DVec3; 3], reach: f64) -> bool {
    p.distance_squared(nearest(p, a, b, c)) <= reach * reach
}

/// The point of the triangle that is nearest to `p`.
fn nearest(p: DVec3, a: DVec3, b: DVec3, c: DVec3) -> DVec3 {
    let (ab, ac) = (b - a, c - a);
    let (d1, d2) = (ab.dot(p - a), ac.dot(p - a));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let (d3, d4) = (ab.dot(p - b), ac.dot(p - b));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let (d5, d6) = (ab.dot(p - c), ac.dot(p - c));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let sum = va + vb + vc;
    a + ab * (vb / sum) + ac * (vc / sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distance_is_to_the_inside_an_edge_or_a_corner_whichever_is_nearest() {
        let triangle = [DVec3::ZERO, DVec3::X, DVec3::Y];
        for (p, distance) in [
            (DVec3::new(0.25, 0.25, 0.5), 0.5),
            (DVec3::new(0.5, -2.0, 0.0), 2.0),
            (DVec3::new(-3.0, -4.0, 0.0), 5.0),
            (DVec3::new(1.0, 1.0, 0.0), 0.5f64.sqrt()),
            (DVec3::new(2.0, 0.0, 0.0), 1.0),
            (DVec3::new(0.0, 3.0, 0.0), 2.0),
            (DVec3::new(-1.0, 0.5, 0.0), 1.0),
        ] {
            assert!(within(p, triangle, distance + 1e-12), "{p}");
            assert!(!within(p, triangle, distance - 1e-12), "{p}");
        }
    }
}
