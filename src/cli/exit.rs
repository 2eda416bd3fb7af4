use std::fmt::Display;
use std::io::Write;
use std::process::ExitCode;

use meshmend::repair::Report;

/// What the exit codes mean, for `--help`.
pub const HELP: &str = "Exit codes of repair, inspect, submit and watch; of several files, the highest:
  0  printable: the result passes every check and no red flag is up. For inspect: nothing is wrong with the file that its level looks for
  1  repaired only in part, or not at all; the report and the messages say what is left. For inspect: something is wrong,
     or the search for intersecting faces was not finished
  2  bad input: the file or an argument can't be used; the message says what and where
  3  internal error, or a job that failed
  4  of submit and watch: the service could not be reached, or refused to do it
  5  not printable, and --require printable was given: the report is written, and no model is
  130  interrupted; jobs that were submitted go on

Exit codes of compare:
  0  faithful: 99 % of the surface that can be seen from outside is within 0.5 % of the diagonal of the second model,
     and no side of the bounding box moved by more than 1 % of it
  1  not faithful
  2, 3  as above

Every flag can be set by an environment variable, named in its help.";

/// The result passes every check, or keeps the shape it is compared with.
pub const PRINTABLE: u8 = 0;
/// Something is left to repair, or the shape was not kept.
pub const PARTIAL: u8 = 1;
/// The file or an argument can't be used.
pub const BAD_INPUT: u8 = 2;
/// A fault of the program or the machine.
pub const INTERNAL: u8 = 3;
/// The service could not be reached, or refused.
pub const REFUSED: u8 = 4;
/// The result is not printable, which `--require printable` asks for.
pub const NOT_PRINTABLE: u8 = 5;
/// Somebody pressed Ctrl-C.
pub const INTERRUPTED: u8 = 130;

/// What a repair's verdict means as an exit code.
pub fn of(report: &Report) -> u8 {
    match report.refusal() {
        Some(_) => NOT_PRINTABLE,
        None if report.verdict.printable => PRINTABLE,
        None => PARTIAL,
    }
}

/// Says what went wrong on standard error.
pub fn fail(code: u8, message: impl Display) -> ExitCode {
    let _ = writeln!(std::io::stderr(), "meshmend: {message}");
    ExitCode::from(code)
}
