//! The command line: its commands, and the commands that need no file of their own (`openapi`, `completions`, `man`).

mod administration;
mod alternatives;
mod compare;
mod config;
mod engine;
mod exit;
mod inspect;
mod listen;
mod print_options;
mod profiles;
mod remote;
mod repair;
mod service;
mod service_error;
mod settings;
mod submit;
mod telemetry;

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, CommandFactory, Parser, Subcommand};
use clap_complete::Shell;

/// Repairs broken 3D models, checks that the result is printable, and reports exactly what changed.
#[derive(Debug, Parser)]
#[command(name = "meshmend", version, propagate_version = true, max_term_width = 110, after_help = exit::HELP)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Serve the API and run workers in one process.
    Serve(settings::ServeArgs),
    /// Run workers only. Needs a `serve` process that uses the same database and file store.
    Work(settings::WorkArgs),
    /// Repair one file. Needs no server.
    Repair(repair::RepairArgs),
    /// List the defects of files and measure them. Needs no server.
    Inspect(inspect::InspectArgs),
    /// Measure how one file differs from another. Needs no server.
    Compare(compare::CompareArgs),
    /// Let a service repair or analyse files, and download the results.
    ///
    /// Each file becomes one job. While the service is unreachable, busy or full, the same request is sent again.
    /// After an interrupt, submitted jobs continue, and the last line shows the command that follows them.
    Submit(submit::SubmitArgs),
    /// Follow jobs of a service until they end.
    Watch(submit::WatchArgs),
    /// Create or update the database's tables, then exit.
    Migrate(settings::MigrateArgs),
    /// Create, list and revoke API keys.
    Keys(administration::KeysArgs),
    /// Set the limits of single tenants, and list tenants.
    Tenants(administration::TenantsArgs),
    /// List the printing processes and their limits, or change the processes of tenants.
    Profiles(profiles::ProfilesArgs),
    /// Copy the SQLite database while the service runs.
    ///
    /// The copy is a consistent snapshot that only the current user can read. Copy the files of jobs separately,
    /// after the database. The service deletes files that the copied database does not list, but it cannot
    /// restore missing files. Copy a PostgreSQL database with `pg_dump`.
    Backup(administration::BackupArgs),
    /// Print the settings of a command and the source of each, with secrets hidden.
    Config(config::ConfigArgs),
    /// Print the OpenAPI document, or check a file against it.
    Openapi(OpenapiArgs),
    /// Print a shell script that completes commands and flags; for example `meshmend completions bash`.
    Completions(CompletionsArgs),
    /// Write the manual pages of all commands into a folder; for packages.
    #[command(hide = true)]
    Man(ManArgs),
}

impl Command {
    /// Whether the command reads the settings of the service.
    fn uses_service_settings(&self) -> bool {
        match self {
            Self::Serve(_) | Self::Work(_) | Self::Migrate(_) | Self::Keys(_) | Self::Tenants(_) | Self::Backup(_) => {
                true
            }
            Self::Profiles(args) => args.uses_service_settings(),
            _ => false,
        }
    }
}

/// Parses the command line, runs the command, and returns its exit code.
pub fn run() -> ExitCode {
    let command = Cli::parse().command;
    if command.uses_service_settings()
        && let Some(message) = config::unknown_variables_error(&Cli::command())
    {
        return exit::fail(exit::BAD_INPUT, message);
    }
    match command {
        Command::Serve(args) => service::serve(args),
        Command::Work(args) => service::work(args),
        Command::Repair(args) => repair::run(&args),
        Command::Inspect(args) => inspect::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Submit(args) => submit::submit(&args),
        Command::Watch(args) => submit::watch(&args),
        Command::Migrate(args) => service::migrate(&args),
        Command::Keys(args) => administration::keys(args),
        Command::Tenants(args) => administration::tenants(args),
        Command::Profiles(args) => profiles::run_profiles(args),
        Command::Backup(args) => administration::backup(&args),
        Command::Config(args) => config::run(&args, Cli::command()),
        Command::Openapi(args) => openapi(&args),
        Command::Completions(args) => completions(&args, Cli::command()),
        Command::Man(args) => man(&args, Cli::command()),
    }
}

/// Arguments of `meshmend openapi`.
#[derive(Debug, Args)]
struct OpenapiArgs {
    /// Check that this file equals the document instead of printing the document; exit code 1 if the file is
    /// outdated.
    #[arg(long, env = "MESHMEND_OPENAPI_CHECK", value_name = "FILE")]
    check: Option<PathBuf>,
    /// OpenAPI version of the document. `3.0` is for code generators that cannot read 3.1: each body has one media
    /// type, and a job is submitted as raw bytes.
    #[arg(long, env = "MESHMEND_OPENAPI_SPEC", default_value = "3.1")]
    spec: Spec,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Spec {
    #[value(name = "3.0")]
    V3_0,
    #[value(name = "3.1")]
    V3_1,
}

/// Runs `meshmend openapi`.
fn openapi(args: &OpenapiArgs) -> ExitCode {
    let document = match args.spec {
        Spec::V3_0 => meshmend::api::document_3_0().and_then(|document| serde_json::to_string_pretty(&document)),
        Spec::V3_1 => meshmend::api::document().to_pretty_json(),
    };
    let document = match document {
        Ok(document) => document + "\n",
        Err(error) => return exit::fail(exit::INTERNAL, error),
    };
    let Some(path) = &args.check else {
        return match std::io::stdout().write_all(document.as_bytes()) {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => exit::fail(exit::INTERNAL, error),
        };
    };
    match std::fs::read_to_string(path) {
        Ok(kept) if kept == document => ExitCode::SUCCESS,
        Ok(_) => exit::fail(exit::PARTIAL, format!("{} is outdated; run `make openapi`", path.display())),
        Err(error) => exit::fail(exit::BAD_INPUT, format!("{}: {error}", path.display())),
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
