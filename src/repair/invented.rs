//! Surface of a result that the input does not describe.

use glam::DVec3;

use super::{OpenSheets, Options, RedFlag, RedFlagCode};
use crate::inspect::percent;
use crate::math::Box3;
use crate::mesh::{BASE_SOURCE, Edges, NO_SOURCE, OPENED_SKIN_SOURCE, SKIN_SOURCE, Surface, UnionFind, is_made};

/// Share of the surface above which the patch of a hole is large.
const LARGE: f64 = 0.02;
/// Places of skins that are kept.
const MAX_PLACES: usize = 5;

/// The patch of one hole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Patch {
    pub area: f64,
    /// Its extent.
    pub extent: f64,
    /// A point on it.
    pub at: DVec3,
}

/// What was made without a counterpart in the input.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Invented {
    /// The area of the whole result.
    pub area: f64,
    /// The area of second skins and rims of sheets.
    pub skins: f64,
    /// The same around regions that were left open.
    pub opened_skins: f64,
    /// The area of skirts and bottoms of bases.
    pub bases: f64,
    /// Points on skins and bases.
    pub places: Vec<DVec3>,
    /// The patches that are larger than 2 % of the surface each, the largest first.
    pub patches: Vec<Patch>,
}

impl Invented {
    /// Adds the made faces up. Linear but for sorting.
    pub fn of(surface: &Surface) -> Self {
        let areas: Vec<f64> = (0..surface.faces.len()).map(|f| surface.area_vector(f).length() / 2.0).collect();
        let mut found = Self { area: areas.iter().sum(), ..Self::default() };
        for ((f, &area), &source) in areas.iter().enumerate().zip(&surface.source) {
            let sum = match source {
                SKIN_SOURCE => &mut found.skins,
                OPENED_SKIN_SOURCE => &mut found.opened_skins,
                BASE_SOURCE => &mut found.bases,
                _ => continue,
            };
            if *sum == 0.0 && found.places.len() < MAX_PLACES {
                found.places.push(surface.corners(f).iter().sum::<DVec3>() / 3.0);
            }
            *sum += area;
        }
        if surface.source.iter().any(|&source| is_made(source)) {
            found.patches = patches(surface, &areas);
            let least = LARGE * found.area;
            found.patches.retain(|patch| patch.area > least);
            found.patches.sort_by(|a, b| b.area.total_cmp(&a.area));
        }
        found
    }

    /// What was invented before a remesh, in a result of this area.
    pub fn in_remesh(&self, area: f64) -> Self {
        Self { area, ..self.clone() }
    }

    /// The area of all large patches.
    pub fn patch_area(&self) -> f64 {
        self.patches.iter().map(|patch| patch.area).sum()
    }

    /// An area as a share of the whole, in percent.
    pub fn share_pct(&self, area: f64) -> f64 {
        percent(area, self.area).unwrap_or(0.0).min(100.0)
    }
}

/// The patches of holes: faces that were made for them, as far as edges connect them.
fn patches(surface: &Surface, areas: &[f64]) -> Vec<Patch> {
    let is_patch = |f: usize| surface.source[f] == NO_SOURCE;
    let mut sets = UnionFind::new(surface.faces.len());
    for half_edges in Edges::new(&surface.faces).iter() {
        let mut faces = half_edges.iter().map(|h| h / 3).filter(|&f| is_patch(f as usize));
        if let Some(first) = faces.next() {
            faces.for_each(|other| sets.unite(first, other));
        }
    }
    let roots = sets.into_roots();
    let mut number = vec![usize::MAX; surface.faces.len()];
    let mut found: Vec<(Patch, Box3, f64)> = Vec::new();
    for f in (0..surface.faces.len()).filter(|&f| is_patch(f)) {
        let slot = &mut number[roots[f] as usize];
        if *slot == usize::MAX {
            *slot = found.len();
            found.push((Patch { area: 0.0, extent: 0.0, at: DVec3::ZERO }, Box3::EMPTY, -1.0));
        }
        let (patch, bounds, largest) = &mut found[*slot];
        let corners = surface.corners(f);
        corners.iter().for_each(|&corner| bounds.extend(corner));
        patch.area += areas[f];
        if areas[f] > *largest {
            (*largest, patch.at) = (areas[f], corners.iter().sum::<DVec3>() / 3.0);
        }
    }
    found.into_iter().map(|(patch, bounds, _)| Patch { extent: bounds.diagonal(), ..patch }).collect()
}

/// The flag for more invented surface than the options allow. Skins that were asked for are not counted, and bases always are asked for.
pub(super) fn surface_invented(invented: &Invented, options: &Options) -> Option<RedFlag> {
    let asked = options.open_sheets == OpenSheets::Thicken;
    let skins = if asked { 0.0 } else { invented.skins + invented.opened_skins };
    let (skins, patches) = (invented.share_pct(skins), invented.share_pct(invented.patch_area()));
    let value = (skins + patches).min(100.0);
    let threshold = options.max_surface_added_pct;
    let parts: Vec<String> = [
        (skins > 0.0).then(|| format!("{skins:.1} % for the thickness of open sheets")),
        (patches > 0.0).then(|| format!("{patches:.1} % to close {} large holes", invented.patches.len())),
    ]
    .into_iter()
    .flatten()
    .collect();
    let detail = format!("{value:.1} % of the result's surface was invented: {}", parts.join(", "));
    let places = invented.patches.iter().map(|patch| patch.at).chain(invented.places.iter().copied());
    (value > threshold).then(|| RedFlag {
        code: RedFlagCode::SurfaceInvented,
        value,
        threshold,
        detail,
        places: places.take(MAX_PLACES).map(|at| at.to_array()).collect(),
    })
}
