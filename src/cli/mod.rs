//! The command line: its commands, and the commands that need no file of their own (`completions`, `man`).
//!
//! The feature `cli` has the commands that work on files. The feature `service` adds those that run, manage or call a service.

#[cfg(feature = "service")]
mod administration;
mod alternatives;
mod compare;
#[cfg(feature = "service")]
mod config;
mod engine;
mod exit;
mod inspect;
#[cfg(feature = "service")]
mod listen;
mod print_options;
mod profiles;
#[cfg(feature = "service")]
mod remote;
mod repair;
#[cfg(feature = "service")]
mod service;
#[cfg(feature = "service")]
mod service_commands;
#[cfg(feature = "service")]
mod service_error;
#[cfg(feature = "service")]
mod settings;
#[cfg(feature = "service")]
mod submit;
#[cfg(feature = "service")]
mod telemetry;
#[cfg(feature = "service")]
mod tenant_profiles;

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, CommandFactory, Parser, Subcommand};
use clap_complete::Shell;

/// Repairs broken 3D models, checks that the result is printable, and reports exactly what changed.
#[derive(Debug, Parser)]
#[cfg_attr(
    not(feature = "service"),
    command(before_help = "This program was built without the service: it has no commands that run or call one.")
)]
#[command(name = "meshmend", version, propagate_version = true, max_term_width = 110, after_help = exit::HELP)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Repair one file. Needs no server.
    Repair(Box<repair::RepairArgs>),
    /// List the defects of files and measure them. Needs no server.
    Inspect(inspect::InspectArgs),
    /// Measure how one file differs from another. Needs no server.
    Compare(compare::CompareArgs),
    /// List the printing processes and their limits, or change the processes of tenants.
    Profiles(profiles::ProfilesArgs),
    #[cfg(feature = "service")]
    #[command(flatten)]
    Service(Box<service_commands::ServiceCommand>),
    /// Print a shell script that completes commands and flags; for example `meshmend completions bash`.
    Completions(CompletionsArgs),
    /// Write the manual pages of all commands into a folder; for packages.
    #[command(hide = true)]
    Man(ManArgs),
}

#[cfg(feature = "service")]
impl Command {
    /// Whether the command reads the settings of the service.
    fn uses_service_settings(&self) -> bool {
        match self {
            Self::Service(command) => command.uses_service_settings(),
            Self::Profiles(args) => args.uses_service_settings(),
            _ => false,
        }
    }
}

/// Parses the command line, runs the command, and returns its exit code.
pub fn run() -> ExitCode {
    let command = Cli::parse().command;
    #[cfg(feature = "service")]
    if command.uses_service_settings()
        && let Some(message) = config::unknown_variables_error(&Cli::command())
    {
        return exit::fail(exit::BAD_INPUT, message);
    }
    match command {
        Command::Repair(args) => repair::run(&args),
        Command::Inspect(args) => inspect::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Profiles(args) => profiles::run_profiles(args),
        #[cfg(feature = "service")]
        Command::Service(command) => service_commands::run(*command, Cli::command()),
        Command::Completions(args) => completions(&args, Cli::command()),
        Command::Man(args) => man(&args, Cli::command()),
    }
}

/// Arguments of `meshmend completions`.
#[derive(Debug, Args)]
struct CompletionsArgs {
    /// Shell to write the completion script for.
    #[arg(value_enum)]
    shell: Shell,
}

/// Runs `meshmend completions`; `program` is the whole command line.
fn completions(args: &CompletionsArgs, mut program: clap::Command) -> ExitCode {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut program, "meshmend", &mut script);
    match std::io::stdout().write_all(&script) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => exit::fail(exit::INTERNAL, error),
    }
}

/// Arguments of `meshmend man`.
#[derive(Debug, Args)]
struct ManArgs {
    /// An existing folder for the pages.
    folder: PathBuf,
}

/// Runs `meshmend man`; `program` is the whole command line.
fn man(args: &ManArgs, program: clap::Command) -> ExitCode {
    match clap_mangen::generate_to(program, &args.folder) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => exit::fail(exit::BAD_INPUT, format!("{}: {error}", args.folder.display())),
    }
}

#[cfg(test)]
#[allow(dead_code, reason = "shared with the tests of the documents")]
#[path = "../../tests/support/prose.rs"]
mod prose;

#[cfg(test)]
mod tests {
    use super::*;

    /// Adds the help texts of a command, its arguments, their values and its subcommands, each with its place.
    fn collect_help(command: &clap::Command, above: &str, texts: &mut Vec<(String, String)>) {
        let place = format!("{above} {}", command.get_name());
        let own = [command.get_about(), command.get_long_about(), command.get_after_help()];
        texts.extend(own.into_iter().flatten().map(|text| (place.clone(), text.to_string())));
        for argument in command.get_arguments() {
            let place = format!("{place} {}", argument.get_id());
            assert!(argument.get_help().is_some() || argument.is_hide_set(), "{place} has no help");
            let help = [argument.get_help(), argument.get_long_help()];
            let values = argument.get_possible_values();
            let help = help.into_iter().chain(values.iter().map(clap::builder::PossibleValue::get_help));
            texts.extend(help.flatten().map(|text| (place.clone(), text.to_string())));
        }
        command.get_subcommands().for_each(|command| collect_help(command, &place, texts));
    }

    #[test]
    fn help_texts_are_short_and_name_their_subjects() {
        let mut command = Cli::command();
        command.build();
        let mut texts = Vec::new();
        collect_help(&command, "", &mut texts);
        assert!(texts.len() > 300, "only {} texts were found", texts.len());
        prose::assert_clear(&texts);
        let unmarked = texts.iter().map(|(place, text)| (place, prose::unmarked_fields(text)));
        assert_eq!(unmarked.filter(|(_, fields)| !fields.is_empty()).collect::<Vec<_>>(), []);
    }

    #[test]
    fn every_flag_has_its_environment_variable() {
        let mut command = Cli::command();
        command.build();
        let mut flag_count = 0;
        for subcommand in command.get_subcommands().filter(|subcommand| subcommand.get_name() != "help") {
            let flags = subcommand
                .get_arguments()
                .filter(|a| !a.is_positional() && !["help", "version"].contains(&a.get_id().as_str()));
            for flag in flags {
                let variable = flag.get_env().unwrap_or_default().to_string_lossy().into_owned();
                assert!(variable.starts_with("MESHMEND_"), "{} --{}", subcommand.get_name(), flag.get_id());
                flag_count += 1;
            }
        }
        assert!(flag_count > 30, "only {flag_count} flags were found");
    }
}
