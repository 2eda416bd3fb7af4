//! Colours, names and severity order of defect kinds, and the legends of drawings.

use std::borrow::Cow;
use std::fmt;

use serde::{Serialize, Serializer};

use crate::inspect::{DefectKind, Findings, Provenance, SurfaceShares};

/// An sRGB colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Colour(pub [u8; 3]);

impl Colour {
    const fn hex(rgb: u32) -> Self {
        let [_, r, g, b] = rgb.to_be_bytes();
        Self([r, g, b])
    }

    /// Mixes this colour with a share (0 to 1) of another.
    #[must_use]
    pub fn mixed(self, other: Self, share: f32) -> Self {
        Self(std::array::from_fn(|i| {
            let (a, b) = (f32::from(self.0[i]), f32::from(other.0[i]));
            to_byte(a + (b - a) * share)
        }))
    }

    /// Multiplies the colour by a light intensity.
    #[must_use]
    pub fn lit(self, by: f32) -> Self {
        Self(self.0.map(|c| to_byte(f32::from(c) * by)))
    }

    /// The channels in linear light, from 0 to 1, as glTF requires.
    #[must_use]
    pub fn linear(self) -> [f64; 3] {
        self.0.map(|c| {
            let c = f64::from(c) / 255.0;
            if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
        })
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
fn to_byte(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

impl fmt::Display for Colour {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [r, g, b] = self.0;
        write!(f, "#{r:02X}{g:02X}{b:02X}")
    }
}

impl Serialize for Colour {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Colour of surface without defects.
pub const SOUND: Colour = Colour::hex(0xC4_C4_C4);
/// Colour of the inner side of surface without defects. Its visibility indicates a hole or a flipped face.
pub const INSIDE: Colour = Colour::hex(0x65_31_3F);

/// How a defect kind is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// Colours its faces, and adds a dot to a small one.
    Faces,
    /// Colours whole parts.
    Parts,
    /// Draws its line, and tints the adjacent faces.
    Line,
    /// Draws a dot, and tints the adjacent faces.
    Point,
}

/// Defect kinds in order of severity. A face with several kinds is drawn as the first one.
///
/// Intersections and bad edges precede kinds that a clean-up repairs. Kinds that colour faces precede kinds that only
/// tint the faces near a line or point. Kinds of whole parts come last, since they would hide all others.
pub const BY_SEVERITY: [DefectKind; DefectKind::ALL.len()] = [
    DefectKind::Corrupt,
    DefectKind::SelfIntersection,
    DefectKind::OppositeFace,
    DefectKind::DuplicateFace,
    DefectKind::DegenerateFace,
    DefectKind::FlatFace,
    DefectKind::Foldover,
    DefectKind::Sheet,
    DefectKind::NonManifoldEdge,
    DefectKind::MisorientedEdge,
    DefectKind::Hole,
    DefectKind::Slit,
    DefectKind::Crack,
    DefectKind::NonManifoldVertex,
    DefectKind::TJunction,
    DefectKind::BadVertexNormal,
    DefectKind::InvertedPart,
    DefectKind::TinyPart,
    DefectKind::InnerShell,
    DefectKind::Disjoint,
];

/// Colour, drawing style and names of a defect kind.
#[derive(Debug, Clone, Copy)]
struct Style {
    colour: Colour,
    shape: Shape,
    one: &'static str,
    many: &'static str,
}

/// One hue per family: yellow and orange for open surface, red for intersections, purple for non-manifold elements,
/// blue for wrong orientation, green for superfluous faces, grey for remarks on parts. The base colours are from
/// Okabe and Ito's palette. The others were adjusted until any two differ by at least 17 in CIE L\*a\*b\* (the greys
/// by 12), for normal vision, deuteranopia and protanopia. A test checks these distances.
const fn style(kind: DefectKind) -> Style {
    use DefectKind as K;
    use Shape::{Faces, Line, Parts, Point};
    let (rgb, shape, one, many) = match kind {
        K::Disjoint => (0xA9_B8_CC, Parts, "separate part", "separate parts"),
        K::Foldover => (0xFA_9F_5A, Faces, "foldover", "foldovers"),
        K::FlatFace => (0x96_FA_C3, Faces, "flat face", "flat faces"),
        K::DegenerateFace => (0x00_9E_73, Faces, "degenerate face", "degenerate faces"),
        K::Slit => (0xFA_FA_2E, Line, "slit", "slits"),
        K::SelfIntersection => (0xD1_24_1B, Faces, "self-intersection", "self-intersections"),
        K::NonManifoldEdge => (0xA1_08_8C, Line, "non-manifold edge", "non-manifold edges"),
        K::NonManifoldVertex => (0x4A_08_9A, Point, "non-manifold vertex", "non-manifold vertices"),
        K::BadVertexNormal => (0x95_AE_FA, Point, "wrong normal", "wrong normals"),
        K::Corrupt => (0x00_00_00, Faces, "unusable face", "unusable faces"),
        K::Hole => (0xE6_9F_00, Line, "hole", "holes"),
        K::MisorientedEdge => (0x00_72_B2, Line, "misoriented edge", "misoriented edges"),
        K::TJunction => (0xAB_83_4B, Point, "T-junction", "T-junctions"),
        K::Crack => (0xF9_FA_96, Line, "crack", "cracks"),
        K::InvertedPart => (0x4B_5F_D6, Parts, "part inside out", "parts inside out"),
        K::DuplicateFace => (0x10_75_14, Faces, "duplicate face", "duplicate faces"),
        K::OppositeFace => (0xC3_F7_5E, Faces, "opposite face", "opposite faces"),
        K::Sheet => (0xA2_7A_A9, Faces, "zero-thickness sheet", "zero-thickness sheets"),
        K::InnerShell => (0xC2_C2_8B, Parts, "nested shell", "nested shells"),
        K::TinyPart => (0x53_70_72, Parts, "tiny part", "tiny parts"),
    };
    Style { colour: Colour::hex(rgb), shape, one, many }
}

/// Colour of a defect kind.
#[must_use]
pub fn colour(kind: DefectKind) -> Colour {
    style(kind).colour
}

/// Drawing style of a defect kind.
#[must_use]
pub fn shape(kind: DefectKind) -> Shape {
    style(kind).shape
}

/// Display name of a defect kind, singular or plural for `count`.
#[must_use]
pub fn in_words(kind: DefectKind, count: u64) -> &'static str {
    if count == 1 { style(kind).one } else { style(kind).many }
}

/// Name of a defect kind in reports, such as `non_manifold_edge`.
#[must_use]
pub fn id(kind: DefectKind) -> String {
    serde_json::to_value(kind).ok().and_then(|v| v.as_str().map(str::to_owned)).unwrap_or_default()
}

/// Colour of surface by provenance: four of the defect colours, so that the same test keeps them distinguishable.
#[must_use]
pub fn provenance_colour(provenance: Provenance) -> Colour {
    match provenance {
        Provenance::Kept => SOUND,
        Provenance::Moved => colour(DefectKind::Hole),
        Provenance::Added => colour(DefectKind::MisorientedEdge),
        Provenance::Removed => colour(DefectKind::SelfIntersection),
    }
}

/// Name of a provenance in reports, such as `kept`.
#[must_use]
pub fn provenance_id(provenance: Provenance) -> String {
    serde_json::to_value(provenance).ok().and_then(|v| v.as_str().map(str::to_owned)).unwrap_or_default()
}

/// Colour of a face with this defect kind: the kind's colour, or a tint for kinds drawn as a line or point.
#[must_use]
pub fn face_colour(kind: DefectKind) -> Colour {
    match shape(kind) {
        Shape::Faces | Shape::Parts => colour(kind),
        Shape::Line | Shape::Point => SOUND.mixed(colour(kind), 0.35),
    }
}

/// The most severe kind among a face's marks.
#[must_use]
pub fn gravest(marks: u32) -> Option<DefectKind> {
    if marks == 0 {
        return None;
    }
    BY_SEVERITY.into_iter().find(|kind| marks & kind.bit() != 0)
}

/// How a face is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Paint {
    /// Surface without defects.
    Sound,
    /// Surface with a defect.
    Defect(DefectKind),
    /// Surface in a drawing of changes, by provenance.
    Provenance(Provenance),
    /// Surface in a drawing of wall thickness, by the number of its band, from 0 for the thinnest.
    Thickness(u8),
}

impl Paint {
    /// Colour of the face.
    #[must_use]
    pub fn colour(self) -> Colour {
        match self {
            Self::Sound => SOUND,
            Self::Defect(kind) => face_colour(kind),
            Self::Provenance(provenance) => provenance_colour(provenance),
            Self::Thickness(band) => thickness_colour(band),
        }
    }

    /// Name in files and reports.
    #[must_use]
    pub fn id(self) -> String {
        match self {
            Self::Sound => "sound".to_owned(),
            Self::Defect(kind) => id(kind),
            Self::Provenance(provenance) => provenance_id(provenance),
            Self::Thickness(band) => format!("thickness_{band}"),
        }
    }

    /// Whether this is sound or kept surface, the majority, of which drawings may show only a sample.
    #[must_use]
    pub fn is_plain(self) -> bool {
        matches!(self, Self::Sound | Self::Provenance(Provenance::Kept) | Self::Thickness(THICK))
    }

    /// Number in files: 0 for sound surface and 1 plus the kind's number for a defect; in a drawing of changes, the
    /// number of the [`Provenance`].
    #[must_use]
    pub fn number(self) -> u8 {
        match self {
            Self::Sound => 0,
            Self::Defect(kind) => 1 + kind as u8,
            Self::Provenance(provenance) => provenance as u8,
            Self::Thickness(band) => band,
        }
    }
}

impl Serialize for Paint {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.id())
    }
}

/// An entry of a legend.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LegendEntry {
    /// The defect kind or provenance, by its name in reports.
    pub kind: Paint,
    /// Display name.
    pub name: Cow<'static, str>,
    /// Colour, as `#RRGGBB` in JSON.
    pub colour: Colour,
    /// Number of defects of this kind, or of faces with this provenance.
    pub count: u64,
    /// Area with this provenance, in square model units; absent for defects.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub area: Option<f64>,
}

/// Legend of the defect kinds found, most severe first.
#[must_use]
pub fn legend(findings: &Findings) -> Vec<LegendEntry> {
    let kinds = BY_SEVERITY.into_iter().filter(|&kind| findings.count(kind) > 0);
    kinds
        .map(|kind| {
            let count = findings.count(kind);
            LegendEntry {
                kind: Paint::Defect(kind),
                name: in_words(kind, count).into(),
                colour: colour(kind),
                count,
                area: None,
            }
        })
        .collect()
}

/// Legend of all four provenances, including those without surface.
#[must_use]
pub fn legend_of_change(shares: &SurfaceShares) -> Vec<LegendEntry> {
    let entry = |provenance| {
        let (share, name) = match provenance {
            Provenance::Kept => (shares.kept, "faces kept"),
            Provenance::Moved => (shares.moved, "faces moved"),
            Provenance::Added => (shares.added, "faces added"),
            Provenance::Removed => (shares.removed, "faces removed, wholly or partly"),
        };
        LegendEntry {
            kind: Paint::Provenance(provenance),
            name: name.into(),
            colour: provenance_colour(provenance),
            count: share.faces,
            area: Some(share.area),
        }
    };
    Provenance::ALL.map(entry).to_vec()
}

/// Limits between the bands of wall thickness, as multiples of the least wall that a process accepts.
pub const BANDS: [f64; 7] = [0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 4.0];
/// Number of the last band: walls that are much thicker than the limit, and surface that is part of no wall.
#[expect(clippy::cast_possible_truncation, reason = "7")]
pub const THICK: u8 = BANDS.len() as u8;

/// Colours of the bands: dark red below the limit, then yellow, then greys.
fn thickness_colour(band: u8) -> Colour {
    const COLOURS: [[u8; 3]; 8] = [
        [0x67, 0x00, 0x1f],
        [0xa5, 0x0f, 0x15],
        [0xde, 0x2d, 0x26],
        [0xfb, 0x6a, 0x4a],
        [0xfe, 0xd9, 0x76],
        [0xb8, 0xd8, 0xe8],
        [0xc8, 0xcd, 0xd2],
        [0xdd, 0xdd, 0xdd],
    ];
    Colour(COLOURS[usize::from(band.min(THICK))])
}

/// The band of a wall thickness, given as a multiple of the limit.
#[must_use]
pub fn thickness_band(multiple: f64) -> u8 {
    #[expect(clippy::cast_possible_truncation, reason = "at most 7")]
    let band = BANDS.iter().filter(|&&limit| multiple >= limit).count() as u8;
    if multiple.is_nan() { THICK } else { band }
}

/// Legend of wall thickness. `faces` has the number of faces and their area for each band; `limit_mm` is the least wall
/// that the process accepts.
#[must_use]
pub fn legend_of_thickness(faces: &[(u64, f64); 8], limit_mm: f64) -> Vec<LegendEntry> {
    let entry = |(band, &(count, area)): (u8, &(u64, f64))| {
        let at = |band: u8| BANDS[usize::from(band)] * limit_mm;
        let name = match band {
            0 => format!("faces with walls under {:.3} mm", at(0)),
            THICK => format!("faces with walls of {:.3} mm or more, or none", at(THICK - 1)),
            band => format!("faces with walls from {:.3} to {:.3} mm", at(band - 1), at(band)),
        };
        let kind = Paint::Thickness(band);
        LegendEntry { kind, name: name.into(), colour: kind.colour(), count, area: Some(area) }
    };
    (0u8..).zip(faces).map(entry).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Remaining linear light for protanopia and deuteranopia at severity 1 (Machado, Oliveira and Fernandes 2009).
    const SIGHTS: [[[f64; 3]; 3]; 3] = [
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        [[0.367_322, 0.860_646, -0.227_968], [0.280_085, 0.672_501, 0.047_413], [-0.011_820, 0.042_940, 0.968_881]],
        [[0.152_286, 1.052_583, -0.204_868], [0.114_503, 0.786_281, 0.099_216], [-0.003_882, -0.048_116, 1.051_998]],
    ];
    /// Matrix from linear sRGB to XYZ, each row divided by the white point D65.
    const XYZ: [[f64; 3]; 3] =
        [[0.433_91, 0.376_23, 0.189_86], [0.212_67, 0.715_15, 0.072_18], [0.017_76, 0.109_47, 0.872_77]];

    fn times(m: &[[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
        m.map(|row| row.iter().zip(v).map(|(a, b)| a * b).sum())
    }

    fn lab(colour: Colour, sight: &[[f64; 3]; 3]) -> [f64; 3] {
        let seen = times(sight, colour.linear()).map(|c| c.clamp(0.0, 1.0));
        let [x, y, z] = times(&XYZ, seen).map(|t| if t > 0.008_856 { t.cbrt() } else { 7.787 * t + 16.0 / 116.0 });
        [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
    }

    #[test]
    fn any_two_colours_differ_with_and_without_colour_blindness() {
        let grey = [SOUND, colour(DefectKind::Disjoint)];
        let mut all: Vec<Colour> = DefectKind::ALL.into_iter().map(colour).collect();
        all.extend([SOUND, INSIDE]);
        for sight in &SIGHTS {
            for (i, &a) in all.iter().enumerate() {
                for &b in &all[..i] {
                    let far: f64 = lab(a, sight).iter().zip(lab(b, sight)).map(|(x, y)| (x - y).powi(2)).sum();
                    let least = if grey.contains(&a) && grey.contains(&b) { 11.9 } else { 17.0 };
                    assert!(far.sqrt() >= least, "{a} and {b} differ by {}", far.sqrt());
                }
            }
        }
    }

    #[test]
    fn the_severity_order_has_every_kind_once() {
        let mut kinds = BY_SEVERITY.to_vec();
        kinds.sort_unstable();
        assert_eq!(kinds, DefectKind::ALL);
    }

    #[test]
    fn a_face_with_several_kinds_is_drawn_as_the_most_severe() {
        let marks = DefectKind::Disjoint.bit() | DefectKind::Hole.bit() | DefectKind::SelfIntersection.bit();
        assert_eq!(gravest(marks), Some(DefectKind::SelfIntersection));
        assert_eq!(gravest(DefectKind::Disjoint.bit()), Some(DefectKind::Disjoint));
        assert_eq!(gravest(0), None);
    }

    #[test]
    fn the_legend_lists_the_found_kinds_with_their_counts() {
        let mut findings = Findings::new(4, 4);
        let defect = |face| crate::inspect::Defect {
            at: [0.0; 3],
            faces: vec![face],
            line: Vec::new(),
            value: None,
            meeting: None,
        };
        findings.push(DefectKind::Hole, defect(0));
        findings.push(DefectKind::FlatFace, defect(1));
        findings.push(DefectKind::FlatFace, defect(2));
        let lines: Vec<String> =
            legend(&findings).iter().map(|e| format!("{} {} {}", e.count, e.name, e.colour)).collect();
        assert_eq!(lines, ["2 flat faces #96FAC3", "1 hole #E69F00"]);
    }
}
