//! The command line: `meshmend serve`, `work`, `repair`, `inspect`, `migrate`, `config`, `openapi`.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    #[cfg(feature = "failpoints")]
    let _failpoints = fail::FailScenario::setup();
    meshmend::tls::use_ring();
    cli::run()
}
