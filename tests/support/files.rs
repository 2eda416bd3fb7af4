//! STL files of small models.

/// Corners of the unit box's faces, counter-clockwise from outside; the last two triangles are its top.
pub const BOX: [[[f32; 3]; 3]; 12] = [
    [[0., 0., 0.], [0., 1., 0.], [1., 1., 0.]],
    [[0., 0., 0.], [1., 1., 0.], [1., 0., 0.]],
    [[0., 0., 0.], [1., 0., 0.], [1., 0., 1.]],
    [[0., 0., 0.], [1., 0., 1.], [0., 0., 1.]],
    [[1., 0., 0.], [1., 1., 0.], [1., 1., 1.]],
    [[1., 0., 0.], [1., 1., 1.], [1., 0., 1.]],
    [[1., 1., 0.], [0., 1., 0.], [0., 1., 1.]],
    [[1., 1., 0.], [0., 1., 1.], [1., 1., 1.]],
    [[0., 1., 0.], [0., 0., 0.], [0., 0., 1.]],
    [[0., 1., 0.], [0., 0., 1.], [0., 1., 1.]],
    [[0., 0., 1.], [1., 0., 1.], [1., 1., 1.]],
    [[0., 0., 1.], [1., 1., 1.], [0., 1., 1.]],
];

/// Binary STL of these triangles.
pub fn stl(triangles: &[[[f32; 3]; 3]]) -> Vec<u8> {
    let mut bytes = vec![0; 80];
    bytes.extend_from_slice(&u32::try_from(triangles.len()).expect("few triangles").to_le_bytes());
    for triangle in triangles {
        bytes.extend_from_slice(&[0; 12]);
        for coordinate in triangle.iter().flatten() {
            bytes.extend_from_slice(&coordinate.to_le_bytes());
        }
        bytes.extend_from_slice(&[0; 2]);
    }
    bytes
}

/// A box without defects.
pub fn whole_box() -> Vec<u8> {
    stl(&BOX)
}

/// A box of 20 with a sealed cubic cavity of 10.
#[allow(dead_code, reason = "not every test that shares this file looks at it")]
pub fn hollow_box() -> Vec<u8> {
    let outer = BOX.map(|triangle| triangle.map(|corner| corner.map(|side| 20. * side)));
    let inner = BOX.map(|[a, b, c]| [a, c, b].map(|corner| corner.map(|side| 5. + 10. * side)));
    stl(&[outer, inner].concat())
}

/// A box without half of its top and with one face flipped: tier 1 repairs it.
pub fn broken_box() -> Vec<u8> {
    let mut triangles = BOX[..11].to_vec();
    triangles[3].swap(0, 1);
    stl(&triangles)
}

/// A box without its top and with one face flipped: closing it adds a sixth of its surface.
#[allow(dead_code, reason = "not every test that shares this file looks at it")]
pub fn open_box() -> Vec<u8> {
    let mut triangles = BOX[..10].to_vec();
    triangles[3].swap(0, 1);
    stl(&triangles)
}

/// A square of two triangles, which encloses nothing and becomes a solid only on request.
pub fn open_sheet() -> Vec<u8> {
    stl(&BOX[..2])
}

/// Two boxes that share one edge: non-manifold, and no operator of tier 1 changes that.
pub fn boxes_on_an_edge() -> Vec<u8> {
    let moved = BOX.map(|triangle| triangle.map(|[x, y, z]| [x + 1., y + 1., z]));
    stl(&[BOX, moved].concat())
}

/// A sphere-like surface of about `faces` triangles, with a hole: large enough to take time.
pub fn large_open_sphere(faces: usize) -> Vec<u8> {
    let rings = ((faces / 4) as f64).sqrt().ceil() as usize;
    let around = 2 * rings;
    let point = |ring: usize, step: usize| {
        let (a, b) = (
            std::f64::consts::PI * ring as f64 / rings as f64,
            std::f64::consts::TAU * (step % around) as f64 / around as f64,
        );
        [(a.sin() * b.cos()) as f32, (a.sin() * b.sin()) as f32, a.cos() as f32]
    };
    let mut triangles = Vec::new();
    for ring in 1..rings - 1 {
        for step in 0..around {
            let (p, q, r, s) =
                (point(ring, step), point(ring + 1, step), point(ring + 1, step + 1), point(ring, step + 1));
            triangles.extend([[p, q, r], [p, r, s]]);
        }
    }
    stl(&triangles)
}
