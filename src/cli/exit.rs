//! Exit codes and how a command reports failure.

use std::fmt::Display;
use std::io::Write;
use std::process::ExitCode;

use meshmend::repair::Report;

/// The exit codes' meanings, as `--help` prints them.
pub const HELP: &str = "Exit codes of repair, inspect, submit and watch; with several files, the highest code:
  0  printable: the result passes every check and raises no red flag. For inspect: the file has no defect that the level checks
  1  repaired only in part, or not at all; the report and the messages list what is left. For inspect: the file has defects,
     does not meet the rules of --process, or the search for intersecting faces was not finished
  2  bad input: a file or an argument is unusable; the message says what is wrong and where
  3  internal error, or a failed job
  4  for submit and watch: the service could not be reached, or refused the request
  5  the result does not meet --require: the report is written, the model is not
  130  interrupted; submitted jobs continue

Exit codes of compare:
  0  faithful: 99 % of the surface visible from outside is within 0.5 % of the diagonal of the second model,
     and no side of the bounding box moved by more than 1 % of the diagonal
  1  not faithful
  2, 3  as above

Every flag can also be set with the environment variable named in its help.";

/// The result passes every check. For `compare`: the shape was kept.
pub const PRINTABLE: u8 = 0;
/// Defects remain. For `compare`: the shape was not kept.
pub const PARTIAL: u8 = 1;
/// A file or an argument is unusable.
pub const BAD_INPUT: u8 = 2;
/// The program or the machine failed.
pub const INTERNAL: u8 = 3;
/// The service could not be reached, or refused the request.
#[cfg(feature = "service")]
pub const REFUSED: u8 = 4;
/// The result does not meet `--require`.
pub const NOT_PRINTABLE: u8 = 5;
/// The user pressed Ctrl-C.
pub const INTERRUPTED: u8 = 130;

/// Returns the exit code for a repair's report.
pub fn of(report: &Report) -> u8 {
    match report.refusal() {
        Some(_) => NOT_PRINTABLE,
        None if report.verdict.printable => PRINTABLE,
        None => PARTIAL,
    }
}

/// Prints an error message on standard error and returns the exit code.
pub fn fail(code: u8, message: impl Display) -> ExitCode {
    let _ = writeln!(std::io::stderr(), "meshmend: {message}");
    ExitCode::from(code)
}
