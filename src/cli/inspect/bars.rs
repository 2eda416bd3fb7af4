use std::fmt::Write as _;

use meshmend::inspect::{Distribution, Histogram};

/// How wide the longest bar is, in characters.
const WIDTH: u64 = 40;
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

/// The figures of a distribution on two lines, and its histogram.
pub fn distribution(name: &str, it: &Distribution, style: Style) -> String {
    let mut text = String::new();
    // Writing to a string can't fail.
    let _ = writeln!(text, "  {name}: {} values", it.count);
    let _ = writeln!(
        text,
        "    min {}   max {}   mean {}   median {}   variance {}",
        figure(it.min),
        figure(it.max),
        figure(it.mean),
        figure(it.median),
        figure(it.variance)
    );
    text + &histogram(&it.histogram, style)
}

fn histogram(it: &Histogram, style: Style) -> String {
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

#[cfg(test)]
mod tests {
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
