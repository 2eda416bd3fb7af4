//! deploy/meshmend.service and its environment file: settings, limits and paths.

use std::collections::BTreeMap;

use crate::support::program::settings;
use crate::support::source::text;

/// The values of each name in a section.
fn section(name: &str) -> BTreeMap<String, Vec<String>> {
    let text = text("deploy/meshmend.service");
    let (_, from) = text.split_once(&format!("[{name}]\n")).expect("a section");
    let lines = from.lines().take_while(|line| !line.starts_with('[')).filter(|line| !line.starts_with('#'));
    let mut values: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (name, value) in lines.filter_map(|line| line.split_once('=')) {
        values.entry(name.to_owned()).or_default().push(value.to_owned());
    }
    values
}

/// The `NAME=value` pairs of all lines, including those that are commented out.
fn pairs<'a>(lines: impl Iterator<Item = &'a str>) -> BTreeMap<String, String> {
    let lines = lines.map(|line| line.trim_start_matches('#')).filter(|line| line.starts_with("MESHMEND_"));
    lines.filter_map(|line| line.split_once('=')).map(|(name, value)| (name.to_owned(), value.to_owned())).collect()
}

#[test]
fn the_unit_starts_the_program_with_valid_settings() {
    let service = section("Service");
    let one = |name: &str| service[name].first().expect("a value").as_str();
    let given: Vec<_> = service["Environment"].iter().flat_map(|line| line.split(' ')).collect();
    let mut variables = pairs(given.into_iter());
    assert_eq!(variables["MESHMEND_DATA_DIR"], format!("/var/lib/{}", one("StateDirectory")));
    assert_eq!(variables["MESHMEND_BLENDER_SLOTS"], format!("/run/{}", one("RuntimeDirectory")));
    let mut command = one("ExecStart").split(' ').map(str::to_owned);
    assert_eq!(command.next().as_deref(), Some("/usr/local/bin/meshmend"));
    let command: Vec<_> = command.collect();
    let listen = settings(&command, &variables)["MESHMEND_LISTEN"].clone();
    assert!(listen.starts_with("127."), "reachable from other machines at {listen}");
    let example = text("deploy/meshmend.env.example");
    variables.extend(pairs(example.lines()));
    let settings = settings(&command, &variables);
    assert_eq!(settings["MESHMEND_JOB_MEMORY_MIB"], "4096");
    let [grace, kill] = [&settings["MESHMEND_SHUTDOWN_GRACE_S"], one("TimeoutStopSec")].map(|time| time.parse::<f64>());
    assert!(kill.expect("seconds") >= grace.expect("seconds") + 5.0);
    assert!(one("EnvironmentFile").ends_with("/etc/meshmend/meshmend.env"));
}

#[test]
fn it_has_no_more_than_it_needs() {
    let service = section("Service");
    for (name, value) in [
        ("DynamicUser", "yes"),
        ("CapabilityBoundingSet", ""),
        ("NoNewPrivileges", "yes"),
        ("ProtectSystem", "strict"),
        ("ProtectHome", "yes"),
        ("PrivateTmp", "yes"),
        ("PrivateDevices", "yes"),
        ("KillMode", "mixed"),
        ("OOMPolicy", "continue"),
    ] {
        assert_eq!(service[name], [value], "{name}");
    }
}
