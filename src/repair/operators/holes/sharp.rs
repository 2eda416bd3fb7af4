//! Patches that grow from the sharpest corners of a loop.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::DVec3;

/// The triangles over a loop, and how many corners of it are not closed.
pub(super) struct Grown {
    pub triangles: Vec<[usize; 3]>,
    pub open: usize,
}

/// Joins two neighbouring sides of a polygon by a triangle, the sharpest corner first, until none is left or none can be.
///
/// `may(triangle, last)` says whether a triangle can be: of the last one no side is new. Corners that are reflex seen from
/// where `normal` points are the bluntest. A corner that cannot be joined is asked again when a neighbour of it went.
/// After *fill holes (sharp)* of Mesh Heal. O(n log n) besides what is asked, which is at most three times a corner.
pub(super) fn sharp(points: &[DVec3], normal: DVec3, mut may: impl FnMut([usize; 3], bool) -> bool) -> Grown {
    let n = points.len();
    let mut around: Vec<[usize; 2]> = (0..n).map(|i| [(i + n - 1) % n, (i + 1) % n]).collect();
    let mut turn = vec![0u32; n];
    let key = |i: usize, [before, after]: [usize; 2]| {
        let (u, v) = (points[after] - points[i], points[before] - points[i]);
        let cross = u.cross(v);
        let angle = cross.length().atan2(u.dot(v));
        // Positive numbers stand in the order of their bits.
        (if cross.dot(normal) < 0.0 { std::f64::consts::TAU - angle } else { angle }).to_bits()
    };
    let mut heap: BinaryHeap<_> = (0..n).map(|i| Reverse((key(i, around[i]), i, 0u32))).collect();
    let mut grown = Grown { triangles: Vec::with_capacity(n.saturating_sub(2)), open: n };
    while let Some(Reverse((_, i, of_turn))) = heap.pop() {
        if turn[i] != of_turn {
            continue;
        }
        let [before, after] = around[i];
        let triangle = [before, i, after];
        if !may(triangle, grown.open == 3) {
            continue;
        }
        grown.triangles.push(triangle);
        if grown.open == 3 {
            grown.open = 0;
            break;
        }
        grown.open -= 1;
        turn[i] = u32::MAX;
        around[before][1] = after;
        around[after][0] = before;
        for j in [before, after] {
            turn[j] += 1;
            heap.push(Reverse((key(j, around[j]), j, turn[j])));
        }
    }
    grown
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sharpest_corner_goes_first_and_a_reflex_one_last() {
        // A spearhead: its tip is the sharpest corner, and the notch is reflex.
        let spear = [DVec3::new(10.0, 0.0, 0.0), DVec3::Y, DVec3::new(2.0, 0.0, 0.0), -DVec3::Y];
        let grown = sharp(&spear, DVec3::Z, |_, _| true);
        assert_eq!((grown.triangles[0], grown.open), ([3, 0, 1], 0));
        let kept = sharp(&spear, DVec3::Z, |t, _| t != [3, 0, 1]);
        assert_eq!((kept.open, kept.triangles.len()), (0, 2));
        assert_eq!(sharp(&spear, DVec3::Z, |_, _| false).open, 4);
    }
}
