//! `meshmend config`: the effective settings, and environment variables that look like settings but are unknown.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::parser::ValueSource;
use clap::{Arg, ArgMatches, Args, Command, ValueEnum};
use comfy_table::{Table, presets};
use meshmend::blender::BlenderConfig;
use serde::Serialize;

use super::exit;
use super::service_error::masked;
use super::settings::{database_file, default_workers, files_folder};

/// Region of a bucket when neither a flag nor `AWS_REGION` sets one.
const AWS_REGION: &str = "us-east-1";

/// Arguments of `meshmend config`.
#[derive(Debug, Args)]
pub struct ConfigArgs {
    /// Format of the output.
    #[arg(long, env = "MESHMEND_CONFIG_FORMAT", value_enum, default_value_t)]
    format: ConfigFormat,
    /// Command line to examine, such as `work --workers 2`; the command is not run. Default: `serve`.
    #[arg(value_name = "COMMAND", trailing_var_arg = true, allow_hyphen_values = true)]
    command: Vec<OsString>,
}

/// Format of the output.
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum ConfigFormat {
    /// For people.
    #[default]
    Table,
    /// For programs.
    Json,
}

/// The effective settings of one command.
#[derive(Serialize)]
struct Config {
    command: String,
    settings: Vec<Setting>,
    /// Set variables with the prefix `MESHMEND_` that no command reads.
    unknown_variables: Vec<String>,
}

#[derive(Serialize)]
struct Setting {
    flag: String,
    variable: Option<String>,
    /// None if the setting is unset and has no default.
    value: Option<String>,
    source: Source,
    secret: bool,
}

/// Where a value comes from.
#[derive(Debug, Clone, Copy, Serialize)]
#[serde(rename_all = "lowercase")]
enum Source {
    Flag,
    Environment,
    Default,
    /// Derived from other settings or from this machine.
    Computed,
}

/// Runs `meshmend config`; `program` parses the command line to examine.
pub fn run(args: &ConfigArgs, mut program: Command) -> ExitCode {
    let command_line = if args.command.is_empty() { vec!["serve".into()] } else { args.command.clone() };
    let matches = match program.try_get_matches_from_mut([OsString::from("meshmend")].into_iter().chain(command_line)) {
        Ok(matches) => matches,
        Err(error) => error.exit(),
    };
    let config = Config::of(&program, &matches);
    let text = match args.format {
        ConfigFormat::Table => Ok(config.table()),
        ConfigFormat::Json => serde_json::to_string_pretty(&config).map(|json| json + "\n"),
    };
    let printed = match text.map_err(std::io::Error::from).and_then(|text| std::io::stdout().write_all(text.as_bytes()))
    {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => exit::fail(exit::INTERNAL, error),
    };
    // Service commands refuse unknown variables, so `config` fails in the same way.
    unknown_variables_error(&program).map_or(printed, |message| exit::fail(exit::BAD_INPUT, message))
}

impl Config {
    /// The settings of the command that `matches` selected, which may be a subcommand of a command.
    fn of(program: &Command, matches: &ArgMatches) -> Self {
        let (mut command, mut matches) = (program, matches);
        let mut names = Vec::new();
        while let Some((name, inner)) = matches.subcommand() {
            let Some(found) = command.find_subcommand(name) else { break };
            (command, matches) = (found, inner);
            names.push(name);
        }
        let flags = command.get_arguments().filter(|flag| is_setting(flag));
        Self {
            command: names.join(" "),
            settings: flags.map(|flag| Setting::of(flag, matches)).collect(),
            unknown_variables: unknown_variables(program),
        }
    }

    fn table(&self) -> String {
        let rows = self.settings.iter().map(|setting| {
            let value = setting.value.as_deref().unwrap_or("none");
            [setting.flag.as_str(), value, setting.source.as_str(), setting.variable.as_deref().unwrap_or("-")]
                .map(str::to_owned)
        });
        table(["SETTING", "VALUE", "FROM", "VARIABLE"], rows) + "\n"
    }
}

impl Setting {
    fn of(flag: &Arg, matches: &ArgMatches) -> Self {
        let id = flag.get_id().as_str();
        let secret = flag.is_hide_env_values_set();
        let values = matches.get_raw(id).into_iter().flatten();
        let values: Vec<String> = values.map(|value| masked(&value.to_string_lossy(), secret)).collect();
        let explicit = (!values.is_empty()).then(|| values.join(","));
        let computed = if explicit.is_none() { computed_value(id, matches) } else { None };
        let source = match matches.value_source(id) {
            _ if computed.is_some() => Source::Computed,
            Some(ValueSource::CommandLine) => Source::Flag,
            Some(ValueSource::EnvVariable) => Source::Environment,
            _ => Source::Default,
        };
        Self {
            flag: format!("--{}", flag.get_long().unwrap_or(id)),
            variable: flag.get_env().map(|name| name.to_string_lossy().into_owned()),
            value: explicit.or(computed),
            source,
            secret,
        }
    }
}

impl Source {
    fn as_str(self) -> &'static str {
        match self {
            Self::Flag => "flag",
            Self::Environment => "environment",
            Self::Default => "default",
            Self::Computed => "computed",
        }
    }
}

/// The effective value of an unset setting; `None` if there is none.
fn computed_value(id: &str, matches: &ArgMatches) -> Option<String> {
    let is_set = |id: &str| matches.try_contains_id(id).unwrap_or(false);
    let data_dir = || matches.get_one::<PathBuf>("data_dir").cloned().unwrap_or_default();
    match id {
        "workers" if matches.try_get_one::<bool>("no_workers").ok().flatten() == Some(&true) => Some("0".to_owned()),
        "workers" => Some(default_workers().to_string()),
        "tenant_max_queued" => matches.get_one::<u64>("max_queued").map(ToString::to_string),
        "database_url" => Some(format!("sqlite:{}", database_file(&data_dir()).display())),
        "blob_url" => Some(files_folder(&data_dir()).display().to_string()),
        "s3_region" if is_set("blob_url") => {
            Some(std::env::var("AWS_REGION").unwrap_or_else(|_| AWS_REGION.to_owned()))
        }
        "blender_total_memory_mib" => Some((BlenderConfig::default().memory_for_all() >> 20).to_string()),
        "blender_slots" => Some(BlenderConfig::default().slots_folder().display().to_string()),
        "blender" => Some(BlenderConfig::default().candidates().first()?.display().to_string()),
        _ => None,
    }
}

fn is_setting(flag: &Arg) -> bool {
    !flag.is_positional() && flag.get_env().is_some()
}

/// Prefix of the environment variables of this program.
const VARIABLE_PREFIX: &str = "MESHMEND_";

/// Variables with this prefix that other programs of this repository read: the clients, the example shop, scripts and
/// tests. They may be set in the same environment.
const COMPANION_VARIABLES: [&str; 16] = [
    "MESHMEND_BROWSER",
    "MESHMEND_BUCKET",
    "MESHMEND_CHECK_API_SECONDS",
    "MESHMEND_CHECK_API_SEED",
    "MESHMEND_FUZZ_FILE",
    "MESHMEND_FUZZ_SECONDS",
    "MESHMEND_FUZZ_SEED",
    "MESHMEND_FUZZ_TARGET",
    "MESHMEND_KILLS",
    "MESHMEND_KILL_SEED",
    "MESHMEND_LIB3MF_PYTHON",
    "MESHMEND_LOAD_S",
    "MESHMEND_PEER_PYTHON",
    "MESHMEND_PROGRAM",
    "MESHMEND_URL",
    "MESHMEND_WEBHOOK_SECRET",
];

/// Least Jaro-Winkler similarity of a suggested name; 1 means equal.
const MIN_SIMILARITY: f64 = 0.92;

/// The error message for unknown variables with the prefix of this program; `None` if there are none. Service
/// commands refuse them, since a misspelt setting would silently have no effect.
pub(super) fn unknown_variables_error(program: &Command) -> Option<String> {
    let unknown = unknown_variables(program);
    if unknown.is_empty() {
        return None;
    }
    let known = variables_of(program);
    let lines: Vec<String> = unknown.iter().map(|name| describe_unknown(name, &known)).collect();
    Some(lines.join("\n"))
}

/// The set variables with the prefix of this program that no command reads.
fn unknown_variables(program: &Command) -> Vec<String> {
    let set = std::env::vars_os().filter_map(|(name, _)| name.into_string().ok());
    let in_kubernetes = std::env::var_os("KUBERNETES_SERVICE_HOST").is_some();
    unknown_among(set, &variables_of(program), in_kubernetes)
}

fn unknown_among(set: impl Iterator<Item = String>, known: &BTreeSet<String>, in_kubernetes: bool) -> Vec<String> {
    let is_known_elsewhere =
        |name: &String| COMPANION_VARIABLES.contains(&name.as_str()) || (in_kubernetes && is_service_link(name));
    let is_unknown =
        |name: &String| name.starts_with(VARIABLE_PREFIX) && !known.contains(name) && !is_known_elsewhere(name);
    let unknown: BTreeSet<String> = set.filter(is_unknown).collect();
    unknown.into_iter().collect()
}

fn describe_unknown(name: &str, known: &BTreeSet<String>) -> String {
    let scored = known.iter().map(|other| (strsim::jaro_winkler(name, other), other));
    let best = scored.filter(|(similarity, _)| *similarity > MIN_SIMILARITY).max_by(|(a, _), (b, _)| a.total_cmp(b));
    let hint = best.map_or_else(String::new, |(_, other)| format!(" Did you mean {other}?"));
    format!("{name} is set, but no command of this version reads it. Correct the name or unset it.{hint}")
}

/// Whether Kubernetes sets this variable for a Service named `meshmend` (Kubernetes documentation, "Service",
/// "Environment variables").
fn is_service_link(name: &str) -> bool {
    let is_of_port =
        |rest: &str| rest.is_empty() || ["_TCP", "_UDP", "_SCTP"].iter().any(|protocol| rest.contains(protocol));
    name.ends_with("_SERVICE_HOST")
        || name.contains("_SERVICE_PORT")
        || name.find("_PORT").is_some_and(|at| is_of_port(&name[at + "_PORT".len()..]))
}

/// Every environment variable that the command or one of its subcommands reads.
fn variables_of(command: &Command) -> BTreeSet<String> {
    let own = command.get_arguments().filter_map(|flag| Some(flag.get_env()?.to_string_lossy().into_owned()));
    own.chain(command.get_subcommands().flat_map(variables_of)).collect()
}

/// Formats rows under a header, in columns aligned by spaces, for people and for tools such as `awk`.
pub(super) fn table<const N: usize>(header: [&str; N], rows: impl IntoIterator<Item = [String; N]>) -> String {
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_header(header).add_rows(rows);
    for column in table.column_iter_mut() {
        column.set_padding((0, 2));
    }
    table.trim_fmt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known() -> BTreeSet<String> {
        BTreeSet::from(["MESHMEND_WORKERS".to_owned(), "MESHMEND_LISTEN".to_owned()])
    }

    fn unknown(set: &[&str], in_kubernetes: bool) -> Vec<String> {
        unknown_among(set.iter().map(|name| (*name).to_owned()), &known(), in_kubernetes)
    }

    #[test]
    fn an_unknown_variable_is_reported_with_the_most_similar_known_one() {
        let set = ["PATH", "MESHMEND_WORKERS", "MESHMEND_WORKRES", "MESHMEND_URL"];
        assert_eq!(unknown(&set, false), ["MESHMEND_WORKRES"]);
        let text = describe_unknown("MESHMEND_WORKRES", &known());
        assert!(text.starts_with("MESHMEND_WORKRES is set, but no command of this version reads it."), "{text}");
        assert!(text.ends_with("Did you mean MESHMEND_WORKERS?"), "{text}");
        assert!(describe_unknown("MESHMEND_COLOUR", &known()).ends_with("unset it."));
    }

    #[test]
    fn variables_of_a_kubernetes_service_named_meshmend_are_ignored() {
        let links = [
            "MESHMEND_SERVICE_HOST",
            "MESHMEND_SERVICE_PORT",
            "MESHMEND_SERVICE_PORT_HTTP",
            "MESHMEND_PORT",
            "MESHMEND_PORT_80_TCP",
            "MESHMEND_PORT_80_TCP_ADDR",
        ];
        assert_eq!(unknown(&links, true), [""; 0]);
        assert_eq!(unknown(&links, false).len(), links.len());
        assert_eq!(unknown(&["MESHMEND_PORTS"], true), ["MESHMEND_PORTS"]);
    }

    #[test]
    fn table_columns_are_aligned_and_lines_have_no_trailing_spaces() {
        let rows = [["a", "1"], ["long name", "22"]].map(|row| row.map(str::to_owned));
        assert_eq!(table(["NAME", "N"], rows), "NAME       N\na          1\nlong name  22");
    }
}
