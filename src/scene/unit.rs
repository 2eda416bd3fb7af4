use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What one step along an axis is, after the units of the 3MF core specification.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
pub enum Unit {
    /// A thousandth of a millimetre.
    #[serde(rename = "um")]
    Micrometre,
    /// A millimetre.
    #[serde(rename = "mm")]
    Millimetre,
    /// A centimetre.
    #[serde(rename = "cm")]
    Centimetre,
    /// An inch, 25.4 mm.
    #[serde(rename = "in")]
    Inch,
    /// A foot, 304.8 mm.
    #[serde(rename = "ft")]
    Foot,
    /// A metre.
    #[serde(rename = "m")]
    Metre,
}

/// A text that is no unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a unit is one of um, mm, cm, in, ft, m")]
pub struct UnitError;

impl Unit {
    /// Every unit, from the smallest to the largest.
    pub const ALL: [Self; 6] =
        [Self::Micrometre, Self::Millimetre, Self::Centimetre, Self::Inch, Self::Foot, Self::Metre];

    /// The symbol, as options and reports have it.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Micrometre => "um",
            Self::Millimetre => "mm",
            Self::Centimetre => "cm",
            Self::Inch => "in",
            Self::Foot => "ft",
            Self::Metre => "m",
        }
    }

    /// Its length in micrometres, which is a whole number for each.
    fn micrometres(self) -> f64 {
        match self {
            Self::Micrometre => 1.0,
            Self::Millimetre => 1e3,
            Self::Centimetre => 1e4,
            Self::Inch => 25_400.0,
            Self::Foot => 304_800.0,
            Self::Metre => 1e6,
        }
    }

    /// What lengths in this unit are to be multiplied with for another one.
    #[must_use]
    pub fn to(self, other: Self) -> f64 {
        self.micrometres() / other.micrometres()
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl FromStr for Unit {
    type Err = UnitError;

    fn from_str(text: &str) -> Result<Self, UnitError> {
        Self::ALL.into_iter().find(|unit| unit.as_str() == text).ok_or(UnitError)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_told_in_another_unit() {
        assert_eq!(Unit::Inch.to(Unit::Millimetre), 25.4);
        assert_eq!(Unit::Metre.to(Unit::Millimetre), 1000.0);
        assert_eq!(Unit::Foot.to(Unit::Inch), 12.0);
    }

    #[test]
    fn a_unit_has_one_name_everywhere() {
        for unit in Unit::ALL {
            assert_eq!(unit.as_str().parse(), Ok(unit));
            assert_eq!(serde_json::to_value(unit).expect("JSON"), unit.as_str());
        }
        assert_eq!("yard".parse::<Unit>(), Err(UnitError));
    }
}
