//! Formats numbers, points, distributions and histograms as text.

use std::fmt::Write as _;

use meshmend::inspect::{Distribution, Histogram};

/// Length of the longest bar, in characters.
const BAR_WIDTH: u64 = 40;
/// Most rows of a histogram; with more bins, neighbouring bins share a row.
const MAX_ROWS: usize = 8;
/// Longest name on the same line as its numbers.
const NAME_WIDTH: usize = 14;
const EIGHTHS: [&str; 8] = ["", "▏", "▎", "▍", "▌", "▋", "▊", "▉"];

/// The characters that the output may use.
#[derive(Debug, Clone, Copy)]
pub struct Style {
    /// Draw bars with block characters, in eighths of a character; otherwise with `#`.
    pub unicode: bool,
}

/// Formats a number with six significant digits.
pub fn format_number(x: f64) -> String {
    let size = x.abs();
    if x == 0.0 {
        return "0".to_owned();
    }
    if !(1e-4..1e9).contains(&size) {
        let text = format!("{x:.5e}");
        let Some((digits, exponent)) = text.split_once('e') else { return text };
        return format!("{}e{exponent}", trimmed(digits));
    }
    let mut decimals = 5;
    let mut bound = 10.0;
    while decimals > 0 && size >= bound {
        decimals -= 1;
        bound *= 10.0;
    }
    let mut bound = 1.0;
    while size < bound {
        decimals += 1;
        bound /= 10.0;
    }
    trimmed(&format!("{x:.decimals$}")).to_owned()
}

/// Without trailing zeros after the decimal point.
fn trimmed(digits: &str) -> &str {
    if digits.contains('.') { digits.trim_end_matches('0').trim_end_matches('.') } else { digits }
}

/// The statistics of a distribution, and its histogram.
pub fn distribution(name: &str, values: &Distribution, style: Style) -> String {
    statistics(name, values) + &histogram(&values.histogram, style)
}

/// The statistics of a distribution, on one line or two.
pub fn statistics(name: &str, values: &Distribution) -> String {
    let fields = [
        ("min", values.min),
        ("max", values.max),
        ("mean", values.mean),
        ("median", values.median),
        ("variance", values.variance),
    ];
    let text = fields.map(|(field, value)| format!("{field} {}", format_number(value))).join("   ");
    if name.len() <= NAME_WIDTH { format!("  {name:NAME_WIDTH$}  {text}\n") } else { format!("  {name}\n    {text}\n") }
}

/// A line with a bar for each bin; runs of empty bins share a line.
fn histogram(histogram: &Histogram, style: Style) -> String {
    let histogram = &with_fewer_bins(histogram);
    let edges: Vec<String> = histogram.edges.iter().map(|&x| format_number(x)).collect();
    let width = edges.iter().map(String::len).max().unwrap_or(0);
    let max_count = histogram.counts.iter().copied().max().unwrap_or(0);
    let mut text = String::new();
    let mut at = 0;
    while at < histogram.counts.len() {
        let count = histogram.counts[at];
        let empty = histogram.counts[at..].iter().take_while(|&&count| count == 0).count();
        let end = at + empty.max(1);
        let bar = bar(count, max_count, style);
        let space = if bar.is_empty() { "" } else { " " };
        let _ = writeln!(text, "    {:>width$} - {:<width$}  {bar}{space}{count}", edges[at], edges[end]);
        at = end;
    }
    text
}

/// Merges neighbouring bins if the histogram would have more than [`MAX_ROWS`] rows, as merged as needed.
fn with_fewer_bins(histogram: &Histogram) -> Histogram {
    let rows = histogram.counts.chunk_by(|a, b| a + b == 0).count();
    let bins_per_row = if rows > MAX_ROWS { histogram.counts.len().div_ceil(MAX_ROWS) } else { 1 };
    let counts = histogram.counts.chunks(bins_per_row).map(|bins| bins.iter().sum()).collect();
    let last = histogram.edges.last().filter(|_| !histogram.counts.len().is_multiple_of(bins_per_row));
    let edges = histogram.edges.iter().step_by(bins_per_row).chain(last).copied().collect();
    Histogram { spacing: histogram.spacing, edges, counts }
}

/// A bar in proportion to `max_count`. The smallest non-zero count still gives a visible bar.
fn bar(count: u64, max_count: u64, style: Style) -> String {
    if count == 0 || max_count == 0 {
        return String::new();
    }
    let scaled = |width: u64| {
        let exact = u128::from(count) * u128::from(width) / u128::from(max_count);
        usize::try_from(exact).unwrap_or(usize::MAX).max(1)
    };
    if style.unicode {
        let eighths = scaled(BAR_WIDTH * 8);
        "█".repeat(eighths / 8) + EIGHTHS[eighths % 8]
    } else {
        "#".repeat(scaled(BAR_WIDTH))
    }
}

/// Formats a point.
pub fn format_point([x, y, z]: [f64; 3]) -> String {
    format!("({}, {}, {})", format_number(x), format_number(y), format_number(z))
}

#[cfg(test)]
mod tests {
    use meshmend::inspect::BinSpacing;

    use super::*;

    #[test]
    fn numbers_are_short_and_keep_six_digits() {
        for (x, text) in [
            (0.0, "0"),
            (12.0, "12"),
            (0.5, "0.5"),
            (1.0 / 3.0, "0.333333"),
            (123_456.7, "123457"),
            (99.123_456, "99.1235"),
            (0.000_123_456_7, "0.000123457"),
            (-2.25, "-2.25"),
            (1e300, "1e300"),
            (1.5e-7, "1.5e-7"),
        ] {
            assert_eq!(format_number(x), text);
        }
    }

    #[test]
    fn neighbouring_bins_share_a_row_and_no_count_is_lost() {
        for bins in [1u32, 8, 9, 16, 17] {
            let edges = (0..=bins).map(f64::from).collect();
            let original = Histogram { spacing: BinSpacing::Linear, edges, counts: vec![1; bins as usize] };
            let merged = with_fewer_bins(&original);
            assert!(merged.counts.len() <= MAX_ROWS && merged.edges.len() == merged.counts.len() + 1);
            assert_eq!(merged.edges.last(), Some(&f64::from(bins)));
            for (count, edges) in merged.counts.iter().zip(merged.edges.windows(2)) {
                assert_eq!(edges[1] - edges[0], *count as f64);
            }
        }
    }

    #[test]
    fn bars_are_in_proportion_and_the_smallest_is_visible() {
        let (plain, blocks) = (Style { unicode: false }, Style { unicode: true });
        assert_eq!(bar(10, 10, plain), "#".repeat(40));
        assert_eq!(bar(5, 10, plain).len(), 20);
        assert_eq!((bar(1, 1_000_000, plain), bar(0, 9, plain)), ("#".to_owned(), String::new()));
        assert_eq!(bar(1, 320, blocks), "▏");
        assert_eq!(bar(9, 320, blocks), "█▏");
        assert_eq!(bar(u64::MAX, u64::MAX, blocks), "█".repeat(40));
    }
}
