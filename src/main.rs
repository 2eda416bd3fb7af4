//! The command line: `meshmend serve`, `work`, `repair`, `inspect`, `migrate`, `config`, `openapi`.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    #[cfg(feature = "failpoints")]
    let _failpoints = fail::FailScenario::setup();
    // Every client of this process speaks TLS by ring; it is installed already only where this is not the first call.
    let _ = rustls::crypto::ring::default_provider().install_default();
    cli::run()
}
