//! What changed from one mesh to another: counts, sizes, how far the surfaces are apart, and what is inside.

mod changes;
mod deviation;
mod fates;
mod inside;
mod ledger;

use std::cell::{OnceCell, RefCell};

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::analysis::Pair;
use super::matching::Common;
use super::sampling::{Sample, samples, visible};
use super::{Analysis, Measures, Volume, measures, percent};
use crate::context::{Cancelled, Context};
use crate::math::Box3;
use changes::box_change_pct;
use deviation::{Distances, deviation, distances};
use inside::{INSIDE_WINDING, are_buried, buried_pct, inside_agreement};

pub use changes::Changes;
pub use deviation::{Deviation, Spread};
pub use fates::{Fate, Fates, SurfaceShare, SurfaceShares};
pub use inside::InsideAgreement;
pub use ledger::{Certificate, Dispensable, Ledger, LostPart, PartCertificate};

/// The version of [`Comparison`]'s structure.
pub const COMPARISON_VERSION: u32 = 1;

/// Surface farther than this from all of the other mesh is lost, as a share of the input's diagonal. A remesh with the
/// default 300 voxels along the diagonal stays within it.
const FAR: f64 = 0.005;
/// Samples at no distance from the other mesh that are asked whether they can be seen.
const NEAR_ASKED: usize = 400;
/// What a faithful result may lose: the distance that 99 % of the visible surface keeps to, and the move of a side of the
/// box, in percent of the diagonal.
const FAITHFUL_PCT: [f64; 2] = [0.5, 1.0];

/// Share of what is inside the input that a faithful result must have inside, in percent.
const INSIDE_KEPT_PCT: f64 = 50.0;

/// How closely two meshes are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CompareOptions {
    /// Points on each surface from which the other's distance is measured.
    pub samples: u32,
    /// Vertices of each mesh, at most, that are measured beside them.
    pub vertices: u32,
    /// Points at which both are asked what is inside; 0 leaves it out.
    pub inside: u32,
}

impl Default for CompareOptions {
    fn default() -> Self {
        Self { samples: 20_000, vertices: 20_000, inside: 20_000 }
    }
}

/// Points at which the inside of a result is compared, where the input's volume can't tell.
const INSIDE: u32 = 1000;
/// Of them as many must be inside the input for the comparison to say anything.
const LEAST_INSIDE: u64 = 20;
/// The winding number from which on a point is certainly inside an open mesh: near a large hole it is about a half.
const CERTAINLY_INSIDE: f64 = 0.75;
/// Change of the volume, in percent, from which on winding numbers are asked whether space was counted twice.
const DOUBTED_VOLUME_PCT: f64 = 5.0;
/// They say so where this share of the inside is common to both, in percent.
const SAME_INSIDE_PCT: f64 = 99.0;

impl CompareOptions {
    /// What every result of a repair is judged with.
    pub const BRIEF: Self = Self { samples: 4000, vertices: 2000, inside: 0 };
}

/// Two meshes compared.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Comparison {
    /// Version of this structure.
    pub version: u32,
    /// Whether the second mesh keeps the first's shape: 99 % of the surface that can be seen from outside is within 0.5 %
    /// of the diagonal of the second mesh, no side of the box moved by more than 1 % of it, and at least half of what is inside the
    /// first, by winding number, is inside the second.
    pub faithful: bool,
    /// What the report of a repair says too.
    #[serde(flatten)]
    pub changes: Changes,
    /// Share of the first mesh's surface that can be seen from outside, in percent; none where nothing was apart, so that
    /// nobody had to look.
    pub visible_pct: Option<f64>,
    /// Distance from all of the first mesh's surface to the second, also from what can't be seen.
    pub deviation: Option<Deviation>,
    /// Whether both agree on what is inside.
    pub inside: Option<InsideAgreement>,
}

/// Compares `before` with `after`. The same meshes give the same figures, on any number of threads.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
pub fn compare(
    before: &Analysis<'_>,
    after: &Analysis<'_>,
    options: CompareOptions,
    context: &Context<'_>,
) -> Result<Comparison, Cancelled> {
    let (before_measures, after_measures) = (measures(before, context)?, measures(after, context)?);
    Original::new(before, &before_measures, options).compare(after, &after_measures, context)
}

/// The mesh that others are compared with, and what is looked at of it again and again: found once.
pub struct Original<'a> {
    analysis: &'a Analysis<'a>,
    measures: &'a Measures,
    options: CompareOptions,
    settled: Option<&'a Analysis<'a>>,
    samples: OnceCell<Vec<Sample>>,
    /// Of each sample whether it can be seen, where somebody asked.
    visible: RefCell<Vec<Asked>>,
}

/// Whether a sample can be seen.
#[derive(Clone, Copy)]
enum Asked {
    NotYet,
    /// None where the search was given up.
    Known(Option<bool>),
}

/// What is known on the way from the one mesh to the other.
struct Way {
    changes: Changes,
    distances: Distances,
}

impl<'a> Original<'a> {
    /// A mesh with its measures. Costs nothing yet.
    #[must_use]
    pub fn new(analysis: &'a Analysis<'a>, measures: &'a Measures, options: CompareOptions) -> Self {
        let (samples, visible) = (OnceCell::new(), RefCell::default());
        Self { analysis, measures, options, settled: None, samples, visible }
    }

    /// The same mesh with its orientation settled, on which is measured what it encloses. None where it is settled as it is.
    #[must_use]
    pub fn with_settled(self, settled: Option<&'a Analysis<'a>>) -> Self {
        Self { settled, ..self }
    }

    /// The volume when the orientation is settled.
    ///
    /// # Errors
    /// [`Cancelled`] when the context says stop.
    pub fn settled_volume(&self, context: &Context<'_>) -> Result<Volume, Cancelled> {
        self.settled.map_or(Ok(self.measures.volume), |settled| Ok(measures(settled, context)?.volume))
    }

    /// The mesh itself.
    #[must_use]
    pub fn analysis(&self) -> &'a Analysis<'a> {
        self.analysis
    }

    /// The mesh's own measures.
    #[must_use]
    pub fn measures(&self) -> &'a Measures {
        self.measures
    }

    /// How another mesh differs. `patches` tells for each face of its soup whether it is a hole's patch, where that is known.
    ///
    /// # Errors
    /// [`Cancelled`] when the context says stop.
    pub fn changes(
        &self,
        after: &Analysis<'_>,
        measures: &Measures,
        patches: Option<&[bool]>,
        context: &Context<'_>,
    ) -> Result<Changes, Cancelled> {
        self.changes_but_for(after, measures, patches, &[], context)
    }

    /// The same where some parts were asked to go: what went with them is no change. `gone` tells of each part whether it was; it is
    /// empty where none was.
    ///
    /// # Errors
    /// [`Cancelled`] when the context says stop.
    pub fn changes_but_for(
        &self,
        after: &Analysis<'_>,
        measures: &Measures,
        patches: Option<&[bool]>,
        gone: &[bool],
        context: &Context<'_>,
    ) -> Result<Changes, Cancelled> {
        let mut changes = self.way(after, measures, patches, gone, context)?.changes;
        if gone.contains(&true) {
            let solids = self.settled.unwrap_or(self.analysis).solids.iter().zip(gone);
            let stays = solids.filter(|(_, gone)| !**gone).map(|(solid, _)| solid);
            changes.leave_out_others(self.measures, measures, stays);
        }
        Ok(changes)
    }

    /// All that can be said of another mesh.
    ///
    /// # Errors
    /// [`Cancelled`] when the context says stop.
    pub fn compare(
        &self,
        after: &Analysis<'_>,
        measures: &Measures,
        context: &Context<'_>,
    ) -> Result<Comparison, Cancelled> {
        let Way { mut changes, distances } = self.way(after, measures, None, &[], context)?;
        changes.surface = Some(self.fates(after, context)?.shares);
        let diagonal = self.analysis.unit_diagonal();
        let apart = distances.samples.iter().any(|&distance| distance != Some(0.0));
        let all: Vec<usize> = if apart { (0..self.samples().len()).collect() } else { Vec::new() };
        let known: Vec<bool> = self.visible(&all, context)?.into_iter().flatten().collect();
        let visible_pct = percent(known.iter().filter(|&&seen| seen).count() as f64, known.len() as f64);
        let inside = inside_agreement(Pair::new(self.analysis, after), INSIDE_WINDING, self.options.inside, context)?;
        let keeps_inside = inside
            .filter(|it| it.inside_before >= LEAST_INSIDE)
            .and_then(|it| it.kept_pct())
            .is_none_or(|kept| kept >= INSIDE_KEPT_PCT);
        Ok(Comparison {
            version: COMPARISON_VERSION,
            faithful: keeps_inside && changes.keeps_visible_surface(),
            changes,
            visible_pct,
            deviation: deviation(self.analysis, self.samples(), &distances, diagonal, |_| true, |_| true),
            inside,
        })
    }

    fn samples(&self) -> &[Sample] {
        self.samples.get_or_init(|| samples(self.analysis, self.options.samples))
    }

    /// Whether each of the samples `wanted` can be seen; none where the search was given up.
    fn visible(&self, wanted: &[usize], context: &Context<'_>) -> Result<Vec<Option<bool>>, Cancelled> {
        let mut asked = self.visible.borrow_mut();
        asked.resize(self.samples().len(), Asked::NotYet);
        let open: Vec<usize> = wanted.iter().copied().filter(|&i| matches!(asked[i], Asked::NotYet)).collect();
        let points: Vec<Sample> = open.iter().map(|&i| self.samples()[i]).collect();
        for (&i, seen) in open.iter().zip(visible(self.analysis, &points, context)?) {
            asked[i] = Asked::Known(seen);
        }
        let answer = |&i: &usize| if let Asked::Known(seen) = asked[i] { seen } else { None };
        Ok(wanted.iter().map(answer).collect())
    }

    fn way(
        &self,
        after: &Analysis<'_>,
        measures: &Measures,
        patches: Option<&[bool]>,
        gone: &[bool],
        context: &Context<'_>,
    ) -> Result<Way, Cancelled> {
        let scale = self.analysis.scale();
        let common = Common::new(&self.analysis.keys(scale), &after.keys(scale));
        context.check()?;
        let kept = common.first.iter().filter(|&&stands| stands).count() as f64;
        let kept_pct = percent(kept, common.first.len() as f64).unwrap_or(100.0);
        let settled = self.settled_volume(context)?;
        let mut changes = Changes::of(self.measures, settled, measures, kept_pct);
        let (there, back) = (Pair::new(self.analysis, after), Pair::new(after, self.analysis));
        let Box3 { min, max } = after.extent();
        let extent = Box3 { min: min / there.ratio, max: max / there.ratio };
        changes.box_change_pct = box_change_pct(self.analysis.extent(), extent);
        let stands = |faces: &[bool], f: u32| common.fine && faces[f as usize];
        let options = self.options;
        let mut found = distances(there, self.samples(), options.vertices, |f| stands(&common.first, f), context)?;
        if gone.contains(&true) {
            let parts = &self.analysis.parts.of_face;
            let is_gone = |sample: &Sample| gone.get(parts[sample.face as usize] as usize) == Some(&true);
            for (distance, _) in found.samples.iter_mut().zip(self.samples()).filter(|(_, sample)| is_gone(sample)) {
                *distance = None;
            }
        }
        let diagonal = self.analysis.unit_diagonal();
        self.lost(&found, diagonal, (after, measures), &mut changes, context)?;
        if !self.analysis.surface.faces.is_empty() {
            let points = samples(after, options.samples);
            let made = distances(back, &points, options.vertices, |f| stands(&common.second, f), context)?;
            let diagonal = diagonal * there.ratio;
            changes.made = deviation(after, &points, &made, diagonal, |_| true, |_| true);
            if let Some(patches) = patches {
                let is_patch = |f: u32| patches.get(after.surface.source[f as usize] as usize) == Some(&true);
                let mut moved = vec![false; after.surface.positions.len()];
                for (face, _) in after.surface.faces.iter().zip(0u32..).filter(|&(_, f)| !is_patch(f)) {
                    face.iter().for_each(|&v| moved[v as usize] = true);
                }
                let (counts, vertices) = (|i: usize| !is_patch(points[i].face), |v: u32| moved[v as usize]);
                changes.moved = deviation(after, &points, &made, diagonal, counts, vertices);
            }
        }
        if after.surface.faces.len() < self.analysis.surface.faces.len() && measures.closed {
            changes.faces_buried_pct = buried_pct(there, |f| common.first[f as usize], context)?;
        }
        changes.inside_overlap_pct = self.inside_overlap_pct(after, measures, changes.volume_change_pct, context)?;
        Ok(Way { changes, distances: found })
    }

    /// Of what is inside this mesh or the other the share inside both, in percent, where the volume can't tell: faces intersect, or the
    /// volume changed and what is inside did not, since parts within others were counted twice.
    fn inside_overlap_pct(
        &self,
        after: &Analysis<'_>,
        measures: &Measures,
        volume_change_pct: Option<f64>,
        context: &Context<'_>,
    ) -> Result<Option<f64>, Cancelled> {
        let crossed = self.measures.self_intersections.pairs.is_some_and(|pairs| pairs > 0);
        let doubted = volume_change_pct.is_some_and(|change| change.abs() > DOUBTED_VOLUME_PCT);
        let is_open = !self.measures.closed;
        if !((is_open || crossed || doubted) && measures.printable()) {
            return Ok(None);
        }
        // Where neighbours of an open surface are turned against each other, its winding numbers say nothing.
        if is_open && self.measures.misoriented_edges > 0 {
            return Ok(None);
        }
        let before = self.settled.unwrap_or(self.analysis);
        let least = if is_open { CERTAINLY_INSIDE } else { INSIDE_WINDING };
        let found = inside_agreement(Pair::new(before, after), least, INSIDE, context)?;
        // Walls of two sides that look apart enclose nothing by winding, and there is nothing to compare.
        let found = found.filter(|it| it.inside_before >= LEAST_INSIDE);
        if is_open {
            // Near a hole the open surface has nothing inside, and a patch that closes it rightly adds to that.
            return Ok(found.and_then(|it| it.kept_pct()));
        }
        let overlap = found.and_then(|it| it.overlap_pct);
        Ok(overlap.filter(|&overlap| crossed || overlap >= SAME_INSIDE_PCT))
    }

    /// Fills in what was lost of the visible surface.
    fn lost(
        &self,
        found: &Distances,
        diagonal: f64,
        (after, measures): (&Analysis<'_>, &Measures),
        changes: &mut Changes,
        context: &Context<'_>,
    ) -> Result<(), Cancelled> {
        if self.samples().is_empty() {
            return Ok(());
        }
        if after.surface.faces.is_empty() {
            changes.surface_lost_pct = Some(100.0);
            return Ok(());
        }
        if found.samples.iter().all(Option::is_none) {
            return Ok(());
        }
        // Where nothing is apart, it does not matter what can be seen. Elsewhere it matters of each sample that is, and of the
        // others only how many can be seen, which some of them tell.
        let (apart, near): (Vec<usize>, Vec<usize>) = (0..found.samples.len())
            .filter(|&i| found.samples[i].is_some())
            .partition(|&i| found.samples[i] != Some(0.0));
        let mut counts = vec![false; found.samples.len()];
        let (mut seen_near, mut walled_in) = (near.len(), 0);
        // What stands in the result but within another part of it was walled in when holes were closed.
        let may_be_walled_in = measures.closed && measures.parts > 1 && !self.measures.closed;
        if !apart.is_empty() || may_be_walled_in {
            // What could not be told to be hidden counts as seen.
            for (&i, seen) in apart.iter().zip(self.visible(&apart, context)?) {
                counts[i] = seen != Some(false);
            }
            let some: Vec<usize> = near.iter().copied().step_by(near.len().div_ceil(NEAR_ASKED).max(1)).collect();
            let seen = self.visible(&some, context)?;
            let seen: Vec<usize> =
                some.iter().zip(seen).filter(|(_, seen)| *seen != Some(false)).map(|(&i, _)| i).collect();
            let share_of = |few: usize| near.len() * few / some.len().max(1);
            seen_near = share_of(seen.len());
            if may_be_walled_in {
                let points = seen.iter().map(|&i| (self.samples()[i].point, self.samples()[i].normal));
                let buried = are_buried(Pair::new(self.analysis, after), &points.collect::<Vec<_>>(), context)?;
                walled_in = share_of(buried.into_iter().filter(|&buried| buried == Some(true)).count());
            }
        }
        // One at no distance is as good as another.
        near.iter().take(seen_near).for_each(|&i| counts[i] = true);
        changes.lost = deviation(self.analysis, self.samples(), found, diagonal, |i| counts[i], |_| false);
        let visible = found.samples.iter().zip(&counts).filter(|(_, counts)| **counts).filter_map(|(&d, _)| d);
        let (mut all, mut far) = (0, walled_in);
        for distance in visible {
            all += 1;
            far += usize::from(distance > FAR * diagonal);
        }
        changes.surface_lost_pct = percent(far as f64, all.max(1) as f64);
        Ok(())
    }
}
