use std::collections::HashSet;

use glam::DVec3;

/// Voxels along the edge of a block: the leaf nodes of OpenVDB, on which Blender's voxel remesh stands, are 8 voxels
/// wide (Museth 2013, "VDB: High-resolution sparse volumes with dynamic topology").
const BLOCK_VOXELS: f64 = 8.0;

/// Bytes that a voxel remesh takes for each block that the surface touches. Measured with Blender 3.4, 4.5 and 5.0 on a
/// box of one and of four million faces: 20 to 38 thousand, most of it for the new faces.
const BLOCK_BYTES: u64 = 40_000;

/// Why a voxel remesh is not begun.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct TooHeavy;

/// Checks that a voxel remesh of `triangles` with voxel edge `voxel` (in the same unit, above zero) stays within about
/// `memory` bytes. The surface is sampled at half a block's distance, and the blocks that the samples lie in are counted;
/// work and memory of the check itself are bounded by `memory` as well.
///
/// # Errors
/// [`TooHeavy`] when there are more blocks, or when so many layers of surface lie on each other that the remesh
/// would take far longer than its size tells.
pub(super) fn check_voxel_memory(
    triangles: impl Iterator<Item = [DVec3; 3]>,
    voxel: f64,
    memory: u64,
) -> Result<(), TooHeavy> {
    let block = voxel * BLOCK_VOXELS;
    // At a whole block's distance rounding lets two samples fall into one block and none into the next.
    let apart = block * 0.5;
    let most_blocks = usize::try_from(memory / BLOCK_BYTES).unwrap_or(usize::MAX);
    let mut samples_left = most_blocks.saturating_mul(64);
    let mut blocks = HashSet::new();
    let mut touch = |place: DVec3| {
        #[expect(clippy::cast_possible_truncation, reason = "saturates, and such a grid has too many blocks anyway")]
        blocks.insert((place / block).floor().to_array().map(|c| c as i64));
        if blocks.len() > most_blocks { Err(TooHeavy) } else { Ok(()) }
    };
    for triangle in triangles {
        let [a, b, c] = longest_edge_first(triangle);
        let length = a.distance(b);
        if length <= block {
            touch((a + b + c) / 3.0)?;
            continue;
        }
        // Rows along the longest edge, so that a needle costs its length and not the square of it.
        let height = (b - a).cross(c - a).length() / length;
        let rows = (height / apart).ceil().max(1.0);
        let mut row = 0.0;
        while row <= rows {
            let (from, to) = (a.lerp(c, row / rows), b.lerp(c, row / rows));
            let steps = (from.distance(to) / apart).ceil().max(1.0);
            let mut step = 0.0;
            while step <= steps {
                samples_left = samples_left.checked_sub(1).ok_or(TooHeavy)?;
                touch(from.lerp(to, step / steps))?;
                step += 1.0;
            }
            row += 1.0;
        }
    }
    Ok(())
}

/// The corners in the same order, begun so that the longest edge is the first.
fn longest_edge_first([a, b, c]: [DVec3; 3]) -> [DVec3; 3] {
    let [ab, bc, ca] = [a.distance_squared(b), b.distance_squared(c), c.distance_squared(a)];
    if ab >= bc && ab >= ca {
        [a, b, c]
    } else if bc >= ca {
        [b, c, a]
    } else {
        [c, a, b]
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    const SQUARE: [[DVec3; 3]; 2] =
        [[DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0)], [DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0), DVec3::Y]];

    fn check(triangles: &[[DVec3; 3]], voxel: f64, blocks: u64) -> Result<(), TooHeavy> {
        check_voxel_memory(triangles.iter().copied(), voxel, blocks * BLOCK_BYTES)
    }

    #[test]
    fn a_flat_square_touches_as_many_blocks_as_it_has_cells() {
        // 1 / (8 * 1/800) = 100 blocks along an edge, and the far border lies in the next.
        assert_eq!(check(&SQUARE, 1.0 / 800.0, 10_300), Ok(()));
        assert_eq!(check(&SQUARE, 1.0 / 800.0, 9_500), Err(TooHeavy));
    }

    #[test]
    fn a_needle_costs_its_length_and_not_its_square() {
        let needle = [[DVec3::ZERO, DVec3::X, DVec3::new(0.5, 1e-6, 0.0)]];
        assert_eq!(check(&needle, 1.0 / 80_000.0, 11_000), Ok(()));
        assert_eq!(check(&needle, 1.0 / 80_000.0, 9_000), Err(TooHeavy));
    }

    #[test]
    fn faces_smaller_than_a_block_cost_nothing_more() {
        let crumbs = vec![SQUARE[0]; 100_000];
        assert_eq!(check(&crumbs, 1.0, 10), Ok(()));
    }

    #[test]
    fn many_layers_of_large_faces_end_the_check_early() {
        let layers = vec![SQUARE[0]; 100_000];
        assert_eq!(check(&layers, 1.0 / 800.0, 20_000), Err(TooHeavy));
    }
}
