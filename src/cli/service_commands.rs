//! The commands that run, manage or call a service, and `meshmend openapi`.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Subcommand};

use super::{administration, config, exit, service, settings, submit};

/// A command of the feature `service`.
#[derive(Debug, Subcommand)]
pub enum ServiceCommand {
    /// Serve the API and run workers in one process.
    Serve(settings::ServeArgs),
    /// Run workers only. Needs a `serve` process that uses the same database and file store.
    Work(settings::WorkArgs),
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
}

impl ServiceCommand {
    /// Whether the command reads the settings of the service.
    pub fn uses_service_settings(&self) -> bool {
        !matches!(self, Self::Submit(_) | Self::Watch(_) | Self::Config(_) | Self::Openapi(_))
    }
}

/// Runs a command of the feature `service`; `program` is the whole command line.
pub fn run(command: ServiceCommand, program: clap::Command) -> ExitCode {
    match command {
        ServiceCommand::Serve(args) => service::serve(args),
        ServiceCommand::Work(args) => service::work(args),
        ServiceCommand::Submit(args) => submit::submit(&args),
        ServiceCommand::Watch(args) => submit::watch(&args),
        ServiceCommand::Migrate(args) => service::migrate(&args),
        ServiceCommand::Keys(args) => administration::keys(args),
        ServiceCommand::Tenants(args) => administration::tenants(args),
        ServiceCommand::Backup(args) => administration::backup(&args),
        ServiceCommand::Config(args) => config::run(&args, program),
        ServiceCommand::Openapi(args) => openapi(&args),
    }
}

/// Arguments of `meshmend openapi`.
#[derive(Debug, Args)]
pub struct OpenapiArgs {
    /// Check that this file equals the document instead of printing the document; exit code 1 if the file is
    /// outdated.
    #[arg(long, env = "MESHMEND_OPENAPI_CHECK", value_name = "FILE")]
    check: Option<PathBuf>,
    /// OpenAPI version of the document. `3.0` is for code generators that cannot read 3.1: each body has one media
    /// type, and a job is submitted as raw bytes.
    #[arg(long, env = "MESHMEND_OPENAPI_SPEC", default_value = "3.1")]
    spec: Spec,
}

/// Version of the OpenAPI specification.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub enum Spec {
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
