use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;

use super::exit;

/// Arguments of `meshmend openapi`.
#[derive(Debug, Args)]
pub struct OpenapiArgs {
    /// Instead of printing, say whether this file is the document; exit code 1 where it is stale.
    #[arg(long, env = "MESHMEND_OPENAPI_CHECK", value_name = "FILE")]
    check: Option<PathBuf>,
}

/// Runs `meshmend openapi`.
pub fn run(args: &OpenapiArgs) -> ExitCode {
    let document = match meshmend::api::document().to_pretty_json() {
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
