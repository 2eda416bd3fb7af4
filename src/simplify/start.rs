use glam::DVec3;

use super::complex::{Complex, LINE, OPEN};
use super::quadric::Quadric;
use crate::context::{Cancelled, Context};
use crate::math::collinear;
use crate::mesh::{Edges, Fans, Parts, Surface};

/// Weight of what holds a line in its place, against that of surface: the line's length squared is the unit.
const LINE_WEIGHT: f64 = 1.0;

/// The parts of the surface at the start.
pub(super) struct Bodies {
    /// The part of each vertex that takes part in collapses.
    pub of_vertex: Vec<u32>,
    /// For each part six times its volume now and at the start; none for those that are open.
    pub volumes: Vec<Option<[f64; 2]>>,
}

/// Finds what must be kept of a surface whose vertices stand at different positions, `unit` being those in the range of exact
/// predicates: lines, vertices that are no inner or boundary vertex of a manifold, parts; and the quadrics.
pub(super) fn prepare(
    welded: &Surface,
    unit: Vec<DVec3>,
    feature_cosine: f64,
    context: &Context<'_>,
) -> Result<(Complex, Bodies), Cancelled> {
    let edges = Edges::new(&welded.faces);
    context.check()?;
    let parts = Parts::new(welded, &edges);
    let open = parts.open(&edges);
    let mut it = Complex::new(unit, welded.faces.clone());
    fix_irregular(&mut it, welded, &edges);
    context.check()?;
    let normals: Vec<DVec3> = (0..it.faces.len()).map(|f| area_vector(it.corners(f))).collect();
    for (f, &normal) in normals.iter().enumerate() {
        let [a, b, c] = it.corners(f);
        it.flat[f] = collinear(a, b, c);
        let doubled = normal.length();
        if doubled > 0.0 {
            let plane = Quadric::plane(normal / doubled, a, doubled * 0.5);
            for v in it.faces[f] {
                it.quadric[v as usize].add(&plane);
            }
        }
    }
    context.check()?;
    for e in 0..edges.len() {
        mark_line(&mut it, &edges, e, &normals, feature_cosine);
    }
    let mut bodies = Bodies {
        of_vertex: vec![Parts::NONE; it.at.len()],
        volumes: open.iter().map(|&open| (!open).then_some([0.0; 2])).collect(),
    };
    // Parts that share an edge of more than two faces are one here, and have no volume of their own.
    for half_edges in edges.iter().filter(|h| h.len() > 2) {
        let part = parts.of_face[half_edges[0] as usize / 3];
        bodies.volumes[part as usize] = None;
    }
    for (f, &part) in parts.of_face.iter().enumerate().filter(|(_, part)| **part != Parts::NONE) {
        let [a, b, c] = it.corners(f);
        if let Some(volume) = &mut bodies.volumes[part as usize] {
            volume[0] += a.dot(b.cross(c));
        }
        for v in it.faces[f] {
            bodies.of_vertex[v as usize] = part;
        }
    }
    for volume in bodies.volumes.iter_mut().flatten() {
        volume[1] = volume[0];
    }
    Ok((it, bodies))
}

/// Fixes the vertices whose faces are not one fan, or disagree in their winding.
fn fix_irregular(it: &mut Complex, welded: &Surface, edges: &Edges) {
    for e in 0..edges.len() {
        let half_edges = edges.half_edges(e);
        let regular = match *half_edges {
            [_] => true,
            [x, y] => Edges::is_forward(&it.faces, x) != Edges::is_forward(&it.faces, y),
            _ => false,
        };
        if !regular {
            for v in edges.vertices(e) {
                it.fixed[v as usize] = true;
            }
        }
    }
    let fans = Fans::new(welded, edges);
    let mut fans_at = vec![0u8; it.at.len()];
    for (&root, c) in fans.of_corner.iter().zip(0u32..) {
        let v = it.faces[c as usize / 3][c as usize % 3] as usize;
        if root == c {
            fans_at[v] = fans_at[v].saturating_add(1);
        }
        // A face with the same vertex twice is in no fan.
        it.fixed[v] |= root == u32::MAX;
    }
    for (fixed, fans) in it.fixed.iter_mut().zip(fans_at) {
        *fixed |= fans != 1;
    }
}

/// Marks an edge that must be kept, and holds it in its place: by planes through it that stand on its faces.
fn mark_line(it: &mut Complex, edges: &Edges, e: usize, normals: &[DVec3], feature_cosine: f64) {
    let half_edges = edges.half_edges(e);
    let marks = match *half_edges {
        [_] => LINE | OPEN,
        [x, y] => {
            let [n, m] = [x, y].map(|h| normals[h as usize / 3]);
            let scale = (n.length_squared() * m.length_squared()).sqrt();
            if scale > 0.0 && n.dot(m) < feature_cosine * scale { LINE } else { return }
        }
        _ => LINE,
    };
    let ends = edges.vertices(e);
    let [p, q] = ends.map(|v| it.at[v as usize]);
    for v in ends {
        it.lines[v as usize] = it.lines[v as usize].saturating_add(1);
    }
    for &h in half_edges {
        it.mark(h, marks);
        let across = normals[h as usize / 3].cross(q - p).normalize_or_zero();
        let plane = Quadric::plane(across, p, LINE_WEIGHT * p.distance_squared(q));
        for v in ends {
            it.quadric[v as usize].add(&plane);
        }
    }
}

/// Twice the area of a triangle times its unit normal.
pub(super) fn area_vector([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}
