//! Spreading: growth fades out along smooth surface with a slope of at most one.
//!
//! A layer that ended in steep slopes would have ridges thinner than the least wall. Where no slope is steeper than 45
//! degrees, no two slopes of one layer oppose each other.

use std::collections::BinaryHeap;

use crate::mesh::{Edges, Stars};

use super::growth::Growths;
use super::layer::{SMOOTH, trusted_normals};
use super::refine::{FaceCorner, Refined};

/// Growth below this share of the least wall is not spread.
const LEAST: f64 = 0.01;

impl Refined {
    /// Spreads the growth to neighbouring corners, within the limits of each point.
    pub fn spread(&mut self, growths: &Growths<'_>) {
        let least = LEAST * growths.min_wall();
        let normals = trusted_normals(self);
        let edges = Edges::new(&self.faces);
        let stars = Stars::new(self.positions.len(), &self.faces);
        // Positive numbers have the order of their bits.
        let mut queue: BinaryHeap<(u64, FaceCorner)> =
            self.growth.iter().filter(|(_, g)| **g > least).map(|(&key, g)| (g.to_bits(), key)).collect();
        while let Some((bits, corner)) = queue.pop() {
            let growth = f64::from_bits(bits);
            if self.growth.get(&corner) != Some(&growth) {
                continue;
            }
            let FaceCorner { vertex: v, face: parent } = corner;
            for &face in stars.of(v) {
                if self.parent[face as usize] != parent {
                    continue;
                }
                for w in self.faces[face as usize] {
                    let length = self.positions[v as usize].distance(self.positions[w as usize]);
                    self.lift(FaceCorner { vertex: w, face: parent }, growth - length, growths, &mut queue);
                    if w == v {
                        continue;
                    }
                    let across = edges.find(v, w).map(|edge| edges.half_edges(edge)).unwrap_or_default();
                    let others = across.iter().map(|half_edge| half_edge / 3).filter(|&other| other != face);
                    for other in others {
                        if normals[face as usize].dot(normals[other as usize]) >= SMOOTH {
                            self.lift(self.corner(other, v), growth, growths, &mut queue);
                        }
                    }
                }
            }
        }
    }

    /// Raises the growth at a corner to `wanted`, as far as the corner's limits allow.
    fn lift(&mut self, key: FaceCorner, wanted: f64, growths: &Growths<'_>, queue: &mut BinaryHeap<(u64, FaceCorner)>) {
        let own = self.growth_at(key);
        let least = LEAST * growths.min_wall();
        if wanted <= least || wanted <= own * (1.0 + 1e-9) {
            return;
        }
        let growth = growths.limit(self.positions[key.vertex as usize], key.face, wanted);
        if growth > own {
            self.growth.insert(key, growth);
            queue.push((growth.to_bits(), key));
        }
    }
}
