//! Distributions and histograms of measured quantities, and helpers for figures in JSON reports.

use serde::{Deserialize, Serialize};

use crate::math::threads;

/// Relative error of values from coordinates rounded to f32. A range up to this width is one bin, and a value this
/// little below a bin edge belongs to the bin above.
const ROUNDING: f64 = 1e-6;
/// Number of bins of a histogram.
const BINS: usize = 16;

/// Distribution of a quantity over the elements of a mesh.
///
/// The figures do not depend on the order of the values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Distribution {
    /// Number of values.
    pub count: u64,
    /// Minimum.
    pub min: f64,
    /// Maximum.
    pub max: f64,
    /// Arithmetic mean.
    pub mean: f64,
    /// Median: the middle value, or the mean of the two middle values.
    pub median: f64,
    /// Population variance, in the square of the quantity's unit.
    pub variance: f64,
    /// Number of values per bin; absent from an abridged report.
    #[serde(default, skip_serializing_if = "Histogram::is_empty")]
    pub histogram: Histogram,
}

/// Number of values per bin, usually with 16 bins.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Histogram {
    /// Spacing of the bin edges.
    pub spacing: BinSpacing,
    /// Bin edges, ascending; one more than bins. A value on an edge belongs to the bin above, except that the last
    /// bin includes the last edge. A value less than a millionth below an edge counts as on the edge, to absorb
    /// rounding. If all values are equal to within a millionth, there is one bin.
    pub edges: Vec<f64>,
    /// Number of values in each bin.
    pub counts: Vec<u64>,
}

/// Spacing of histogram bins.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum BinSpacing {
    /// All bins have equal width.
    #[default]
    Linear,
    /// Each bin is wider than the previous one by a constant factor, from the smallest positive value to the maximum.
    /// Zeros are in the first bin, which then starts at 0. Used if the maximum exceeds 16 times the smallest positive
    /// value. Equal widths would then put almost all faces of a typical mesh into the first bin.
    Geometric,
}

/// Choice of histogram bins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Bins {
    /// From the minimum to the maximum, with the spacing that [`BinSpacing`] describes.
    ByRange,
    /// This number of bins of equal width between two fixed limits that include all values. Makes histograms of
    /// several files comparable bin by bin.
    Between(f64, f64, usize),
}

impl Distribution {
    /// Describes values, which must be finite and not negative. Returns `None` if there are no values.
    #[must_use]
    pub fn of(mut values: Vec<f64>, bins: Bins) -> Option<Self> {
        let range = ValueRange::of(&values)?;
        let ValueRange { min, max, .. } = range;
        let mean = mean_of(&values, max, |x| x).clamp(min, max);
        // Squares of fractions of the maximum cannot overflow.
        let share = if max > 0.0 { max } else { 1.0 };
        let variance = mean_of(&values, 1.0, |x| ((x - mean) / share) * ((x - mean) / share));
        let histogram = Histogram::of(&values, bins, range);
        let count = values.len();
        let (below, &mut middle, _) = values.select_nth_unstable_by(count / 2, f64::total_cmp);
        let median = match below.iter().copied().max_by(f64::total_cmp) {
            Some(other) if count.is_multiple_of(2) => other * 0.5 + middle * 0.5,
            _ => middle,
        };
        let variance = finite(variance * share * share);
        Some(Self { count: count as u64, min, max, mean, median, variance, histogram })
    }

    /// Converts the figures to another unit: multiplies values by `length` to the power `dimension`. Clamps to the
    /// f64 range.
    #[must_use]
    pub fn in_unit(mut self, length: f64, dimension: u32) -> Self {
        // Multiplies by one factor at a time, since the product of the factors may overflow where the result does
        // not.
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

    /// Counts the values, which have the given range.
    fn of(values: &[f64], bins: Bins, ValueRange { min, max, positive }: ValueRange) -> Self {
        let (spacing, edges) = match bins {
            Bins::Between(low, high, bins) => (BinSpacing::Linear, linear(low, high, bins)),
            Bins::ByRange if max - min <= ROUNDING * max => (BinSpacing::Linear, vec![min, max]),
            Bins::ByRange if max / 16.0 <= positive => (BinSpacing::Linear, linear(min, max, BINS)),
            Bins::ByRange => {
                let mut edges = geometric(positive, max);
                edges[0] = min;
                (BinSpacing::Geometric, edges)
            }
        };
        let bounds: Vec<f64> = edges[1..edges.len() - 1].iter().map(|edge| edge * (1.0 - ROUNDING)).collect();
        let mut counts = vec![0; bounds.len() + 1];
        for of_chunk in threads::map_chunks(values.len(), |range| {
            let mut counts = vec![0u64; bounds.len() + 1];
            values[range].iter().for_each(|&x| counts[bounds.partition_point(|&bound| bound <= x)] += 1);
            counts
        }) {
            counts.iter_mut().zip(of_chunk).for_each(|(sum, count)| *sum += count);
        }
        Self { spacing, edges, counts }
    }
}

/// The range of some values.
#[derive(Clone, Copy)]
struct ValueRange {
    min: f64,
    max: f64,
    /// The smallest positive value; the maximum if there is none.
    positive: f64,
}

impl ValueRange {
    /// `None` if there are no values.
    fn of(values: &[f64]) -> Option<Self> {
        let of_chunks = threads::map_chunks(values.len(), |range| {
            let values = &values[range];
            Self {
                min: values.iter().copied().fold(f64::INFINITY, f64::min),
                max: values.iter().copied().fold(0.0, f64::max),
                positive: values.iter().copied().filter(|&x| x > 0.0).fold(f64::INFINITY, f64::min),
            }
        });
        let Self { min, max, positive } = of_chunks.into_iter().reduce(|a, b| Self {
            min: a.min.min(b.min),
            max: a.max.max(b.max),
            positive: a.positive.min(b.positive),
        })?;
        Some(Self { min, max, positive: if positive.is_finite() { positive } else { max } })
    }
}

#[expect(clippy::cast_precision_loss, reason = "small whole numbers")]
fn linear(low: f64, high: f64, bins: usize) -> Vec<f64> {
    let part = |i: usize| low * ((bins - i) as f64 / bins as f64) + high * (i as f64 / bins as f64);
    (0..=bins).map(part).collect()
}

/// Bisects recursively with square roots, which are identical on every machine, unlike powers.
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

/// Mean of a function of the values, which must give numbers from 0 to `largest`. Adds whole multiples of 2^-92 of
/// the magnitude of `largest`, so that neither the order of the values nor the number of threads has an effect.
#[expect(clippy::cast_precision_loss, reason = "fewer than 2^53 values, and the sum is rounded once")]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most 2^93, and not negative")]
fn mean_of(values: &[f64], largest: f64, value: impl Fn(f64) -> f64 + Sync + Send) -> f64 {
    const FINEST: f64 = (1u128 << 92) as f64;
    let size = power_of_two(largest);
    let of_chunks = threads::map_chunks(values.len(), |range| {
        values[range].iter().map(|&x| (value(x) / size * FINEST) as u128).sum::<u128>()
    });
    of_chunks.into_iter().sum::<u128>() as f64 / FINEST / values.len() as f64 * size
}

/// Largest power of two up to a normal number, for division without rounding; 1 for subnormal or non-finite numbers.
pub(super) fn power_of_two(x: f64) -> f64 {
    if x.is_normal() { f64::from_bits(x.to_bits() & 0x7FF0_0000_0000_0000) } else { 1.0 }
}

/// Clamps infinities to the largest finite numbers, since JSON cannot represent infinity.
pub(super) fn finite(x: f64) -> f64 {
    if x.is_nan() { 0.0 } else { x.clamp(f64::MIN, f64::MAX) }
}

/// Percentile of sorted values for a fraction from 0 to 1, with linear interpolation; 0 if there are no values.
pub(super) fn percentile(sorted: &[f64], share: f64) -> f64 {
    let at = share * (sorted.len().max(1) - 1) as f64;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
    let below = at.floor() as usize;
    let Some(&low) = sorted.get(below) else { return 0.0 };
    let high = sorted.get(below + 1).copied().unwrap_or(low);
    low + (high - low) * at.fract()
}

/// `part` in percent of `whole`; `None` if the result is not finite.
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
    fn figures_match_the_textbook_definitions() {
        let stats = of(&[7.0, 1.0, 4.0, 4.0]);
        assert_eq!((stats.count, stats.min, stats.max), (4, 1.0, 7.0));
        assert_eq!((stats.mean, stats.median, stats.variance), (4.0, 4.0, 4.5));
        assert_eq!(of(&[1.0, 2.0, 10.0]).median, 2.0);
        assert_eq!(of(&[1.0, 2.0, 3.0, 10.0]).median, 2.5);
        assert_eq!(Distribution::of(Vec::new(), Bins::ByRange), None);
    }

    #[test]
    fn figures_of_many_values_depend_on_neither_their_order_nor_the_threads() {
        let values: Vec<f64> = (0..200_000u64).map(|i| (i * 7919 % 199_999) as f64 * 0.1).collect();
        let expected = of(&values);
        let mut sorted = values.clone();
        sorted.sort_by(f64::total_cmp);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
        assert_eq!(pool.install(|| of(&sorted)), expected);
        assert_eq!(expected.median, (sorted[99_999] + sorted[100_000]) / 2.0);
        assert!((expected.mean - sorted.iter().sum::<f64>() / 200_000.0).abs() < 1e-6);
        assert_eq!(expected.histogram.counts.iter().sum::<u64>(), 200_000);
    }

    #[test]
    fn bins_of_equal_width_hold_every_value_once() {
        let values: Vec<f64> = (0..=16).map(|i| 16.0 + f64::from(i)).collect();
        let stats = of(&values).histogram;
        assert_eq!(stats.spacing, BinSpacing::Linear);
        assert_eq!(stats.edges, values);
        assert_eq!(stats.counts, [1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 2]);
    }

    #[test]
    fn a_wide_range_gets_geometric_bins_with_zeros_in_the_first() {
        let mut values: Vec<f64> = (0..=16).map(|i| f64::from(1u32 << i)).collect();
        let stats = of(&values).histogram;
        assert_eq!(stats.spacing, BinSpacing::Geometric);
        for (edge, value) in stats.edges.iter().zip(&values) {
            assert!((edge / value - 1.0).abs() < 1e-14, "{edge} {value}");
        }
        values.extend([0.0, 0.0]);
        let stats = of(&values).histogram;
        assert_eq!((stats.edges[0], stats.counts[0], stats.counts.iter().sum::<u64>()), (0.0, 3, 19));
    }

    #[test]
    fn equal_values_fill_one_bin_with_zero_variance() {
        let stats = of(&[0.1; 7]);
        assert_eq!((stats.mean, stats.median, stats.variance), (0.1, 0.1, 0.0));
        assert_eq!((stats.histogram.edges, stats.histogram.counts), (vec![0.1, 0.1], vec![7]));
        let stats = of(&[0.0; 3]);
        assert_eq!((stats.mean, stats.variance, stats.histogram.counts), (0.0, 0.0, vec![3]));
    }

    #[test]
    fn fixed_limits_do_not_depend_on_the_values() {
        let stats = Distribution::of(vec![0.0, 0.5, 1.0, 8.0], Bins::Between(0.0, 8.0, 16)).unwrap().histogram;
        assert_eq!((stats.edges[0], stats.edges[1], stats.edges[16]), (0.0, 0.5, 8.0));
        assert_eq!((stats.counts[0], stats.counts[1], stats.counts[2], stats.counts[15]), (1, 1, 1, 1));
    }

    #[test]
    fn values_of_any_size_give_finite_figures() {
        for x in [1e300, 1e-300, f64::MAX, 5e-324] {
            let stats = of(&[x, x / 2.0, x / 4.0]);
            let figures = [stats.min, stats.max, stats.mean, stats.median, stats.variance];
            assert!(figures.iter().chain(&stats.histogram.edges).all(|f| f.is_finite() && *f >= 0.0), "{stats:?}");
            assert!(stats.mean <= stats.max && stats.mean >= stats.min, "{stats:?}");
        }
        let scaled = of(&[1.0, 2.0]).in_unit(1e200, 2);
        assert_eq!((scaled.max, scaled.variance), (f64::MAX, f64::MAX));
    }

    #[test]
    fn unit_conversion_scales_each_figure_by_its_dimension() {
        let stats = of(&[1.0, 3.0]).in_unit(0.5, 2);
        assert_eq!((stats.min, stats.max, stats.mean, stats.variance), (0.25, 0.75, 0.5, 1.0 / 16.0));
        assert_eq!((stats.histogram.edges[0], stats.histogram.edges[16]), (0.25, 0.75));
    }
}
