use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// An edge that waits to be collapsed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Waiting {
    cost: f64,
    /// Its vertices, the smaller first.
    pub ends: [u32; 2],
    /// The sum of their versions when it was put in.
    pub version: u32,
    /// Whether it is on a line.
    pub along_line: bool,
    /// Whether it has waited for others already.
    pub patient: bool,
}

impl Ord for Waiting {
    /// The cheapest is the greatest; of equals that with the smallest vertices.
    fn cmp(&self, other: &Self) -> Ordering {
        other.cost.total_cmp(&self.cost).then_with(|| other.ends.cmp(&self.ends)).then_with(|| {
            (other.version, other.patient, other.along_line).cmp(&(self.version, self.patient, self.along_line))
        })
    }
}

impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Waiting {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Waiting {}

/// Edges, the cheapest first.
#[derive(Default)]
pub(super) struct Queue {
    heap: BinaryHeap<Waiting>,
    /// Those that are put in together, see [`Queue::fill`].
    batch: Vec<Waiting>,
}

impl Queue {
    pub fn push(&mut self, cost: f64, waiting: Waiting) {
        self.heap.push(Waiting { cost, ..waiting });
    }

    /// Puts edges into an empty queue in linear time.
    pub fn fill(&mut self, edges: impl Iterator<Item = (f64, Waiting)>) {
        self.batch = std::mem::take(&mut self.heap).into_vec();
        self.batch.clear();
        self.batch.extend(edges.map(|(cost, waiting)| Waiting { cost, ..waiting }));
        self.heap = BinaryHeap::from(std::mem::take(&mut self.batch));
    }

    pub fn pop(&mut self) -> Option<(f64, Waiting)> {
        self.heap.pop().map(|waiting| (waiting.cost, waiting))
    }
}

impl Waiting {
    pub fn new(a: u32, b: u32, version: u32, along_line: bool) -> Self {
        Self { cost: 0.0, ends: [a.min(b), a.max(b)], version, along_line, patient: false }
    }

    /// The same edge when it has waited for others.
    pub fn patient(self) -> Self {
        Self { patient: true, ..self }
    }
}
