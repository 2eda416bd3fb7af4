//! docker/compose.yaml: settings, limits and open ports of its services.

use std::collections::BTreeSet;

use serde_json::Value;

use crate::support::compose::{FILE, compose, services, variables};
use crate::support::containers::{Container, mebibytes, seconds};
use crate::support::image::Image;
use crate::support::source::{names, root, strings, text, yaml};

/// The items of a list, or the keys of a map.
fn named(value: &Value) -> Vec<String> {
    match value {
        Value::Object(map) => map.keys().cloned().collect(),
        list => strings(list),
    }
}

#[test]
fn each_of_its_commands_is_one_that_the_program_takes_with_its_settings() {
    let compose = compose();
    let mut checked = Vec::new();
    for (name, service) in services(&compose).iter().filter(|(_, service)| service["image"] == "meshmend") {
        let mounts = strings(&service["volumes"]).into_iter().chain(strings(&service["tmpfs"]));
        let inside = |mount: String| mount.split(':').find(|path| path.starts_with('/')).expect("a folder").to_owned();
        let container = Container {
            name: name.clone(),
            command: strings(&service["command"]),
            variables: variables(service),
            mounts: mounts.map(inside).collect(),
            memory_mib: mebibytes(service["mem_limit"].as_str().expect("a limit")),
            grace: seconds(service["stop_grace_period"].as_str().expect("a time")),
        };
        let settings = container.check();
        assert!(settings["MESHMEND_DATABASE_URL"].starts_with("postgres://"), "{name}");
        checked.push((name.as_str(), settings.get("MESHMEND_NO_WORKERS").cloned()));
    }
    assert_eq!(checked, [("api", Some("true".to_owned())), ("migrate", None), ("worker", None)]);
}

#[test]
fn no_container_has_more_than_it_needs() {
    let compose = compose();
    for (name, service) in services(&compose) {
        assert_eq!(service["read_only"], true, "{name}");
        assert_eq!(strings(&service["cap_drop"]), ["ALL"], "{name}");
        assert_eq!(strings(&service["security_opt"]), ["no-new-privileges:true"], "{name}");
        assert!(service["mem_limit"].is_string(), "{name} has no memory limit");
        assert!(service["privileged"].is_null() && service["cap_add"].is_null(), "{name}");
        for port in strings(&service["ports"]) {
            assert!(port.starts_with("127.0.0.1:"), "{name} is reachable from other machines at {port}");
        }
        let image = service["image"].as_str().expect("an image");
        assert!(image == "meshmend" || image.rsplit(':').next().is_some_and(|tag| tag != "latest"), "{image}");
    }
    let worker = &services(&compose)["worker"];
    let networks = strings(&worker["networks"]);
    assert!(networks.iter().all(|network| compose["networks"][network]["internal"] == true), "a worker has no network");
    assert_eq!(worker["deploy"]["replicas"], 2);
}

#[test]
fn names_in_the_compose_file_exist() {
    let compose = compose();
    let has = |kind: &str, name: &str| compose[kind].as_object().is_some_and(|them| them.contains_key(name));
    for (name, service) in services(&compose) {
        for (other, condition) in service["depends_on"].as_object().into_iter().flatten() {
            let other = services(&compose).get(other).unwrap_or_else(|| panic!("{name} waits for {other}"));
            if condition["condition"] == "service_healthy" {
                assert!(other["healthcheck"]["test"].is_array() || other["image"] == "meshmend", "{name}");
            }
        }
        for network in named(&service["networks"]) {
            assert!(has("networks", &network), "{name}: {network}");
        }
        for volume in strings(&service["volumes"]) {
            let (kept, _) = volume.split_once(':').unwrap_or(("", ""));
            assert!(kept.is_empty() || has("volumes", kept), "{name}: {volume}");
        }
        for config in service["configs"].as_array().into_iter().flatten() {
            assert!(has("configs", config["source"].as_str().expect("a name")), "{name}: {config}");
        }
    }
    for (name, config) in compose["configs"].as_object().expect("configs") {
        let file = root().join("docker").join(config["file"].as_str().expect("a file"));
        assert!(file.is_file(), "{name}: {}", file.display());
    }
    let given = text("docker/.env.example");
    let given: BTreeSet<_> = given.lines().filter_map(|line| line.split_once('=')).map(|(name, _)| name).collect();
    let file = text(FILE);
    let asked = names(&file, "${", |c| c.is_ascii_uppercase() || c.is_ascii_digit() || "_${".contains(c));
    let asked: BTreeSet<_> = asked.into_iter().map(|variable| variable.trim_start_matches("${")).collect();
    assert_eq!(asked, given);
}

#[test]
fn prometheus_scrapes_the_listeners_for_metrics() {
    let [prometheus] = yaml("deploy/prometheus/prometheus.yml").try_into().expect("one document");
    let asked = &prometheus["scrape_configs"][0]["dns_sd_configs"][0];
    let port = format!(":{}", asked["port"]);
    assert!(Image::read().variables()["MESHMEND_METRICS_LISTEN"].ends_with(&port));
    let compose = compose();
    let networks = strings(&services(&compose)["prometheus"]["networks"]);
    for name in strings(&asked["names"]) {
        let theirs = strings(&services(&compose)[&name]["networks"]);
        assert!(theirs.iter().any(|network| networks.contains(network)), "{name} is not reached");
    }
}
