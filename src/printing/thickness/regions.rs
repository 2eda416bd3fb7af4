//! Thin faces grouped into features, each with its kind, area and thickness.

use crate::context::{Cancelled, Context};
use crate::math::r2;
use crate::mesh::{Edges, Parts, UnionFind};
use glam::DVec3;
use rayon::prelude::*;

use super::kinds::{Form, Walker};
use super::places::{FeatureKind, Space, ThinRegion};
use super::prepared::{OPPOSED, Prepared};
use super::search::Thinnest;

/// Neighbouring faces whose normals have at least this dot product are parts of one side of a wall.
const SAME_SIDE: f64 = 0.7;
/// Sample points on one face.
const MAX_SAMPLES: f64 = 64.0;
/// Largest faces of a region at which its kind is determined.
const STARTS: usize = 3;
/// Regions whose kind is determined, the largest first.
const MAX_KINDS: usize = 400;
/// Budget of one ray.
const RAY: u64 = 1 << 14;

/// Perpendicular chords of a face.
#[derive(Debug, Clone, Copy, Default)]
struct Measured {
    /// Area whose chords are thin, and the integral of the thickness over it.
    area: f64,
    integral: f64,
    /// A thin chord near the middle of the face.
    chord: Option<[DVec3; 2]>,
}

/// A region whose kind is not yet known.
struct Draft {
    region: ThinRegion,
    /// A chord in each of its largest faces.
    starts: Vec<[DVec3; 2]>,
}

/// Groups faces for which `place` gives a partner.
pub(super) struct Grouping<'a> {
    pub prepared: &'a Prepared<'a>,
    pub all: &'a [Thinnest],
    pub limit: f64,
    pub side: Space,
}

impl Grouping<'_> {
    /// All features, in the order of their first face; sharp edges come last.
    pub fn regions(&self, context: &Context<'_>) -> Result<Vec<ThinRegion>, Cancelled> {
        let edges = Edges::new(&self.prepared.surface.faces);
        let parts = Parts::new(&self.prepared.surface, &edges);
        let is_between = |f: u32| {
            let wall = self.all[f as usize].wall;
            self.side == Space::Air
                && wall.is_some_and(|(other, _)| parts.of_face[f as usize] != parts.of_face[other as usize])
        };
        let wall = |f: u32| self.all[f as usize].wall.map(|(other, _)| other);
        let joins = |f: u32, h: u32| {
            is_between(f) == is_between(h) && self.prepared.normal(f).dot(self.prepared.normal(h)) > SAME_SIDE
        };
        let sides = self.groups(&edges, wall, joins);
        context.check()?;
        let mut regions = self.measured(&sides, context)?;
        let kinds = self.kinds(&regions, &is_between, context)?;
        for (region, kind) in regions.iter_mut().zip(kinds) {
            (region.region.kind, region.region.is_decided) = kind;
        }
        let mut regions = self.merged(regions, &edges);
        let tip = |f: u32| self.all[f as usize].tip.map(|(other, _)| other);
        regions.extend(self.groups(&edges, tip, |_, _| true).into_iter().map(|faces| self.tip_region(faces)));
        Ok(regions)
    }

    /// Groups of the faces that have a partner: joined with it, and with neighbours that `joins` accepts.
    fn groups(
        &self,
        edges: &Edges,
        partner: impl Fn(u32) -> Option<u32>,
        joins: impl Fn(u32, u32) -> bool,
    ) -> Vec<Vec<u32>> {
        let mut sets = UnionFind::new(self.all.len());
        for half_edges in edges.iter() {
            for pair in half_edges.windows(2) {
                let (f, h) = (pair[0] / 3, pair[1] / 3);
                if partner(f).is_some() && partner(h).is_some() && joins(f, h) {
                    sets.unite(f, h);
                }
            }
        }
        for f in (0u32..).take(self.all.len()) {
            if let Some(other) = partner(f).filter(|&other| partner(other).is_some()) {
                sets.unite(f, other);
            }
        }
        gathered(sets.into_roots(), |f| partner(f).is_some())
    }

    /// The regions of groups, not yet with a kind, and a chord of each of their largest faces.
    fn measured(&self, groups: &[Vec<u32>], context: &Context<'_>) -> Result<Vec<Draft>, Cancelled> {
        let mut regions = Vec::with_capacity(groups.len());
        for faces in groups {
            context.check()?;
            let measured: Vec<Measured> = faces.par_iter().map(|&f| self.measure(f)).collect();
            let area: f64 = measured.iter().map(|m| m.area).sum();
            let integral: f64 = measured.iter().map(|m| m.integral).sum();
            let mut largest: Vec<usize> = (0..faces.len()).filter(|&i| measured[i].chord.is_some()).collect();
            largest.sort_by(|&a, &b| measured[b].area.total_cmp(&measured[a].area).then(a.cmp(&b)));
            let starts = largest.iter().take(STARTS).filter_map(|&i| measured[i].chord).collect();
            let region = self.region(faces.clone(), [area, integral], |t| t.wall.map(|w| w.1));
            regions.push(Draft { region, starts });
        }
        Ok(regions)
    }

    /// A region without a kind, from the chords of its faces.
    fn region(
        &self,
        faces: Vec<u32>,
        [area, integral]: [f64; 2],
        chord: impl Fn(&Thinnest) -> Option<super::facing::Chord>,
    ) -> ThinRegion {
        let chords = faces.iter().filter_map(|&f| chord(&self.all[f as usize]));
        let least = chords.min_by(|a, b| a.thickness.total_cmp(&b.thickness));
        let (least, at) = least.map_or((0.0, DVec3::ZERO), |c| (c.thickness, (c.points[0] + c.points[1]) / 2.0));
        let scale = self.prepared.scale;
        ThinRegion {
            kind: FeatureKind::SharpEdge,
            is_decided: faces.iter().all(|&f| self.all[f as usize].undecided.is_none()),
            faces,
            area: area / (scale * scale),
            least: least / scale,
            mean: (if area > 0.0 { integral / area } else { least }).max(least) / scale,
            at: at / scale,
        }
    }

    fn tip_region(&self, faces: Vec<u32>) -> ThinRegion {
        let measured: Vec<Measured> = faces.par_iter().map(|&f| self.measure(f)).collect();
        let area = measured.iter().map(|m| m.area).sum();
        let integral = measured.iter().map(|m| m.integral).sum();
        self.region(faces, [area, integral], |t| t.tip.map(|w| w.1))
    }

    /// Measures perpendicular chords at points spread over a face.
    fn measure(&self, f: u32) -> Measured {
        let ([a, b, c], n) = (self.prepared.corners(f), self.prepared.normal(f));
        let area = (b - a).cross(c - a).length() / 2.0;
        let count = (2.0 * area / (self.limit * self.limit)).ceil().clamp(1.0, MAX_SAMPLES);
        let mut measured = Measured::default();
        for i in 0..count as u32 {
            let [u, v] = if i == 0 { [1.0 / 3.0; 2] } else { r2(f64::from(i)) };
            let [u, v] = if u + v > 1.0 { [1.0 - u, 1.0 - v] } else { [u, v] };
            let p = a + (b - a) * u + (c - a) * v;
            let hit = self.prepared.first_hit([p, -n], self.limit, Some(f), &mut RAY.clone());
            let hit = hit.filter(|&(_, h)| n.dot(self.prepared.normal(h)) <= OPPOSED);
            let Some((distance, _)) = hit else { continue };
            measured.area += area / count;
            measured.integral += distance * area / count;
            measured.chord = measured.chord.or(Some([p, p - n * distance]));
        }
        if measured.area == 0.0 {
            measured.area = area / (2.0 * count);
            let chord = self.all[f as usize].wall.or(self.all[f as usize].tip).map(|(_, chord)| chord);
            measured.integral = chord.map_or(self.limit, |chord| chord.thickness) * measured.area;
        }
        measured
    }

    /// The kind of each region, and whether it is certain.
    fn kinds(
        &self,
        regions: &[Draft],
        is_between: &(impl Fn(u32) -> bool + Sync),
        context: &Context<'_>,
    ) -> Result<Vec<(FeatureKind, bool)>, Cancelled> {
        let mut order: Vec<usize> = (0..regions.len()).collect();
        order.sort_by(|&a, &b| regions[b].region.area.total_cmp(&regions[a].region.area).then(a.cmp(&b)));
        let mut is_late = vec![true; regions.len()];
        order.into_iter().take(MAX_KINDS).for_each(|i| is_late[i] = false);
        context.check()?;
        let walker = Walker { prepared: self.prepared, limit: self.limit };
        let kind = |(i, Draft { region, starts }): (usize, &Draft)| {
            if region.faces.first().is_some_and(|&f| is_between(f)) {
                return (FeatureKind::Clearance, region.is_decided);
            }
            let mut starts = starts.clone();
            if starts.is_empty() {
                let walls = region.faces.iter().filter_map(|&f| self.all[f as usize].wall);
                starts.extend(walls.take(1).map(|(_, chord)| chord.points));
            }
            let forms = starts.into_iter().take(if is_late[i] { 0 } else { STARTS });
            let forms: Vec<FeatureKind> =
                forms.filter_map(|chord| walker.form(chord)).map(|form| self.name(form)).collect();
            match most_frequent(&forms) {
                Some(kind) => (kind, region.is_decided),
                None => (self.name(Form::Sheet { is_supported: false }), false),
            }
        };
        let mut kinds = Vec::with_capacity(regions.len());
        for block in 0..regions.len().div_ceil(64) {
            context.check()?;
            let range = block * 64..regions.len().min(block * 64 + 64);
            kinds.par_extend(range.into_par_iter().map(|i| kind((i, &regions[i]))));
        }
        Ok(kinds)
    }

    fn name(&self, form: Form) -> FeatureKind {
        match (self.side, form) {
            (Space::Material, Form::Sheet { is_supported: true }) => FeatureKind::SupportedWall,
            (Space::Material, Form::Sheet { is_supported: false }) => FeatureKind::FreeWall,
            (Space::Material, Form::Rod { held: 2.. }) => FeatureKind::Wire,
            (Space::Material, Form::Rod { .. }) => FeatureKind::Pin,
            (Space::Air, Form::Sheet { .. }) => FeatureKind::Slot,
            (Space::Air, Form::Rod { held: 2.. }) => FeatureKind::ThroughHole,
            (Space::Air, Form::Rod { .. }) => FeatureKind::BlindHole,
        }
    }

    /// Joins regions of one kind that have a common edge.
    fn merged(&self, regions: Vec<Draft>, edges: &Edges) -> Vec<ThinRegion> {
        let none = u32::MAX;
        let mut of_face = vec![none; self.all.len()];
        for (draft, i) in regions.iter().zip(0u32..) {
            draft.region.faces.iter().for_each(|&f| of_face[f as usize] = i);
        }
        let mut sets = UnionFind::new(regions.len());
        for half_edges in edges.iter() {
            for pair in half_edges.windows(2) {
                let [i, j] = [pair[0], pair[1]].map(|h| of_face[h as usize / 3]);
                if i != none && j != none && regions[i as usize].region.kind == regions[j as usize].region.kind {
                    sets.unite(i, j);
                }
            }
        }
        let roots = sets.into_roots();
        let mut merged: Vec<Option<ThinRegion>> = Vec::with_capacity(regions.len());
        let mut slot = vec![0; regions.len()];
        for (i, Draft { region, .. }) in regions.into_iter().enumerate() {
            let root = roots[i] as usize;
            if root == i {
                slot[i] = merged.len();
                merged.push(Some(region));
            } else if let Some(first) = &mut merged[slot[root]] {
                first.absorb(region);
            }
        }
        merged.into_iter().flatten().collect()
    }
}

impl ThinRegion {
    fn absorb(&mut self, other: Self) {
        let area = self.area + other.area;
        if area > 0.0 {
            self.mean = (self.mean * self.area + other.mean * other.area) / area;
        }
        self.area = area;
        if other.least < self.least {
            (self.least, self.at) = (other.least, other.at);
        }
        self.is_decided &= other.is_decided;
        self.faces.extend(other.faces);
        self.faces.sort_unstable();
    }
}

/// The kind that occurs most often; the first one of equally frequent kinds.
fn most_frequent(kinds: &[FeatureKind]) -> Option<FeatureKind> {
    let count = |kind: FeatureKind| kinds.iter().filter(|&&other| other == kind).count();
    kinds.iter().copied().reduce(|best, kind| if count(kind) > count(best) { kind } else { best })
}

/// The members of each set, sets and members in ascending order.
fn gathered(roots: Vec<u32>, is_member: impl Fn(u32) -> bool) -> Vec<Vec<u32>> {
    let mut groups: Vec<Vec<u32>> = Vec::new();
    let mut slot = vec![usize::MAX; roots.len()];
    for (&root, f) in roots.iter().zip(0u32..).filter(|&(_, f)| is_member(f)) {
        let slot = &mut slot[root as usize];
        if *slot == usize::MAX {
            *slot = groups.len();
            groups.push(Vec::new());
        }
        groups[*slot].push(f);
    }
    groups
}
