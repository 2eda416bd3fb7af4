use super::cut::{Pairing, Pinches, cut_apart};
use super::debris::remove_debris;
use super::degenerate::{remove_caps, remove_collapsed};
use super::duplicates::remove_duplicates;
use super::holes::FillHoles;
use super::orient::orient;
use super::quantise::quantise;
use super::resolve::resolve;
use super::separate::separate;
use super::weld::Weld;
use super::{Applied, Operator};
use crate::arrange::{Inside, ManifoldRust};
use crate::format::Format;
use crate::mesh::Surface;
use crate::repair::{Cancelled, Change, Context, Options};

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
        Ok(match self {
            Self::RoundCoordinates if scope.format != Format::Stl => Applied::default(),
            Self::RoundCoordinates => Change::list([("vertices_rounded_to_f32", quantise(surface))]).into(),
            Self::RemoveCollapsedFaces => remove_collapsed(surface).into(),
            Self::Weld => {
                let weld = Weld { tolerance: options.weld_tolerance, most: scope.reach };
                let mut applied = weld.apply(surface, context)?;
                applied.changes.extend(remove_collapsed(surface));
                applied
            }
            Self::RemoveDuplicates => remove_duplicates(surface).into(),
            Self::RemoveCaps => remove_caps(surface, context)?.into(),
            Self::Orient => orient(surface, context)?.into(),
            Self::CutApart => cut_apart(surface, scope.pairing, Pinches::KeepAtBoundaries, context)?.into(),
            Self::FillHoles => {
                let filled = FillHoles {
                    max_edges: options.max_hole_edges,
                    max_size: options.max_hole_size,
                    max_holes: options.max_holes,
                    filling: options.hole_filling,
                    refine: options.refine_patches,
                    fair: options.fair_patches,
                    to_f32: scope.format == Format::Stl,
                }
                .apply(surface, context)?;
                Applied { left: filled.in_words(), changes: filled.changes, ..Applied::default() }
            }
            Self::Resolve => {
                let resolved = resolve(surface, &ManifoldRust, scope.inside, context)?;
                let failed = resolved.error.map(|error| error.to_string());
                Applied { changes: resolved.changes, failed, ..Applied::default() }
            }
            Self::RemoveDebris => remove_debris(surface, context)?.into(),
            Self::Separate => separate(surface, context)?.into(),
        })
    }
}
