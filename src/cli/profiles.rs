//! `meshmend profiles`: lists the built-in printing processes, and changes the profiles of tenants in the database.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, Subcommand};
use meshmend::access::TenantName;
use meshmend::jobs::{NewProfile, TenantProfile};
use meshmend::printing::profile::{ProcessLimits, Profile};
use serde_json::json;

use super::config::table;
use super::exit;
use super::service::{ServiceData, run, to_stdout};
use super::service_error::ServiceError;
use super::settings::DataArgs;

/// Arguments of `meshmend profiles`.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct ProfilesArgs {
    #[command(subcommand)]
    command: Option<ProfilesCommand>,
    /// Show only this profile.
    name: Option<String>,
    /// Print the profiles as JSON, with the sources of each limit.
    #[arg(long, env = "MESHMEND_JSON")]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum ProfilesCommand {
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

impl ProfilesArgs {
    /// Whether the command reads the settings of the service.
    pub fn uses_service_settings(&self) -> bool {
        self.command.is_some()
    }
}

/// Runs `meshmend profiles`.
pub fn run_profiles(args: ProfilesArgs) -> ExitCode {
    match args.command {
        None => print_built_in(args.name.as_deref(), args.json),
        Some(ProfilesCommand::List { tenant, json, data }) => run(&data, async |data: ServiceData| {
            let profiles = data.store.profiles(tenant.as_str()).await?;
            if json {
                return profiles.iter().try_for_each(|profile| to_stdout(&profile_json(&tenant, profile)));
            }
            to_stdout(&table(["PROFILE", "BASED ON", "LIMITS"], profiles.iter().map(profile_row)))
        }),
        Some(ProfilesCommand::Set { tenant, name, limits, data }) => run(&data, async |data: ServiceData| {
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
        Some(ProfilesCommand::Remove { tenant, name, data }) => run(&data, async |data: ServiceData| {
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

/// Prints the built-in profiles, or one of them.
fn print_built_in(name: Option<&str>, as_json: bool) -> ExitCode {
    let profiles: Vec<&Profile> = match name {
        None => Profile::built_in().iter().collect(),
        Some(name) => match Profile::resolve(name, None) {
            Ok(_) => Profile::named(name).into_iter().collect(),
            Err(error) => return exit::fail(exit::BAD_INPUT, error),
        },
    };
    let text = if as_json {
        serde_json::to_string_pretty(&profiles).unwrap_or_default()
    } else {
        profiles.iter().map(|profile| profile_text(profile)).collect::<Vec<_>>().join("\n")
    };
    let _ = writeln!(std::io::stdout(), "{text}");
    ExitCode::SUCCESS
}

fn profile_text(profile: &Profile) -> String {
    let limits = [
        ("supported wall", &profile.supported_wall_mm),
        ("free wall", &profile.free_wall_mm),
        ("wire", &profile.wire_mm),
        ("pin", &profile.pin_mm),
        ("hole", &profile.hole_mm),
        ("gap", &profile.gap_mm),
        ("clearance", &profile.clearance_mm),
        ("embossed detail", &profile.embossed_mm),
        ("engraved detail", &profile.engraved_mm),
    ];
    let mut text = format!("{}: {}\n", profile.name, profile.title);
    for (name, limit) in limits {
        text.push_str(&format!("  {name:<16} {:>6} mm\n", limit.limit));
    }
    text.push_str(&format!("  {:<16} {:>6} mm³\n", "part volume", profile.part_volume_mm3.limit));
    if let Some(holes) = &profile.escape_holes {
        text.push_str(&format!("  {:<16} {:>6} mm, {} per cavity\n", "escape holes", holes.diameter_mm, holes.count));
    }
    if let Some(volume) = &profile.build_volume_mm {
        let [x, y, z] = volume.size;
        text.push_str(&format!("  {:<16} {x} x {y} x {z} mm\n", "build volume"));
    }
    text
}
