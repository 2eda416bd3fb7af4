//! What became of each part of one mesh in another.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::original::Original;
use super::probes::{Place, Places, Probes};
use crate::context::{Cancelled, Context};
use crate::inspect::matching::{NO_FACE, matched};
use crate::inspect::{Analysis, finite};
use crate::mesh::Parts;

/// Parts that a part_accounting lists, of those with a reason and of those without.
const MOST_LISTED: usize = 1000;
/// Share of a part's points that must be in the result, and on no other part's surface, for the part to be there.
const PRESENT: f64 = 0.1;
/// Share of a part's points that may be anywhere where the rest has a reason: sampling tells no less.
const STRAY: f64 = 0.1;

/// Why an input part of which nothing is in the result is not missed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum PartReason {
    /// All of it lies on surface of other parts, and that is in the result.
    Duplicate,
    /// It encloses nothing: an open sheet, or closed and without volume.
    NoVolume,
    /// It lies inside the result, by winding number.
    InsideAnother,
    /// It is open and too small to print.
    Debris,
    /// Its volume is below the share that the options keep.
    Dropped,
}

/// A part that is not in the result, and why it is not missed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct AccountedPart {
    /// The part, by number from 0 in the order of the parts' first faces.
    pub part: u32,
    /// Its first face, by index in the file from 0.
    pub first_face: u32,
    /// Its faces.
    pub faces: u64,
    /// Why it is not missed.
    pub reason: PartReason,
    /// Points on it that were looked at; 0 where its faces alone tell.
    pub samples: u32,
}

/// A part that is not in the result without a reason.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct LostPart {
    /// The part, by number from 0 in the order of the parts' first faces.
    pub part: u32,
    /// Its first face, by index in the file from 0.
    pub first_face: u32,
    /// Its faces.
    pub faces: u64,
    /// Its area.
    pub area: f64,
    /// A point on it that is neither on nor in the result.
    pub at: [f64; 3],
}

/// What became of each edge-connected part of the input, found on the result's own bytes: every part is in the result, or has
/// a reason, or is lost.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct PartAccounting {
    /// Parts of the input.
    pub parts: u64,
    /// Parts of which every face with an area stands in the result.
    pub kept: u64,
    /// Parts of which some stands, whole, cut or moved.
    pub changed: u64,
    /// Of the parts that were kept or changed, those that share a part of the result with another.
    pub united: u64,
    /// Parts with the reason `duplicate`.
    pub duplicate: u64,
    /// Parts with the reason `no_volume`.
    pub no_volume: u64,
    /// Parts with the reason `inside_another`.
    pub inside_another: u64,
    /// Parts with the reason `debris`.
    pub debris: u64,
    /// Parts with the reason `dropped`.
    #[serde(default)]
    pub dropped: u64,
    /// Parts with neither: an error of the program.
    pub lost: u64,
    /// Parts that were not looked at to the end, on meshes made to be slow; they count nowhere else.
    pub unknown: u64,
    /// The parts with a reason, the first 1000.
    pub reasons: Vec<AccountedPart>,
    /// The parts that were lost, the first 1000.
    pub lost_parts: Vec<LostPart>,
    /// All parts with a reason, however many.
    #[serde(skip)]
    pub certified: Vec<(u32, PartReason)>,
}

/// What the faces of a part alone tell of why it may go.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dispensable {
    /// It encloses something that could be printed.
    No,
    /// It encloses nothing.
    NoVolume,
    /// It is too small to print.
    Debris,
    /// Its volume is below the share that the options keep.
    Dropped,
}

impl Original<'_> {
    /// What became of each part. `dispensable` is asked about those parts alone that are neither in the result nor within it
    /// nor on what is, and answers for each in order.
    ///
    /// A part is in the result where one of its faces is, in the same place; of equal faces as many as the result has, the
    /// first ones. For the others points on them are looked for: near the result, and then on another part's surface or not,
    /// or inside the result. O(n log n), within a budget.
    ///
    /// # Errors
    /// [`Cancelled`] when the context says stop.
    pub fn part_accounting(
        &self,
        after: &Analysis<'_>,
        dispensable: impl FnOnce(&[u32]) -> Result<Vec<Dispensable>, Cancelled>,
        context: &Context<'_>,
    ) -> Result<PartAccounting, Cancelled> {
        let before = self.analysis;
        let mut accounting = Accounting::new(before, after);
        context.check()?;
        let gone = accounting.gone();
        if gone.is_empty() {
            return Ok(accounting.close(&[]));
        }
        let probes = Probes::new(before, &gone);
        let found = Places::new(before, after, &accounting.stands).locate(&probes, context)?;
        let mut findings = Vec::with_capacity(gone.len());
        for (&part, range) in gone.iter().zip(&probes.of_part) {
            let finding = Finding::of(&found[range.clone()]);
            if finding == Finding::Present {
                let in_result = |place: &Option<Place>| match place {
                    Some(Place::On { face, .. }) => Some(after.parts.of_face[*face as usize]),
                    _ => None,
                };
                accounting.links.extend(found[range.clone()].iter().filter_map(in_result).map(|of| (of, part)));
            }
            findings.push(finding);
        }
        let missed: Vec<u32> = gone
            .iter()
            .zip(&findings)
            .filter(|(_, finding)| **finding == Finding::Missed)
            .map(|(&part, _)| part)
            .collect();
        let mut answers = if missed.is_empty() { Vec::new() } else { dispensable(&missed)? }.into_iter();
        let entries: Vec<Entry> = gone
            .iter()
            .zip(findings)
            .zip(&probes.of_part)
            .map(|((&part, finding), range)| {
                let samples = u32::try_from(range.len()).unwrap_or(u32::MAX);
                let status = match finding {
                    Finding::Present => PartStatus::Changed,
                    Finding::Unknown => PartStatus::Unknown,
                    Finding::Certain(reason) => PartStatus::Certain(reason, samples),
                    Finding::Missed => match answers.next().unwrap_or(Dispensable::No) {
                        Dispensable::NoVolume => PartStatus::Certain(PartReason::NoVolume, 0),
                        Dispensable::Debris => PartStatus::Certain(PartReason::Debris, 0),
                        Dispensable::Dropped => PartStatus::Certain(PartReason::Dropped, 0),
                        Dispensable::No => {
                            let stray = range.clone().find(|&i| found[i] == Some(Place::Off));
                            PartStatus::Lost(stray.map_or(DVec3::ZERO, |i| probes.points[i]))
                        }
                    },
                };
                Entry { part, status }
            })
            .collect();
        Ok(accounting.close(&entries))
    }
}

/// What was found out about a part of which no face stands.
struct Entry {
    part: u32,
    status: PartStatus,
}

enum PartStatus {
    Changed,
    Certain(PartReason, u32),
    /// With a point of it, in unit coordinates.
    Lost(DVec3),
    Unknown,
}

/// What is known from the faces that stand as they were.
struct Accounting<'a> {
    before: &'a Analysis<'a>,
    /// Of each part the faces that have an area, and those of them that stand.
    faces: Vec<[u64; 2]>,
    /// Whether a face of each part stands.
    stands: Vec<bool>,
    /// Parts of the result with parts of the input that are in them.
    links: Vec<(u32, u32)>,
}

impl<'a> Accounting<'a> {
    fn new(before: &'a Analysis<'a>, after: &'a Analysis<'a>) -> Self {
        let scale = before.scale();
        let matched = matched(&before.keys(scale), &after.keys(scale));
        let count = before.parts.count;
        let mut book = Self { before, faces: vec![[0; 2]; count], stands: vec![false; count], links: Vec::new() };
        let faces = before.parts.of_face.iter().zip(before.flat()).zip(&matched);
        for ((&part, &flat), &other) in faces.filter(|((part, _), _)| **part != Parts::NONE) {
            let stands = other != NO_FACE;
            if !flat {
                let counts = &mut book.faces[part as usize];
                *counts = [counts[0] + 1, counts[1] + u64::from(stands)];
            }
            book.stands[part as usize] |= stands;
            let link = stands.then(|| (after.parts.of_face[other as usize], part));
            // Neighbours are mostly of the same parts.
            if let Some(link) = link.filter(|link| book.links.last() != Some(link)) {
                book.links.push(link);
            }
        }
        book
    }

    /// The parts of which no face stands.
    fn gone(&self) -> Vec<u32> {
        (0u32..).zip(&self.stands).filter(|(_, stands)| !**stands).map(|(part, _)| part).collect()
    }

    /// Whether each part shares a part of the result with another.
    fn united(&mut self) -> Vec<bool> {
        self.links.retain(|&(of, _)| of != Parts::NONE);
        self.links.sort_unstable();
        self.links.dedup();
        let mut united = vec![false; self.before.parts.count];
        for together in self.links.chunk_by(|a, b| a.0 == b.0).filter(|together| together.len() > 1) {
            together.iter().for_each(|&(_, part)| united[part as usize] = true);
        }
        united
    }

    /// The part_accounting, with what was found of the parts that do not stand, in order.
    fn close(mut self, entries: &[Entry]) -> PartAccounting {
        let united = self.united();
        let Self { before, faces, stands, .. } = self;
        let mut part_accounting = PartAccounting { parts: before.parts.count as u64, ..PartAccounting::default() };
        for ([all, standing], _) in faces.iter().zip(&stands).filter(|(_, stands)| **stands) {
            *(if all == standing { &mut part_accounting.kept } else { &mut part_accounting.changed }) += 1;
        }
        part_accounting.united = united.iter().filter(|&&united| united).count() as u64;
        let mut first = vec![NO_FACE; if entries.is_empty() { 0 } else { before.parts.count }];
        let mut count = vec![0u64; first.len()];
        if !entries.is_empty() {
            for (&part, f) in before.parts.of_face.iter().zip(0u32..).filter(|(part, _)| **part != Parts::NONE) {
                first[part as usize] = first[part as usize].min(f);
                count[part as usize] += 1;
            }
        }
        let unit = before.unit_length();
        for &Entry { part, ref status } in entries {
            let first_face = before.surface.source[first[part as usize] as usize];
            let faces = count[part as usize];
            match *status {
                PartStatus::Changed => part_accounting.changed += 1,
                PartStatus::Unknown => part_accounting.unknown += 1,
                PartStatus::Certain(reason, samples) => {
                    *match reason {
                        PartReason::Duplicate => &mut part_accounting.duplicate,
                        PartReason::NoVolume => &mut part_accounting.no_volume,
                        PartReason::InsideAnother => &mut part_accounting.inside_another,
                        PartReason::Debris => &mut part_accounting.debris,
                        PartReason::Dropped => &mut part_accounting.dropped,
                    } += 1;
                    part_accounting.certified.push((part, reason));
                    if part_accounting.reasons.len() < MOST_LISTED {
                        part_accounting.reasons.push(AccountedPart { part, first_face, faces, reason, samples });
                    }
                }
                PartStatus::Lost(at) => {
                    part_accounting.lost += 1;
                    if part_accounting.lost_parts.len() < MOST_LISTED {
                        let area = finite(before.solids[part as usize].area);
                        let at = (at * unit).to_array().map(finite);
                        part_accounting.lost_parts.push(LostPart { part, first_face, faces, area, at });
                    }
                }
            }
        }
        part_accounting
    }
}

/// What the points of a part tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Finding {
    Present,
    Certain(PartReason),
    Missed,
    Unknown,
}

impl Finding {
    fn of(places: &[Option<Place>]) -> Self {
        let (mut own, mut another, mut inside, mut off) = (0u32, 0u32, 0u32, 0u32);
        for place in places.iter().flatten() {
            *match place {
                Place::On { another: false, .. } => &mut own,
                Place::On { another: true, .. } => &mut another,
                Place::In => &mut inside,
                Place::Off => &mut off,
            } += 1;
        }
        let all = own + another + inside + off;
        let at_least = |count: u32, share: f64| f64::from(count) >= share * f64::from(all);
        if all == 0 {
            Self::Unknown
        } else if own > 0 && at_least(own, PRESENT) {
            Self::Present
        } else if at_least(another, 1.0 - STRAY) {
            Self::Certain(PartReason::Duplicate)
        } else if inside > 0 && at_least(another + inside, 1.0 - STRAY) {
            Self::Certain(PartReason::InsideAnother)
        } else {
            Self::Missed
        }
    }
}
