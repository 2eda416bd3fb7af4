//! The program `meshmend`: the command line, or with the feature `service` also a child process of a worker.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    #[cfg(feature = "failpoints")]
    let _failpoints = fail::FailScenario::setup();
    #[cfg(feature = "service")]
    {
        // A worker starts this program again for each job. That child needs neither the command line nor TLS.
        if let Some(code) = meshmend::worker::run_child(std::env::args_os().skip(1)) {
            return code;
        }
        meshmend::tls::use_ring();
    }
    cli::run()
}
