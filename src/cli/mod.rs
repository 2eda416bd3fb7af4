mod address;
mod auth;
mod backup;
mod blobs;
mod compare;
mod completions;
mod config;
mod database;
mod engine;
mod exit;
mod files;
mod inspect;
mod keys;
mod listen;
mod openapi;
mod remote;
mod repair;
mod service;
mod settings;
mod submit;
mod table;
mod telemetry;
mod tenants;
mod variables;
mod watch;
mod webhooks;

use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};

/// Repairs broken 3D models, proves that the result is printable, and gives an honest account of what changed.
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
    /// Run workers only, beside a `serve` that shares the data folder.
    Work(settings::WorkArgs),
    /// Repair one file. Needs no server.
    Repair(repair::RepairArgs),
    /// Tell what is wrong with files, and describe them. Needs no server.
    Inspect(inspect::InspectArgs),
    /// Tell what changed from one file to another. Needs no server.
    Compare(compare::CompareArgs),
    /// Have a service repair or analyse files, and download what comes of them.
    ///
    /// Each file is a job. It is sent again, as the same request, where the service can't be reached, is busy or has no room. An interrupt
    /// leaves jobs running, and the last line says how to go on.
    Submit(submit::SubmitArgs),
    /// Follow jobs of a service until they have ended.
    Watch(watch::WatchArgs),
    /// Make or update the database's tables and stop.
    Migrate(settings::MigrateArgs),
    /// Make, list and revoke API keys.
    Keys(keys::KeysArgs),
    /// Set what single tenants may use, and list them.
    Tenants(tenants::TenantsArgs),
    /// Copy the SQLite database while the service runs.
    ///
    /// The copy is whole and of one moment. Only this user may read it. It has no files of jobs: copy those after it, since files that the
    /// copy does not know are removed, while files that it misses are lost. Copy a PostgreSQL database with `pg_dump`.
    Backup(backup::BackupArgs),
    /// Print the settings of a command and where each is from, with secrets hidden.
    Config(config::ConfigArgs),
    /// Print the OpenAPI document, or check a file against it.
    Openapi(openapi::OpenapiArgs),
    /// Print a script that completes commands and flags in a shell, such as `meshmend completions bash`.
    Completions(completions::CompletionsArgs),
}

impl Command {
    /// Whether the settings of the service decide what it does.
    fn runs_the_service(&self) -> bool {
        matches!(
            self,
            Self::Serve(_) | Self::Work(_) | Self::Migrate(_) | Self::Keys(_) | Self::Tenants(_) | Self::Backup(_)
        )
    }
}

/// Runs the command line.
pub fn run() -> ExitCode {
    let command = Cli::parse().command;
    if command.runs_the_service()
        && let Some(message) = variables::refusal(&Cli::command())
    {
        return exit::fail(exit::BAD_INPUT, message);
    }
    match command {
        Command::Serve(args) => service::serve(args),
        Command::Work(args) => service::work(args),
        Command::Repair(args) => repair::run(&args),
        Command::Inspect(args) => inspect::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Submit(args) => submit::run(&args),
        Command::Watch(args) => watch::run(&args),
        Command::Migrate(args) => service::migrate(&args),
        Command::Keys(args) => keys::keys(args),
        Command::Tenants(args) => tenants::tenants(args),
        Command::Backup(args) => backup::run(&args),
        Command::Config(args) => config::run(&args, Cli::command()),
        Command::Openapi(args) => openapi::run(&args),
        Command::Completions(args) => completions::run(&args, Cli::command()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_flag_has_its_environment_variable() {
        let mut command = Cli::command();
        command.build();
        let mut flags = 0;
        for verb in command.get_subcommands().filter(|verb| verb.get_name() != "help") {
            let given = verb
                .get_arguments()
                .filter(|a| !a.is_positional() && !["help", "version"].contains(&a.get_id().as_str()));
            for flag in given {
                let variable = flag.get_env().unwrap_or_default().to_string_lossy().into_owned();
                assert!(variable.starts_with("MESHMEND_"), "{} --{}", verb.get_name(), flag.get_id());
                flags += 1;
            }
        }
        assert!(flags > 30, "only {flags} flags were found");
    }
}
