//! The evidence for or against a unit, in words.

use serde::{Deserialize, Serialize};

/// A piece of evidence for or against a unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case", tag = "reason")]
pub enum UnitReason {
    /// The request declares this unit.
    Declared,
    /// The file states this unit.
    StatedByFile,
    /// The program that wrote the file writes this unit.
    Program,
    /// Other files of the job have this unit.
    Siblings,
    /// The size in this unit is usual, small or large for a print.
    Size {
        /// The longest side, in millimetres.
        longest_mm: f64,
        /// Whether the process prints this size.
        is_printed: bool,
    },
    /// The walls in this unit.
    Walls {
        /// The median wall, in millimetres.
        median_mm: f64,
        /// Whether they are as thick as usual walls.
        is_usual: bool,
    },
    /// Lengths in this unit are round.
    RoundLengths {
        /// Lengths that are multiples of 0.5 mm.
        metric: usize,
        /// Lengths that are multiples of 1/32 inch.
        imperial: usize,
        /// All lengths.
        of: usize,
    },
    /// Holes in this unit fit metric screws.
    ScrewHoles {
        /// Holes that fit.
        fit: usize,
        /// All holes.
        of: usize,
    },
}

impl UnitReason {
    /// The evidence in words.
    #[must_use]
    pub fn in_words(&self) -> String {
        match *self {
            Self::Declared => "the request declares it".to_owned(),
            Self::StatedByFile => "the file states it".to_owned(),
            Self::Program => "the program that wrote the file writes it".to_owned(),
            Self::Siblings => "other files of the job have it".to_owned(),
            Self::Size { longest_mm, is_printed } => {
                let can = if is_printed { "a size the process prints" } else { "a size the process does not print" };
                format!("the longest side would be {} mm, {can}", short(longest_mm))
            }
            Self::Walls { median_mm, is_usual } => {
                let usual = if is_usual { "as usual" } else { "which is unusual" };
                format!("walls would be {} mm thick, {usual}", short(median_mm))
            }
            Self::RoundLengths { metric, imperial, of } if imperial > metric => {
                format!("{imperial} of {of} lengths would be multiples of 1/32 inch")
            }
            Self::RoundLengths { metric, of, .. } => format!("{metric} of {of} lengths would be multiples of 0.5 mm"),
            Self::ScrewHoles { fit, of } => format!("{fit} of {of} holes would fit metric screws"),
        }
    }
}

/// A number with three significant digits.
fn short(x: f64) -> String {
    if x == 0.0 || !x.is_finite() {
        return format!("{x}");
    }
    #[expect(clippy::cast_possible_truncation, reason = "an exponent")]
    let digits = (2 - x.abs().log10().floor() as i32).clamp(0, 12);
    #[expect(clippy::cast_sign_loss, reason = "clamped")]
    let text = format!("{x:.*}", digits as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}
