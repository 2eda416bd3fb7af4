use std::ffi::OsString;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::parser::ValueSource;
use clap::{Arg, ArgMatches, Args, Command, ValueEnum};
use meshmend::blender::BlenderConfig;
use serde::Serialize;
use url::Url;

use super::settings::default_workers;
use super::table::table;
use super::{blobs, database, exit, variables};

/// The region of a bucket where neither a flag nor `AWS_REGION` names one.
const AWS_REGION: &str = "us-east-1";
/// What stands for what is not shown.
const HIDDEN: &str = "***";

/// Arguments of `meshmend config`.
#[derive(Debug, Args)]
pub struct ConfigArgs {
    /// How the settings are printed.
    #[arg(long, env = "MESHMEND_CONFIG_FORMAT", value_enum, default_value_t)]
    format: ConfigFormat,
    /// The command line to look at, such as `work --workers 2`; without it, `serve`. It is not run.
    #[arg(value_name = "COMMAND", trailing_var_arg = true, allow_hyphen_values = true)]
    command: Vec<OsString>,
}

/// How settings are printed.
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum ConfigFormat {
    /// For people.
    #[default]
    Table,
    /// For programs.
    Json,
}

/// What is in force for one command.
#[derive(Serialize)]
struct Config {
    command: String,
    settings: Vec<Setting>,
    /// Variables that are set and that no command of this program knows.
    unknown_variables: Vec<String>,
}

#[derive(Serialize)]
struct Setting {
    flag: String,
    variable: Option<String>,
    /// None where nothing is set and there is no default.
    value: Option<String>,
    source: Source,
    secret: bool,
}

/// Where a value is from.
#[derive(Debug, Clone, Copy, Serialize)]
#[serde(rename_all = "lowercase")]
enum Source {
    Flag,
    Environment,
    Default,
    /// Made of other settings, or of what this machine has.
    Computed,
}

/// Runs `meshmend config`: `program` reads the command line that it is about.
pub fn run(args: &ConfigArgs, mut program: Command) -> ExitCode {
    let given = if args.command.is_empty() { vec!["serve".into()] } else { args.command.clone() };
    let matches = match program.try_get_matches_from_mut([OsString::from("meshmend")].into_iter().chain(given)) {
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
    // Commands that run the service refuse this environment too.
    variables::refusal(&program).map_or(printed, |message| exit::fail(exit::BAD_INPUT, message))
}

impl Config {
    /// The settings of the command that was given, which may be a command's command.
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
            unknown_variables: variables::unknown(program),
        }
    }

    fn table(&self) -> String {
        let rows = self.settings.iter().map(|it| {
            let value = it.value.as_deref().unwrap_or("none");
            [it.flag.as_str(), value, it.source.as_str(), it.variable.as_deref().unwrap_or("-")].map(str::to_owned)
        });
        table(["SETTING", "VALUE", "FROM", "VARIABLE"], rows) + "\n"
    }
}

impl Setting {
    fn of(flag: &Arg, matches: &ArgMatches) -> Self {
        let id = flag.get_id().as_str();
        let secret = flag.is_hide_env_values_set();
        let values = matches.get_raw(id).into_iter().flatten();
        let values: Vec<String> = values.map(|value| shown(&value.to_string_lossy(), secret)).collect();
        let given = (!values.is_empty()).then(|| values.join(","));
        let computed = if given.is_none() { computed(id, matches) } else { None };
        let source = match matches.value_source(id) {
            _ if computed.is_some() => Source::Computed,
            Some(ValueSource::CommandLine) => Source::Flag,
            Some(ValueSource::EnvVariable) => Source::Environment,
            _ => Source::Default,
        };
        Self {
            flag: format!("--{}", flag.get_long().unwrap_or(id)),
            variable: flag.get_env().map(|name| name.to_string_lossy().into_owned()),
            value: given.or(computed),
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

/// The value that is in force for a setting that is not given; none where none is.
fn computed(id: &str, matches: &ArgMatches) -> Option<String> {
    let is_given = |id: &str| matches.try_contains_id(id).unwrap_or(false);
    let data_dir = || matches.get_one::<PathBuf>("data_dir").cloned().unwrap_or_default();
    match id {
        "workers" if matches.try_get_one::<bool>("no_workers").ok().flatten() == Some(&true) => Some("0".to_owned()),
        "workers" => Some(default_workers().to_string()),
        "tenant_max_queued" => matches.get_one::<u64>("max_queued").map(ToString::to_string),
        "database_url" => Some(format!("sqlite:{}", database::file(&data_dir()).display())),
        "blob_url" => Some(blobs::folder(&data_dir()).display().to_string()),
        "s3_region" if is_given("blob_url") => {
            Some(std::env::var("AWS_REGION").unwrap_or_else(|_| AWS_REGION.to_owned()))
        }
        "blenders_memory_mib" => Some((BlenderConfig::default().memory_for_all() >> 20).to_string()),
        "blender_slots" => Some(BlenderConfig::default().slots_folder().display().to_string()),
        "blender" => Some(BlenderConfig::default().candidates().first()?.display().to_string()),
        _ => None,
    }
}

fn is_setting(flag: &Arg) -> bool {
    !flag.is_positional() && flag.get_env().is_some()
}

/// A value as it may be seen. Of a secret, only where it leads to, if it is an address; of any other address, all but
/// who asks there and with what.
pub(super) fn shown(value: &str, secret: bool) -> String {
    let Some(mut url) = Url::parse(value).ok().filter(Url::has_host) else {
        return if secret { HIDDEN.to_owned() } else { value.to_owned() };
    };
    if secret {
        let port = url.port().map(|port| format!(":{port}")).unwrap_or_default();
        return format!("{}://{HIDDEN}@{}{port}/{HIDDEN}", url.scheme(), url.host_str().unwrap_or_default());
    }
    let asks_as = !url.username().is_empty() || url.password().is_some();
    if !asks_as && url.query().is_none() {
        return value.to_owned();
    }
    if asks_as && (url.set_username(HIDDEN).is_err() || url.set_password(None).is_err()) {
        return HIDDEN.to_owned();
    }
    url.set_query(url.query().map(|_| HIDDEN));
    url.into()
}

#[cfg(test)]
mod tests {
    use super::shown;

    #[test]
    fn a_secret_is_never_shown_and_an_address_without_who_asks_there() {
        for (value, secret, seen) in [
            ("plain", false, "plain"),
            ("plain", true, "***"),
            ("127.0.0.1:8080", false, "127.0.0.1:8080"),
            ("key:with:colons", true, "***"),
            ("postgres://me:pass@db:5432/jobs?password=pass", true, "postgres://***@db:5432/***"),
            ("postgres://me:p%40ss@db/jobs", true, "postgres://***@db/***"),
            ("http://collector:4318", false, "http://collector:4318"),
            ("http://token@collector:4318/x", false, "http://***@collector:4318/x"),
            ("http://collector:4318/x?key=token", false, "http://collector:4318/x?***"),
            ("s3://bucket/prefix", false, "s3://bucket/prefix"),
        ] {
            assert_eq!(shown(value, secret), seen, "{value}");
        }
    }
}
