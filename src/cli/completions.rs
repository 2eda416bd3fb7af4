use std::io::Write;
use std::process::ExitCode;

use clap::{Args, Command};
use clap_complete::Shell;

use super::exit;

/// Arguments of `meshmend completions`.
#[derive(Debug, Args)]
pub struct CompletionsArgs {
    /// The shell that is to complete commands and flags.
    #[arg(value_enum)]
    shell: Shell,
}

/// Runs `meshmend completions` for this `program`.
pub fn run(args: &CompletionsArgs, mut program: Command) -> ExitCode {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut program, "meshmend", &mut script);
    match std::io::stdout().write_all(&script) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => exit::fail(exit::INTERNAL, error),
    }
}
