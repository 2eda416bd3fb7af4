//! Times: the clock, and the format of times in JSON. The format is RFC 3339 in UTC with milliseconds, such as
//! `2026-03-01T09:30:00.000Z`. All texts have the same width, so that they sort like times.

use std::num::NonZeroU8;

use serde::{Deserializer, Serializer};
use time::format_description::well_known::Iso8601;
use time::format_description::well_known::iso8601::{Config, EncodedConfig, TimePrecision};
use time::{OffsetDateTime, UtcOffset};

/// The wall clock, passed in so that tests of leases and retries need not wait.
pub trait Clock: Send + Sync {
    /// Milliseconds since the Unix epoch.
    fn now_ms(&self) -> i64;
}

/// The operating system's clock.
#[derive(Debug, Clone, Copy, Default)]
pub struct SystemClock;

impl SystemClock {
    /// The current time.
    #[must_use]
    #[expect(clippy::disallowed_methods, reason = "the one place that asks the operating system")]
    pub fn now(self) -> OffsetDateTime {
        OffsetDateTime::now_utc()
    }
}

impl Clock for SystemClock {
    fn now_ms(&self) -> i64 {
        let now = self.now();
        now.unix_timestamp() * 1000 + i64::from(now.millisecond())
    }
}

const FORMAT: EncodedConfig =
    Config::DEFAULT.set_time_precision(TimePrecision::Second { decimal_digits: NonZeroU8::new(3) }).encode();

/// The text of a time, in the format of this module.
#[must_use]
pub fn text(time: OffsetDateTime) -> String {
    time.to_offset(UtcOffset::UTC).format(&Iso8601::<FORMAT>).unwrap_or_default()
}

/// Serializes a time as its [`text`].
///
/// # Errors
/// The serializer's errors.
pub fn serialize<S: Serializer>(time: &OffsetDateTime, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&text(*time))
}

/// Deserializes a time in any form of RFC 3339.
///
/// # Errors
/// When the text is not an RFC 3339 time.
pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<OffsetDateTime, D::Error> {
    time::serde::rfc3339::deserialize(deserializer)
}

/// Serialization of an optional time.
pub mod option {
    use serde::{Deserializer, Serialize, Serializer};
    use time::OffsetDateTime;

    use crate::jobs::timestamp::text;

    /// Serializes a time, or null.
    ///
    /// # Errors
    /// The serializer's errors.
    pub fn serialize<S: Serializer>(time: &Option<OffsetDateTime>, serializer: S) -> Result<S::Ok, S::Error> {
        time.map(text).serialize(serializer)
    }

    /// Deserializes a time in any form of RFC 3339, or null.
    ///
    /// # Errors
    /// When the text is not an RFC 3339 time.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<OffsetDateTime>, D::Error> {
        time::serde::rfc3339::option::deserialize(deserializer)
    }
}

#[cfg(test)]
mod tests {
    use time::Duration;

    use super::*;

    #[test]
    fn every_time_has_the_same_width() {
        let start = OffsetDateTime::UNIX_EPOCH + Duration::days(20_000);
        assert_eq!(text(start), "2024-10-04T00:00:00.000Z");
        assert_eq!(text(start + Duration::nanoseconds(120_999_999)), "2024-10-04T00:00:00.120Z");
        let offset = UtcOffset::from_hms(2, 0, 0).expect("an offset");
        assert_eq!(text((start + Duration::seconds(59)).to_offset(offset)), "2024-10-04T00:00:59.000Z");
    }
}
