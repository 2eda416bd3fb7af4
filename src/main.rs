//! The program `meshmend`: a child process of a worker, or the command line.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    #[cfg(feature = "failpoints")]
    let _failpoints = fail::FailScenario::setup();
    // A worker starts this program again for each job. That child needs neither the command line nor TLS.
    if let Some(code) = meshmend::worker::run_child(std::env::args_os().skip(1)) {
        return code;
    }
    meshmend::tls::use_ring();
    cli::run()
}
