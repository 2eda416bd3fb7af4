use serde::{Deserialize, Serialize};

/// What rounding of coordinates to f32 makes of equal values, as a share of them: a range no wider is one bin, and a value that is so little
/// below a border is on it.
const NOISE: f64 = 1e-6;
/// Bins of a histogram.
const BINS: usize = 16;

/// How a quantity is distributed over the elements of a mesh.
///
/// The same values in any order give the same figures: they are sorted before they are added.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Distribution {
    /// How many values there are.
    pub count: u64,
    /// The smallest.
    pub min: f64,
    /// The largest.
    pub max: f64,
    /// The arithmetic mean.
    pub mean: f64,
    /// The middle value, or the mean of the two in the middle.
    pub median: f64,
    /// The mean of the squared distances to the mean, in the square of the quantity's unit.
    pub variance: f64,
    /// How many values there are in each of a row of bins; left out of an abridged report.
    #[serde(default, skip_serializing_if = "Histogram::is_empty")]
    pub histogram: Histogram,
}

/// How many values there are in each of a row of bins, usually 16.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Histogram {
    /// How the edges are placed.
    pub spacing: BinSpacing,
    /// The borders of the bins, ascending, one more than there are bins. A value on a border belongs to the bin above it, the
    /// last border to the last bin; a value counts as on a border that is above it by a millionth at most, which is rounding. A range so
    /// narrow is one bin.
    pub edges: Vec<f64>,
    /// The values in each bin.
    pub counts: Vec<u64>,
}

/// How the bins of a histogram are placed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum BinSpacing {
    /// All of the same width.
    #[default]
    Linear,
    /// Each wider than the one before by the same factor, from the smallest value above 0 to the largest; zeros are in the
    /// first bin, which then begins at 0. Chosen where the largest value is over 16 times the smallest: with bins of one
    /// width nearly all faces of a usual mesh would stand in the first.
    Geometric,
}

/// Which bins to count in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Bins {
    /// From the smallest value to the largest, spaced as [`BinSpacing`] says.
    ByRange,
    /// This many of the same width between two fixed borders that hold all values, so that files can be compared bin by
    /// bin.
    Between(f64, f64, usize),
}

impl Distribution {
    /// Describes values, which must be finite and not negative; none where there is no value.
    #[must_use]
    pub fn of(mut values: Vec<f64>, bins: Bins) -> Option<Self> {
        values.sort_unstable_by(f64::total_cmp);
        let (&min, &max) = (values.first()?, values.last()?);
        let mean = mean_of(values.iter().copied(), max, values.len()).clamp(min, max);
        // The squares are taken of shares of the largest value, which can't overflow.
        let share = if max > 0.0 { max } else { 1.0 };
        let squares = values.iter().map(|&x| ((x - mean) / share) * ((x - mean) / share));
        let variance = mean_of(squares, 1.0, values.len());
        let half = values.len() / 2;
        let median = if values.len() % 2 == 1 { values[half] } else { values[half - 1] * 0.5 + values[half] * 0.5 };
        let histogram = Histogram::of(&values, bins);
        let variance = finite(variance * share * share);
        Some(Self { count: values.len() as u64, min, max, mean, median, variance, histogram })
    }

    /// The same values, each multiplied by `length` to the power `dimension`: those of the model in another unit. What no
    /// f64 holds becomes the largest that there is.
    #[must_use]
    pub fn in_unit(mut self, length: f64, dimension: u32) -> Self {
        // One factor after another: their product may overflow where the result does not.
        let scaled = |x: f64, power: u32| finite((0..power).fold(x, |x, _| x * length));
        for value in [&mut self.min, &mut self.max, &mut self.mean, &mut self.median] {
            *value = scaled(*value, dimension);
        }
        self.variance = scaled(self.variance, 2 * dimension);
        for edge in &mut self.histogram.edges {
            *edge = scaled(*edge, dimension);
        }
        self
    }
}

impl Histogram {
    fn is_empty(&self) -> bool {
        self.counts.is_empty()
    }

    /// Counts sorted values, of which there must be one.
    fn of(sorted: &[f64], bins: Bins) -> Self {
        let (first, last) = (sorted[0], sorted[sorted.len() - 1]);
        let positive = sorted.get(sorted.partition_point(|&x| x <= 0.0)).copied().unwrap_or(last);
        let (spacing, edges) = match bins {
            Bins::Between(low, high, bins) => (BinSpacing::Linear, linear(low, high, bins)),
            Bins::ByRange if last - first <= NOISE * last => (BinSpacing::Linear, vec![first, last]),
            Bins::ByRange if last / 16.0 <= positive => (BinSpacing::Linear, linear(first, last, BINS)),
            Bins::ByRange => {
                let mut edges = geometric(positive, last);
                edges[0] = first;
                (BinSpacing::Geometric, edges)
            }
        };
        let mut begin = 0;
        let counts = (1..edges.len())
            .map(|bin| {
                let end = if bin + 1 == edges.len() {
                    sorted.len()
                } else {
                    sorted.partition_point(|&x| x < edges[bin] * (1.0 - NOISE)).max(begin)
                };
                let count = end - begin;
                begin = end;
                count as u64
            })
            .collect();
        Self { spacing, edges, counts }
    }
}

#[expect(clippy::cast_precision_loss, reason = "small whole numbers")]
fn linear(low: f64, high: f64, bins: usize) -> Vec<f64> {
    let part = |i: usize| low * ((bins - i) as f64 / bins as f64) + high * (i as f64 / bins as f64);
    (0..=bins).map(part).collect()
}

/// Halved again and again by square roots, which are the same on every machine as powers are not.
fn geometric(low: f64, high: f64) -> Vec<f64> {
    let mut edges = vec![low; BINS + 1];
    edges[BINS] = high;
    let mut step = BINS;
    while step > 1 {
        for i in (0..BINS).step_by(step) {
            edges[i + step / 2] = edges[i].sqrt() * edges[i + step].sqrt();
        }
        step /= 2;
    }
    edges
}

/// The mean of values of which none is larger than `largest`; the sum is of shares of it, and of what each addition
/// rounds off (Neumaier 1974).
#[expect(clippy::cast_precision_loss, reason = "fewer than 2^53 values")]
fn mean_of(values: impl Iterator<Item = f64>, largest: f64, count: usize) -> f64 {
    if largest <= 0.0 {
        return 0.0;
    }
    let (mut sum, mut lost) = (0.0f64, 0.0);
    for x in values.map(|x| x / largest) {
        let next = sum + x;
        lost += if sum.abs() >= x.abs() { (sum - next) + x } else { (x - next) + sum };
        sum = next;
    }
    (sum + lost) / count as f64 * largest
}

/// JSON has no word for infinity.
pub(super) fn finite(x: f64) -> f64 {
    if x.is_nan() { 0.0 } else { x.clamp(f64::MIN, f64::MAX) }
}

/// The value below which a share of sorted values lies, between two of them in proportion; 0 where there is none.
pub(super) fn percentile(sorted: &[f64], share: f64) -> f64 {
    let at = share * (sorted.len().max(1) - 1) as f64;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
    let below = at.floor() as usize;
    let Some(&low) = sorted.get(below) else { return 0.0 };
    let high = sorted.get(below + 1).copied().unwrap_or(low);
    low + (high - low) * at.fract()
}

/// A part in percent of a whole's size; none where that is no number.
#[must_use]
pub fn percent(part: f64, whole: f64) -> Option<f64> {
    let value = part / whole.abs() * 100.0;
    (whole != 0.0 && value.is_finite()).then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(values: &[f64]) -> Distribution {
        Distribution::of(values.to_vec(), Bins::ByRange).unwrap()
    }

    #[test]
    fn figures_are_those_of_the_textbook() {
        let it = of(&[7.0, 1.0, 4.0, 4.0]);
        assert_eq!((it.count, it.min, it.max), (4, 1.0, 7.0));
        assert_eq!((it.mean, it.median, it.variance), (4.0, 4.0, 4.5));
        assert_eq!(of(&[1.0, 2.0, 10.0]).median, 2.0);
        assert_eq!(of(&[1.0, 2.0, 3.0, 10.0]).median, 2.5);
        assert_eq!(Distribution::of(Vec::new(), Bins::ByRange), None);
    }

    #[test]
    fn bins_of_one_width_hold_every_value_once() {
        let values: Vec<f64> = (0..=16).map(|i| 16.0 + f64::from(i)).collect();
        let it = of(&values).histogram;
        assert_eq!(it.spacing, BinSpacing::Linear);
        assert_eq!(it.edges, values);
        assert_eq!(it.counts, [1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 2]);
    }

    #[test]
    fn a_wide_range_gets_bins_that_grow_by_one_factor_and_zeros_are_in_the_first() {
        let mut values: Vec<f64> = (0..=16).map(|i| f64::from(1u32 << i)).collect();
        let it = of(&values).histogram;
        assert_eq!(it.spacing, BinSpacing::Geometric);
        for (edge, value) in it.edges.iter().zip(&values) {
            assert!((edge / value - 1.0).abs() < 1e-14, "{edge} {value}");
        }
        values.extend([0.0, 0.0]);
        let it = of(&values).histogram;
        assert_eq!((it.edges[0], it.counts[0], it.counts.iter().sum::<u64>()), (0.0, 3, 19));
    }

    #[test]
    fn equal_values_are_one_bin_and_vary_by_nothing() {
        let it = of(&[0.1; 7]);
        assert_eq!((it.mean, it.median, it.variance), (0.1, 0.1, 0.0));
        assert_eq!((it.histogram.edges, it.histogram.counts), (vec![0.1, 0.1], vec![7]));
        let it = of(&[0.0; 3]);
        assert_eq!((it.mean, it.variance, it.histogram.counts), (0.0, 0.0, vec![3]));
    }

    #[test]
    fn fixed_borders_do_not_move_with_the_values() {
        let it = Distribution::of(vec![0.0, 0.5, 1.0, 8.0], Bins::Between(0.0, 8.0, 16)).unwrap().histogram;
        assert_eq!((it.edges[0], it.edges[1], it.edges[16]), (0.0, 0.5, 8.0));
        assert_eq!((it.counts[0], it.counts[1], it.counts[2], it.counts[15]), (1, 1, 1, 1));
    }

    #[test]
    fn values_of_any_size_give_finite_figures() {
        for x in [1e300, 1e-300, f64::MAX, 5e-324] {
            let it = of(&[x, x / 2.0, x / 4.0]);
            let figures = [it.min, it.max, it.mean, it.median, it.variance];
            assert!(figures.iter().chain(&it.histogram.edges).all(|f| f.is_finite() && *f >= 0.0), "{it:?}");
            assert!(it.mean <= it.max && it.mean >= it.min, "{it:?}");
        }
        let scaled = of(&[1.0, 2.0]).in_unit(1e200, 2);
        assert_eq!((scaled.max, scaled.variance), (f64::MAX, f64::MAX));
    }

    #[test]
    fn a_unit_changes_each_figure_by_its_power() {
        let it = of(&[1.0, 3.0]).in_unit(0.5, 2);
        assert_eq!((it.min, it.max, it.mean, it.variance), (0.25, 0.75, 0.5, 1.0 / 16.0));
        assert_eq!((it.histogram.edges[0], it.histogram.edges[16]), (0.25, 0.75));
    }
}
