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
/// `memory` bytes. The surface is cut into pieces no longer than a block, and the blocks that they lie in are counted;
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
    let most_blocks = usize::try_from(memory / BLOCK_BYTES).unwrap_or(usize::MAX);
    let mut pieces_left = most_blocks.saturating_mul(64);
    let mut blocks = HashSet::new();
    let mut stack = Vec::new();
    for triangle in triangles {
        stack.push(triangle);
        while let Some(piece) = stack.pop() {
            if let Some(halves) = halve(piece, block) {
                pieces_left = pieces_left.checked_sub(1).ok_or(TooHeavy)?;
                stack.extend(halves);
                continue;
            }
            let centre = (piece[0] + piece[1] + piece[2]) / (3.0 * block);
            #[expect(
                clippy::cast_possible_truncation,
                reason = "saturates, and such a grid has too many blocks anyway"
            )]
            blocks.insert(centre.floor().to_array().map(|c| c as i64));
            if blocks.len() > most_blocks {
                return Err(TooHeavy);
            }
        }
    }
    Ok(())
}

/// Two halves of a triangle whose longest edge is longer than `block`. Cutting the longest edge keeps the number of
/// pieces of a needle linear in its length.
fn halve([a, b, c]: [DVec3; 3], block: f64) -> Option<[[DVec3; 3]; 2]> {
    let lengths = [a.distance_squared(b), b.distance_squared(c), c.distance_squared(a)];
    let longest = lengths[0].max(lengths[1]).max(lengths[2]);
    if longest <= block * block {
        return None;
    }
    let [a, b, c] = match lengths {
        [ab, _, _] if ab >= longest => [a, b, c],
        [_, bc, _] if bc >= longest => [b, c, a],
        _ => [c, a, b],
    };
    let middle = a.midpoint(b);
    Some([[a, middle, c], [middle, b, c]])
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: [[DVec3; 3]; 2] =
        [[DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0)], [DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0), DVec3::Y]];

    fn check(triangles: &[[DVec3; 3]], voxel: f64, blocks: u64) -> Result<(), TooHeavy> {
        check_voxel_memory(triangles.iter().copied(), voxel, blocks * BLOCK_BYTES)
    }

    #[test]
    fn a_flat_square_touches_as_many_blocks_as_it_has_cells() {
        // 1 / (8 * 1/800) = 100 blocks along an edge.
        assert_eq!(check(&SQUARE, 1.0 / 800.0, 10_200), Ok(()));
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
