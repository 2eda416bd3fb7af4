//! Damaged models in every format, determined by a seed.

use glam::DVec3;
use meshmend::format::{Format, Limits, read, write};
use meshmend::mesh::Soup;

use crate::damage::Random;
use crate::meshes::{cube, inside_out, join, push, sheet, sphere, torus};

/// The maximum number of faces before damage.
const MOST: usize = 250;

/// A model with damaged geometry in some format, sometimes with damaged bytes too.
pub fn file(seed: u64) -> Vec<u8> {
    let random = &mut Random::new(seed);
    let soup = model(random);
    let mut bytes = match random.below(7) {
        0 => ascii_stl(&soup),
        1 => write(&soup, Format::Obj).unwrap_or_default(),
        2 => write(&soup, Format::Ply).unwrap_or_default(),
        3 => write(&soup, Format::Off).unwrap_or_default(),
        4 => write(&soup, Format::Mesh).unwrap_or_default(),
        _ => write(&soup, Format::Stl).unwrap_or_default(),
    };
    if random.below(3) == 0 {
        damage_some(&mut bytes, random);
    }
    bytes
}

/// A file in one of the format's dialects.
fn dialect(format: Format, others: &[&str], seed: u64) -> Vec<u8> {
    let random = &mut Random::new(seed);
    let which = random.below(2 * (others.len() + 1));
    let mut bytes = match others.get(which) {
        Some(text) => text.as_bytes().to_vec(),
        None if format == Format::Stl && which.is_multiple_of(2) => ascii_stl(&model(random)),
        None => write(&model(random), format).unwrap_or_default(),
    };
    if random.below(2) == 0 {
        damage_some(&mut bytes, random);
    }
    bytes
}

/// The text of a 3MF model that uses most features, or an archive with one, with damaged bytes.
pub fn threemf(seed: u64) -> Vec<u8> {
    let random = &mut Random::new(seed);
    let mut bytes = match random.below(5) {
        0 => write(&model(random), Format::ThreeMf).unwrap_or_default(),
        _ => MODEL.as_bytes().to_vec(),
    };
    for _ in 0..random.below(5) {
        damage_bytes(&mut bytes, random);
    }
    bytes
}

/// A glTF document that uses most features, or a GLB file, with damaged bytes.
pub fn gltf(seed: u64) -> Vec<u8> {
    let random = &mut Random::new(seed);
    let mut bytes = match random.below(5) {
        0 => write(&model(random), Format::Glb).unwrap_or_default(),
        _ => DOCUMENT.as_bytes().to_vec(),
    };
    for _ in 0..random.below(6) {
        damage_bytes(&mut bytes, random);
    }
    bytes
}

/// Whether the undamaged glTF document can be read.
pub fn gltf_is_read() -> bool {
    read(DOCUMENT.as_bytes(), &Limits::default()).is_ok_and(|mesh| mesh.soup.faces.len() == 10)
}

/// The texts of an OBJ model and its materials that use most features, or an archive with them, with damaged bytes.
pub fn zip(seed: u64) -> Vec<u8> {
    let random = &mut Random::new(seed);
    let mut bytes = match random.below(5) {
        0 => write(&model(random), Format::Zip).unwrap_or_default(),
        _ => PAINTED.as_bytes().to_vec(),
    };
    for _ in 0..random.below(6) {
        damage_bytes(&mut bytes, random);
    }
    bytes
}

pub fn stl(seed: u64) -> Vec<u8> {
    dialect(
        Format::Stl,
        &[
            "solid\nfacet\nouter loop\nvertex 0 0 0 vertex 1 0 0\nvertex 0 1 0 endloop\nendfacet\nendsolid a\nsolid b\nendsolid b\n",
        ],
        seed,
    )
}

pub fn obj(seed: u64) -> Vec<u8> {
    let quads =
        "o x\nv 0 0 0 1\nv 4 0 0\nv 1 1 0\nv 0 4 0\nvt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3//1 4/1\nf -4 -3 \\\n-1\nl 1 2\n";
    dialect(Format::Obj, &[quads], seed)
}

pub fn ply(seed: u64) -> Vec<u8> {
    let strips = "ply\nformat ascii 1.0\ncomment x\nelement vertex 4\nproperty float x\nproperty float y\nproperty double z\nproperty uchar red\n\
                  element face 2\nproperty list uchar int vertex_indices\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n\
                  0 0 0 1\n1 0 0 1\n1 1 0 1\n0 1 0 1\n4 0 1 2 3\n3 0 1 2\n5 0 1 2 -1 3\n";
    let big = "ply\nformat binary_big_endian 1.0\nelement vertex 3\nproperty char x\nproperty char y\nproperty char z\nelement face 1\n\
               property list uchar uchar vertex_indices\nend_header\n\0\0\0\u{1}\0\0\0\u{1}\0\u{3}\0\u{1}\u{2}";
    dialect(Format::Ply, &[strips, big], seed)
}

pub fn off(seed: u64) -> Vec<u8> {
    let coloured = "COFF\n5 2 0\n0 0 0 1 1 1\n4 0 0 1 1 1\n1 1 0 1 1 1\n0 4 0 1 1 1\n9 9 9 0 0 0\n4 0 1 2 3\n5 0 1 4 2 3 255 0 0\n";
    let dimensions = "4nOFF\n3\n3 1 3 # counts\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    dialect(Format::Off, &[coloured, dimensions], seed)
}

pub fn mesh(seed: u64) -> Vec<u8> {
    dialect(
        Format::Mesh,
        &["Face 7 3 1 2\nVertex 3 0 0 0\nVertex 1 1 0 0 {rgb=(1 0 0)}\nVertex 2 0 1 0\nFace 9 1 2 8\n"],
        seed,
    )
}

/// Damages bytes at some places.
pub fn damage_some(bytes: &mut Vec<u8>, random: &mut Random) {
    for _ in 0..=random.below(6) {
        damage_bytes(bytes, random);
    }
}

const DOCUMENT: &str = r##"{"asset":{"version":"2.0","copyright":"c"},"extensionsUsed":["KHR_materials_unlit"],"scene":0,"scenes":[{"nodes":[0,2]}],"nodes":[{"name":"a","children":[1],"rotation":[0,0,0.7071068,0.7071068]},{"mesh":0,"scale":[2,1,-1]},{"mesh":1,"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,5,6,7,1],"extras":{"x":1}}],"meshes":[{"name":"m","primitives":[{"attributes":{"POSITION":0,"COLOR_0":1},"indices":3},{"attributes":{"POSITION":0,"TEXCOORD_0":2},"material":0,"mode":5}]},{"weights":[0.5],"primitives":[{"attributes":{"POSITION":4},"indices":3,"mode":4,"targets":[{"POSITION":0}],"material":1}]}],"materials":[{"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}},{"name":"red","pbrMetallicRoughness":{"baseColorFactor":[1,0,0,0.5]},"alphaMode":"BLEND"}],"textures":[{"source":0,"sampler":0}],"samplers":[{"wrapS":33071,"magFilter":9728}],"images":[{"uri":"data:image/png;base64,iVBORw0KGgo="}],"accessors":[{"bufferView":0,"componentType":5126,"type":"VEC3","count":4,"min":[0,0,0],"max":[1,1,1]},{"bufferView":1,"componentType":5121,"normalized":true,"type":"VEC4","count":4},{"bufferView":2,"componentType":5126,"type":"VEC2","count":4},{"bufferView":3,"componentType":5123,"type":"SCALAR","count":12},{"bufferView":0,"componentType":5126,"type":"VEC3","count":4,"sparse":{"count":2,"indices":{"bufferView":4,"componentType":5123},"values":{"bufferView":5}}}],"bufferViews":[{"buffer":0,"byteOffset":0,"byteLength":48},{"buffer":0,"byteOffset":48,"byteLength":16},{"buffer":0,"byteOffset":64,"byteLength":32},{"buffer":0,"byteOffset":96,"byteLength":24},{"buffer":0,"byteOffset":120,"byteLength":4},{"buffer":0,"byteOffset":124,"byteLength":24}],"buffers":[{"byteLength":148,"uri":"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAAAAAAAAAAAAAAAIA//wAA/wD/AP8AAP//CQkJCQAAAAAAAAAAAACAPwAAAAAAAAAAAACAPwAAAD8AAAA/AAACAAEAAAABAAMAAQACAAMAAgAAAAMAAQADAAAAwD8AAAAAAAAAAAAAAAAAAAAAAAAAQA=="}]}"##;

const MODEL: &str = r##"<?xml version="1.0" encoding="UTF-8"?>
<model unit="inch" xml:lang="en" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" xmlns:m="http://schemas.microsoft.com/3dmanufacturing/material/2015/02" xmlns:v="urn:v">
<metadata name="Title">a &amp; b</metadata><metadata name="v:own" preserve="1" type="xs:string"><![CDATA[c]]>&#10;</metadata>
<resources>
<basematerials id="1"><base name="PLA" displaycolor="#FF0000"/><base name="ABS" displaycolor="#00FF0080"/></basematerials>
<m:colorgroup id="2"><m:color color="#102030"/><m:color color="#405060"/></m:colorgroup>
<m:texture2d id="3" path="/3D/3dmodel.model" contenttype="image/png" tilestyleu="clamp"/>
<m:texture2dgroup id="4" texid="3"><m:tex2coord u="0" v="1"/><m:tex2coord u="0.5" v="-1e3"/></m:texture2dgroup>
<m:compositematerials id="5" matid="1" matindices="0 1"><m:composite values="0.25 1"/></m:compositematerials>
<m:multiproperties id="6" pids="1 2 4" blendmethods="mix"><m:multi pindices="0 1 1"/><m:multi pindices="1"/></m:multiproperties>
<object id="7" name="one" partnumber="8" type="support" pid="1" pindex="1"><mesh><vertices>
<vertex x="0" y="0" z="0"/><vertex x="1.5" y="0" z="0"/><vertex x="0" y="2e1" z="0"/><vertex x="0" y="0" z="-3"/></vertices><triangles>
<triangle v1="0" v2="1" v3="2"/><triangle v1="0" v2="3" v3="1" pid="6" p1="0" p2="1" p3="0"/>
<triangle v1="1" v2="3" v3="2" pid="5" p1="0"/><triangle v1="2" v2="3" v3="0" p1="0"/></triangles></mesh></object>
<object id="8"><components><component objectid="7" transform="1 0 0 0 1 0 0 0 1 5 6 7"/><component objectid="7"/></components></object>
</resources>
<build><item objectid="8" transform="-2 0 0 0 2 0 0 0 2 0 0 1"><metadatagroup><metadata name="Title">it</metadata></metadatagroup></item></build>
</model>
"##;

const PAINTED: &str = "mtllib c.mtl
v 0 0 0 1 0 0
v 4 0 0 0 1 0
v 4 4 0 0 0 1
v 0 4 0 0.5 0.5 0.5
v 2 1 0
v 0 0 5 1
vt 0 0
vt 1 0 0
vt 0.5 -1e3
f 1 2 3 4
usemtl red
f 1/1 2/2 3/3
f 1 2 5 3 4
usemtl wood
f 1/1 2/2 3/3 4/1
f -6/-1 -5/-2/1 -4/-3
f 7/1 1/2 2/9
usemtl grey
f 1 2 3
usemtl (null)
f 1 2 4
usemtl color_808080
f 4 3 2
usemtl none
f 1 4 6
f 1 2
v 9 9 9 0 1 1
---
newmtl red
Kd 1 0 0
d 0.5
newmtl wood
Kd 1 1 0.5
Tr 0.1
map_Kd -s 1 1 1 -clamp on ..\\p.png
newmtl grey
Kd 0.2
newmtl color_808080
Kd 0.502 0.502 0.502
";

/// One to four solids or sheets, often coplanar or tangent, with damage.
fn model(random: &mut Random) -> Soup {
    let mut soup = Soup::default();
    for _ in 0..=random.below(4) {
        let n = 1 + random.below(4) as u32;
        let low = whole(random, 4);
        let solid = match random.below(7) {
            0 | 1 => cube(low, 1.0 + random.below(3) as f64, n),
            2 => moved(torus(1.0 + random.below(2) as f64, 1.0, 4 + 2 * n, 3 + n), low),
            3 => sphere(low, 1.0, 3 + n, 2 + n),
            4 => moved(sheet(n + 1), low),
            5 => inside_out(cube(low, 1.0, n)),
            _ => any_triangles(random),
        };
        if soup.faces.len() + solid.faces.len() <= MOST {
            soup = join(&soup, &solid);
        }
    }
    if soup.faces.is_empty() {
        soup = cube(DVec3::ZERO, 1.0, 2);
    }
    for _ in 0..random.below(5) {
        damage(&mut soup, random);
    }
    soup
}

fn whole(random: &mut Random, n: usize) -> DVec3 {
    DVec3::from_array([0, 1, 2].map(|_| random.below(n) as f64))
}

fn moved(mut soup: Soup, by: DVec3) -> Soup {
    soup.positions.iter_mut().for_each(|p| *p += by);
    soup
}

/// Triangles with corners on a small lattice, which touch and intersect in every way.
fn any_triangles(random: &mut Random) -> Soup {
    let mut soup = Soup::default();
    for _ in 0..4 + random.below(40) {
        let corners = [0, 1, 2].map(|_| whole(random, 4));
        push(&mut soup, corners);
    }
    soup
}

/// Numbers at the limits of arithmetic.
const NUMBERS: [f64; 12] =
    [f64::NAN, f64::INFINITY, 3.4e38, -3.4e38, 1e-45, 1e300, 0.0, -0.0, 1e-30, 1.0, 16_777_217.0, 1e20];

#[expect(clippy::too_many_lines, reason = "one arm for each kind of damage")]
fn damage(soup: &mut Soup, random: &mut Random) {
    if soup.faces.is_empty() {
        return;
    }
    let amount = 1 + random.below(6);
    match random.below(13) {
        // Faces are removed, flipped or duplicated.
        0 => (0..amount).for_each(|_| {
            if soup.faces.len() > 1 {
                soup.faces.swap_remove(random.below(soup.faces.len()));
            }
        }),
        1 => (0..4 * amount).for_each(|_| {
            let f = random.below(soup.faces.len());
            soup.faces[f].swap(0, 1);
        }),
        2 => (0..amount).for_each(|_| {
            let mut face = soup.faces[random.below(soup.faces.len())];
            face.rotate_left(random.below(3));
            if random.below(2) == 0 {
                face.swap(0, 1);
            }
            soup.faces.push(face);
        }),
        // Corners move far, slightly or onto others, alone or with all corners at their position.
        3 => (0..amount).for_each(|_| {
            let v = random.below(soup.positions.len());
            soup.positions[v] += random.vector() * [1e-7, 1e-4, 0.1, 3.0][random.below(4)];
        }),
        4 => (0..amount).for_each(|_| {
            let (v, w) = (random.below(soup.positions.len()), random.below(soup.positions.len()));
            soup.positions[v] = soup.positions[w];
        }),
        5 => (0..amount).for_each(|_| {
            let p = soup.positions[random.below(soup.positions.len())];
            let to = p + random.vector() * [1e-6, 1e-3, 0.2][random.below(3)];
            soup.positions.iter_mut().filter(|q| **q == p).for_each(|q| *q = to);
        }),
        6 => (0..amount).for_each(|_| {
            let v = random.below(soup.positions.len());
            soup.positions[v][random.below(3)] = NUMBERS[random.below(NUMBERS.len())];
        }),
        // The whole model becomes tiny, huge, distant, flat or rotated.
        7 => {
            let scale = [1e-40, 1e-20, 1e-6, 1e6, 1e30, 3e37][random.below(6)];
            soup.positions.iter_mut().for_each(|p| *p *= scale);
        }
        8 => {
            let by = random.vector() * [1e3, 1e6, 1e12][random.below(3)];
            soup.positions.iter_mut().for_each(|p| *p += by);
        }
        9 => {
            let (k, by) = (random.below(3), [0.0, 1e-6, 1e-3][random.below(3)]);
            soup.positions.iter_mut().for_each(|p| p[k] *= by);
        }
        10 => {
            let axis = (random.vector() + DVec3::splat(0.01)).normalize();
            let turn = glam::DMat3::from_axis_angle(axis, random.below(100) as f64);
            soup.positions.iter_mut().for_each(|p| *p = turn * *p);
        }
        // The model is duplicated, with a small offset or none.
        11 if soup.faces.len() <= MOST => {
            let by = random.vector() * [0.0, 1e-6, 0.3][random.below(3)];
            *soup = join(soup, &moved(soup.clone(), by));
        }
        // The faces are reordered.
        _ => {
            for f in (1..soup.faces.len()).rev() {
                soup.faces.swap(f, random.below(f + 1));
            }
        }
    }
}

/// Keywords of the formats.
const WORDS: [&[u8]; 14] = [
    b"\n",
    b" ",
    b"-1",
    b"0",
    b"1e999",
    b"nan",
    b"99999999999",
    b"\\\n",
    b"endfacet\n",
    b"f 1 2 3\n",
    b"4 0 1 2 3\n",
    b"#",
    b"solid",
    b"\0\0\x80\x7f",
];

fn damage_bytes(bytes: &mut Vec<u8>, random: &mut Random) {
    if bytes.is_empty() {
        return;
    }
    let at = random.below(bytes.len());
    match random.below(7) {
        0 => bytes[at] ^= 1 << random.below(8),
        1 => bytes[at] = random.below(256) as u8,
        2 => {
            bytes.remove(at);
        }
        3 => {
            let word = WORDS[random.below(WORDS.len())];
            bytes.splice(at..at, word.iter().copied());
        }
        4 => {
            let end = bytes.len().min(at + 1 + random.below(200));
            let piece = bytes[at..end].to_vec();
            let to = random.below(bytes.len());
            bytes.splice(to..to, piece);
        }
        5 => {
            // A number of a binary file becomes a copy of another, or a number at the limits of arithmetic.
            let number = NUMBERS[random.below(NUMBERS.len())] as f32;
            if let Some(place) = bytes.get_mut(at..at + 4) {
                place.copy_from_slice(&number.to_le_bytes());
            }
        }
        _ => bytes.truncate(at.max(1)),
    }
}

fn ascii_stl(soup: &Soup) -> Vec<u8> {
    let mut text = String::from("solid made\n");
    for f in 0..soup.faces.len() {
        text.push_str("facet normal 0 0 0\nouter loop\n");
        for p in soup.corners(f) {
            text.push_str(&format!("vertex {:e} {:e} {:e}\n", p.x as f32, p.y as f32, p.z as f32));
        }
        text.push_str("endloop\nendfacet\n");
    }
    text.push_str("endsolid made\n");
    text.into_bytes()
}
