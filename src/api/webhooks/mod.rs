//! Webhook endpoints, their secrets, and how deliveries fared.

pub(super) mod deliveries;
pub(super) mod endpoints;
pub(super) mod secrets;

use std::time::Duration;

/// How long an old secret signs beside a new one.
const OVERLAP: Duration = Duration::from_secs(24 * 3600);

/// Whether a text has the form of an id: `prefix`, an underscore and a UUID in hexadecimal.
pub(super) fn is_name(text: &str, prefix: &str) -> bool {
    let digits = text.strip_prefix(prefix).and_then(|rest| rest.strip_prefix('_'));
    digits.is_some_and(|digits| digits.len() == 32 && digits.bytes().all(|byte| byte.is_ascii_hexdigit()))
}
