//! The subcommands of `meshmend profiles`, which change the profiles of tenants in the database.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Subcommand;
use meshmend::access::TenantName;
use meshmend::jobs::{NewProfile, TenantProfile};
use meshmend::printing::profile::ProcessLimits;
use serde_json::json;

use super::config::table;
use super::service::{ServiceData, run, to_stdout};
use super::service_error::ServiceError;
use super::settings::DataArgs;

/// What to do with the profiles of a tenant.
#[derive(Debug, Subcommand)]
pub enum TenantProfilesCommand {
    /// List the profiles of a tenant in the service's database.
    List {
        /// Tenant that owns the profiles.
        #[arg(long, env = "MESHMEND_PROFILE_TENANT", default_value_t)]
        tenant: TenantName,
        /// Print one JSON object per line instead of a table.
        #[arg(long, env = "MESHMEND_JSON")]
        json: bool,
        #[command(flatten)]
        data: DataArgs,
    },
    /// Create or replace a profile of a tenant in the service's database.
    Set {
        /// Tenant that owns the profile.
        #[arg(long, env = "MESHMEND_PROFILE_TENANT", default_value_t)]
        tenant: TenantName,
        /// Name of the profile: lower-case letters, digits, hyphens, underscores and dots.
        name: String,
        /// JSON file with the limits, such as `{"based_on": "sls-pa12", "free_wall_mm": 1.2}`.
        limits: PathBuf,
        #[command(flatten)]
        data: DataArgs,
    },
    /// Remove a profile of a tenant from the service's database. Jobs that were submitted with the profile keep its
    /// limits.
    Remove {
        /// Tenant that owns the profile.
        #[arg(long, env = "MESHMEND_PROFILE_TENANT", default_value_t)]
        tenant: TenantName,
        /// Name of the profile.
        name: String,
        #[command(flatten)]
        data: DataArgs,
    },
}

/// Runs a subcommand of `meshmend profiles`.
pub fn run_tenant_profiles(command: TenantProfilesCommand) -> ExitCode {
    match command {
        TenantProfilesCommand::List { tenant, json, data } => run(&data, async |data: ServiceData| {
            let profiles = data.store.profiles(tenant.as_str()).await?;
            if json {
                return profiles.iter().try_for_each(|profile| to_stdout(&profile_json(&tenant, profile)));
            }
            to_stdout(&table(["PROFILE", "BASED ON", "LIMITS"], profiles.iter().map(profile_row)))
        }),
        TenantProfilesCommand::Set { tenant, name, limits, data } => run(&data, async |data: ServiceData| {
            let new = read_profile(&name, &limits).map_err(ServiceError::Refused)?;
            let store = data.store.as_ref();
            // The operator may add more profiles than the API lets a tenant add.
            let stored = match store.replace_profile(tenant.as_str(), &new, None).await? {
                Some(replaced) => Some(replaced),
                None => store.add_profile(tenant.as_str(), &new, u32::MAX).await?,
            };
            let changed = || ServiceError::Refused(format!("the profile '{name}' was changed meanwhile; try again"));
            to_stdout(&profile_json(&tenant, &stored.ok_or_else(changed)?))
        }),
        TenantProfilesCommand::Remove { tenant, name, data } => run(&data, async |data: ServiceData| {
            if data.store.delete_profile(tenant.as_str(), &name, None).await? {
                to_stdout(&format!("removed {name}"))
            } else {
                Err(ServiceError::Refused(format!(
                    "the tenant '{tenant}' has no profile '{name}'; `meshmend profiles list --tenant {tenant}` shows all"
                )))
            }
        }),
    }
}

/// Reads the limits of a profile from a JSON file.
fn read_profile(name: &str, path: &Path) -> Result<NewProfile, String> {
    let named = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let text = std::fs::read(path).map_err(|error| named(&error))?;
    let limits: ProcessLimits = serde_json::from_slice(&text).map_err(|error| named(&error))?;
    NewProfile::new(name, limits).map_err(|error| match error.field() {
        Some(_) => named(&error),
        None => format!("'{name}' is no name for a profile: {error}"),
    })
}

fn profile_json(tenant: &TenantName, profile: &TenantProfile) -> String {
    json!({"tenant": tenant.as_str(), "name": profile.name, "limits": profile.limits}).to_string()
}

fn profile_row(profile: &TenantProfile) -> [String; 3] {
    let base = profile.limits.based_on.clone().unwrap_or_default();
    let limits = ProcessLimits { based_on: None, ..profile.limits.clone() };
    [profile.name.clone(), base, serde_json::to_string(&limits).unwrap_or_default()]
}
