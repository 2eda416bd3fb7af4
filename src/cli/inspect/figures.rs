//! Numbers, places and histograms in words.

use std::fmt::Write as _;

use meshmend::inspect::{Distribution, Histogram};

/// How wide the longest bar is, in characters.
const WIDTH: u64 = 40;
/// Most rows of a histogram; neighbouring bins share one where there are more.
const MOST_ROWS: usize = 8;
/// Longest name that stands beside its figures.
const SHORT: usize = 14;
const EIGHTHS: [&str; 8] = ["", "▏", "▎", "▍", "▌", "▋", "▊", "▉"];

/// What the output can show.
#[derive(Debug, Clone, Copy)]
pub struct Style {
    /// Blocks in eighths of a character; otherwise plain `#`.
    pub unicode: bool,
}

/// A number in six digits.
pub fn figure(x: f64) -> String {
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

fn trimmed(digits: &str) -> &str {
    if digits.contains('.') { digits.trim_end_matches('0').trim_end_matches('.') } else { digits }
}

/// The figures of a distribution, and its histogram.
pub fn distribution(name: &str, it: &Distribution, style: Style) -> String {
    figures(name, it) + &histogram(&it.histogram, style)
}

/// The figures of a distribution.
pub fn figures(name: &str, it: &Distribution) -> String {
    let values =
        [("min", it.min), ("max", it.max), ("mean", it.mean), ("median", it.median), ("variance", it.variance)];
    let values = values.map(|(name, value)| format!("{name} {}", figure(value))).join("   ");
    if name.len() <= SHORT { format!("  {name:SHORT$}  {values}\n") } else { format!("  {name}\n    {values}\n") }
}

fn histogram(it: &Histogram, style: Style) -> String {
    let it = &in_few_bins(it);
    let edges: Vec<String> = it.edges.iter().map(|&x| figure(x)).collect();
    let wide = edges.iter().map(String::len).max().unwrap_or(0);
    let most = it.counts.iter().copied().max().unwrap_or(0);
    let mut text = String::new();
    let mut at = 0;
    while at < it.counts.len() {
        let count = it.counts[at];
        // Rows of empty bins are one line.
        let empty = it.counts[at..].iter().take_while(|&&count| count == 0).count();
        let end = at + empty.max(1);
        let bar = bar(count, most, style);
        let apart = if bar.is_empty() { "" } else { " " };
        let _ = writeln!(text, "    {:>wide$} - {:<wide$}  {bar}{apart}{count}", edges[at], edges[end]);
        at = end;
    }
    text
}

/// The same, where it would take more than [`MOST_ROWS`], with as few neighbouring bins put together as leave no more.
fn in_few_bins(it: &Histogram) -> Histogram {
    let rows = it.counts.chunk_by(|a, b| a + b == 0).count();
    let together = if rows > MOST_ROWS { it.counts.len().div_ceil(MOST_ROWS) } else { 1 };
    let counts = it.counts.chunks(together).map(|bins| bins.iter().sum()).collect();
    let last = it.edges.last().filter(|_| !it.counts.len().is_multiple_of(together));
    Histogram { spacing: it.spacing, edges: it.edges.iter().step_by(together).chain(last).copied().collect(), counts }
}

/// A bar in proportion; some of it is seen wherever there is anything to count.
fn bar(count: u64, most: u64, style: Style) -> String {
    if count == 0 || most == 0 {
        return String::new();
    }
    let share = |of: u64| {
        let exact = u128::from(count) * u128::from(of) / u128::from(most);
        usize::try_from(exact).unwrap_or(usize::MAX).max(1)
    };
    if style.unicode {
        let eighths = share(WIDTH * 8);
        "█".repeat(eighths / 8) + EIGHTHS[eighths % 8]
    } else {
        "#".repeat(share(WIDTH))
    }
}

/// A place in words.
pub fn point([x, y, z]: [f64; 3]) -> String {
    format!("({}, {}, {})", figure(x), figure(y), figure(z))
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
            assert_eq!(figure(x), text);
        }
    }

    #[test]
    fn neighbouring_bins_share_a_row_and_none_is_lost() {
        for bins in [1u32, 8, 9, 16, 17] {
            let edges = (0..=bins).map(f64::from).collect();
            let all = Histogram { spacing: BinSpacing::Linear, edges, counts: vec![1; bins as usize] };
            let few = in_few_bins(&all);
            assert!(few.counts.len() <= MOST_ROWS && few.edges.len() == few.counts.len() + 1);
            assert_eq!(few.edges.last(), Some(&f64::from(bins)));
            for (count, edges) in few.counts.iter().zip(few.edges.windows(2)) {
                assert_eq!(edges[1] - edges[0], *count as f64);
            }
        }
    }

    #[test]
    fn bars_are_in_proportion_and_the_least_is_seen() {
        let (plain, blocks) = (Style { unicode: false }, Style { unicode: true });
        assert_eq!(bar(10, 10, plain), "#".repeat(40));
        assert_eq!(bar(5, 10, plain).len(), 20);
        assert_eq!((bar(1, 1_000_000, plain), bar(0, 9, plain)), ("#".to_owned(), String::new()));
        assert_eq!(bar(1, 320, blocks), "▏");
        assert_eq!(bar(9, 320, blocks), "█▏");
        assert_eq!(bar(u64::MAX, u64::MAX, blocks), "█".repeat(40));
    }
}
