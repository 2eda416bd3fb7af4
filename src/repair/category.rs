use super::Category;
use super::sheets::SHEET_SHARE;
use crate::inspect::Measures;

impl Category {
    /// The name used in JSON.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Clean => "clean",
            Self::Holes => "holes",
            Self::ManySmallHoles => "many_small_holes",
            Self::NonManifold => "non_manifold",
            Self::SelfIntersecting => "self_intersecting",
            Self::Fragmented => "fragmented",
            Self::MultipleComponents => "multiple_components",
            Self::Orientation => "orientation",
            Self::Degenerate => "degenerate",
            Self::OpenSheet => "open_sheet",
            Self::Complex => "complex",
        }
    }
}

/// Where one kind of trouble ends and another begins.
struct Thresholds {
    /// Share of the area in open sheets that makes the whole an open sheet.
    sheet_share: f64,
    /// Boundary loops from which on holes are many.
    many_loops: u64,
    /// Parts from which on a model is fragmented, ...
    fragments: u64,
    /// ... if it has on average at most this many faces a part, or
    faces_a_fragment: u64,
    /// boundary loops for at least this share of its parts.
    open_fragments: f64,
}

const THRESHOLDS: Thresholds =
    Thresholds { sheet_share: SHEET_SHARE, many_loops: 8, fragments: 10, faces_a_fragment: 20, open_fragments: 0.5 };

/// What kind of trouble a model is in, by its measures and by the share of its area in open sheets.
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
pub fn categorise(m: &Measures, sheet_share: f64) -> Category {
    let t = &THRESHOLDS;
    if m.printable() {
        return Category::Clean;
    }
    if m.boundary_edges > 0 && sheet_share >= t.sheet_share {
        return Category::OpenSheet;
    }
    let small = m.faces <= m.parts.saturating_mul(t.faces_a_fragment);
    let open = m.boundary_loops as f64 >= m.parts as f64 * t.open_fragments;
    if m.parts >= t.fragments && (small || open) {
        return Category::Fragmented;
    }
    let nonmanifold = m.nonmanifold_edges > 0 || m.nonmanifold_vertices > 0;
    let holes = m.boundary_edges > 0;
    let turned = m.misoriented_edges > 0 || m.inverted_parts > 0 || m.volume.value < 0.0;
    let faces = m.degenerate_faces > 0
        || m.duplicate_faces > 0
        || m.nonfinite_faces > 0
        || m.unreadable_faces > 0
        || m.unshared_edges > 0
        || m.near_coincident_faults > 0;
    let crossed = m.self_intersections.checked && !m.self_intersections.proven_none();
    match (nonmanifold, holes, crossed) {
        (false, false, false) if turned => Category::Orientation,
        (false, false, false) if faces => Category::Degenerate,
        _ if m.parts > 1 => Category::MultipleComponents,
        (true, false, false) => Category::NonManifold,
        (false, true, false) if turned => Category::Complex,
        (false, true, false) if m.boundary_loops >= t.many_loops => Category::ManySmallHoles,
        (false, true, false) => Category::Holes,
        (false, false, true) => Category::SelfIntersecting,
        _ => Category::Complex,
    }
}
