//! The models that the documentation shows.

use glam::DVec3;
use meshmend::mesh::Soup;

use crate::meshes::{cube, inside_out, join, sheet, sphere};

/// A model, the options of its repair, and the pictures shown: the program's name for each and the documentation's.
pub struct Shown {
    pub name: &'static str,
    pub model: Soup,
    pub options: &'static [&'static str],
    pub pictures: &'static [(&'static str, &'static str)],
}

/// The models, on a grid that f32 represents exactly, so that they are the same on every machine.
pub fn shown() -> Vec<Shown> {
    let repaired: &[_] = &[("before", "before"), ("after", "after")];
    let changed: &[_] = &[("before", "before"), ("change", "change")];
    let boxes = join(&stretched(DVec3::ZERO), &stretched(DVec3::new(18.0, 8.0, 6.0)));
    let mut shown = vec![
        Shown { name: "ball", model: ball_with_holes(), options: &[], pictures: changed },
        Shown { name: "cube", model: inside_out(cube(DVec3::ZERO, 30.0, 1)), options: &[], pictures: repaired },
        Shown { name: "boxes", model: boxes, options: &[], pictures: repaired },
        Shown { name: "halves", model: halves(), options: &[], pictures: changed },
        Shown { name: "sheet", model: wavy(), options: &["--open-sheets", "base"], pictures: repaired },
    ];
    for p in shown.iter_mut().flat_map(|shown| &mut shown.model.positions) {
        *p = (*p * 1024.0).round() / 1024.0;
    }
    shown
}

/// A box of 30 by 20 by 20.
fn stretched(low: DVec3) -> Soup {
    let mut soup = cube(DVec3::ZERO, 1.0, 1);
    for p in &mut soup.positions {
        *p = low + *p * DVec3::new(30.0, 20.0, 20.0);
    }
    soup
}

fn centre(soup: &Soup, face: [u32; 3]) -> DVec3 {
    face.iter().map(|&v| soup.positions[v as usize]).sum::<DVec3>() / 3.0
}

/// A ball with three holes.
fn ball_with_holes() -> Soup {
    let mut ball = sphere(DVec3::ZERO, 20.0, 32, 16);
    let holes = [([0.6, -0.7, 0.4], 0.95), ([0.2, -0.3, 0.93], 0.97), ([0.95, 0.1, 0.3], 0.98)];
    let is_there = |face: &[u32; 3]| {
        let towards = centre(&ball, *face).normalize();
        holes.iter().all(|&(at, cosine)| towards.dot(DVec3::from(at).normalize()) < cosine)
    };
    ball.faces = ball.faces.iter().copied().filter(is_there).collect();
    ball
}

/// A ball of two halves with a small gap between them.
fn halves() -> Soup {
    let ball = sphere(DVec3::ZERO, 20.0, 24, 12);
    let (mut left, mut right) = (ball.clone(), ball.clone());
    left.faces.retain(|&face| centre(&ball, face).x < 0.0);
    right.faces.retain(|&face| centre(&ball, face).x > 0.0);
    for p in &mut right.positions {
        p.x += 0.008;
    }
    join(&left, &right)
}

/// A sheet with waves.
fn wavy() -> Soup {
    let mut soup = sheet(16);
    for p in &mut soup.positions {
        *p = DVec3::new(3.0 * p.x, 3.0 * p.y, 4.0 * (p.x / 3.0).sin() * (p.y / 4.0).cos());
    }
    soup
}

/// The file names of the pictures.
pub fn picture_names() -> Vec<String> {
    let of =
        |shown: &Shown| shown.pictures.iter().map(|(_, kind)| format!("{}-{kind}.png", shown.name)).collect::<Vec<_>>();
    shown().iter().flat_map(of).collect()
}
