//! The pictures of the documentation are what the program draws of the models in `support/pictures.rs`.

use std::path::PathBuf;
use std::process::Command;

use meshmend::format::{self, Format};

use crate::support::pages::root;
use crate::support::pictures::{Shown, shown};

/// File names and bytes of the pictures as the program draws them now.
fn drawn_pictures() -> Vec<(String, Vec<u8>)> {
    let folder = tempfile::tempdir().unwrap();
    let draw = |shown: Shown| {
        let model = folder.path().join(format!("{}.off", shown.name));
        let pictures = folder.path().join(shown.name);
        std::fs::write(&model, format::write(&shown.model, Format::Off).unwrap()).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_meshmend"));
        command.arg("repair").arg(&model).arg("-o").arg(folder.path().join("result.stl"));
        command.arg("--pictures").arg(&pictures).args(["--max-tier", "2"]).args(shown.options);
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}: {}", shown.name, String::from_utf8_lossy(&output.stderr));
        shown.pictures.iter().map(move |(from, kind)| {
            let bytes = std::fs::read(pictures.join(format!("{from}.png"))).unwrap();
            (format!("{}-{kind}.png", shown.name), bytes)
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

/// The same picture, compressed better than the program does in its short time.
fn recompressed(png: &[u8]) -> Vec<u8> {
    let (width, height, pixels) = pixels(png);
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_compression(png::Compression::High);
    // Most of the pixels belong to faces of one colour.
    encoder.set_filter(png::Filter::NoFilter);
    encoder.write_header().unwrap().write_image_data(&pixels).unwrap();
    file
}

fn stored_path(name: &str) -> PathBuf {
    root().join("docs/pictures").join(name)
}

#[test]
fn the_pictures_are_what_the_program_draws() {
    for (name, bytes) in drawn_pictures() {
        let stored =
            std::fs::read(stored_path(&name)).unwrap_or_else(|error| panic!("{name}: {error}; run 'make pictures'"));
        assert!(pixels(&stored) == pixels(&bytes), "{name} is not what the program draws: run 'make pictures'");
        assert!(stored.len() < 150_000, "{name} has {} bytes", stored.len());
    }
}

#[test]
#[ignore = "writes docs/pictures: 'make pictures'"]
fn write_pictures() {
    for (name, bytes) in drawn_pictures() {
        std::fs::write(stored_path(&name), recompressed(&bytes)).unwrap();
    }
}
