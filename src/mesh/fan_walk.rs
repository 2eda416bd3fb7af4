use super::edges::origin;
use super::{EdgeId, Edges, HalfEdgeId, Surface};

/// The corners at a vertex that follow one another across edges of exactly two faces, in order. Asks nothing of the
/// surface; where it has no edge of more than two faces at the vertex, these are all corners of the fan.
///
/// ```text
///      .   2   .          counter-clockwise seen from outside, as the face
///    3   \ | /   1        of the corner that it was asked for is turned;
///    -----  v  -----      a face that is turned the other way is passed
///    4   / | \   0        all the same
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FanWalk {
    /// The corners, each named by the half-edge that starts there. A closed walk begins with the one asked for.
    pub corners: Vec<HalfEdgeId>,
    /// The edges at which an open walk begins and ends, which have one face or more than two; none for a closed walk.
    pub ends: Option<[EdgeId; 2]>,
}

impl FanWalk {
    /// Walks both ways from a corner; none if its face has a vertex twice. O(k log d) for `k` corners and vertices of
    /// `d` faces.
    ///
    /// # Panics
    /// When there is no such corner, or `edges` are not those of the surface.
    #[must_use]
    pub fn new(surface: &Surface, edges: &Edges, corner: HalfEdgeId) -> Option<Self> {
        let faces = &surface.faces;
        let [right, left] = [corner.next(), corner.prev()].map(|h| origin(faces, h.raw()));
        let ahead = match walk(faces, edges, corner, left)? {
            (corners, None) => return Some(Self { corners, ends: None }),
            (corners, Some(end)) => (corners, end),
        };
        // Not closed ahead, so that the way back does not close either.
        let (mut corners, begin) = walk(faces, edges, corner, right)?;
        corners.reverse();
        corners.extend(ahead.0.into_iter().skip(1));
        Some(Self { corners, ends: begin.map(|begin| [begin, ahead.1]) })
    }
}

/// From a corner on across the edge to `toward`, until an edge that has not two faces, which is answered too, or until
/// the corner comes again.
fn walk(faces: &[[u32; 3]], edges: &Edges, from: HalfEdgeId, toward: u32) -> Option<(Vec<HalfEdgeId>, Option<EdgeId>)> {
    let centre = origin(faces, from.raw());
    let (mut corners, mut at, mut toward) = (vec![from], from, toward);
    loop {
        let edge = edges.find(centre, toward)?;
        let &[one, other] = edges.half_edges(edge) else {
            #[expect(clippy::cast_possible_truncation, reason = "there are fewer than 2^32 half-edges")]
            return Some((corners, Some(EdgeId::new(edge as u32))));
        };
        let across = if one / 3 == at.raw() / 3 { other } else { one };
        let around = HalfEdgeId::new(across).face().half_edges();
        at = around.into_iter().find(|h| origin(faces, h.raw()) == centre)?;
        if at == from {
            return Some((corners, None));
        }
        corners.push(at);
        toward = faces[at.face().index()].into_iter().find(|&v| v != centre && v != toward)?;
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;
    use glam::DVec3;

    /// Faces in the order of the walk, and the edges at its ends.
    type Walked = (Vec<u32>, Option<[[u32; 2]; 2]>);

    fn walk_of(faces: &[[u32; 3]], corner: u32) -> Option<Walked> {
        let positions = (0..9).map(|i| DVec3::splat(f64::from(i))).collect();
        let surface = Surface { positions, faces: faces.to_vec(), source: vec![0; faces.len()] };
        let edges = Edges::new(&surface.faces);
        let it = FanWalk::new(&surface, &edges, HalfEdgeId::new(corner))?;
        let ends = it.ends.map(|ends| ends.map(|e| edges.vertices(e.index())));
        Some((it.corners.into_iter().map(|c| c.face().raw()).collect(), ends))
    }

    #[test]
    fn a_closed_fan_is_walked_once_around_from_the_corner_asked_for() {
        let faces = [[0, 1, 2], [0, 3, 4], [0, 2, 3], [4, 1, 0]];
        assert_eq!(walk_of(&faces, 0).unwrap(), (vec![0, 2, 1, 3], None));
        assert_eq!(walk_of(&faces, 6).unwrap(), (vec![2, 1, 3, 0], None));
    }

    #[test]
    fn an_open_fan_is_walked_from_boundary_to_boundary_also_across_a_turned_face() {
        for middle in [[0, 2, 3], [0, 3, 2]] {
            let walked = walk_of(&[[0, 1, 2], middle, [4, 0, 3]], 0).unwrap();
            assert_eq!(walked, (vec![0, 1, 2], Some([[0, 1], [0, 4]])));
        }
    }

    #[test]
    fn a_walk_ends_where_an_edge_has_three_faces() {
        let faces = [[0, 1, 2], [0, 2, 3], [0, 2, 4], [0, 5, 1]];
        assert_eq!(walk_of(&faces, 0).unwrap(), (vec![3, 0], Some([[0, 5], [0, 2]])));
    }

    #[test]
    fn two_faces_on_one_another_are_a_closed_fan_and_a_repeated_vertex_has_none() {
        assert_eq!(walk_of(&[[0, 1, 2], [0, 2, 1]], 3).unwrap(), (vec![1, 0], None));
        assert_eq!(walk_of(&[[0, 1, 1]], 0), None);
    }
}
