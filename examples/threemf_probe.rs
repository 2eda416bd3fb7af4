use meshmend::format::*;
use std::time::Instant;
fn main() {
    let mut args = std::env::args().skip(1);
    let out = args.next().unwrap();
    for path in args {
        let bytes = std::fs::read(&path).unwrap();
        let name = std::path::Path::new(&path).file_name().unwrap().to_string_lossy().into_owned();
        let t = Instant::now();
        let it = read_scene(&bytes, &ReadOptions::default());
        let ms = t.elapsed().as_secs_f64() * 1e3;
        let rss = || {
            std::fs::read_to_string("/proc/self/status")
                .unwrap()
                .lines()
                .find(|l| l.starts_with("VmHWM"))
                .unwrap()
                .split_whitespace()
                .nth(1)
                .unwrap()
                .parse::<u64>()
                .unwrap()
                / 1024
        };
        let mb = rss();
        match it {
            Ok(it) => {
                let s = &it.scene;
                let meshes = s.objects.iter().filter_map(|o| o.mesh()).count();
                let tri: usize = s.objects.iter().filter_map(|o| o.mesh()).map(|m| m.soup.faces.len()).sum();
                let vert: usize = s.objects.iter().filter_map(|o| o.mesh()).map(|m| m.soup.positions.len()).sum();
                println!(
                    "{name}\tOK objects={} meshes={meshes} tri={tri} vert={vert} items={} placed={} unit={:?} palettes={} textures={} notes={} ms={ms:.1} mb={mb} warn={:?}",
                    s.objects.len(),
                    s.items.len(),
                    s.placed_faces(),
                    s.unit.map(|u| u.as_str()),
                    s.palettes.len(),
                    s.textures.len(),
                    s.notes.len(),
                    it.warnings
                );
                if out != "-" {
                    let t = Instant::now();
                    let a = write_scene(s, Format::ThreeMf).unwrap();
                    let wms = t.elapsed().as_secs_f64() * 1e3;
                    std::fs::write(format!("{out}/{name}"), &a).unwrap();
                    let again = read_scene(&a, &ReadOptions::default()).unwrap();
                    let b = write_scene(&again.scene, Format::ThreeMf).unwrap();
                    println!(
                        "  write {wms:.1} ms {} bytes (was {}), same scene {}, same bytes {} warn={:?}",
                        a.len(),
                        bytes.len(),
                        again.scene == *s,
                        a == b,
                        again.warnings
                    );
                }
            }
            Err(e) => println!("{name}\t{:?} {e} ms={ms:.1} mb={mb}", e.kind),
        }
    }
}
