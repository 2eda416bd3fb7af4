mod administration;
mod compare;
mod config;
mod engine;
mod exit;
mod inspect;
mod listen;
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
    Watch(submit::WatchArgs),
    /// Make or update the database's tables and stop.
    Migrate(settings::MigrateArgs),
    /// Make, list and revoke API keys.
    Keys(administration::KeysArgs),
    /// Set what single tenants may use, and list them.
    Tenants(administration::TenantsArgs),
    /// Copy the SQLite database while the service runs.
    ///
    /// The copy is whole and of one moment. Only this user may read it. It has no files of jobs: copy those after it, since files that the
    /// copy does not know are removed, while files that it misses are lost. Copy a PostgreSQL database with `pg_dump`.
    Backup(administration::BackupArgs),
    /// Print the settings of a command and where each is from, with secrets hidden.
    Config(config::ConfigArgs),
    /// Print the OpenAPI document, or check a file against it.
    Openapi(OpenapiArgs),
    /// Print a script that completes commands and flags in a shell, such as `meshmend completions bash`.
    Completions(CompletionsArgs),
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
        && let Some(message) = config::refusal(&Cli::command())
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
        Command::Backup(args) => administration::backup(&args),
        Command::Config(args) => config::run(&args, Cli::command()),
        Command::Openapi(args) => openapi(&args),
        Command::Completions(args) => completions(&args, Cli::command()),
    }
}

/// Arguments of `meshmend openapi`.
#[derive(Debug, Args)]
struct OpenapiArgs {
    /// Instead of printing, say whether this file is the document; exit code 1 where it is stale.
    #[arg(long, env = "MESHMEND_OPENAPI_CHECK", value_name = "FILE")]
    check: Option<PathBuf>,
    /// Version of the OpenAPI specification that the document follows. `3.0` is for code generators that don't read 3.1: each body
    /// has one media type, and a job is submitted as raw bytes.
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
        Ok(_) => exit::fail(exit::PARTIAL, format!("{} is stale; run 'make openapi'", path.display())),
        Err(error) => exit::fail(exit::BAD_INPUT, format!("{}: {error}", path.display())),
    }
}

/// Arguments of `meshmend completions`.
#[derive(Debug, Args)]
struct CompletionsArgs {
    /// The shell that is to complete commands and flags.
    #[arg(value_enum)]
    shell: Shell,
}

/// Runs `meshmend completions` for this `program`.
fn completions(args: &CompletionsArgs, mut program: clap::Command) -> ExitCode {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut program, "meshmend", &mut script);
    match std::io::stdout().write_all(&script) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => exit::fail(exit::INTERNAL, error),
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
