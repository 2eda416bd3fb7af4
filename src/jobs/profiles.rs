//! The process profiles of tenants: their names, their limits, and how a job's options use them.

use std::fmt;
use std::str::FromStr;

use time::OffsetDateTime;

use crate::printing::profile::{ProcessLimits, Profile, ProfileError};

/// Longest title of a profile, in characters.
const TITLE_CHARS: usize = 100;

/// The name of a tenant's profile: 1 to 63 lower-case letters, digits, hyphens, underscores and dots.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ProfileName(String);

impl ProfileName {
    /// Returns the name as text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for ProfileName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl FromStr for ProfileName {
    type Err = TenantProfileError;

    fn from_str(text: &str) -> Result<Self, TenantProfileError> {
        let is_plain = |c: u8| c.is_ascii_lowercase() || c.is_ascii_digit();
        let is_valid = (1..=63).contains(&text.len())
            && text.bytes().next().is_some_and(is_plain)
            && text.bytes().all(|c| is_plain(c) || b"-_.".contains(&c));
        if is_valid { Ok(Self(text.to_owned())) } else { Err(TenantProfileError::Name) }
    }
}

/// Why a tenant's profile is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TenantProfileError {
    /// The name has other characters, or is too long.
    #[error(
        "the name must be 1 to 63 lower-case letters, digits, hyphens, underscores and dots, and must start with a letter or digit"
    )]
    Name,
    /// A built-in profile has the name.
    #[error("the name belongs to the built-in profile `{0}`; choose another name")]
    Reserved(String),
    /// The profile on which the limits are based is missing.
    #[error("`based_on` is missing; name a built-in profile, whose limits apply where you set none")]
    NoBase,
    /// The profile on which the limits are based is not built in.
    #[error("`based_on` must name a built-in profile: {0}")]
    UnknownBase(ProfileError),
    /// A limit is out of its range.
    #[error(transparent)]
    Limit(ProfileError),
    /// The title is blank or too long, or has several lines.
    #[error("`title` must be 1 to {TITLE_CHARS} characters on one line; without a title the profile shows its name")]
    Title,
}

impl TenantProfileError {
    /// The wrong field of the limits; `None` if the name is wrong.
    #[must_use]
    pub fn field(&self) -> Option<&'static str> {
        match self {
            Self::Name | Self::Reserved(_) => None,
            Self::NoBase | Self::UnknownBase(_) => Some("based_on"),
            Self::Limit(ProfileError::Limit { limit }) => Some(limit),
            Self::Limit(ProfileError::Unknown { .. }) => Some("based_on"),
            Self::Title => Some("title"),
        }
    }
}

/// A profile to store, with a valid name and valid limits.
#[derive(Debug, Clone, PartialEq)]
pub struct NewProfile {
    /// The name.
    pub name: ProfileName,
    /// The limits; `based_on` is the name of a built-in profile.
    pub limits: ProcessLimits,
}

impl NewProfile {
    /// Checks the name and the limits of a profile.
    ///
    /// # Errors
    /// [`TenantProfileError`] for the first fault.
    pub fn new(name: &str, limits: ProcessLimits) -> Result<Self, TenantProfileError> {
        let name: ProfileName = name.parse()?;
        if let Some(built_in) = Profile::named(name.as_str()) {
            return Err(TenantProfileError::Reserved(built_in.name.clone()));
        }
        let base = limits.based_on.as_deref().ok_or(TenantProfileError::NoBase)?;
        let base = Profile::resolve(base, None).map_err(TenantProfileError::UnknownBase)?;
        limits.validate().map_err(TenantProfileError::Limit)?;
        let is_title = |title: &String| {
            let is_blank = title.trim().is_empty();
            !is_blank && title.chars().count() <= TITLE_CHARS && !title.chars().any(char::is_control)
        };
        if !limits.title.as_ref().is_none_or(is_title) {
            return Err(TenantProfileError::Title);
        }
        Ok(Self { name, limits: ProcessLimits { based_on: Some(base.name), ..limits } })
    }
}

/// A profile of a tenant, as the store keeps it.
#[derive(Debug, Clone, PartialEq)]
pub struct TenantProfile {
    /// The name.
    pub name: String,
    /// The limits; `based_on` is the name of a built-in profile.
    pub limits: ProcessLimits,
    /// Grows with every change of the profile. A profile that is created again starts at 1.
    pub version: u32,
    /// When the profile was created.
    pub created_at: OffsetDateTime,
    /// When the limits were last changed.
    pub updated_at: OffsetDateTime,
}

impl TenantProfile {
    /// The limits for a job's options. The title is the profile's name if it has no title.
    #[must_use]
    pub fn job_limits(&self) -> ProcessLimits {
        let limits = self.limits.clone();
        ProcessLimits { title: limits.title.or_else(|| Some(self.name.clone())), ..limits }
    }

    /// The whole profile: its limits, and those of the profile on which it is based.
    ///
    /// # Errors
    /// [`ProfileError`] if this version of the program lacks the profile on which it is based.
    pub fn profile(&self) -> Result<Profile, ProfileError> {
        Profile::resolve(&self.name, Some(&self.job_limits()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn based_on(base: &str) -> ProcessLimits {
        ProcessLimits { based_on: Some(base.to_owned()), ..ProcessLimits::default() }
    }

    #[test]
    fn a_profile_needs_a_free_plain_name_and_a_built_in_base() {
        let new = NewProfile::new("our-sls_2.1", based_on("sls")).expect("valid");
        assert_eq!((new.name.as_str(), new.limits.based_on.as_deref()), ("our-sls_2.1", Some("sls-pa12")));
        for (name, limits, field, words) in [
            ("", based_on("sls"), None, "1 to 63"),
            ("Our SLS", based_on("sls"), None, "1 to 63"),
            ("-sls", based_on("sls"), None, "start with a letter"),
            ("sls_pa12", based_on("sls"), None, "`sls-pa12`"),
            ("mine", ProcessLimits::default(), Some("based_on"), "is missing"),
            ("mine", based_on("clay"), Some("based_on"), "`clay`"),
            ("mine", ProcessLimits { gap_mm: Some(-1.0), ..based_on("sls") }, Some("gap_mm"), "`gap_mm`"),
            ("mine", ProcessLimits { title: Some("a\nb".to_owned()), ..based_on("sls") }, Some("title"), "one line"),
            ("mine", ProcessLimits { title: Some(" ".to_owned()), ..based_on("sls") }, Some("title"), "one line"),
        ] {
            let error = NewProfile::new(name, limits).expect_err("refused");
            assert_eq!(error.field(), field, "{name}: {error}");
            assert!(error.to_string().contains(words), "{name}: {error}");
        }
    }
}
