//! Ids of jobs and uploads.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use uuid::Uuid;

use crate::access::IdSource;

/// Defines an id type, a prefix followed by a UUID of version 7, and the error of its parser.
macro_rules! prefixed_id {
    ($(#[$about:meta])* $id:ident, $prefix:literal, $(#[$about_error:meta])* $error:ident, $message:literal) => {
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub struct $id(Uuid);

        $(#[$about_error])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
        #[error($message)]
        pub struct $error;

        impl $id {
            /// Creates an id with the current time.
            #[must_use]
            pub fn new(ids: &dyn IdSource) -> Self {
                Self(ids.sortable())
            }
        }

        impl fmt::Display for $id {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!($prefix, "{}"), self.0.simple())
            }
        }

        impl FromStr for $id {
            type Err = $error;

            fn from_str(text: &str) -> Result<Self, $error> {
                let digits = text.strip_prefix($prefix).filter(|digits| digits.len() == 32).ok_or($error)?;
                Uuid::try_parse(digits).map(Self).map_err(|_| $error)
            }
        }
    };
}

prefixed_id!(
    /// A job's id: `job_` and a UUID of version 7, so that ids sort by time.
    JobId,
    "job_",
    /// The text is not a job id.
    JobIdError,
    "a job id must be `job_` and 32 hexadecimal digits"
);

prefixed_id!(
    /// An upload's id: `upl_` and a UUID of version 7.
    UploadId,
    "upl_",
    /// The text is not an upload id.
    UploadIdError,
    "an upload id must be `upl_` and 32 hexadecimal digits"
);

impl Serialize for JobId {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for JobId {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::SystemIds;

    #[test]
    fn job_ids_round_trip_through_text_and_other_texts_are_refused() {
        let id = JobId::new(&SystemIds);
        assert_eq!(id.to_string().parse(), Ok(id));
        let long = format!("{id}0");
        let bare = id.to_string().replace("job_", "");
        for text in ["", "job_", "job_1", "job_zz", &bare, &long, "job_0190-4", "../etc"] {
            assert_eq!(text.parse::<JobId>(), Err(JobIdError), "{text}");
        }
    }

    #[test]
    fn job_ids_sort_by_creation_time() {
        let ids: Vec<JobId> = (0..100).map(|_| JobId::new(&SystemIds)).collect();
        assert!(ids.is_sorted());
    }
}
