//! The clearance in front of a wall, up to the next surface, and balls that keep to it.

use crate::math::Tree;
use crate::mesh::Surface;
use glam::DVec3;

use super::limits::{Filler, Limits};

/// The largest dot product of the outward directions at two contacts of a ball in a wall: 36.9 degrees.
pub const OPPOSED: f64 = -0.8;
/// How far balls stay behind faces on a side that stays, as a share of the least wall, so that rounding leaves these faces as they are.
const BEHIND_KEPT: f64 = 0.01;
/// Steps of one ball.
pub const STEPS: u64 = 1 << 16;

/// A point of a face with the face's normal.
#[derive(Clone, Copy)]
pub struct Contact {
    /// The point.
    pub point: DVec3,
    /// The normal, of length 1.
    pub normal: DVec3,
}

/// The clearances in front of the walls of a surface that grew from the input. Both have trees.
pub struct Clearances<'a> {
    /// The surface.
    pub current: (&'a Surface, &'a Tree),
    /// The input, whose gaps count, and its solids.
    pub limits: &'a Limits<'a>,
}

impl Clearances<'_> {
    /// The ball that replaces a thin one, given by its centre and its radius, and exceeds it by `wanted`, within the clearances in
    /// front of its contacts.
    pub fn ball(&self, thin: (DVec3, f64), wanted: f64, contacts: [Contact; 2]) -> Filler {
        let to_solids = if self.limits.has_several_solids() { self.limits.settings.least_gap() / 2.0 } else { 0.0 };
        let (_, radius) = thin;
        let to_kept = self.behind_kept(radius);
        let clearance = |at: Contact| match self.limits.is_kept(at.point) {
            true => -to_kept,
            false => self.clearance(at, 2.0 * wanted + to_solids.max(to_kept), radius),
        };
        within_clearances(thin, wanted, contacts, contacts.map(clearance))
    }

    /// How far the ball that replaces a thin one of a radius stays behind a kept face. Both balls still overlap.
    fn behind_kept(&self, radius: f64) -> f64 {
        (BEHIND_KEPT * self.limits.settings.min_wall).min(radius / 2.0)
    }

    /// How far the solid may grow at a contact, at most `wanted`. Negative in front of another solid that is nearer than the least
    /// gap: the ball must stay behind the contact, by up to `most_behind`.
    fn clearance(&self, Contact { point, normal }: Contact, wanted: f64, most_behind: f64) -> f64 {
        let gap = self.limits.settings.least_gap();
        let (surface, tree) = self.current;
        let corners = |face: u32| surface.corners(face as usize);
        let ball = tree.shrunk_ball([point, normal], wanted + gap / 2.0, &mut STEPS.clone(), corners);
        let Some((touched, radius)) = ball.and_then(|ball| Some((ball.touches?.point, ball.radius))) else {
            return wanted;
        };
        let outward = (touched - (point + normal * radius)).normalize_or_zero();
        if outward.dot(normal) < -OPPOSED {
            return wanted;
        }
        let distance = (radius - gap / 2.0).min(wanted);
        let is_near_solid = || self.limits.are_of_two_solids([point, touched]);
        if distance < 0.0 && is_near_solid() { distance.max(-most_behind) } else { distance.max(0.0) }
    }
}

/// The ball that replaces a thin one and exceeds it by `wanted`, as far as the clearances in front of both contacts allow.
fn within_clearances(
    (centre, thin): (DVec3, f64),
    wanted: f64,
    contacts: [Contact; 2],
    clearances: [f64; 2],
) -> Filler {
    let lack = clearances.map(|clearance| (wanted - clearance).max(0.0));
    if lack[0] + lack[1] <= 0.0 {
        return Filler { slack: wanted, ..Filler::new(centre, thin + wanted) };
    }
    // The ball moves away from a limit as far as the other side allows.
    let [p, q] = contacts;
    let across = (q.point - p.point).normalize_or_zero();
    let shift = [0, 1].map(|k| lack[k].min((clearances[1 - k] - wanted).max(0.0)));
    let radius = thin + wanted - (lack[0] - shift[0]).max(lack[1] - shift[1]);
    let is_limited = lack[0] > shift[0] || lack[1] > shift[1];
    // A ball that cannot grow at all has no radius, but says that there is a limit.
    let radius = if radius > thin { radius } else { 0.0 };
    let moved = shift[0] - shift[1];
    let slack = (radius - thin - moved.abs()).max(0.0);
    Filler { is_limited, slack, ..Filler::new(centre + across * moved, radius) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Precision;
    use crate::printing::shapes::{cuboid, joined};
    use crate::printing::thickening::{Growth, Thickening};

    /// The ball in a plate of 0.3 below another solid, at a distance.
    fn ball_below(gap: f64) -> Filler {
        let corner = |z: f64| DVec3::new(10.0, 10.0, z);
        let solids = joined(&[cuboid(DVec3::ZERO, corner(0.3)), cuboid(DVec3::Z * (0.3 + gap), corner(2.0))]);
        let settings = Thickening { min_wall: 1.0, growth: Growth::Both, min_gap: 0.5, precision: Precision::F32 };
        let (limits, at) = (Limits::new(&solids, settings), DVec3::new(5.0, 5.0, 0.15));
        let contacts =
            [0.3, 0.0].map(|z| Contact { point: at.with_z(z), normal: DVec3::Z * if z > 0.0 { 1.0 } else { -1.0 } });
        let mut ball =
            Clearances { current: (&solids, &limits.tree), limits: &limits }.ball((at, 0.15), 0.39, contacts);
        limits.apply(&mut ball, 0.2);
        ball
    }

    #[test]
    fn a_ball_near_another_solid_keeps_its_size_and_leaves_it_more_than_the_gap() {
        let free = ball_below(2.0);
        assert_eq!((free.centre.z, free.radius), (0.15, 0.54));
        // Half of what the gap lacks, or of what it has more, belongs to the other solid.
        for gap in [0.25, 0.3, 0.7] {
            let ball = ball_below(gap);
            let left = 0.3 + gap - (ball.centre.z + ball.radius);
            assert!((ball.radius - 0.54).abs() < 1e-9, "{gap}: {ball:?}");
            assert!((left - f64::midpoint(0.5, gap)).abs() < 1e-9, "{gap}: {left}");
        }
    }

    #[test]
    fn a_ball_keeps_its_size_behind_the_side_that_stays() {
        let plate = joined(&[cuboid(DVec3::ZERO, DVec3::new(10.0, 10.0, 0.3))]);
        let settings = Thickening { min_wall: 1.0, growth: Growth::Outward, min_gap: 0.5, precision: Precision::F32 };
        let is_below = |face: usize| plate.corners(face).iter().all(|corner| corner.z == 0.0);
        let limits = Limits::new(&plate, settings).keeping((0..plate.faces.len()).map(is_below).collect());
        let at = DVec3::new(5.0, 5.0, 0.15);
        let contacts = [0.3, 0.0].map(|z| Contact { point: at.with_z(z), normal: (at.with_z(z) - at).normalize() });
        let mut ball = Clearances { current: (&plate, &limits.tree), limits: &limits }.ball((at, 0.15), 0.39, contacts);
        limits.apply(&mut ball, 0.2);
        let behind = ball.centre.z - ball.radius;
        assert!((ball.radius - 0.54).abs() < 1e-9 && (1e-6..0.02).contains(&behind), "{ball:?}");
        // A ball that no contact moves away from the side only gets smaller.
        let mut other = Filler::new(at, 0.54);
        limits.apply(&mut other, 0.05);
        assert!((other.radius - 0.15).abs() < 1e-9, "{other:?}");
    }
}
