//! `meshmend profiles`: lists the built-in printing processes.

use std::io::Write;
use std::process::ExitCode;

use clap::Args;
use meshmend::printing::profile::Profile;

use super::exit;
#[cfg(feature = "service")]
use super::tenant_profiles::{TenantProfilesCommand, run_tenant_profiles};

/// Arguments of `meshmend profiles`.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct ProfilesArgs {
    #[cfg(feature = "service")]
    #[command(subcommand)]
    command: Option<TenantProfilesCommand>,
    /// Show only this profile.
    name: Option<String>,
    /// Print the profiles as JSON, with the sources of each limit.
    #[arg(long, env = "MESHMEND_JSON")]
    json: bool,
}

#[cfg(feature = "service")]
impl ProfilesArgs {
    /// Whether the command reads the settings of the service.
    pub fn uses_service_settings(&self) -> bool {
        self.command.is_some()
    }
}

/// Runs `meshmend profiles`.
pub fn run_profiles(args: ProfilesArgs) -> ExitCode {
    #[cfg(feature = "service")]
    if let Some(command) = args.command {
        return run_tenant_profiles(command);
    }
    print_built_in(args.name.as_deref(), args.json)
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
