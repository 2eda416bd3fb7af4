//! Names of jobs, uploads and other rows, and where they come from.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use uuid::Uuid;

/// Where names and random numbers come from, passed in beside the clock.
pub trait IdSource: Send + Sync {
    /// A new UUID that sorts by the time at which it was made.
    fn sortable(&self) -> Uuid;

    /// A new UUID that nobody can guess.
    fn random(&self) -> Uuid;
}

/// The operating system's random numbers, and UUIDs of versions 7 and 4 made of them.
#[derive(Debug, Clone, Copy, Default)]
pub struct SystemIds;

impl IdSource for SystemIds {
    fn sortable(&self) -> Uuid {
        Uuid::now_v7()
    }

    fn random(&self) -> Uuid {
        Uuid::new_v4()
    }
}

/// Defines a name that is a prefix and a UUID of version 7, and the error of a text that is none.
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
            /// A new id of this moment.
            #[must_use]
            pub fn new() -> Self {
                Self(SystemIds.sortable())
            }
        }

        impl Default for $id {
            fn default() -> Self {
                Self::new()
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
    /// A job's name: `job_` and a UUID of version 7, so that names sort by time.
    JobId,
    "job_",
    /// A text that is no job id.
    JobIdError,
    "a job id is 'job_' and 32 hexadecimal digits"
);

prefixed_id!(
    /// An upload's name: `upl_` and a UUID of version 7.
    UploadId,
    "upl_",
    /// A text that is no upload id.
    UploadIdError,
    "an upload id is 'upl_' and 32 hexadecimal digits"
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

    #[test]
    fn a_job_id_is_read_back_from_its_text_and_nothing_else_is() {
        let id = JobId::new();
        assert_eq!(id.to_string().parse(), Ok(id));
        let long = format!("{id}0");
        let bare = id.to_string().replace("job_", "");
        for text in ["", "job_", "job_1", "job_zz", &bare, &long, "job_0190-4", "../etc"] {
            assert_eq!(text.parse::<JobId>(), Err(JobIdError), "{text}");
        }
    }

    #[test]
    fn ids_sort_by_the_time_they_were_made() {
        let ids: Vec<JobId> = (0..100).map(|_| JobId::new()).collect();
        assert!(ids.is_sorted());
    }
}
