//! Process profiles: the limits of each printing process, with their sources.

mod limits;

use std::collections::BTreeMap;
use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

pub use self::limits::ProcessLimits;
use crate::inspect::OptionsError;

/// The built-in profiles. Sources disagree by a factor of two to three, because some state the detail that a machine resolves, and others
/// the detail that survives cleaning. So each limit has two numbers.
const BUILT_IN: &str = include_str!("profiles.json");

/// The limits of one printing process. All lengths are in millimetres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// Name of the profile, as in the option `process`.
    pub name: String,
    /// Title for people.
    pub title: String,
    /// Other names that the option `process` accepts.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub aliases: Vec<String>,
    /// Thinnest wall that is held on two or more sides.
    pub supported_wall_mm: Limit,
    /// Thinnest wall that is held on at most one side.
    pub free_wall_mm: Limit,
    /// Thinnest wire: a bar that is held at both ends.
    pub wire_mm: Limit,
    /// Thinnest pin: a bar that is held at one end.
    pub pin_mm: Limit,
    /// Narrowest hole.
    pub hole_mm: Limit,
    /// Narrowest gap between two surfaces of one solid, such as a slot.
    pub gap_mm: Limit,
    /// Narrowest gap between two separate solids.
    pub clearance_mm: Limit,
    /// Narrowest embossed detail.
    pub embossed_mm: Limit,
    /// Narrowest engraved detail.
    pub engraved_mm: Limit,
    /// Smallest volume of a separate solid, in mm³.
    pub part_volume_mm3: Limit,
    /// Holes through which powder or resin must leave a cavity; absent if a cavity may stay closed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub escape_holes: Option<EscapeHoles>,
    /// Whether the process prints in liquid resin, so that hollows which open only upward trap resin or air during the print.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub checks_cups: bool,
    /// Density of the printed material; absent if the process prints several materials.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub material_density: Option<Density>,
    /// Build volume of a common machine; absent if there is no limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub build_volume_mm: Option<BuildVolume>,
    /// Most faces that a print service accepts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_faces: Option<Limit>,
    /// Largest file that a print service accepts, in bytes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_bytes: Option<Limit>,
}

/// A limit of a process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Limit {
    /// The limit that a model must keep. Beyond it, some print services refuse the model.
    pub limit: f64,
    /// The most tolerant limit that a source states. Beyond it, no print service is known to accept the model.
    pub minimum: f64,
    /// Where the limit comes from.
    pub basis: Basis,
    /// Titles of the sources.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sources: Vec<String>,
}

/// Where a limit comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Basis {
    /// Published design rules; `sources` names them.
    Sourced,
    /// Derived from another limit of the process, such as twice the nozzle's diameter.
    Derived,
    /// A cautious choice, because no design rule was found.
    Judgement,
    /// Set by the request, or by a profile of the tenant.
    Requested,
}

/// The holes that a cavity needs, so that powder or resin can leave it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct EscapeHoles {
    /// Least diameter.
    pub diameter_mm: f64,
    /// Number of holes that `voids=vent` drills into a sealed cavity. The openings of a cavity that is already open are
    /// not counted.
    pub count: u32,
    /// Where the rule comes from.
    pub basis: Basis,
    /// Titles of the sources.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sources: Vec<String>,
}

/// The density of a printed part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Density {
    /// The density in g/cm³.
    pub g_cm3: f64,
    /// Where the density comes from.
    pub basis: Basis,
    /// Titles of the sources.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sources: Vec<String>,
}

/// The build volume of a machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct BuildVolume {
    /// Side lengths along x, y and z.
    pub size: [f64; 3],
    /// Where the size comes from.
    pub basis: Basis,
    /// Titles of the sources.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sources: Vec<String>,
}

/// Why a process has no profile.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ProfileError {
    /// No profile has the name.
    #[error("there is no process `{name}`; use one of {}", names().join(", "))]
    Unknown {
        /// The unknown name.
        name: String,
    },
    /// A limit is not a finite number of 0 or more.
    #[error("`{limit}` must be a finite number, 0 or greater")]
    Limit {
        /// Name of the limit.
        limit: &'static str,
    },
}

impl Profile {
    /// The built-in profiles.
    #[must_use]
    pub fn built_in() -> &'static [Self] {
        static PROFILES: LazyLock<Vec<Profile>> = LazyLock::new(|| read_built_in(BUILT_IN));
        &PROFILES
    }

    /// The built-in profile of a name or alias. Case, and the separators `-`, `_`, `.` and space, make no difference.
    #[must_use]
    pub fn named(name: &str) -> Option<&'static Self> {
        let wanted = simplified(name);
        let is_wanted = |profile: &&Self| {
            std::iter::once(&profile.name).chain(&profile.aliases).any(|name| simplified(name) == wanted)
        };
        Self::built_in().iter().find(is_wanted)
    }

    /// The profile that the options `process` and `process_limits` select.
    ///
    /// # Errors
    /// [`ProfileError`] if there is no such profile, or if a limit is invalid.
    pub fn resolve(process: &str, limits: Option<&ProcessLimits>) -> Result<Self, ProfileError> {
        let base = limits.and_then(|limits| limits.based_on.as_deref()).unwrap_or(process);
        let profile = Self::named(base).ok_or_else(|| ProfileError::Unknown { name: base.to_owned() })?;
        let Some(limits) = limits else { return Ok(profile.clone()) };
        limits.validate()?;
        let mut profile = limits.applied_to(profile.clone());
        if limits.based_on.is_some() {
            process.clone_into(&mut profile.name);
            profile.aliases.clear();
        }
        Ok(profile)
    }
}

/// The profile that the options `process` and `process_limits` select; `None` without a process.
///
/// # Errors
/// [`OptionsError`] if there is no such process, if a limit is invalid, or if there are limits without a process.
pub fn checked_profile(process: Option<&str>, limits: Option<&ProcessLimits>) -> Result<Option<Profile>, OptionsError> {
    let wrong = |option, value: String, expected| OptionsError { option, value, expected };
    let Some(process) = process else {
        return match limits {
            Some(_) => Err(wrong("process_limits", "limits".to_owned(), "absent without `process`")),
            None => Ok(None),
        };
    };
    Profile::resolve(process, limits).map(Some).map_err(|error| match error {
        ProfileError::Unknown { name } => wrong("process", format!("`{name}`"), "a name that `GET /v1/profiles` lists"),
        ProfileError::Limit { limit } => {
            wrong("process_limits", format!("an invalid `{limit}`"), "finite numbers of 0 or more")
        }
    })
}

impl ProcessLimits {
    /// Checks that each limit is finite and not negative.
    ///
    /// # Errors
    /// [`ProfileError::Limit`] for the first invalid limit.
    pub fn validate(&self) -> Result<(), ProfileError> {
        self.first_invalid().map_or(Ok(()), |limit| Err(ProfileError::Limit { limit }))
    }

    fn applied_to(&self, mut profile: Profile) -> Profile {
        let lengths = [
            (&mut profile.supported_wall_mm, self.supported_wall_mm),
            (&mut profile.free_wall_mm, self.free_wall_mm),
            (&mut profile.wire_mm, self.wire_mm),
            (&mut profile.pin_mm, self.pin_mm),
            (&mut profile.hole_mm, self.hole_mm),
            (&mut profile.gap_mm, self.gap_mm),
            (&mut profile.clearance_mm, self.clearance_mm),
            (&mut profile.embossed_mm, self.embossed_mm),
            (&mut profile.engraved_mm, self.engraved_mm),
            (&mut profile.part_volume_mm3, self.part_volume_mm3),
        ];
        for (limit, requested) in lengths {
            if let Some(requested) = requested {
                *limit = requested_limit(requested);
            }
        }
        if let Some(title) = &self.title {
            profile.title.clone_from(title);
        }
        if let Some(density) = self.material_density_g_cm3 {
            let requested = Density { g_cm3: density, basis: Basis::Requested, sources: Vec::new() };
            profile.material_density = Some(requested).filter(|requested| requested.g_cm3 > 0.0);
        }
        if let Some(size) = self.build_volume_mm {
            profile.build_volume_mm = Some(BuildVolume { size, basis: Basis::Requested, sources: Vec::new() });
        }
        #[expect(clippy::cast_precision_loss, reason = "counts far below 2^53")]
        let counted = |requested: u64| requested_limit(requested as f64);
        profile.max_faces = self.max_faces.map(counted).or(profile.max_faces);
        profile.max_bytes = self.max_bytes.map(counted).or(profile.max_bytes);
        profile.escape_holes = self.escape_holes(profile.escape_holes.take());
        profile
    }

    fn escape_holes(&self, of_profile: Option<EscapeHoles>) -> Option<EscapeHoles> {
        if self.escape_hole_mm.is_none() && self.escape_hole_count.is_none() {
            return of_profile;
        }
        let diameter_mm = self.escape_hole_mm.or(of_profile.as_ref().map(|holes| holes.diameter_mm))?;
        let count = self.escape_hole_count.or(of_profile.as_ref().map(|holes| holes.count)).unwrap_or(1);
        let holes = EscapeHoles { diameter_mm, count, basis: Basis::Requested, sources: Vec::new() };
        (diameter_mm > 0.0 && count > 0).then_some(holes)
    }
}

/// A limit that a request or a tenant sets.
fn requested_limit(limit: f64) -> Limit {
    Limit { limit, minimum: limit, basis: Basis::Requested, sources: Vec::new() }
}

/// Names of the built-in profiles.
fn names() -> Vec<&'static str> {
    Profile::built_in().iter().map(|profile| profile.name.as_str()).collect()
}

/// The letters and digits of a name, in lower case.
fn simplified(name: &str) -> String {
    name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

/// The file of built-in profiles. Its profiles name sources by key.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BuiltIn {
    #[expect(dead_code, reason = "for readers of the file")]
    version: u32,
    #[expect(dead_code, reason = "for readers of the file")]
    date: String,
    sources: BTreeMap<String, String>,
    profiles: Vec<Profile>,
}

/// Reads the file of built-in profiles and replaces the sources' keys with their titles. A test checks that the file is
/// valid; an invalid file gives no profiles.
fn read_built_in(text: &str) -> Vec<Profile> {
    let Ok(BuiltIn { sources, mut profiles, .. }) = serde_json::from_str(text) else { return Vec::new() };
    let with_titles = |keys: &mut Vec<String>| {
        for key in keys {
            if let Some(title) = sources.get(key) {
                title.clone_into(key);
            }
        }
    };
    for profile in &mut profiles {
        profile.source_lists().into_iter().for_each(with_titles);
    }
    profiles
}

impl Profile {
    fn source_lists(&mut self) -> Vec<&mut Vec<String>> {
        let limits = [
            &mut self.supported_wall_mm,
            &mut self.free_wall_mm,
            &mut self.wire_mm,
            &mut self.pin_mm,
            &mut self.hole_mm,
            &mut self.gap_mm,
            &mut self.clearance_mm,
            &mut self.embossed_mm,
            &mut self.engraved_mm,
            &mut self.part_volume_mm3,
        ];
        let optional = [self.max_faces.as_mut(), self.max_bytes.as_mut()].into_iter().flatten();
        let limits = limits.into_iter().chain(optional).map(|limit| &mut limit.sources);
        let holes = self.escape_holes.as_mut().map(|holes| &mut holes.sources);
        let density = self.material_density.as_mut().map(|density| &mut density.sources);
        let volume = self.build_volume_mm.as_mut().map(|volume| &mut volume.sources);
        limits.chain(holes).chain(density).chain(volume).collect()
    }
}

#[cfg(test)]
mod tests;
