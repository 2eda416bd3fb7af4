//! Values of attributes, as 3MF's schema has them.

use std::str::FromStr;

use glam::{DAffine3, DMat3, DVec3};

/// A whole number below 2^31: `ST_ResourceID`, `ST_ResourceIndex`.
#[inline]
pub(super) fn index(value: &[u8]) -> Option<u32> {
    let digits = value.trim_ascii();
    if digits.is_empty() {
        return None;
    }
    digits.iter().try_fold(0_u32, |sum, &digit| match digit {
        b'0'..=b'9' => sum.checked_mul(10)?.checked_add(u32::from(digit - b'0')).filter(|&it| it < 1 << 31),
        _ => None,
    })
}

/// A finite decimal number: `ST_Number`.
#[inline]
pub(super) fn number(value: &[u8]) -> Option<f64> {
    let word = value.trim_ascii();
    // What else Rust takes for a number is words: `inf`, `NaN`.
    if !word.iter().all(|b| matches!(b, b'0'..=b'9' | b'.' | b'-' | b'+' | b'e' | b'E')) {
        return None;
    }
    f64::from_str(std::str::from_utf8(word).ok()?).ok().filter(|it| it.is_finite())
}

/// Words between white space.
pub(super) fn words(value: &[u8]) -> impl Iterator<Item = &[u8]> {
    value.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
}

/// Twelve numbers, a point's coordinates standing before the matrix as a row: `ST_Matrix3D`.
pub(super) fn matrix(value: &[u8]) -> Option<DAffine3> {
    let mut numbers = [0.0; 12];
    let mut all = words(value);
    for slot in &mut numbers {
        *slot = number(all.next()?)?;
    }
    let [m00, m01, m02, m10, m11, m12, m20, m21, m22, m30, m31, m32] = numbers;
    let matrix3 = DMat3::from_cols_array(&[m00, m01, m02, m10, m11, m12, m20, m21, m22]);
    all.next().is_none().then_some(DAffine3 { matrix3, translation: DVec3::new(m30, m31, m32) })
}

/// `#RRGGBB` or `#RRGGBBAA`: `ST_ColorValue`.
pub(super) fn color(value: &[u8]) -> Option<[u8; 4]> {
    let digits = value.trim_ascii().strip_prefix(b"#")?;
    let mut color = [0, 0, 0, 255];
    let channels = match digits.len() {
        6 | 8 => digits.chunks_exact(2),
        _ => return None,
    };
    for (channel, pair) in color.iter_mut().zip(channels) {
        let digit = |b: u8| char::from(b).to_digit(16);
        *channel = u8::try_from(digit(pair[0])? * 16 + digit(pair[1])?).ok()?;
    }
    Some(color)
}

/// `xs:boolean`.
pub(super) fn boolean(value: &[u8]) -> Option<bool> {
    match value.trim_ascii() {
        b"1" | b"true" => Some(true),
        b"0" | b"false" => Some(false),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_decimal_and_finite() {
        assert_eq!(number(b" -1.5e1 "), Some(-15.0));
        assert_eq!(number(b".5"), Some(0.5));
        for refused in [&b"NaN"[..], b"inf", b"1e999", b"1,5", b"0x1", b"", b"1 2", b"-"] {
            assert_eq!(number(refused), None, "{}", String::from_utf8_lossy(refused));
        }
    }

    #[test]
    fn indices_are_whole_and_below_two_to_the_31() {
        assert_eq!(index(b" 07 "), Some(7));
        assert_eq!(index(b"2147483647"), Some(i32::MAX as u32));
        for refused in [&b"2147483648"[..], b"99999999999999999999", b"-1", b"+1", b"1.0", b""] {
            assert_eq!(index(refused), None, "{}", String::from_utf8_lossy(refused));
        }
    }

    #[test]
    fn a_matrix_has_twelve_numbers_by_rows() {
        let turned = matrix(b"0 1 0  -1 0 0  0 0 1  5 6 7").expect("a matrix");
        assert_eq!(turned.transform_point3(DVec3::X), DVec3::new(5.0, 7.0, 7.0));
        assert_eq!(matrix(b"1 0 0 0 1 0 0 0 1 0 0"), None);
        assert_eq!(matrix(b"1 0 0 0 1 0 0 0 1 0 0 0 0"), None);
        assert_eq!(matrix(b"1,0 0 0 0 1 0 0 0 1 0 0 0"), None);
    }

    #[test]
    fn colours_have_three_or_four_channels() {
        assert_eq!(color(b"#FF8000"), Some([255, 128, 0, 255]));
        assert_eq!(color(b"#ff800010"), Some([255, 128, 0, 16]));
        for refused in [&b"FF8000"[..], b"#FF80", b"#GG8000", b"#FF80001"] {
            assert_eq!(color(refused), None, "{}", String::from_utf8_lossy(refused));
        }
    }
}
