//! The cells of an arrangement: regions of space bounded by facets, and the winding number of each.

use std::cmp::Ordering;

use smallvec::SmallVec;

use super::complex::{ArrangeError, Complex, SolidFaces};
use super::grid::Plane;
use crate::context::Context;
use crate::math::{Dipoles, Sign, sort_by_angle, threads, winding_exact};
use crate::mesh::{Edges, NotClosed, UnionFind};

/// How far a measured winding number may be from an integer. Beyond that the number is measured again exactly; if it is
/// still beyond, the surface counts as open.
const UNSURE: f64 = 0.2;
/// Maximum nodes and triangles visited per winding number.
const STEPS: u64 = 1_000_000;
/// Winding numbers up to this many are summed over all faces.
const FEW: usize = 4;

/// The cells between the facets, with their winding numbers.
pub(super) struct Cells {
    /// The cell on each side of each facet: side `2 w` is in front of facet `w`, where its normal points; side `2 w +
    /// 1` is behind it.
    pub of_side: Vec<u32>,
    /// The winding number of each cell. Cell numbers have gaps.
    pub winding: Vec<i32>,
    /// The connected piece of each facet. Cells of pieces that do not touch have different numbers, even if they belong
    /// to one region.
    pub piece_of: Vec<u32>,
}

impl Cells {
    /// Finds the cells and computes their winding numbers.
    pub fn new(complex: &Complex, context: &Context<'_>) -> Result<Self, ArrangeError> {
        let (of_side, piece_of) = find(complex, context)?;
        let winding = winding_numbers(complex, &of_side, &piece_of, context)?;
        Ok(Self { of_side, winding, piece_of })
    }

    /// The cells in front of and behind a facet.
    pub fn beside(&self, facet: usize) -> [usize; 2] {
        [0, 1].map(|side| self.of_side[2 * facet + side] as usize)
    }
}

/// The cell on each side of each facet, and the connected piece of each facet.
fn find(complex: &Complex, context: &Context<'_>) -> Result<(Vec<u32>, Vec<u32>), ArrangeError> {
    let facets = &complex.facets;
    let corners: Vec<[u32; 3]> = facets.iter().map(|facet| facet.corners).collect();
    let edges = Edges::new(&corners);
    context.check()?;
    // Only edges of several facets need the exact order, which takes time.
    let order = |edge: usize| order_around(complex, edges.half_edges(edge), &corners);
    let is_crowded = |edge: usize| edges.half_edges(edge).len() > 2;
    let crowded = threads::filter_map(edges.len(), |edge| is_crowded(edge).then(|| order(edge)));
    let sides = || {
        let mut sides = UnionFind::new(2 * facets.len());
        for_each_neighbours(&edges, &corners, &crowded, |(facet, forward), (next, next_forward)| {
            // The cell counter-clockwise of a forward facet is in front of it.
            sides.unite(2 * facet + u32::from(!forward), 2 * next + u32::from(next_forward));
        });
        sides.into_roots()
    };
    let pieces = || {
        let mut pieces = UnionFind::new(facets.len());
        for_each_neighbours(&edges, &corners, &crowded, |(facet, _), (next, _)| pieces.unite(facet, next));
        pieces.into_roots()
    };
    let found = threads::join(facets.len(), sides, pieces);
    context.check()?;
    Ok(found)
}

/// The facets around an edge, see [`order_around`].
type Around = SmallVec<[(u32, bool); 4]>;

/// Calls `visit` with each facet at each edge and the next facet around the edge. `crowded` has the facets around each edge with more
/// than two facets.
fn for_each_neighbours(
    edges: &Edges,
    corners: &[[u32; 3]],
    crowded: &[Around],
    mut visit: impl FnMut((u32, bool), (u32, bool)),
) {
    let mut crowded = crowded.iter();
    for half_edges in edges.iter() {
        let directed = |half_edge: u32| (half_edge / 3, Edges::is_forward(corners, half_edge));
        match *half_edges {
            [only] => visit(directed(only), directed(only)),
            [first, second] => {
                let (first, second) = (directed(first), directed(second));
                visit(first, second);
                visit(second, first);
            }
            _ => {
                let around = crowded.next().map_or(&[][..], |around| around);
                let nexts = around.iter().cycle().skip(1);
                around.iter().zip(nexts).for_each(|(&facet, &next)| visit(facet, next));
            }
        }
    }
}

/// The facets around an edge, counter-clockwise seen from its larger vertex. The flag tells whether a facet's half-edge
/// runs forward, from the smaller vertex to the larger.
pub(super) fn order_around(complex: &Complex, half_edges: &[u32], corners: &[[u32; 3]]) -> Around {
    let directed = half_edges.iter().map(|&h| (h, Edges::is_forward(corners, h)));
    if half_edges.len() <= 2 {
        return directed.map(|(h, forward)| (h / 3, forward)).collect();
    }
    let directed: Around = directed.collect();
    let planes: SmallVec<[Plane; 4]> =
        directed.iter().map(|&(h, _)| complex.plane(&complex.facets[h as usize / 3])).collect();
    // Positive if `j` is less than half a turn ahead of `i`.
    let ahead = |i: usize, j: usize| {
        let ((_, forward), (g, _)) = (directed[i], directed[j]);
        let sign = complex.points.side(&planes[i], Edges::opposite(corners, g));
        if forward { sign } else { -sign }
    };
    let quarter: SmallVec<[u8; 4]> = (0..directed.len())
        .map(|j| match (j, ahead(0, j)) {
            (0, _) => 0,
            (_, Sign::Positive) => 1,
            (_, Sign::Zero) => 2,
            (_, Sign::Negative) => 3,
        })
        .collect();
    let order = sort_by_angle(&quarter, ahead, |_, _| Ordering::Equal);
    order.into_iter().map(|i| (directed[i].0 / 3, directed[i].1)).collect()
}

/// Computes the winding numbers of the cells: measures one cell of each piece, then propagates across the piece's
/// facets.
fn winding_numbers(
    complex: &Complex,
    cell_of: &[u32],
    piece_of: &[u32],
    context: &Context<'_>,
) -> Result<Vec<i32>, ArrangeError> {
    let facets = &complex.facets;
    // The largest facet of each piece.
    let areas = threads::map_cheap(facets.len(), |facet| {
        let [a, b, c] = facets[facet].corners.map(|p| complex.points.place(p));
        (b - a).cross(c - a).length_squared()
    });
    let mut largest: Vec<u32> = (0..facets.len() as u32).collect();
    for facet in 0..facets.len() {
        let best = &mut largest[piece_of[facet] as usize];
        if areas[facet] > areas[*best as usize] {
            *best = facet as u32;
        }
    }
    drop(areas);
    // The facets of each cell.
    let mut first = vec![0u32; cell_of.len() + 1];
    cell_of.iter().for_each(|&cell| first[cell as usize + 1] += 1);
    for cell in 0..cell_of.len() {
        first[cell + 1] += first[cell];
    }
    let mut next = first.clone();
    let mut sides_of = vec![0u32; cell_of.len()];
    for (side, &cell) in (0u32..).zip(cell_of) {
        sides_of[next[cell as usize] as usize] = side;
        next[cell as usize] += 1;
    }
    let pieces: Vec<usize> = (0..facets.len()).filter(|&facet| piece_of[facet] as usize == facet).collect();
    let winding_numbers = WindingNumbers::new(complex, pieces.len());
    let mut number: Vec<Option<i32>> = vec![None; cell_of.len()];
    let mut stack = Vec::new();
    for piece in pieces {
        context.check()?;
        let start = largest[piece] as usize;
        let before = winding_numbers.before(start)?;
        number[cell_of[2 * start] as usize] = Some(before);
        stack.push(cell_of[2 * start]);
        while let Some(cell) = stack.pop() {
            let here = number[cell as usize].unwrap_or(0);
            for &side in &sides_of[first[cell as usize] as usize..first[cell as usize + 1] as usize] {
                let weight = facets[side as usize / 2].weight;
                let there = if side % 2 == 0 { here + weight } else { here - weight };
                let other = cell_of[(side ^ 1) as usize];
                match number[other as usize] {
                    None => {
                        number[other as usize] = Some(there);
                        stack.push(other);
                    }
                    Some(known) if known != there => return Err(NotClosed.into()),
                    Some(_) => {}
                }
            }
        }
    }
    Ok(number.into_iter().map(|number| number.unwrap_or(0)).collect())
}

/// Measures winding numbers with respect to the whole surface.
struct WindingNumbers<'a> {
    complex: &'a Complex,
    /// The fast sum over the faces with area; `None` where few numbers are measured, for which preparing it takes longer.
    dipoles: Option<Dipoles>,
}

impl<'a> WindingNumbers<'a> {
    /// Prepares the measurement of `count` winding numbers.
    fn new(complex: &'a Complex, count: usize) -> Self {
        let faces = &complex.solid_faces;
        Self { complex, dipoles: (count > FEW).then(|| faces.tree().dipoles(|f| faces.triangle(f))) }
    }

    /// The winding number of the cell in front of a facet. Faces that cover the facet contribute nothing at its centre.
    /// All other faces contribute the mean of the winding numbers on both sides.
    fn before(&self, facet: usize) -> Result<i32, ArrangeError> {
        let facet = &self.complex.facets[facet];
        let faces = &self.complex.solid_faces;
        let corners = facet.corners.map(|p| SolidFaces::to_unit(self.complex.points.place(p)));
        let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
        let triangle = |f: u32| {
            if facet.faces.contains(&faces.numbers[f as usize]) { [middle; 3] } else { faces.triangle(f) }
        };
        let mean = |number: f64| number - f64::from(facet.weight) / 2.0;
        let unsure = |x: f64| (x - x.round()).abs() > UNSURE;
        let mut steps = STEPS;
        let fast = self.dipoles.as_ref().map(|of| mean(faces.tree().winding(of, middle, &mut steps, triangle)));
        let number = match fast.filter(|&number| !unsure(number) && steps > 0) {
            Some(number) => number,
            None => mean(winding_exact(middle, (0..faces.corners.len() as u32).map(triangle))),
        };
        if unsure(number) {
            return Err(NotClosed.into());
        }
        #[expect(clippy::cast_possible_truncation, reason = "no more than there are faces")]
        Ok(number.round() as i32)
    }
}
