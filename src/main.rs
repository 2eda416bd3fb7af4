//! The command line: `meshmend serve`, `work`, `repair`, `inspect`, `compare`, `submit`, `watch`, `migrate`, `keys`,
//! `tenants`, `backup`, `config`, `openapi`, `completions`.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    #[cfg(feature = "failpoints")]
    let _failpoints = fail::FailScenario::setup();
    // Needs neither the command line nor the network.
    if let Some(code) = meshmend::worker::run_child(std::env::args_os().skip(1)) {
        return code;
    }
    meshmend::tls::use_ring();
    cli::run()
}
