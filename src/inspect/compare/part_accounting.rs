//! Accounting for every part of an input mesh: present in the result, absent for a reason, or lost.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::original::Original;
use super::probes::{PointLocation, PointLocator, Probes};
use crate::context::{Cancelled, Context};
use crate::inspect::matching::{NO_FACE, matched};
use crate::inspect::{Analysis, finite};
use crate::mesh::Parts;

/// Maximum length of each list of a part accounting.
const MOST_LISTED: usize = 1000;
/// A part is present if at least this fraction of its sample points lies on the result's surface, and on no other part of
/// the input.
const PRESENT: f64 = 0.1;
/// Largest fraction of a part's sample points that may contradict its reason, to allow for sampling error.
const OUTLIERS: f64 = 0.1;

/// Why the absence of an input part from the result is no loss.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum PartReason {
    /// The whole part lies on surface of other parts that are in the result.
    Duplicate,
    /// The part encloses nothing: it is an open sheet, or closed with zero volume.
    NoVolume,
    /// The part lies inside the result, by winding number.
    InsideAnother,
    /// The part is open and too small to print.
    Debris,
    /// The part's volume is below the share that the options keep.
    Dropped,
}

/// A part absent from the result for a known reason.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct AccountedPart {
    /// Number of the part, from 0 in the order of the parts' first faces.
    pub part: u32,
    /// Index of the part's first face in the file, from 0.
    pub first_face: u32,
    /// Number of faces of the part.
    pub faces: u64,
    /// Why the absence is no loss.
    pub reason: PartReason,
    /// Number of sample points that support the reason; 0 if the part's own faces decide.
    pub samples: u32,
}

/// A part absent from the result without a reason.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct LostPart {
    /// Number of the part, from 0 in the order of the parts' first faces.
    pub part: u32,
    /// Index of the part's first face in the file, from 0.
    pub first_face: u32,
    /// Number of faces of the part.
    pub faces: u64,
    /// Area of the part, in square model units.
    pub area: f64,
    /// A point of the part, in the model's unit: neither on nor in the result if a sampled point is.
    pub at: [f64; 3],
}

/// Part accounting of a repair: every edge-connected part of the input is in the result, absent for a reason, or
/// lost. Computed from the final bytes of the result.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct PartAccounting {
    /// Number of parts of the input.
    pub parts: u64,
    /// Parts whose every face with an area is in the result at the same place.
    pub kept: u64,
    /// Parts present in the result with changes: some faces are missing, retriangulated or moved.
    pub changed: u64,
    /// Kept or changed parts that share a part of the result with another part of the input.
    pub united: u64,
    /// Absent parts with the reason `duplicate`.
    pub duplicate: u64,
    /// Absent parts with the reason `no_volume`.
    pub no_volume: u64,
    /// Absent parts with the reason `inside_another`.
    pub inside_another: u64,
    /// Absent parts with the reason `debris`.
    pub debris: u64,
    /// Absent parts with the reason `dropped`.
    #[serde(default)]
    pub dropped: u64,
    /// Absent parts without a reason. A count above 0 is a bug of the program.
    pub lost: u64,
    /// Parts that the search did not decide within its budget; no other count includes them.
    pub unknown: u64,
    /// The absent parts with a reason; at most the first 1000.
    pub reasons: Vec<AccountedPart>,
    /// The lost parts; at most the first 1000.
    pub lost_parts: Vec<LostPart>,
    /// All absent parts with a reason, by number. Only the program uses them; reports list the first in `reasons`.
    #[serde(skip)]
    pub all_reasons: Vec<(u32, PartReason)>,
}

impl Original<'_> {
    /// Accounts for each part.
    ///
    /// A part is present if the result has at least one of its faces at the same place. Each face of the result matches
    /// only one of several identical input faces, in the order of their indices. A part without such a face is judged by
    /// sample points: each is on the result, inside the result or outside, and may also lie on another part. Takes
    /// O(n log n) time, within a budget.
    ///
    /// `reasons_of` is called once, with the parts that are neither present nor inside the result nor duplicates. It
    /// judges each part by the part's own faces, and returns in order why the absence is no loss, or none for a part
    /// that must stay. It is not called if there are no such parts.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn part_accounting(
        &self,
        after: &Analysis<'_>,
        reasons_of: impl FnOnce(&[u32]) -> Result<Vec<Option<PartReason>>, Cancelled>,
        context: &Context<'_>,
    ) -> Result<PartAccounting, Cancelled> {
        let before = self.analysis;
        let mut tally = Tally::new(before, after);
        context.check()?;
        let candidates = tally.parts_without_kept_face();
        if candidates.is_empty() {
            return Ok(tally.finish(&[]));
        }
        let probes = Probes::new(before, &candidates);
        let locations = PointLocator::new(before, after, &tally.has_kept_face).locate(&probes, context)?;
        let mut verdicts = Vec::with_capacity(candidates.len());
        for (&part, range) in candidates.iter().zip(&probes.of_part) {
            let verdict = Verdict::of(&locations[range.clone()]);
            if verdict == Verdict::Present {
                let result_part = |location: &Option<PointLocation>| match location {
                    Some(PointLocation::On { face, .. }) => Some(after.parts.of_face[*face as usize]),
                    _ => None,
                };
                tally.links.extend(locations[range.clone()].iter().filter_map(result_part).map(|of| (of, part)));
            }
            verdicts.push(verdict);
        }
        let unmatched: Vec<u32> = candidates
            .iter()
            .zip(&verdicts)
            .filter(|(_, verdict)| **verdict == Verdict::Unmatched)
            .map(|(&part, _)| part)
            .collect();
        let mut reasons = if unmatched.is_empty() { Vec::new() } else { reasons_of(&unmatched)? }.into_iter();
        let candidates: Vec<Candidate> = candidates
            .iter()
            .zip(verdicts)
            .zip(&probes.of_part)
            .map(|((&part, verdict), range)| {
                let samples = u32::try_from(range.len()).unwrap_or(u32::MAX);
                let status = match verdict {
                    Verdict::Present => PartStatus::Changed,
                    Verdict::Unknown => PartStatus::Unknown,
                    Verdict::Reasoned(reason) => PartStatus::Reasoned(reason, samples),
                    Verdict::Unmatched => match reasons.next().flatten() {
                        Some(reason) => PartStatus::Reasoned(reason, 0),
                        None => {
                            let is_outside = |i: &usize| locations[*i] == Some(PointLocation::Outside);
                            let sample = range.clone().find(is_outside).or_else(|| range.clone().next());
                            PartStatus::Lost(sample.map_or(DVec3::ZERO, |i| probes.points[i]))
                        }
                    },
                };
                Candidate { part, status }
            })
            .collect();
        Ok(tally.finish(&candidates))
    }
}

/// Status of a part without a kept face.
struct Candidate {
    part: u32,
    status: PartStatus,
}

enum PartStatus {
    Changed,
    Reasoned(PartReason, u32),
    /// A point of the lost part, in unit coordinates ([`Analysis::unit_length`] is their scale).
    Lost(DVec3),
    Unknown,
}

/// Working state of the accounting, initialised from the faces that both meshes have at the same place.
struct Tally<'a> {
    before: &'a Analysis<'a>,
    /// For each part the number of faces with an area, and how many of these the result has at the same place.
    faces: Vec<[u64; 2]>,
    /// For each part, whether the result has at least one of its faces.
    has_kept_face: Vec<bool>,
    /// Pairs of a part of the result and a part of the input that the result's part contains.
    links: Vec<(u32, u32)>,
}

impl<'a> Tally<'a> {
    fn new(before: &'a Analysis<'a>, after: &'a Analysis<'a>) -> Self {
        let scale = before.scale();
        let matched = matched(&before.keyed_faces(scale), &after.keyed_faces(scale));
        let count = before.parts.count;
        let mut tally =
            Self { before, faces: vec![[0; 2]; count], has_kept_face: vec![false; count], links: Vec::new() };
        let faces = before.parts.of_face.iter().zip(before.flat()).zip(&matched);
        for ((&part, &flat), &other) in faces.filter(|((part, _), _)| **part != Parts::NONE) {
            let is_kept = other != NO_FACE;
            if !flat {
                let counts = &mut tally.faces[part as usize];
                *counts = [counts[0] + 1, counts[1] + u64::from(is_kept)];
            }
            tally.has_kept_face[part as usize] |= is_kept;
            let link = is_kept.then(|| (after.parts.of_face[other as usize], part));
            // Consecutive faces usually give the same link; this avoids most duplicates.
            if let Some(link) = link.filter(|link| tally.links.last() != Some(link)) {
                tally.links.push(link);
            }
        }
        tally
    }

    /// Parts without a face in the result.
    fn parts_without_kept_face(&self) -> Vec<u32> {
        (0u32..).zip(&self.has_kept_face).filter(|(_, kept)| !**kept).map(|(part, _)| part).collect()
    }

    /// For each part, whether it shares a part of the result with another part.
    fn united(&mut self) -> Vec<bool> {
        self.links.retain(|&(result_part, _)| result_part != Parts::NONE);
        self.links.sort_unstable();
        self.links.dedup();
        let mut united = vec![false; self.before.parts.count];
        for group in self.links.chunk_by(|a, b| a.0 == b.0).filter(|group| group.len() > 1) {
            group.iter().for_each(|&(_, part)| united[part as usize] = true);
        }
        united
    }

    /// Completes the accounting with the status of each part without a kept face, in order.
    fn finish(mut self, candidates: &[Candidate]) -> PartAccounting {
        let united = self.united();
        let Self { before, faces, has_kept_face, .. } = self;
        let mut accounting = PartAccounting { parts: before.parts.count as u64, ..PartAccounting::default() };
        for ([all, kept], _) in faces.iter().zip(&has_kept_face).filter(|(_, kept)| **kept) {
            *(if all == kept { &mut accounting.kept } else { &mut accounting.changed }) += 1;
        }
        accounting.united = united.iter().filter(|&&united| united).count() as u64;
        let mut first = vec![NO_FACE; if candidates.is_empty() { 0 } else { before.parts.count }];
        let mut count = vec![0u64; first.len()];
        if !candidates.is_empty() {
            for (&part, f) in before.parts.of_face.iter().zip(0u32..).filter(|(part, _)| **part != Parts::NONE) {
                first[part as usize] = first[part as usize].min(f);
                count[part as usize] += 1;
            }
        }
        let unit = before.unit_length();
        for &Candidate { part, ref status } in candidates {
            let first_face = before.surface.source[first[part as usize] as usize];
            let faces = count[part as usize];
            match *status {
                PartStatus::Changed => accounting.changed += 1,
                PartStatus::Unknown => accounting.unknown += 1,
                PartStatus::Reasoned(reason, samples) => {
                    *match reason {
                        PartReason::Duplicate => &mut accounting.duplicate,
                        PartReason::NoVolume => &mut accounting.no_volume,
                        PartReason::InsideAnother => &mut accounting.inside_another,
                        PartReason::Debris => &mut accounting.debris,
                        PartReason::Dropped => &mut accounting.dropped,
                    } += 1;
                    accounting.all_reasons.push((part, reason));
                    if accounting.reasons.len() < MOST_LISTED {
                        accounting.reasons.push(AccountedPart { part, first_face, faces, reason, samples });
                    }
                }
                PartStatus::Lost(at) => {
                    accounting.lost += 1;
                    if accounting.lost_parts.len() < MOST_LISTED {
                        let area = finite(before.solids[part as usize].area);
                        let at = (at * unit).to_array().map(finite);
                        accounting.lost_parts.push(LostPart { part, first_face, faces, area, at });
                    }
                }
            }
        }
        accounting
    }
}

/// The verdict on a part without a kept face, from its sample points.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    /// The part is in the result, with changes.
    Present,
    /// The part is absent, and the points show the reason.
    Reasoned(PartReason),
    /// The part is absent, and the points show no reason.
    Unmatched,
    /// The search decided no point within its budget.
    Unknown,
}

impl Verdict {
    fn of(locations: &[Option<PointLocation>]) -> Self {
        let (mut own, mut another, mut inside, mut outside) = (0u32, 0u32, 0u32, 0u32);
        for location in locations.iter().flatten() {
            *match location {
                PointLocation::On { another: false, .. } => &mut own,
                PointLocation::On { another: true, .. } => &mut another,
                PointLocation::In => &mut inside,
                PointLocation::Outside => &mut outside,
            } += 1;
        }
        let all = own + another + inside + outside;
        let at_least = |count: u32, share: f64| f64::from(count) >= share * f64::from(all);
        if all == 0 {
            Self::Unknown
        } else if own > 0 && at_least(own, PRESENT) {
            Self::Present
        } else if at_least(another, 1.0 - OUTLIERS) {
            Self::Reasoned(PartReason::Duplicate)
        } else if inside > 0 && at_least(another + inside, 1.0 - OUTLIERS) {
            Self::Reasoned(PartReason::InsideAnother)
        } else {
            Self::Unmatched
        }
    }
}
