//! The pictures of the documentation: what the program draws of models that are made here.

use std::path::PathBuf;
use std::process::Command;

use glam::DVec3;
use meshmend::format::{self, Format};
use meshmend::mesh::Soup;

use crate::meshes::{cube, inside_out, join, sphere};
use crate::pages::root;

/// A model, how it is repaired, and which of the program's pictures are shown, by what they are called in the documentation.
struct Shown {
    name: &'static str,
    model: Soup,
    options: &'static [&'static str],
    pictures: &'static [(&'static str, &'static str)],
}

/// The models, on a grid that STL can hold, so that they are the same on every machine.
fn shown() -> Vec<Shown> {
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
    for p in shown.iter_mut().flat_map(|it| &mut it.model.positions) {
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

/// A ball from which what lies around three directions is missing.
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

/// A ball of two halves that are a little apart.
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
    let mut soup = crate::meshes::sheet(16);
    for p in &mut soup.positions {
        *p = DVec3::new(3.0 * p.x, 3.0 * p.y, 4.0 * (p.x / 3.0).sin() * (p.y / 4.0).cos());
    }
    soup
}

/// The files of the pictures.
pub fn names() -> Vec<String> {
    let of = |it: &Shown| it.pictures.iter().map(|(_, kind)| format!("{}-{kind}.png", it.name)).collect::<Vec<_>>();
    shown().iter().flat_map(of).collect()
}

/// The pictures as the program draws them today, by file.
fn drawn() -> Vec<(String, Vec<u8>)> {
    let folder = tempfile::tempdir().unwrap();
    let draw = |it: Shown| {
        let model = folder.path().join(format!("{}.off", it.name));
        let pictures = folder.path().join(it.name);
        std::fs::write(&model, format::write(&it.model, Format::Off).unwrap()).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_meshmend"));
        command.arg("repair").arg(&model).arg("-o").arg(folder.path().join("result.stl"));
        command.arg("--pictures").arg(&pictures).args(["--max-tier", "2"]).args(it.options);
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}: {}", it.name, String::from_utf8_lossy(&output.stderr));
        it.pictures.iter().map(move |(from, kind)| {
            let bytes = std::fs::read(pictures.join(format!("{from}.png"))).unwrap();
            (format!("{}-{kind}.png", it.name), bytes)
        })
    };
    shown().into_iter().flat_map(draw).collect()
}

/// A picture's size and pixels.
fn pixels(png: &[u8]) -> (u32, u32, Vec<u8>) {
    let mut reader = png::Decoder::new(std::io::Cursor::new(png)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!((info.color_type, info.bit_depth), (png::ColorType::Rgb, png::BitDepth::Eight));
    (info.width, info.height, pixels)
}

/// The same picture in fewer bytes: the program spends little time on that.
fn packed(png: &[u8]) -> Vec<u8> {
    let (width, height, pixels) = pixels(png);
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_compression(png::Compression::High);
    // Most of it is faces of one colour.
    encoder.set_filter(png::Filter::NoFilter);
    encoder.write_header().unwrap().write_image_data(&pixels).unwrap();
    file
}

fn kept(name: &str) -> PathBuf {
    root().join("docs/pictures").join(name)
}

#[test]
fn the_pictures_are_what_the_program_draws() {
    for (name, bytes) in drawn() {
        let kept = std::fs::read(kept(&name)).unwrap_or_else(|error| panic!("{name}: {error}; run 'make pictures'"));
        assert!(pixels(&kept) == pixels(&bytes), "{name} is not what the program draws: run 'make pictures'");
        assert!(kept.len() < 150_000, "{name} has {} bytes", kept.len());
    }
}

#[test]
#[ignore = "writes docs/pictures: 'make pictures'"]
fn write_pictures() {
    for (name, bytes) in drawn() {
        std::fs::write(kept(&name), packed(&bytes)).unwrap();
    }
}
