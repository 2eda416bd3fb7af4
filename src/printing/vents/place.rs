//! Where bores go: candidates through the wall of a void, judged by how low, how hidden and how short they are.

use glam::DVec3;

use super::bore::{across, corner_radius};
use super::options::VentOptions;
use crate::context::{Cancelled, Context};
use crate::math::ray_direction;
use crate::mesh::Surface;
use crate::printing::voids::{Passage, RegionRays, Regions, SealedVoid};

/// Faces of a void from which bores are tried.
const STARTS: usize = 300;
/// Candidates whose whole width is tested, for each bore.
const MAX_TESTED: usize = 400;
/// Bores with a place that are compared for visibility.
const FINALISTS: usize = 8;
/// Where a second axis starts beside the centre of a void, in the bore's radius: an axis through the centre of a
/// symmetric model often meets an edge, and then its way is uncertain.
const ASIDE: [f64; 2] = [0.0137, 0.0071];
/// Rays along the wall of a bore, and rays that measure visibility.
const RING: u32 = 16;
const VIEWS: u32 = 32;
/// How far a bore starts inside the void, and ends outside, in its radius.
const LEAD: f64 = 1.0;
const OVERRUN: f64 = 0.25;
/// How much earlier than at the plane of the mouth a ray around a bore may leave the wall, in its distance from the axis.
const MAX_EARLY_EXIT: f64 = 0.5;
/// The sine-like slope of a bore's direction to the normal of the void's wall from which it is tried.
const LEAST_ALIGNMENT: f64 = 0.4;
/// Weights of the score: each term is about 0 to 1, and less is better.
const SEEN: f64 = 2.0;
const HIGH_MOUTH: f64 = 1.0;
const HIGH_START: f64 = 2.0;
/// For each ten diameters of length: longer bores are hard to clear.
const LONG: f64 = 2.0;
const SLANTED: f64 = 1.0;
const VISIBLE: f64 = 1.5;
/// How much a further bore gains if it opens into the void as far from the others as the void is wide.
const APART: f64 = 8.0;

/// A bore's place, in the model's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Site {
    /// Index of the void.
    pub void: usize,
    /// The centre of the mouth on the outer surface.
    pub mouth: DVec3,
    /// The unit direction from the void to the mouth.
    pub direction: DVec3,
    /// Length of its axis in the wall.
    pub length: f64,
    /// The point where its axis leaves the void.
    pub inlet: DVec3,
    /// The ends of the prism's axis: in the void and outside.
    pub axis: [DVec3; 2],
}

/// A void for which places are sought.
pub(super) struct Task<'a> {
    /// Its index.
    pub void: usize,
    /// For each region, whether it is the outside or a void with a bore.
    pub is_open: &'a [bool],
    /// The bores of other voids.
    pub others: &'a [Site],
}

/// A straight way through a wall, on the unit scale.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    /// The start of the axis in the void, and the unit direction.
    start: DVec3,
    direction: DVec3,
    /// Where the axis enters and leaves the wall, as distances from the start.
    wall: [f64; 2],
    /// The region of the wall, and the face through which the axis leaves it.
    material: u32,
    mouth_face: u32,
    score: f64,
}

impl Candidate {
    fn inlet(&self) -> DVec3 {
        self.start + self.direction * self.wall[0]
    }

    fn mouth(&self) -> DVec3 {
        self.start + self.direction * self.wall[1]
    }
}

/// A ray parallel to the axis of a bore.
struct Ray {
    from: DVec3,
    hits: Vec<Passage>,
}

/// Chooses places for bores.
pub(super) struct Placement<'a> {
    rays: RegionRays<'a>,
    regions: &'a Regions,
    voids: &'a [SealedVoid],
    options: &'a VentOptions,
    up: DVec3,
    /// The radius of the prism's corners, and the wall to keep around it, on the unit scale.
    radius: f64,
    wall: f64,
    /// The lowest and highest height of the model, and its diagonal, on the unit scale.
    heights: [f64; 2],
    diagonal: f64,
}

impl<'a> Placement<'a> {
    /// Prepares the search for places of vents on a surface.
    pub fn new(surface: &'a Surface, regions: &'a Regions, voids: &'a [SealedVoid], options: &'a VentOptions) -> Self {
        let rays = RegionRays::new(surface, regions);
        let up = options.up.try_normalize().unwrap_or(DVec3::Z);
        let heights = range(rays.unit.iter().map(|p| p.dot(up)));
        let radius = options.diameter / 2.0 * rays.scale * corner_radius() * (1.0 + 1e-5);
        let wall = options.wall * rays.scale;
        let diagonal = surface.bounds().diagonal() * rays.scale;
        Self { rays, regions, voids, options, up, radius, wall, heights, diagonal }
    }

    /// The places of a void's bores: for each bore the best place, followed by others in case it fails.
    pub fn sites(&self, task: &Task<'_>, context: &Context<'_>) -> Result<Vec<Vec<Site>>, Cancelled> {
        let candidates = self.candidates(task, context)?;
        let (mut chosen, mut sites) = (Vec::new(), Vec::new());
        while sites.len() < self.options.per_void as usize {
            let best = self.best(&candidates, task, &chosen, context)?;
            let Some(&first) = best.first() else { break };
            chosen.push(first);
            sites.push(best);
        }
        Ok(sites)
    }

    /// Straight ways of the axis alone from a void through its wall.
    fn candidates(&self, task: &Task<'_>, context: &Context<'_>) -> Result<Vec<Candidate>, Cancelled> {
        let void = task.void;
        let mut candidates = Vec::new();
        let [side, front] = across(self.up);
        let fixed = [-self.up, self.up, side, -side, front, -front];
        for (at, &face) in self.starts(void).iter().enumerate() {
            if at % 32 == 0 {
                context.check()?;
            }
            let region = self.voids[void].region;
            let outward = self.rays.normal(face) * self.regions.out_of(face, region);
            let centre = self.rays.corners(face).iter().sum::<DVec3>() / 3.0;
            let aligned = fixed.into_iter().filter(|d| d.dot(outward) > LEAST_ALIGNMENT);
            for direction in aligned.chain(Some(outward).filter(|d| d.is_normalized())) {
                let start = self.start_inside(centre, face, direction);
                candidates.extend(start.and_then(|start| self.candidate(task, start, direction)));
            }
        }
        let centre = self.voids[void].at * self.rays.scale;
        for direction in fixed.into_iter().chain((0..26).map(ray_direction)) {
            let [a, b] = across(direction);
            let froms = [centre, centre + (a * ASIDE[0] + b * ASIDE[1]) * self.radius];
            let certain = froms.into_iter().find_map(|from| {
                let hits = self.rays.along([from, from + direction * self.diagonal], None)?;
                Some((from, hits))
            });
            if let Some((from, wall)) = certain.and_then(|(from, hits)| Some((from, *hits.first()?))) {
                let start = from + direction * (wall.distance - self.lead()).max(wall.distance / 2.0);
                candidates.extend(self.candidate(task, start, direction));
            }
        }
        candidates.sort_by(|a, b| a.score.total_cmp(&b.score));
        Ok(candidates)
    }

    /// Faces of a void from which bores are tried: the lowest, the largest, and some between.
    fn starts(&self, void: usize) -> Vec<u32> {
        let mut faces = self.voids[void].faces.clone();
        let height = |f: u32| self.rays.corners(f).iter().map(|p| p.dot(self.up)).sum::<f64>();
        let area = |f: u32| {
            let [a, b, c] = self.rays.corners(f);
            (b - a).cross(c - a).length()
        };
        if faces.len() > STARTS {
            let by = |key: &dyn Fn(u32) -> f64| {
                let mut sorted = self.voids[void].faces.clone();
                sorted.sort_by(|&f, &g| key(f).total_cmp(&key(g)).then(f.cmp(&g)));
                sorted.truncate(STARTS / 3);
                sorted
            };
            let spread = faces.iter().copied().step_by(faces.len() / (STARTS / 3));
            faces = by(&height).into_iter().chain(by(&|f| -area(f))).chain(spread).collect();
            faces.sort_unstable();
            faces.dedup();
        }
        faces
    }

    fn lead(&self) -> f64 {
        LEAD * self.radius
    }

    /// A point in the void behind a face's centre, against a direction.
    fn start_inside(&self, centre: DVec3, face: u32, direction: DVec3) -> Option<DVec3> {
        let back = [centre, centre - direction * (2.0 * self.lead())];
        let free = self.rays.along(back, Some(face))?.first().map_or(f64::INFINITY, |hit| hit.distance);
        Some(centre - direction * self.lead().min(free / 2.0))
    }

    /// The way of an axis from a start in a void through one wall into an open region.
    fn candidate(&self, task: &Task<'_>, start: DVec3, direction: DVec3) -> Option<Candidate> {
        let region = self.voids[task.void].region;
        let hits = self.rays.along([start, start + direction * (2.0 * self.diagonal)], None)?;
        let [first, second] = [hits.first()?, hits.get(1)?];
        if first.from != region || !task.is_open[second.to as usize] {
            return None;
        }
        let wall = [first.distance, second.distance];
        let mut found = Candidate { start, direction, wall, material: first.to, mouth_face: second.face, score: 0.0 };
        let share = |p: DVec3, [low, high]: [f64; 2]| (p.dot(self.up) - low) / (high - low).max(f64::MIN_POSITIVE);
        let bounds = self.voids[task.void].bounds;
        let corners = (0..8u32).map(|i| {
            let pick = |k: usize| if i >> k & 1 == 1 { bounds.max[k] } else { bounds.min[k] };
            DVec3::new(pick(0), pick(1), pick(2)).dot(self.up) * self.rays.scale
        });
        let seen = (1.0 + direction.dot(self.up)) / 2.0;
        let slant = 1.0 - self.rays.normal(second.face).dot(direction).abs();
        found.score = SEEN * seen
            + HIGH_MOUTH * share(found.mouth(), self.heights)
            + HIGH_START * share(found.inlet(), range(corners))
            + LONG * (wall[1] - wall[0]) / (20.0 * self.radius)
            + SLANTED * slant;
        Some(found)
    }

    /// The best candidates whose whole width passes, far from the bores that the void has, best first. Those that leave
    /// the wanted wall around the bore come before all others.
    fn best(
        &self,
        candidates: &[Candidate],
        task: &Task<'_>,
        own: &[Site],
        context: &Context<'_>,
    ) -> Result<Vec<Site>, Cancelled> {
        let bounds = self.voids[task.void].bounds;
        let size = ((bounds.max - bounds.min).max_element() * self.rays.scale).max(f64::MIN_POSITIVE);
        let nearest = |candidate: &Candidate| {
            own.iter()
                .map(|site| candidate.inlet().distance(site.inlet * self.rays.scale))
                .fold(f64::INFINITY, f64::min)
        };
        let apart = |candidate: &Candidate| if own.is_empty() { 0.0 } else { APART * nearest(candidate) / size };
        let mut ranked: Vec<(f64, &Candidate)> = candidates.iter().map(|c| (c.score - apart(c), c)).collect();
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut finalists: [Vec<(f64, Site)>; 2] = Default::default();
        for (tested, (score, candidate)) in ranked.into_iter().enumerate() {
            if tested % 16 == 0 {
                context.check()?;
            }
            let has_any = finalists.iter().any(|list| !list.is_empty());
            if finalists[0].len() >= FINALISTS || (tested >= MAX_TESTED && has_any) {
                break;
            }
            let Some(site) = self.site(candidate, task) else { continue };
            if own.iter().chain(task.others).any(|other| self.collide(&site, other)) {
                continue;
            }
            let thin = usize::from(!self.has_wall_around(candidate, task));
            if finalists[thin].len() < FINALISTS {
                finalists[thin].push((score + VISIBLE * self.visibility(candidate), site));
            }
        }
        finalists.iter_mut().for_each(|list| list.sort_by(|a, b| a.0.total_cmp(&b.0)));
        Ok(finalists.into_iter().flatten().map(|(_, site)| site).collect())
    }

    /// Whether rays around a bore, up to the wanted wall away from it, meet no surface but that of the void and the one
    /// in which the bore ends. A ray that ends long before the plane of the bore's mouth left through another side.
    fn has_wall_around(&self, candidate: &Candidate, task: &Task<'_>) -> bool {
        let radii = [0.5, 1.0].map(|share| self.radius + share * self.wall);
        let length = candidate.wall[1] + 4.0 * radii[1];
        let Some(rays) = self.rays_around(candidate, length, radii) else { return false };
        let normal = self.rays.normal(candidate.mouth_face);
        let slope = candidate.direction.dot(normal);
        rays.iter().all(|ray| {
            let Some(leaves) = self.passes_wall(&ray.hits, candidate, task) else { return false };
            let to_plane = (candidate.mouth() - ray.from).dot(normal) / slope;
            ray.hits[leaves].distance >= to_plane - MAX_EARLY_EXIT * radii[1]
        })
    }

    /// The index of the passage at which a ray leaves the void and its wall; `None` if it meets another region before.
    fn passes_wall(&self, hits: &[Passage], candidate: &Candidate, task: &Task<'_>) -> Option<usize> {
        let region = self.voids[task.void].region;
        let leaves = hits.iter().position(|hit| self.is_open(hit, task))?;
        hits[..leaves].iter().all(|hit| hit.to == candidate.material || hit.to == region).then_some(leaves)
    }

    /// Whether a passage leads into an open region other than the void.
    fn is_open(&self, hit: &Passage, task: &Task<'_>) -> bool {
        task.is_open[hit.to as usize] && hit.to != self.voids[task.void].region
    }

    /// The bore of a candidate, if rays along its wall pass from the void and its wall into the open region, too.
    fn site(&self, candidate: &Candidate, task: &Task<'_>) -> Option<Site> {
        let Candidate { start, direction, wall, .. } = *candidate;
        let longest = wall[1] + 6.0 * self.radius;
        let around = self.rays_around(candidate, longest, [0.55, 1.0].map(|share| share * self.radius))?;
        let mut rays: Vec<Vec<Passage>> = around.into_iter().map(|ray| ray.hits).collect();
        rays.push(self.rays.along([start, start + direction * longest], None)?);
        let is_open = |hit: &Passage| self.is_open(hit, task);
        let mut end = 0.0f64;
        for hits in &rays {
            end = end.max(hits[self.passes_wall(hits, candidate, task)?].distance);
        }
        end += OVERRUN * self.radius;
        // Once outside, no ray meets anything before the end of the bore.
        let is_clear = |hits: &Vec<Passage>| {
            hits.iter().rfind(|hit| hit.distance <= end).is_some_and(is_open)
                && hits.iter().filter(|hit| hit.distance <= end && is_open(hit)).count() == 1
        };
        if end >= longest || !rays.iter().all(is_clear) {
            return None;
        }
        let scale = self.rays.scale;
        let axis = [start, start + direction * end].map(|p| self.options.precision.round(p / scale));
        let [inlet, mouth] = [candidate.inlet(), candidate.mouth()].map(|p| p / scale);
        Some(Site { void: task.void, mouth, direction, length: (wall[1] - wall[0]) / scale, inlet, axis })
    }

    /// The passages along rays around the axis, at two distances from it. `None` if one starts neither in the void nor in
    /// its wall.
    fn rays_around(&self, candidate: &Candidate, length: f64, radii: [f64; 2]) -> Option<Vec<Ray>> {
        let Candidate { start, direction, material, .. } = *candidate;
        let [a, b] = across(direction);
        let mut rays = Vec::new();
        for i in 0..2 * RING {
            let angle = std::f64::consts::TAU * (f64::from(i) + 0.3) / f64::from(RING);
            let radius = radii[usize::from(i < RING)];
            let from = start + (a * angle.cos() + b * angle.sin()) * radius;
            let aside = self.rays.along([start, from], None)?;
            let is_known = match aside.as_slice() {
                [] => true,
                [hit] => hit.to == material,
                _ => false,
            };
            if !is_known {
                return None;
            }
            rays.push(Ray { from, hits: self.rays.along([from, from + direction * length], None)? });
        }
        Some(rays)
    }

    /// Whether the wall between two bores is thinner than their radius or the wanted wall.
    fn collide(&self, one: &Site, other: &Site) -> bool {
        let in_wall = |site: &Site| [site.inlet, site.mouth];
        let gap = segment_distance(in_wall(one), in_wall(other)) * self.rays.scale - 2.0 * self.radius;
        gap < self.radius.max(self.wall)
    }

    /// The share of directions from which a mouth is seen; directions from far below count little.
    fn visibility(&self, candidate: &Candidate) -> f64 {
        let eye = candidate.start + candidate.direction * (candidate.wall[1] + OVERRUN * self.radius);
        let (mut seen, mut all) = (0.0, 0.0);
        for view in (0..VIEWS).map(ray_direction) {
            let weight = if view.dot(self.up) < -0.5 { 0.2 } else { 1.0 };
            all += weight;
            let hits = self.rays.along([eye, eye + view * (2.0 * self.diagonal)], None);
            seen += if hits.is_some_and(|hits| hits.is_empty()) { weight } else { 0.0 };
        }
        seen / all
    }
}

/// The least and the greatest of some numbers.
fn range(numbers: impl Iterator<Item = f64>) -> [f64; 2] {
    numbers.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)])
}

/// The distance between two segments.
fn segment_distance([a, b]: [DVec3; 2], [c, d]: [DVec3; 2]) -> f64 {
    let nearest = crate::math::nearest_on_segment;
    // The nearest points lie at an end, or both within: alternate projection converges on a convex problem.
    let mut p = (a + b) / 2.0;
    for _ in 0..64 {
        let q = nearest(p, [c, d]);
        p = nearest(q, [a, b]);
    }
    let ends = [[a, nearest(a, [c, d])], [b, nearest(b, [c, d])], [c, nearest(c, [a, b])], [d, nearest(d, [a, b])]];
    ends.iter().map(|[p, q]| p.distance(*q)).fold(p.distance(nearest(p, [c, d])), f64::min)
}
