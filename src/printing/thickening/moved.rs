//! Moved vertices: flat regions grow by moving their vertices, so that the surface keeps its faces.
//!
//! Each vertex moves to where the planes of the faces around it meet: those of growing regions moved outward, those of
//! other regions as they are. Only a region whose faces turn over gets new ones, without its inner vertices. Where its
//! borders cross each other, it may keep its faces: where they face back, they close what went beyond the border.
//!
//! ```text
//!        |                |
//!        |                |
//!    +---+         +------+      a wall grows upward; the side beside it keeps its plane
//!    |       ->    |
//!    +----         +-------
//! ```

use std::collections::BTreeSet;

use crate::context::{Cancelled, Context};
use crate::math::{Precision, nearest_on_triangle, triangulated_area};
use crate::mesh::{Stars, Surface};
use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::{FxHashMap, FxHashSet};
use smallvec::SmallVec;

use super::layer::{Layered, SMOOTH};
use super::mitre::{Plane, mitre};
use super::refine::{Refined, index};
use super::regions::Regions;

/// How far a vertex may leave the plane of a face that does not grow, as a share of the growth.
const ENOUGH: f64 = 1e-3;
/// Cosine of the largest angle by which a face may turn.
const LEAST_COSINE: f64 = 0.5;
/// Cosine of the angle up to which two planes are one.
const SAME: f64 = 0.999_99;

/// The most times that regions which cannot move are left out.
const MAX_PASSES: usize = 32;

/// Moves the vertices of growing regions of a surface without pieces. Growing faces get their source plus `added`. Regions
/// stay that would turn a region which does not grow, or whose border would cross itself and that may not fold. None if all
/// stay.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn moved(
    (refined, regions, may_fold): (&Refined, &Regions, bool),
    source: &[u32],
    added: u32,
    precision: Precision,
    context: &Context<'_>,
) -> Result<Option<Layered>, Cancelled> {
    let place = regions.near_vertices(refined).into_roots();
    let at_places: Vec<[u32; 3]> = refined.faces.iter().map(|face| face.map(|v| place[v as usize])).collect();
    let stars = Stars::new(refined.positions.len(), &at_places);
    let most = |face| (0..3).map(|corner| refined.corner_growth(face, corner)).fold(0.0, f64::max);
    let growth = (0..index(refined.faces.len())).map(most).collect();
    let mut mover = Mover { refined, regions, growth, place, stars, may_fold, left_out: FxHashSet::default() };
    for _ in 0..MAX_PASSES {
        context.check()?;
        let blocked = match mover.positions(precision) {
            Ok(positions) => match mover.faces(&positions) {
                Ok((faces, is_folded)) => return Ok(mover.layered(positions, (faces, is_folded), (source, added))),
                Err(blocked) => blocked,
            },
            Err(blocked) => blocked,
        };
        let before = mover.left_out.len();
        mover.left_out.extend(blocked);
        if mover.left_out.len() == before {
            break;
        }
    }
    Ok(None)
}

/// A face, and the face of the surface before the move that it stands for.
type NewFace = ([u32; 3], u32);

/// The regions that move.
struct Mover<'a> {
    refined: &'a Refined,
    regions: &'a Regions,
    /// How far each face is to move.
    growth: Vec<f64>,
    /// For each vertex, the first one of those that are one place but for rounding. They move together.
    place: Vec<u32>,
    /// The faces at each place.
    stars: Stars,
    /// Whether regions whose borders cross each other keep their faces.
    may_fold: bool,
    /// The regions that stay.
    left_out: FxHashSet<u32>,
}

impl Mover<'_> {
    /// How far a face moves.
    fn growth(&self, face: u32) -> f64 {
        if self.left_out.contains(&self.regions.of(face)) { 0.0 } else { self.growth[face as usize] }
    }

    /// The faces at a vertex.
    fn star(&self, vertex: u32) -> &[u32] {
        self.stars.of(self.place[vertex as usize])
    }

    /// The growing regions at some vertices.
    fn growing_at(&self, vertices: impl Iterator<Item = u32>) -> Vec<u32> {
        let mut regions = Vec::new();
        for vertex in vertices {
            let growing = self.star(vertex).iter().filter(|&&face| self.growth(face) > 0.0);
            regions.extend(growing.map(|&face| self.regions.of(face)));
        }
        regions
    }

    /// The positions after the move, or the growing regions at vertices that cannot move.
    fn positions(&self, precision: Precision) -> Result<Vec<DVec3>, Vec<u32>> {
        let vertices = 0..index(self.refined.positions.len());
        let offset = |v: u32| Vertex { mover: self, star: self.star(v) }.offset();
        let offsets: Vec<Option<DVec3>> = vertices.clone().into_par_iter().map(offset).collect();
        let stuck = self.growing_at(vertices.zip(&offsets).filter(|(_, offset)| offset.is_none()).map(|(v, _)| v));
        if !stuck.is_empty() {
            return Err(stuck);
        }
        let moved = |(&p, by): (&DVec3, &Option<DVec3>)| match *by {
            Some(by) if by != DVec3::ZERO => precision.round(p + by),
            _ => p,
        };
        Ok(self.refined.positions.iter().zip(&offsets).map(moved).collect())
    }

    /// The faces between moved vertices and whether some of them fold, or the growing regions around one that has no faces.
    fn faces(&self, positions: &[DVec3]) -> Result<(Vec<NewFace>, bool), Vec<u32>> {
        let is_turned = |&face: &u32| {
            let [a, b, c] = self.refined.faces[face as usize].map(|v| positions[v as usize]);
            let old = self.regions.normals()[face as usize];
            old != DVec3::ZERO && (b - a).cross(c - a).normalize_or_zero().dot(old) < LEAST_COSINE
        };
        let all = 0..index(self.refined.faces.len());
        let turned: BTreeSet<u32> = all.clone().filter(is_turned).map(|face| self.regions.of(face)).collect();
        let stays = |&face: &u32| !turned.contains(&self.regions.of(face));
        let mut faces: Vec<NewFace> = all.filter(stays).map(|face| (self.refined.faces[face as usize], face)).collect();
        let (mut is_folded, mut blocked) = (false, Vec::new());
        for &region in &turned {
            match self.retriangulated(positions, region) {
                Some(new) => faces.extend(new),
                None if self.may_fold => {
                    is_folded = true;
                    faces.extend(self.regions.faces(region).iter().map(|&f| (self.refined.faces[f as usize], f)));
                }
                None => {
                    let of_region = self.regions.faces(region).iter().flat_map(|&f| self.refined.faces[f as usize]);
                    blocked.extend(self.growing_at(of_region));
                }
            }
        }
        if blocked.is_empty() { Ok((faces, is_folded)) } else { Err(blocked) }
    }

    /// New faces of a region between its moved borders, each with the old face nearest to it before the move. None if the
    /// borders touch or cross each other.
    fn retriangulated(&self, positions: &[DVec3], region: u32) -> Option<Vec<NewFace>> {
        let Self { refined, regions, .. } = self;
        let old = regions.faces(region);
        let (border, ends) = borders(old.iter().map(|&face| refined.faces[face as usize]))?;
        let normal = old.iter().map(|&face| regions.normals()[face as usize]).find(|&normal| normal != DVec3::ZERO)?;
        let points: Vec<DVec3> = border.iter().map(|&v| positions[v as usize]).collect();
        let triangles = triangulated_area(&points, &ends, normal)?;
        let nearest = |face: [u32; 3]| {
            let centre = face.iter().map(|&v| refined.positions[v as usize]).sum::<DVec3>() / 3.0;
            let distance = |face: u32| nearest_on_triangle(centre, refined.corners(face)).distance_squared(centre);
            old.iter().copied().min_by(|&f, &g| distance(f).total_cmp(&distance(g)))
        };
        let new = triangles.into_par_iter().map(|triangle| triangle.map(|i| border[i]));
        new.map(|face| nearest(face).map(|old| (face, old))).collect()
    }

    /// The moved surface; none if nothing grows.
    fn layered(
        &self,
        positions: Vec<DVec3>,
        (faces, is_folded): (Vec<NewFace>, bool),
        (source, added): (&[u32], u32),
    ) -> Option<Layered> {
        let (faces, parent): (Vec<[u32; 3]>, Vec<u32>) = faces.into_iter().unzip();
        let piece: Vec<Option<u32>> = parent.iter().map(|&face| (self.growth(face) > 0.0).then_some(face)).collect();
        let carrier = |(&face, piece): (&u32, &Option<u32>)| {
            let source = source[face as usize];
            if piece.is_some() { source % added + added } else { source }
        };
        let source = parent.iter().zip(&piece).map(carrier).collect();
        let mut surface = Surface { positions, faces, source };
        surface.drop_unreferenced();
        piece.iter().any(Option::is_some).then_some(Layered { surface, piece, parent, is_folded })
    }
}

/// The faces around a vertex.
struct Vertex<'a> {
    mover: &'a Mover<'a>,
    star: &'a [u32],
}

impl Vertex<'_> {
    /// How far the vertex moves; none if no growing face has a plane, or if a face that does not grow would leave its plane.
    fn offset(&self) -> Option<DVec3> {
        let most = self.star.iter().map(|&face| self.growth(face)).fold(0.0, f64::max);
        if most <= 0.0 {
            return Some(DVec3::ZERO);
        }
        let known = self.star.iter().copied().filter(|&face| self.normal(face) != DVec3::ZERO);
        let (growing, others): (SmallVec<[u32; 8]>, SmallVec<[u32; 8]>) =
            known.partition(|&face| self.growth(face) > 0.0);
        if growing.is_empty() {
            return None;
        }
        // A face that continues a growing one smoothly turns outward.
        let is_smooth = |face: u32| growing.iter().any(|&other| self.normal(face).dot(self.normal(other)) >= SMOOTH);
        let kept: SmallVec<[u32; 8]> = others.into_iter().filter(|&face| !is_smooth(face)).collect();
        let mut planes: SmallVec<[Plane; 8]> = SmallVec::new();
        for (face, is_top) in growing.iter().map(|&face| (face, true)).chain(kept.iter().map(|&face| (face, false))) {
            let plane = Plane { normal: self.normal(face), distance: self.growth(face), is_top };
            let is_same = |other: &&mut Plane| other.is_top == is_top && other.normal.dot(plane.normal) >= SAME;
            match planes.iter_mut().find(is_same) {
                Some(same) => same.distance = same.distance.max(plane.distance),
                None => planes.push(plane),
            }
        }
        let offset = mitre(&planes);
        kept.iter().all(|&face| self.normal(face).dot(offset).abs() <= ENOUGH * most).then_some(offset)
    }

    fn growth(&self, face: u32) -> f64 {
        self.mover.growth(face)
    }

    fn normal(&self, face: u32) -> DVec3 {
        self.mover.regions.plane(face)
    }
}

/// The closed borders of some faces, one after another, with their ends. None if one passes a vertex twice.
fn borders(faces: impl Iterator<Item = [u32; 3]>) -> Option<(Vec<u32>, Vec<usize>)> {
    let half_edges: Vec<[u32; 2]> = faces.flat_map(|[a, b, c]| [[a, b], [b, c], [c, a]]).collect();
    let all: FxHashSet<[u32; 2]> = half_edges.iter().copied().collect();
    let mut next: FxHashMap<u32, u32> = FxHashMap::default();
    for &[a, b] in half_edges.iter().filter(|[a, b]| !all.contains(&[*b, *a])) {
        if next.insert(a, b).is_some() {
            return None;
        }
    }
    let (mut border, mut ends) = (Vec::new(), Vec::new());
    for [start, _] in half_edges {
        let mut at = start;
        while let Some(following) = next.remove(&at) {
            border.push(at);
            at = following;
        }
        if ends.last().copied().unwrap_or(0) < border.len() {
            ends.push(border.len());
        }
    }
    Some((border, ends))
}
