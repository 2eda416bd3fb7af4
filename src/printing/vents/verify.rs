//! Verification of a drilled model: the voids have joined the outside, the bores are wide, and nothing else changed.

use std::fmt;

use glam::{DVec2, DVec3};
use rustc_hash::FxHashSet;

use super::bore::{Bore, across};
use crate::context::{Cancelled, Context};
use crate::inspect::{Analysis, intersections};
use crate::math::{Box3, Tree};
use crate::mesh::{ClosedSurface, Edges, Surface};
use crate::printing::voids::{OUTSIDE, Regions, RegionsError};

/// The relative tolerance of a bore's width and of volumes that must not change.
const TOLERANCE: f64 = 1e-7;

/// The ends of a bore of which the width is not checked, in radii.
const END: f64 = 1e-3;

/// What is wrong with a drilled model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mistake {
    /// The result is not closed, or the nesting of its parts is undecided.
    NotClosed,
    /// Faces intersect.
    Intersects,
    /// The number of voids or of solids is not as expected.
    Regions,
    /// Another void changed.
    OtherVoid,
    /// The Euler characteristic changed by another amount than the bores explain.
    Topology,
    /// A face reaches into a bore.
    Narrow,
    /// A face away from the bores changed.
    FarFace,
}

impl fmt::Display for Mistake {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotClosed => "the surface is no longer closed",
            Self::Intersects => "faces intersect",
            Self::Regions => "the number of voids or solids is not as expected",
            Self::OtherVoid => "another void changed",
            Self::Topology => "the number of handles is not as expected",
            Self::Narrow => "a face reaches into a bore",
            Self::FarFace => "a face away from the bores changed",
        })
    }
}

/// Verifies the surface after bores of `opened` voids were drilled. Returns the first mistake, if any.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub(super) fn verify(
    [before, after]: [&Surface; 2],
    bores: &[Bore],
    opened: usize,
    context: &Context<'_>,
) -> Result<Option<Mistake>, Cancelled> {
    let edges = [before, after].map(|surface| Edges::new(&surface.faces));
    // Each bore joins two boundaries, or adds a handle: both take two from the Euler characteristic.
    #[expect(clippy::cast_possible_wrap, reason = "few bores")]
    let expected = before.euler_characteristic(&edges[0]) - 2 * bores.len() as i64;
    if after.euler_characteristic(&edges[1]) != expected {
        return Ok(Some(Mistake::Topology));
    }
    if has_far_change(before, after, bores) {
        return Ok(Some(Mistake::FarFace));
    }
    if let Some(mistake) = compare_regions([before, after], &edges, opened, context)? {
        return Ok(Some(mistake));
    }
    let tree = Tree::new(&after.positions, &after.faces);
    if bores.iter().any(|bore| is_narrow(after, &tree, bore)) {
        return Ok(Some(Mistake::Narrow));
    }
    let soup = after.to_soup();
    let found = intersections(&Analysis::new((&soup).into(), context)?, context)?;
    Ok((!found.counts.proven_none()).then_some(Mistake::Intersects))
}

/// Compares the regions: `opened` voids are gone, all other voids and the number of solids are the same.
fn compare_regions(
    surfaces: [&Surface; 2],
    edges: &[Edges; 2],
    opened: usize,
    context: &Context<'_>,
) -> Result<Option<Mistake>, Cancelled> {
    let mut all = Vec::new();
    for (surface, edges) in surfaces.into_iter().zip(edges) {
        let Ok(closed) = ClosedSurface::new(surface, edges) else { return Ok(Some(Mistake::NotClosed)) };
        match Regions::new(closed, edges, context) {
            Ok(regions) => all.push(regions),
            Err(RegionsError::Cancelled(stop)) => return Err(stop),
            Err(_) => return Ok(Some(Mistake::NotClosed)),
        }
    }
    let solids: Vec<usize> = all.iter().map(|regions| regions.is_material.iter().filter(|m| **m).count()).collect();
    let volumes: Vec<Vec<f64>> =
        all.iter().zip(surfaces).map(|(regions, surface)| void_volumes(regions, surface)).collect();
    if solids[0] != solids[1] || volumes[0].len() != volumes[1].len() + opened {
        return Ok(Some(Mistake::Regions));
    }
    // Every void that is left was there before.
    let mut old = volumes[0].iter();
    let is_same = |new: &f64| old.any(|old| (old - new).abs() <= TOLERANCE * old.abs());
    Ok((!volumes[1].iter().all(is_same)).then_some(Mistake::OtherVoid))
}

/// The volumes of the voids, largest first.
fn void_volumes(regions: &Regions, surface: &Surface) -> Vec<f64> {
    let mut volumes: Vec<f64> = (0u32..)
        .zip(regions.faces())
        .filter(|(region, _)| *region != OUTSIDE && !regions.is_material[*region as usize])
        .map(|(region, faces)| regions.volume(surface, region, &faces))
        .collect();
    volumes.sort_by(|a, b| b.total_cmp(a));
    volumes
}

/// Whether a face whose box meets no bore is gone, or a new face belongs neither to a bore nor to a face at one.
fn has_far_change(before: &Surface, after: &Surface, bores: &[Bore]) -> bool {
    let boxes: Vec<Box3> = bores
        .iter()
        .map(|bore| {
            let bounds = Box3::of(bore.corners());
            let margin = TOLERANCE * (bounds.diagonal() + bounds.max.abs().max(bounds.min.abs()).max_element());
            bounds.grown(margin)
        })
        .collect();
    let is_near = |surface: &Surface, f: usize| {
        let own = Box3::of(surface.corners(f));
        boxes.iter().any(|bounds| bounds.meets(&own))
    };
    let kept: FxHashSet<[[u64; 3]; 3]> = (0..after.faces.len()).map(|f| after.face_key(f)).collect();
    let gone = |f: &usize| !kept.contains(&before.face_key(*f));
    let mut removed: FxHashSet<u32> = FxHashSet::default();
    for f in (0..before.faces.len()).filter(gone) {
        if !is_near(before, f) {
            return true;
        }
        removed.insert(before.source[f]);
    }
    let known: FxHashSet<[[u64; 3]; 3]> = (0..before.faces.len()).map(|f| before.face_key(f)).collect();
    (0..after.faces.len())
        .any(|f| !known.contains(&after.face_key(f)) && !is_near(after, f) && !removed.contains(&after.source[f]))
}

/// Whether a face reaches into the cylinder around a bore's axis.
fn is_narrow(surface: &Surface, tree: &Tree, bore: &Bore) -> bool {
    let [from, to] = bore.axis;
    let (length, direction) = (from.distance(to), (to - from).normalize_or_zero());
    let [a, b] = across(direction);
    let least = bore.radius * (1.0 - TOLERANCE);
    let mut narrow = false;
    tree.overlapping(&Box3::of(bore.corners()), |face| {
        let corners = surface.corners(face as usize);
        // Heights along the axis; the face's part between both ends of the bore, seen along the axis. What is left of
        // the ends themselves lies in the void's wall.
        let local = corners.map(|p| (p - from).dot(direction));
        let whole: Vec<(DVec3, f64)> = corners.iter().copied().zip(local).collect();
        let clipped = clip(&clip(&whole, END * bore.radius, 1.0), length - END * bore.radius, -1.0);
        let flat: Vec<DVec2> =
            clipped.iter().map(|(p, _)| DVec2::new((*p - from).dot(a), (*p - from).dot(b))).collect();
        narrow = !flat.is_empty() && distance_from_origin(&flat) < least;
        !narrow
    });
    narrow
}

/// The part of a convex polygon with heights above `at`, times `sign`.
fn clip(polygon: &[(DVec3, f64)], at: f64, sign: f64) -> Vec<(DVec3, f64)> {
    let mut clipped = Vec::with_capacity(polygon.len() + 1);
    for (i, &(p, h)) in polygon.iter().enumerate() {
        let (q, k) = polygon[(i + 1) % polygon.len()];
        let (own, next) = ((h - at) * sign, (k - at) * sign);
        if own >= 0.0 {
            clipped.push((p, h));
        }
        if (own > 0.0 && next < 0.0) || (own < 0.0 && next > 0.0) {
            let share = own / (own - next);
            clipped.push((p + (q - p) * share, at));
        }
    }
    clipped
}

/// The distance of a convex polygon from the origin; 0 if it covers the origin.
fn distance_from_origin(polygon: &[DVec2]) -> f64 {
    let sides = (0..polygon.len()).map(|i| (polygon[i], polygon[(i + 1) % polygon.len()]));
    let turns: Vec<f64> = sides.clone().map(|(p, q)| p.perp_dot(q)).collect();
    if polygon.len() > 2 && (turns.iter().all(|&t| t > 0.0) || turns.iter().all(|&t| t < 0.0)) {
        return 0.0;
    }
    sides
        .map(|(p, q)| {
            let along = q - p;
            let share =
                if along == DVec2::ZERO { 0.0 } else { (-p.dot(along) / along.length_squared()).clamp(0.0, 1.0) };
            (p + along * share).length()
        })
        .fold(f64::INFINITY, f64::min)
}
