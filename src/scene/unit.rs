use std::fmt;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A unit of length: what one step along an axis is, after the units of the 3MF core specification.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, ToSchema, clap::ValueEnum)]
pub enum Unit {
    /// 0.001 mm.
    #[serde(rename = "um", alias = "micrometre")]
    #[value(name = "um", alias = "micrometre")]
    Micrometre,
    /// What slicers take numbers for.
    #[default]
    #[serde(rename = "mm", alias = "millimetre")]
    #[value(name = "mm", alias = "millimetre")]
    Millimetre,
    /// 10 mm.
    #[serde(rename = "cm", alias = "centimetre")]
    #[value(name = "cm", alias = "centimetre")]
    Centimetre,
    /// 25.4 mm.
    #[serde(rename = "in", alias = "inch")]
    #[value(name = "in", alias = "inch")]
    Inch,
    /// 304.8 mm.
    #[serde(rename = "ft", alias = "foot")]
    #[value(name = "ft", alias = "foot")]
    Foot,
    /// 1000 mm.
    #[serde(rename = "m", alias = "metre")]
    #[value(name = "m", alias = "metre")]
    Metre,
}

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

    /// How many millimetres it is.
    #[must_use]
    pub fn millimetres(self) -> f64 {
        self.to(Self::Millimetre)
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
            assert_eq!(serde_json::to_value(unit).expect("JSON"), unit.as_str());
            assert_eq!(<Unit as clap::ValueEnum>::from_str(unit.as_str(), false), Ok(unit));
        }
    }
}
