//! What each kind of defect looks like and is called, and which of several is shown.

use std::fmt;

use serde::{Serialize, Serializer};

use crate::inspect::{DefectKind, Findings, Provenance, SurfaceShares};

/// A colour in sRGB.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Colour(pub [u8; 3]);

impl Colour {
    const fn hex(rgb: u32) -> Self {
        let [_, r, g, b] = rgb.to_be_bytes();
        Self([r, g, b])
    }

    /// This colour with the share `other` (0 to 1) of another one.
    #[must_use]
    pub fn mixed(self, other: Self, share: f32) -> Self {
        Self(std::array::from_fn(|i| {
            let (a, b) = (f32::from(self.0[i]), f32::from(other.0[i]));
            to_byte(a + (b - a) * share)
        }))
    }

    /// This colour with its light multiplied.
    #[must_use]
    pub fn lit(self, by: f32) -> Self {
        Self(self.0.map(|c| to_byte(f32::from(c) * by)))
    }

    /// The three channels in linear light, 0 to 1, as glTF wants them.
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

/// Surface with nothing wrong.
pub const SOUND: Colour = Colour::hex(0xC4_C4_C4);
/// The inner side of sound surface: where it is seen, there is a hole, or a face is turned.
pub const INSIDE: Colour = Colour::hex(0x65_31_3F);

/// How a kind of defect is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// Its faces are coloured, and a small one gets a dot.
    Faces,
    /// Whole parts are coloured.
    Parts,
    /// Its line is drawn, and the faces beside it are tinted.
    Line,
    /// A dot is drawn, and the faces around it are tinted.
    Point,
}

/// The kinds, gravest first: of several that a face has part in, it is shown in the first.
///
/// Crossings and bad edges come before what a clean-up mends, kinds that colour faces before those that only tint the
/// neighbours of a line or a point, and what concerns whole parts comes last, since it would hide all the others.
pub const BY_GRAVITY: [DefectKind; DefectKind::ALL.len()] = [
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

/// How one kind looks and what it is called.
#[derive(Debug, Clone, Copy)]
struct Look {
    colour: Colour,
    shape: Shape,
    one: &'static str,
    many: &'static str,
}

/// One hue a family: yellows and orange where the surface is open, red where it crosses, purples where it is not
/// manifold, blues where it is turned, greens where a face is too much, greys where a part is only remarked on. The
/// anchors are of Okabe and Ito's palette; the others were moved until every two differ by at least 17 in CIE L\*a\*b\*, for
/// normal sight and for deuteranopia and protanopia (the greys by 12). A test holds them to it.
const fn look(kind: DefectKind) -> Look {
    use DefectKind as K;
    use Shape::{Faces, Line, Parts, Point};
    let (rgb, shape, one, many) = match kind {
        K::Disjoint => (0xA9_B8_CC, Parts, "separate part", "separate parts"),
        K::Foldover => (0xFA_9F_5A, Faces, "face folded over", "faces folded over"),
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
        K::Sheet => (0xA2_7A_A9, Faces, "sheet of no thickness", "sheets of no thickness"),
        K::InnerShell => (0xC2_C2_8B, Parts, "shell inside another", "shells inside another"),
        K::TinyPart => (0x53_70_72, Parts, "tiny part", "tiny parts"),
    };
    Look { colour: Colour::hex(rgb), shape, one, many }
}

/// The colour of a kind.
#[must_use]
pub fn colour(kind: DefectKind) -> Colour {
    look(kind).colour
}

/// How a kind is shown.
#[must_use]
pub fn shape(kind: DefectKind) -> Shape {
    look(kind).shape
}

/// What a kind is called when there are `count` of it.
#[must_use]
pub fn in_words(kind: DefectKind, count: u64) -> &'static str {
    if count == 1 { look(kind).one } else { look(kind).many }
}

/// The name of a kind as in reports, such as `non_manifold_edge`.
#[must_use]
pub fn id(kind: DefectKind) -> String {
    serde_json::to_value(kind).ok().and_then(|v| v.as_str().map(str::to_owned)).unwrap_or_default()
}

/// The colour of surface by what became of it: four of the colours of defects, so that the same test holds them apart.
#[must_use]
pub fn provenance_colour(provenance: Provenance) -> Colour {
    match provenance {
        Provenance::Kept => SOUND,
        Provenance::Moved => colour(DefectKind::Hole),
        Provenance::Added => colour(DefectKind::MisorientedEdge),
        Provenance::Removed => colour(DefectKind::SelfIntersection),
    }
}

/// The name of a provenance as in reports, such as `kept`.
#[must_use]
pub fn provenance_id(provenance: Provenance) -> String {
    serde_json::to_value(provenance).ok().and_then(|v| v.as_str().map(str::to_owned)).unwrap_or_default()
}

/// The colour of a face: of its kind, or a tint of it where the kind is a line or a point.
#[must_use]
pub fn face_colour(kind: DefectKind) -> Colour {
    match shape(kind) {
        Shape::Faces | Shape::Parts => colour(kind),
        Shape::Line | Shape::Point => SOUND.mixed(colour(kind), 0.35),
    }
}

/// The gravest kind of a face's marks.
#[must_use]
pub fn gravest(marks: u32) -> Option<DefectKind> {
    if marks == 0 {
        return None;
    }
    BY_GRAVITY.into_iter().find(|kind| marks & kind.bit() != 0)
}

/// What a face is shown as.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Paint {
    /// Surface with nothing wrong.
    Sound,
    /// Part of a defect.
    Defect(DefectKind),
    /// Surface of a comparison, by what happened to it.
    Provenance(Provenance),
}

impl Paint {
    /// Its colour.
    #[must_use]
    pub fn colour(self) -> Colour {
        match self {
            Self::Sound => SOUND,
            Self::Defect(kind) => face_colour(kind),
            Self::Provenance(provenance) => provenance_colour(provenance),
        }
    }

    /// Its name in files and reports.
    #[must_use]
    pub fn id(self) -> String {
        match self {
            Self::Sound => "sound".to_owned(),
            Self::Defect(kind) => id(kind),
            Self::Provenance(provenance) => provenance_id(provenance),
        }
    }

    /// Whether it marks unchanged or sound surface, which is most of it; a sample of such faces is enough.
    #[must_use]
    pub fn is_plain(self) -> bool {
        matches!(self, Self::Sound | Self::Provenance(Provenance::Kept))
    }

    /// Its number in files: 0 for sound surface and from 1 for the kinds of defect; in a comparison, from 0 for each [`Provenance`].
    #[must_use]
    pub fn number(self) -> u8 {
        match self {
            Self::Sound => 0,
            Self::Defect(kind) => 1 + kind as u8,
            Self::Provenance(provenance) => provenance as u8,
        }
    }
}

impl Serialize for Paint {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.id())
    }
}

/// One line of a legend.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LegendEntry {
    /// Which kind, or which provenance, by its name in reports.
    pub kind: Paint,
    /// Its name in words.
    pub name: &'static str,
    /// Its colour, as `#RRGGBB` in JSON.
    pub colour: Colour,
    /// How many of it there are.
    pub count: u64,
    /// The area of so much surface, in the square of the model's unit; none for defects.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub area: Option<f64>,
}

/// The kinds that were found, gravest first.
#[must_use]
pub fn legend(findings: &Findings) -> Vec<LegendEntry> {
    let found = BY_GRAVITY.into_iter().filter(|&kind| findings.count(kind) > 0);
    found
        .map(|kind| {
            let count = findings.count(kind);
            LegendEntry {
                kind: Paint::Defect(kind),
                name: in_words(kind, count),
                colour: colour(kind),
                count,
                area: None,
            }
        })
        .collect()
}

/// All four provenance, also those of no surface, so that the colours can be read.
#[must_use]
pub fn legend_of_change(shares: &SurfaceShares) -> Vec<LegendEntry> {
    let entry = |provenance| {
        let (share, name) = match provenance {
            Provenance::Kept => (shares.kept, "faces kept"),
            Provenance::Moved => (shares.moved, "faces moved"),
            Provenance::Added => (shares.added, "faces added"),
            Provenance::Removed => (shares.removed, "faces removed, in part or whole"),
        };
        LegendEntry {
            kind: Paint::Provenance(provenance),
            name,
            colour: provenance_colour(provenance),
            count: share.faces,
            area: Some(share.area),
        }
    };
    Provenance::ALL.map(entry).to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Machado, Oliveira and Fernandes 2009, severity 1: what is left of linear light.
    const SIGHTS: [[[f64; 3]; 3]; 3] = [
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        [[0.367_322, 0.860_646, -0.227_968], [0.280_085, 0.672_501, 0.047_413], [-0.011_820, 0.042_940, 0.968_881]],
        [[0.152_286, 1.052_583, -0.204_868], [0.114_503, 0.786_281, 0.099_216], [-0.003_882, -0.048_116, 1.051_998]],
    ];
    /// sRGB to XYZ, each row divided by the white point (D65).
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
    fn every_two_colours_differ_for_normal_sight_and_for_the_colour_blind() {
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
    fn the_order_of_gravity_has_every_kind_once() {
        let mut kinds = BY_GRAVITY.to_vec();
        kinds.sort_unstable();
        assert_eq!(kinds, DefectKind::ALL);
    }

    #[test]
    fn a_face_of_several_kinds_is_shown_in_the_gravest() {
        let marks = DefectKind::Disjoint.bit() | DefectKind::Hole.bit() | DefectKind::SelfIntersection.bit();
        assert_eq!(gravest(marks), Some(DefectKind::SelfIntersection));
        assert_eq!(gravest(DefectKind::Disjoint.bit()), Some(DefectKind::Disjoint));
        assert_eq!(gravest(0), None);
    }

    #[test]
    fn the_legend_names_what_was_found_with_its_count() {
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
