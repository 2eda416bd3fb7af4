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
pub fn run(args: &OpenapiArgs) -> ExitCode {
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
