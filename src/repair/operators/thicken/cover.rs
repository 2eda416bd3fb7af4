use crate::mesh::{Edges, Surface, UnionFind};
use crate::repair::operators::cut::{NONE, Pairing, mates};
use crate::repair::{Cancelled, Context};

/// The double cover of a part of a surface, by corners: two sides of each corner, joined to those of its neighbours across
/// edges. Corners that follow one another are a fan, and a fan has two sides, since the faces around one vertex are a disc
/// whatever the whole is.
pub(super) struct Cover {
    /// The faces that are covered. A corner is `3 * i + c` for the `i`-th of them.
    pub faces: Vec<u32>,
    /// The half-edges across which nothing goes on, as corners.
    pub boundary: Vec<u32>,
    /// For each corner its fan, and above it whether the corner's front is the fan's back.
    of_corner: Vec<u32>,
    /// The vertex of each fan.
    vertices: Vec<u32>,
}

impl Cover {
    pub fn new(surface: &Surface, faces: &[u32], context: &Context<'_>) -> Result<Self, Cancelled> {
        let of = |f: &u32| surface.faces[*f as usize];
        let part = Surface {
            positions: surface.positions.clone(),
            faces: faces.iter().map(of).collect(),
            source: vec![0; faces.len()],
        };
        let edges = Edges::new(&part.faces);
        let mates = mates(&part, &edges, Pairing::Angular, context)?.of;
        let node = |corner: u32, side: u32| 2 * corner + side;
        let mut sets = UnionFind::new(part.faces.len() * 6);
        let mut boundary = Vec::new();
        for (h, &mate) in (0u32..).zip(&mates) {
            if mate == NONE {
                boundary.push(h);
            } else if mate > h {
                let same_way = Edges::ends(&part.faces, h) == Edges::ends(&part.faces, mate);
                let (start, end) = if same_way { (mate, Edges::next(mate)) } else { (Edges::next(mate), mate) };
                for side in 0..2 {
                    let other = side ^ u32::from(same_way);
                    sets.unite(node(h, side), node(start, other));
                    sets.unite(node(Edges::next(h), side), node(end, other));
                }
            }
        }
        let roots = sets.into_roots();
        let mut number = vec![NONE; roots.len()];
        let (mut of_corner, mut vertices) = (Vec::with_capacity(mates.len()), Vec::new());
        for (corner, sides) in roots.as_chunks::<2>().0.iter().enumerate() {
            // The smaller root is the front of the fan's first corner.
            let [front, back] = *sides;
            let (root, turned) = if front <= back { (front, false) } else { (back, true) };
            let fan = &mut number[root as usize];
            if *fan == NONE {
                #[expect(clippy::cast_possible_truncation, reason = "no more fans than corners")]
                {
                    *fan = vertices.len() as u32;
                }
                vertices.push(part.faces[corner / 3][corner % 3]);
            }
            of_corner.push(*fan << 1 | u32::from(turned));
        }
        Ok(Self { faces: faces.to_vec(), boundary, of_corner, vertices })
    }

    /// How many fans there are.
    pub fn fans(&self) -> usize {
        self.vertices.len()
    }

    /// The fan of a corner, and whether the front of the corner's face is at the fan's back.
    pub fn at(&self, corner: usize) -> (usize, bool) {
        let packed = self.of_corner[corner];
        ((packed >> 1) as usize, packed & 1 == 1)
    }

    /// The vertex that a fan is at.
    pub fn vertex(&self, fan: usize) -> u32 {
        self.vertices[fan]
    }
}
