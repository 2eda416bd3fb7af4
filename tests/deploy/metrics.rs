//! The Grafana dashboard and the Prometheus alerts name metrics and labels that exist.

use std::collections::BTreeSet;

use meshmend::telemetry::{METRICS, Metric, MetricKind};
use serde_json::Value;

use crate::support::source::{names, text, yaml};

/// Labels that Prometheus itself adds.
const OF_PROMETHEUS: [&str; 3] = ["instance", "job", "le"];

fn expressions(value: &Value) -> Vec<String> {
    match value {
        Value::Object(map) => {
            let own = map.get("expr").and_then(Value::as_str).map(str::to_owned);
            own.into_iter().chain(map.values().flat_map(expressions)).collect()
        }
        Value::Array(list) => list.iter().flat_map(expressions).collect(),
        _ => Vec::new(),
    }
}

/// The metric that a series belongs to.
fn metric(series: &str) -> Option<&'static Metric> {
    METRICS.iter().find(|metric| match series.strip_prefix(metric.name) {
        Some(rest) if metric.kind == MetricKind::Histogram => ["_bucket", "_sum", "_count"].contains(&rest),
        Some(rest) => rest.is_empty(),
        None => false,
    })
}

fn is_of_a_name(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '_'
}

/// The metrics of an expression; each must exist and have the labels that the expression uses.
fn metrics(expression: &str) -> BTreeSet<&'static str> {
    let mut found = BTreeSet::new();
    let mut labels: BTreeSet<&str> = OF_PROMETHEUS.into();
    let mut rest = expression;
    let own = ["meshmend_", "process_"].into_iter().flat_map(|prefix| names(expression, prefix, is_of_a_name));
    for series in own {
        let metric = metric(series).unwrap_or_else(|| panic!("there is no {series}: {expression}"));
        found.insert(metric.name);
        labels.extend(metric.labels);
        rest = &rest[rest.find(series).expect("it is there") + series.len()..];
        if let Some(matchers) = rest.strip_prefix('{') {
            let matchers = &matchers[..matchers.find('}').expect("an end")];
            for matcher in matchers.split("\",") {
                let label = matcher.split(['=', '!']).next().expect("a label").trim();
                assert!(metric.labels.contains(&label) || OF_PROMETHEUS.contains(&label), "{label}: {expression}");
            }
        }
    }
    for clause in ["by (", "ignoring("] {
        for (at, _) in expression.match_indices(clause) {
            let list = &expression[at + clause.len()..];
            for label in list[..list.find(')').expect("an end")].split(',') {
                assert!(labels.contains(label.trim()), "{label}: {expression}");
            }
        }
    }
    found
}

fn dashboard() -> Value {
    serde_json::from_str(&text("deploy/grafana/meshmend.json")).expect("JSON")
}

#[test]
fn every_metric_is_drawn_and_whatever_is_drawn_is_a_metric() {
    let expressions = expressions(&dashboard());
    let drawn: BTreeSet<_> = expressions.iter().flat_map(|expression| metrics(expression)).collect();
    let all: BTreeSet<_> = METRICS.iter().map(|metric| metric.name).collect();
    assert_eq!(drawn, all);
}

#[test]
fn dashboard_panels_do_not_overlap() {
    let dashboard = dashboard();
    let panels = dashboard["panels"].as_array().expect("panels");
    let mut taken = BTreeSet::new();
    let ids: BTreeSet<_> = panels.iter().map(|panel| panel["id"].as_u64().expect("an id")).collect();
    assert_eq!(ids.len(), panels.len());
    for panel in panels {
        let at = |name: &str| panel["gridPos"][name].as_u64().expect("a number");
        assert!(at("x") + at("w") <= 24, "{}", panel["title"]);
        for cell in (at("x")..at("x") + at("w")).flat_map(|x| (at("y")..at("y") + at("h")).map(move |y| (x, y))) {
            assert!(taken.insert(cell), "{} overlaps another panel", panel["title"]);
        }
    }
}

#[test]
fn alerts_use_existing_metrics_and_have_descriptions() {
    let [alerts] = yaml("deploy/prometheus/alerts.yml").try_into().expect("one document");
    let rules = alerts["groups"][0]["rules"].as_array().expect("rules").clone();
    assert!(rules.len() > 8);
    for rule in &rules {
        let expression = rule["expr"].as_str().expect("an expression");
        assert!(!metrics(expression).is_empty() || expression.starts_with("up{"), "{rule}");
        assert!(rule["annotations"]["summary"].is_string(), "{rule}");
        assert!(["page", "ticket"].contains(&rule["labels"]["severity"].as_str().expect("a severity")), "{rule}");
    }
    let [tests] = yaml("deploy/prometheus/alerts_test.yml").try_into().expect("one document");
    for series in
        tests["tests"].as_array().expect("tests").iter().flat_map(|test| test["input_series"].as_array()).flatten()
    {
        metrics(series["series"].as_str().expect("a series"));
    }
}

#[test]
fn the_documentation_has_a_remedy_for_each_alert() {
    let page = text("docs/metrics.md");
    let documented: Vec<_> = page.lines().filter_map(|line| line.strip_prefix("| `Meshmend")).collect();
    let [alerts] = yaml("deploy/prometheus/alerts.yml").try_into().expect("one document");
    let rules = alerts["groups"][0]["rules"].as_array().expect("rules").clone();
    assert_eq!(documented.len(), rules.len());
    for (documented, rule) in documented.iter().zip(&rules) {
        let word = |value: &Value| value.as_str().expect("a string").to_owned();
        let row = format!("Meshmend{documented}");
        let expected = format!("{}` | {} | ", word(&rule["alert"]), word(&rule["labels"]["severity"]));
        assert!(row.starts_with(&expected), "{row} should start with {expected}");
    }
}
