use std::collections::BTreeSet;

use clap::Command;

/// How the environment variables of this program begin.
const PREFIX: &str = "MESHMEND_";

/// Variables that begin so and that other programs of this repository read: the clients, the example of a shop, scripts and tests. They
/// may stand in the same environment.
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

/// How alike a known name must be to be suggested; 1 is equal (Jaro-Winkler).
const MIN_SIMILARITY: f64 = 0.92;

/// Why commands that run the service refuse this environment: variables that look like settings and that no command reads. None where
/// there are no such variables. A misspelt setting would silently have no effect.
pub(super) fn refusal(program: &Command) -> Option<String> {
    let unknown = unknown(program);
    if unknown.is_empty() {
        return None;
    }
    let known = of_commands(program);
    let lines: Vec<String> = unknown.iter().map(|name| describe(name, &known)).collect();
    Some(lines.join("\n"))
}

/// The variables that are set, begin like settings, and are read by no command.
pub(super) fn unknown(program: &Command) -> Vec<String> {
    let set = std::env::vars_os().filter_map(|(name, _)| name.into_string().ok());
    let in_kubernetes = std::env::var_os("KUBERNETES_SERVICE_HOST").is_some();
    unknown_of(set, &of_commands(program), in_kubernetes)
}

fn unknown_of(set: impl Iterator<Item = String>, known: &BTreeSet<String>, in_kubernetes: bool) -> Vec<String> {
    let is_known_elsewhere =
        |name: &String| COMPANION_VARIABLES.contains(&name.as_str()) || (in_kubernetes && is_service_link(name));
    let is_unknown = |name: &String| name.starts_with(PREFIX) && !known.contains(name) && !is_known_elsewhere(name);
    let unknown: BTreeSet<String> = set.filter(is_unknown).collect();
    unknown.into_iter().collect()
}

fn describe(name: &str, known: &BTreeSet<String>) -> String {
    let alike = known.iter().map(|other| (strsim::jaro_winkler(name, other), other));
    let best = alike.filter(|(alike, _)| *alike > MIN_SIMILARITY).max_by(|(a, _), (b, _)| a.total_cmp(b));
    let hint = best.map_or_else(String::new, |(_, other)| format!(" Did you mean {other}?"));
    format!("{name} is set, but no command of this version reads it. Correct the name or unset it.{hint}")
}

/// Whether Kubernetes sets such a variable for a Service named `meshmend` (its documentation, "Service", "Environment variables").
fn is_service_link(name: &str) -> bool {
    let is_of_port =
        |rest: &str| rest.is_empty() || ["_TCP", "_UDP", "_SCTP"].iter().any(|protocol| rest.contains(protocol));
    name.ends_with("_SERVICE_HOST")
        || name.contains("_SERVICE_PORT")
        || name.find("_PORT").is_some_and(|at| is_of_port(&name[at + "_PORT".len()..]))
}

/// Every variable that a command reads.
fn of_commands(command: &Command) -> BTreeSet<String> {
    let own = command.get_arguments().filter_map(|flag| Some(flag.get_env()?.to_string_lossy().into_owned()));
    own.chain(command.get_subcommands().flat_map(of_commands)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known() -> BTreeSet<String> {
        BTreeSet::from(["MESHMEND_WORKERS".to_owned(), "MESHMEND_LISTEN".to_owned()])
    }

    fn unknown(set: &[&str], in_kubernetes: bool) -> Vec<String> {
        unknown_of(set.iter().map(|name| (*name).to_owned()), &known(), in_kubernetes)
    }

    #[test]
    fn a_variable_that_no_command_reads_is_named_with_the_one_that_was_probably_meant() {
        let set = ["PATH", "MESHMEND_WORKERS", "MESHMEND_WORKRES", "MESHMEND_URL"];
        assert_eq!(unknown(&set, false), ["MESHMEND_WORKRES"]);
        let text = describe("MESHMEND_WORKRES", &known());
        assert!(text.starts_with("MESHMEND_WORKRES is set, but no command of this version reads it."), "{text}");
        assert!(text.ends_with("Did you mean MESHMEND_WORKERS?"), "{text}");
        assert!(describe("MESHMEND_COLOUR", &known()).ends_with("unset it."));
    }

    #[test]
    fn variables_of_a_kubernetes_service_named_meshmend_are_no_settings() {
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
}
