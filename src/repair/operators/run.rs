use super::base::AddBase;
use super::clean_and_patch::CleanAndPatch;
use super::cut::{Pairing, Pinches, cut_apart};
use super::debris::remove_debris;
use super::degenerate::{remove_collapsed, remove_without_area};
use super::duplicates::remove_duplicates;
use super::fins::FreeFins;
use super::foldovers::UnfoldFoldovers;
use super::holes::FillHoles;
use super::join::JoinParts;
use super::membranes::remove_membranes;
use super::merge::MergeVertices;
use super::one_sided::CutOneSided;
use super::orient::Orient;
use super::overlaps::RemoveOverlappingNeighbours;
use super::quantise::quantise;
use super::remesh::RemeshInside;
use super::resolve::Resolve;
use super::rounding::{TellApart, tell_apart};
use super::separate::Separate;
use super::sew::Sew;
use super::sheets_within::remove_sheets_within;
use super::simplify::ReduceFaces;
use super::slivers::RemoveSlivers;
use super::small_parts::DropSmallParts;
use super::stitch::Stitch;
use super::t_junctions::SplitTJunctions;
use super::thicken::{Skins, THICKNESS, ThickenSheets};
use super::weld::Weld;
use super::{Applied, Operator};
use crate::arrange::{Exact, Inside};
use crate::format::Format;
use crate::inspect::Tolerances;
use crate::mesh::Surface;
use crate::remesh::{self, Remesh};
use crate::repair::{Cancelled, Change, Context, InsideRule, OpenSheets, Options, Overlaps};

/// What an operator's parameters follow from.
#[derive(Debug, Clone, Copy)]
pub(in crate::repair) struct Scope<'a> {
    pub options: &'a Options,
    /// The format of the result.
    pub format: Format,
    /// How faces are paired around edges of more than two.
    pub pairing: Pairing,
    /// What is inside where parts are turned inside out.
    pub inside: Inside,
    /// Whether open sheets are made solid.
    pub closes_sheets: bool,
    /// How far a vertex may still move, in the model's unit, after what operators before it used up.
    pub reach: f64,
}

impl Operator {
    /// Runs the operator.
    ///
    /// # Errors
    /// [`Cancelled`]; the surface may then be half done.
    pub(in crate::repair) fn run(
        self,
        scope: &Scope<'_>,
        surface: &mut Surface,
        context: &Context<'_>,
    ) -> Result<Applied, Cancelled> {
        let options = scope.options;
        let to_f32 = scope.format.is_single();
        Ok(match self {
            Self::RoundCoordinates => {
                let rounded = if to_f32 { quantise(surface) } else { 0 };
                let limits = TellApart { most: scope.reach, moves: false };
                let joined = tell_apart(surface, limits, |_| true, context)?;
                Change::list([("vertices_rounded_to_f32", rounded), ("near_coincident_vertices_merged", joined)]).into()
            }
            Self::RemoveCollapsedFaces => remove_collapsed(surface).into(),
            Self::Weld => {
                let weld = Weld { tolerance: options.weld_tolerance, most: scope.reach };
                let mut applied = weld.apply(surface, context)?;
                applied.changes.extend(remove_collapsed(surface));
                applied
            }
            Self::MergeVertices => {
                let distance = options.merge_distance.unwrap_or_default();
                MergeVertices { distance, most: scope.reach }.apply(surface, context)?
            }
            Self::RemoveDuplicates => remove_duplicates(surface).into(),
            Self::RemoveCaps => remove_without_area(surface, scope.reach, context)?,
            Self::RemoveSlivers => {
                let slivers = RemoveSlivers { tolerance: options.degenerate_tolerance, most: scope.reach };
                slivers.apply(surface, context)?
            }
            Self::SplitTJunctions => {
                SplitTJunctions { most: scope.reach, ..SplitTJunctions::default() }.apply(surface, context)?
            }
            Self::Sew => {
                let usual = Sew::default();
                // A ratio that was asked for is the only limit.
                let tolerance = if options.sew_ratio.is_some() { f64::INFINITY } else { usual.tolerance };
                let ratio = options.sew_ratio.unwrap_or(usual.ratio);
                Sew { ratio, tolerance, most: scope.reach }.apply(surface, context)?
            }
            Self::Stitch => {
                let usual = Stitch::default();
                let stitch = Stitch {
                    threshold: options.stitch_threshold.unwrap_or(usual.threshold),
                    distance: options.stitch_distance,
                    position: options.stitch_position,
                    to_f32,
                    counts_left: options.stitch_threshold.is_some() || options.stitch_distance.is_some(),
                    snap: options.stitch_epsilon,
                    most: scope.reach,
                };
                stitch.apply(surface, context)?
            }
            Self::UnfoldFoldovers => {
                let angle = Tolerances::default().foldover_angle;
                let height = options.degenerate_tolerance;
                UnfoldFoldovers { angle, height, most: scope.reach }.apply(surface, context)?
            }
            Self::RemoveOverlappingNeighbours => {
                let usual = RemoveOverlappingNeighbours::default();
                // An angle that was asked for is the only limit.
                let reach = if options.overlap_angle_deg.is_some() { f64::INFINITY } else { usual.reach };
                let angle_deg = options.overlap_angle_deg.unwrap_or(usual.angle_deg);
                RemoveOverlappingNeighbours { angle_deg, reach }.apply(surface, context)?
            }
            Self::RemoveSheetsWithin => remove_sheets_within(surface, context)?,
            Self::RemoveMembranes => remove_membranes(surface, context)?,
            Self::Orient => Orient { nested: options.nested }.apply(surface, context)?,
            Self::CutOneSided => {
                CutOneSided { most: scope.reach, to_f32: scope.format.is_single() }.apply(surface, context)?
            }
            Self::CutApart => cut_apart(surface, scope.pairing, Pinches::KeepAtBoundaries, context)?.into(),
            Self::FreeFins => FreeFins { to_f32 }.apply(surface, context)?.into(),
            Self::JoinParts => JoinParts { most: scope.reach }.apply(surface, context)?,
            Self::ThickenSheets => {
                let asked = options.open_sheets == OpenSheets::Thicken;
                let skins = if asked { Skins::BothSides } else { Skins::Behind };
                ThickenSheets { thickness: options.thickness, skins, spares_solids: !asked, most: scope.reach, to_f32 }
                    .apply(surface, context)?
            }
            Self::AddBase => {
                AddBase { thickness: options.thickness, most: scope.reach, to_f32 }.apply(surface, context)?
            }
            Self::FillHoles => {
                let filled = FillHoles {
                    max_edges: options.max_hole_edges,
                    max_size: options.max_hole_size,
                    max_holes: options.max_holes,
                    filling: options.hole_filling,
                    refine: options.refine_patches,
                    fair: options.fair_patches,
                    to_f32: scope.format.is_single(),
                }
                .apply(surface, context)?;
                Applied { left: filled.in_words(), changes: filled.changes, ..Applied::default() }
            }
            Self::CleanAndPatch => {
                let clean = CleanAndPatch {
                    max_hole_edges: options.max_hole_edges,
                    max_hole_size: options.max_hole_size,
                    max_face_loss_pct: options.max_face_loss_pct,
                    max_deviation: scope.reach,
                    ..CleanAndPatch::default()
                };
                clean.apply(surface, context)?
            }
            Self::Resolve => {
                let thickness = || {
                    let diagonal = surface.bounds().diagonal();
                    options.thickness.unwrap_or(THICKNESS * diagonal).min(scope.reach)
                };
                let sheets = scope.closes_sheets.then(thickness);
                let always = options.inside != InsideRule::Auto;
                let resolve = Resolve { inside: scope.inside, most: scope.reach, sheets, always };
                let it = match options.overlaps {
                    Overlaps::Union => resolve.apply(surface, &Exact, context)?,
                    Overlaps::Keep => resolve.apply_to_parts(surface, &Exact, context)?,
                };
                let left = (it.pairs_left > 0).then(|| format!("{} pairs of faces still intersect", it.pairs_left));
                let failed = it.error.map(|e| e.to_string());
                Applied { changes: it.changes, moved: it.moved, left, failed, ..Applied::default() }
            }
            Self::Remesh => {
                let resolution = f64::from(options.voxel_resolution);
                let diagonal = || surface.bounds().diagonal();
                let cell = Some(options.voxel_size.unwrap_or_else(|| diagonal() / resolution));
                let inside = match scope.inside {
                    Inside::Positive => remesh::Inside::Outward,
                    Inside::Nonzero => remesh::Inside::EitherWay,
                    Inside::Odd => remesh::Inside::Odd,
                };
                let remesh = Remesh { cell, max_faces: options.max_remesh_faces, inside, to_f32, ..Remesh::default() };
                RemeshInside { remesh, most: scope.reach, reduce: !options.without.contains(&Self::Simplify) }
                    .apply(surface, context)?
            }
            Self::RemoveDebris => remove_debris(surface, context)?.into(),
            Self::DropSmallParts => {
                DropSmallParts { min_volume_pct: options.min_part_volume_pct }.apply(surface, context)?
            }
            Self::Separate => Separate { most: scope.reach }.apply(surface, context)?,
            Self::Simplify => {
                let (max_faces, max_error) = (options.max_faces, options.max_error);
                ReduceFaces { max_faces, max_error, most: scope.reach, to_f32 }.apply(surface, context)?
            }
        })
    }
}
