//! deploy/helm/meshmend: Helm's own engine renders the chart, and its objects are those of deploy/kubernetes.

use std::collections::BTreeMap;
use std::io::Write;
use std::process::{Command, Output};

use serde_json::{Map, Value, json};

use crate::support::manifests::objects;
use crate::support::source::{root, text, yaml};
use crate::support::tools::tool;

const CHART: &str = "deploy/helm/meshmend";

/// Renders the chart as a release with these values.
fn render(release: &str, values: &Value) -> Option<Output> {
    let mut file = tempfile::NamedTempFile::new().expect("a file");
    file.write_all(values.to_string().as_bytes()).expect("written");
    let mut python = Command::new(tool("python")?);
    python.current_dir(root()).args(["scripts/helm.py", "render", CHART, release, "meshmend"]).arg(file.path());
    Some(python.output().expect("Python runs"))
}

/// The objects of a release.
fn rendered(release: &str, values: &Value) -> Option<Vec<Value>> {
    let output = render(release, values)?;
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(serde_saphyr::from_multiple(&String::from_utf8_lossy(&output.stdout)).expect("YAML"))
}

/// Removes what Helm adds to each object, and the order of variables, which means nothing.
fn plain(value: &mut Value) {
    match value {
        Value::Object(map) => {
            map.retain(|name, _| {
                ![
                    "app.kubernetes.io/instance",
                    "app.kubernetes.io/version",
                    "app.kubernetes.io/managed-by",
                    "checksum/config",
                ]
                .contains(&name.as_str())
                    && !name.starts_with("helm.sh/")
            });
            map.values_mut().for_each(plain);
            let is_empty = |value: &Value| value.as_object().is_some_and(Map::is_empty);
            map.retain(|name, value| !(name == "annotations" && is_empty(value)));
            if let Some(variables) = map.get_mut("env").and_then(Value::as_array_mut) {
                variables.sort_by_key(|variable| variable["name"].to_string());
            }
        }
        Value::Array(list) => list.iter_mut().for_each(plain),
        _ => {}
    }
}

type Objects = BTreeMap<(String, String), Value>;

fn by_name(objects: Vec<Value>) -> Objects {
    let key = |object: &Value| {
        ["kind", "name"].map(|field| {
            let value = if field == "kind" { &object["kind"] } else { &object["metadata"]["name"] };
            value.as_str().expect("text").to_owned()
        })
    };
    objects.into_iter().map(|object| (key(&object).into(), object)).collect()
}

/// The manifests' objects, with the image that the kustomization names.
fn manifests() -> Objects {
    let [kustomization] = yaml("deploy/kubernetes/kustomization.yaml").try_into().expect("one document");
    let image = &kustomization["images"][0];
    let image = format!("{}:{}", image["newName"].as_str().expect("a name"), image["newTag"].as_str().expect("a tag"));
    // Helm creates the namespace if it is asked to.
    let mut objects = objects();
    objects.retain(|object| object["kind"] != "Namespace");
    for object in &mut objects {
        plain(object);
        object["metadata"].as_object_mut().expect("metadata").remove("namespace");
        if let Some(container) = object.pointer_mut("/spec/template/spec/containers/0") {
            assert_eq!(container["image"], "meshmend");
            container["image"] = image.clone().into();
        }
    }
    by_name(objects)
}

#[test]
fn its_objects_are_those_of_the_manifests() {
    let manifests = manifests();
    let secret = manifests[&("Secret".to_owned(), "meshmend".to_owned())]["stringData"].clone();
    let Some(mut chart) = rendered("meshmend", &json!({"secret": {"values": secret}})) else { return };
    for object in &mut chart {
        plain(object);
        // The manifests have no labels on the objects themselves.
        object["metadata"].as_object_mut().expect("metadata").remove("labels");
        if object["kind"] == "NetworkPolicy" {
            let name = object["metadata"]["name"].as_str().expect("a name").trim_start_matches("meshmend-").to_owned();
            // The manifests have a namespace of their own, and deny all traffic in it; a chart may share its namespace.
            if name == "deny-all" {
                assert_eq!(
                    object["spec"]["podSelector"],
                    json!({"matchLabels": {"app.kubernetes.io/name": "meshmend"}})
                );
                object["spec"]["podSelector"] = json!({});
            }
            object["metadata"]["name"] = name.into();
        }
    }
    let chart = by_name(chart);
    assert_eq!(chart.keys().collect::<Vec<_>>(), manifests.keys().collect::<Vec<_>>());
    for (key, manifest) in &manifests {
        assert_eq!(&chart[key], manifest, "{key:?}");
    }
}

#[test]
fn its_objects_satisfy_the_schemas_of_kubernetes() {
    let values = json!({
        "secret": {"name": "from-the-store"},
        "image": {"repository": "registry.example.com/meshmend", "tag": "0.1.0-slim", "pullPolicy": "Always", "pullSecrets": ["registry"]},
        "autoscaling": {"enabled": false},
        "config": {"MESHMEND_MAX_FILE_MIB": 1024},
        "api": {"podAnnotations": {"example.com/team": "prints"}, "minAvailable": "50%"},
        "worker": {
            "replicas": 3,
            "nodeSelector": {"example.com/pool": "jobs"},
            "tolerations": [{"key": "jobs", "operator": "Exists", "effect": "NoSchedule"}],
            "affinity": {"nodeAffinity": {}},
        },
    });
    for (release, values) in [("meshmend", &json!({})), ("prints", &values)] {
        let Some(output) = render(release, values) else { return };
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let mut file = tempfile::Builder::new().suffix(".yaml").tempfile().expect("a file");
        file.write_all(&output.stdout).expect("written");
        let Some(validate) = tool("kubernetes-validate") else { return };
        let checked =
            Command::new(validate).args(["--strict", "--no-warn"]).arg(file.path()).output().expect("it runs");
        let said = String::from_utf8_lossy(&checked.stdout).into_owned() + &String::from_utf8_lossy(&checked.stderr);
        assert!(checked.status.success(), "{said}");
        assert!(said.matches("passed for resource").count() > 10, "{said}");
    }
}

#[test]
fn values_change_what_they_name() {
    let Some(objects) = rendered("prints", &json!({"autoscaling": {"enabled": false}, "ingress": {"enabled": false}}))
    else {
        return;
    };
    let objects = by_name(objects);
    let get = |kind: &str, name: &str| objects.get(&(kind.to_owned(), name.to_owned()));
    assert_eq!(get("Deployment", "prints-worker").expect("a Deployment")["spec"]["replicas"], 2);
    assert!(
        objects
            .keys()
            .all(|(kind, _)| !["ScaledObject", "TriggerAuthentication", "Ingress", "Secret"].contains(&kind.as_str()))
    );
    assert!(objects.keys().all(|(_, name)| name.starts_with("prints")), "{:?}", objects.keys());
    let api = get("Deployment", "prints-api").expect("a Deployment");
    assert_eq!(api["spec"]["template"]["spec"]["containers"][0]["envFrom"][1]["secretRef"]["name"], "prints");
    // Pods are replaced when a setting changes.
    let sum = |values: Value| {
        let object =
            rendered("prints", &values).map(by_name)?.remove(&("Deployment".to_owned(), "prints-api".to_owned()))?;
        Some(object["spec"]["template"]["metadata"]["annotations"]["checksum/config"].clone())
    };
    assert_ne!(sum(json!({})), sum(json!({"config": {"MESHMEND_LOG": "debug"}})));
}

#[test]
fn values_that_are_wrong_are_refused_with_their_name() {
    for (values, name) in [
        (json!({"api": {"replicas": "two"}}), "/api/replicas"),
        (json!({"workers": {}}), "workers"),
        (json!({"worker": {"resources": {"limits": {"memory": "8 GB"}}}}), "/worker/resources/limits/memory"),
        (json!({"config": {"LOG": "info"}}), "LOG"),
        (
            json!({"networkPolicy": {"enabled": true, "database": {"cidr": "db.example.com", "port": 5432}}}),
            "/networkPolicy/database/cidr",
        ),
    ] {
        let Some(output) = render("meshmend", &values) else { return };
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && message.contains(name), "{values}: {message}");
    }
}

#[test]
fn it_has_the_version_of_the_program() {
    let [chart] = yaml(&format!("{CHART}/Chart.yaml")).try_into().expect("one document");
    for field in ["version", "appVersion"] {
        assert_eq!(chart[field], env!("CARGO_PKG_VERSION"), "{field}");
    }
    let helper = text(&format!("{CHART}/templates/_helpers.tpl"));
    assert!(helper.contains(".Chart.AppVersion"));
}
