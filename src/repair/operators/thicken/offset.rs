use glam::DVec3;

use super::cover::Cover;
use crate::mesh::Surface;

/// A vertex is moved by no more than this many times the thickness to keep it on all faces around.
pub(super) const MITER: f64 = 2.0;

/// Of each fan, where its vertex goes for a thickness of 1 before its front.
pub(super) struct Offsets(Vec<DVec3>);

impl Offsets {
    pub fn new(surface: &Surface, cover: &Cover) -> Self {
        let mut sums = vec![DVec3::ZERO; cover.fans()];
        let mut any = vec![DVec3::ZERO; cover.fans()];
        each_corner(surface, cover, |fan, normal, angle| {
            sums[fan] += normal * angle;
            if any[fan] == DVec3::ZERO {
                any[fan] = normal;
            }
        });
        // Where normals cancel, the front of one face is as good as another; a vertex of faces without area goes anywhere.
        let mut ahead: Vec<DVec3> = sums
            .iter()
            .zip(&any)
            .map(|(sum, any)| if sum.length() > 1e-6 { sum.normalize() } else { *any })
            .map(|n| if n == DVec3::ZERO { DVec3::Z } else { n })
            .collect();
        let mut least = vec![1.0f64; cover.fans()];
        each_corner(surface, cover, |fan, normal, _| least[fan] = least[fan].min(ahead[fan].dot(normal)));
        for (ahead, least) in ahead.iter_mut().zip(least) {
            *ahead /= least.max(1.0 / MITER);
        }
        Self(ahead)
    }

    pub fn of(&self, fan: usize) -> DVec3 {
        self.0[fan]
    }
}

/// Calls `each` for every corner of a face with area: the fan, the unit normal on the fan's front, and the angle.
fn each_corner(surface: &Surface, cover: &Cover, mut each: impl FnMut(usize, DVec3, f64)) {
    for (i, &f) in cover.faces.iter().enumerate() {
        let corners = surface.corners(f as usize);
        // Scaled, so that the area of the smallest face does not vanish.
        let size = corners[1].distance(corners[0]).max(corners[2].distance(corners[0]));
        let [p, q] = [(corners[1] - corners[0]) / size, (corners[2] - corners[0]) / size];
        let Some(normal) = p.cross(q).try_normalize() else { continue };
        for c in 0..3 {
            let (to, from) = (corners[(c + 1) % 3] - corners[c], corners[(c + 2) % 3] - corners[c]);
            let (fan, turned) = cover.at(3 * i + c);
            let angle = to.normalize_or_zero().angle_between(from.normalize_or_zero());
            if angle.is_finite() {
                each(fan, if turned { -normal } else { normal }, angle);
            }
        }
    }
}
