//! deploy/kubernetes: the manifests' settings, limits, probes and network policies.

use std::collections::{BTreeMap, BTreeSet};

use meshmend::access::SystemIds;
use meshmend::format::Format;
use meshmend::jobs::{Input, JobId, JobOptions, JobStore, NewJob, PostgresStore, QueueStore, RetryPolicy};
use serde_json::Value;
use sqlx::Connection;

use crate::postgres::Postgres;
use crate::support::containers::{Container, mebibytes};
use crate::support::image::Image;
use crate::support::manifests::{FOLDER, objects};
use crate::support::source::{root, strings, yaml};

fn named(kind: &str, name: &str) -> Value {
    let found = objects().into_iter().find(|object| object["kind"] == kind && object["metadata"]["name"] == name);
    found.unwrap_or_else(|| panic!("there is no {kind} {name}"))
}

/// The pod templates by the name of the object that holds them.
fn templates() -> BTreeMap<String, Value> {
    let name = |object: &Value| object["metadata"]["name"].as_str().expect("a name").to_owned();
    let workloads = objects().into_iter().filter(|object| object["spec"]["template"].is_object());
    workloads.map(|object| (name(&object), object["spec"]["template"].clone())).collect()
}

fn container(template: &Value) -> &Value {
    let containers = template["spec"]["containers"].as_array().expect("containers");
    assert_eq!(containers.len(), 1);
    &containers[0]
}

fn variables(container: &Value) -> BTreeMap<String, String> {
    let mut variables = BTreeMap::new();
    for from in container["envFrom"].as_array().into_iter().flatten() {
        let of = match (from["configMapRef"]["name"].as_str(), from["secretRef"]["name"].as_str()) {
            (Some(name), None) => named("ConfigMap", name)["data"].clone(),
            (None, Some(name)) => named("Secret", name)["stringData"].clone(),
            _ => panic!("{from}"),
        };
        let of: BTreeMap<String, String> = serde_json::from_value(of).expect("strings");
        variables.extend(of);
    }
    for variable in container["env"].as_array().into_iter().flatten() {
        let text = |field: &str| variable[field].as_str().expect("a string").to_owned();
        variables.insert(text("name"), text("value"));
    }
    variables
}

#[test]
fn each_of_its_commands_is_one_that_the_program_takes_with_its_settings() {
    let templates = templates();
    assert_eq!(templates.keys().collect::<Vec<_>>(), ["meshmend-api", "meshmend-migrate", "meshmend-worker"]);
    for (name, template) in templates {
        let (spec, container) = (&template["spec"], container(&template));
        let mounts = container["volumeMounts"].as_array().expect("mounts");
        for mount in mounts {
            let volumes = spec["volumes"].as_array().expect("volumes");
            let volume = volumes.iter().find(|volume| volume["name"] == mount["name"]).expect("a volume");
            assert!(volume["emptyDir"]["sizeLimit"].is_string(), "{name}: {volume} has no limit");
        }
        let pause = container["lifecycle"]["preStop"]["sleep"]["seconds"].as_f64().unwrap_or(0.0);
        let settings = Container {
            name: name.clone(),
            command: strings(&container["args"]),
            variables: variables(container),
            mounts: mounts.iter().map(|mount| mount["mountPath"].as_str().expect("a path").to_owned()).collect(),
            memory_mib: mebibytes(container["resources"]["limits"]["memory"].as_str().expect("a limit")),
            // 30 s is the default of Kubernetes.
            grace: spec["terminationGracePeriodSeconds"].as_f64().unwrap_or(30.0) - pause,
        }
        .check();
        assert_eq!(settings.contains_key("MESHMEND_LISTEN"), name == "meshmend-api");
        for port in container["ports"].as_array().into_iter().flatten() {
            let listens = format!(":{}", port["containerPort"]);
            assert!(settings.values().any(|value| value.ends_with(&listens)), "{name}: nothing listens on {listens}");
        }
    }
}

#[test]
fn no_pod_has_more_than_it_needs() {
    let user = Image::read().user();
    for (name, template) in templates() {
        let (spec, container) = (&template["spec"], container(&template));
        let pod = &spec["securityContext"];
        assert_eq!((&pod["runAsNonRoot"], &pod["seccompProfile"]["type"]), (&true.into(), &"RuntimeDefault".into()));
        assert_eq!((pod["runAsUser"].as_u64(), pod["runAsGroup"].as_u64()), (Some(user[0]), Some(user[1])), "{name}");
        assert_eq!(spec["automountServiceAccountToken"], false, "{name}");
        assert_eq!(
            spec["enableServiceLinks"], false,
            "{name}: Kubernetes would set variables that begin with MESHMEND_"
        );
        let own = &container["securityContext"];
        assert_eq!((&own["readOnlyRootFilesystem"], &own["allowPrivilegeEscalation"]), (&true.into(), &false.into()));
        assert_eq!(strings(&own["capabilities"]["drop"]), ["ALL"], "{name}");
        for kind in ["requests", "limits"] {
            for what in ["cpu", "memory", "ephemeral-storage"] {
                assert!(container["resources"][kind][what].is_string(), "{name} has no {kind} of {what}");
            }
        }
        if name != "meshmend-migrate" {
            for (probe, path) in
                [("startupProbe", "/livez"), ("livenessProbe", "/livez"), ("readinessProbe", "/readyz")]
            {
                let get = &container[probe]["httpGet"];
                assert_eq!((&get["path"], &get["port"]), (&path.into(), &"metrics".into()), "{name}");
            }
        }
    }
}

#[test]
fn names_in_the_manifests_exist() {
    let templates = templates();
    let labels: Vec<_> =
        templates.values().map(|template| template["metadata"]["labels"].as_object().expect("labels")).collect();
    let some_pod = |selector: &Value| {
        let wanted = selector.as_object().expect("labels");
        labels.iter().any(|labels| wanted.iter().all(|(name, value)| labels.get(name) == Some(value)))
    };
    let ports: BTreeSet<_> = templates
        .values()
        .flat_map(|template| container(template)["ports"].as_array().cloned().unwrap_or_default())
        .flat_map(|port| [port["name"].clone(), port["containerPort"].clone()].map(|value| value.to_string()))
        .collect();
    for object in objects() {
        let (kind, spec) = (object["kind"].as_str().expect("a kind"), &object["spec"]);
        match kind {
            "Service" => {
                assert!(some_pod(&spec["selector"]));
                assert!(ports.contains(&spec["ports"][0]["targetPort"].to_string()));
            }
            "Deployment" => assert_eq!(spec["selector"]["matchLabels"], spec["template"]["metadata"]["labels"]),
            "PodDisruptionBudget" => assert!(some_pod(&spec["selector"]["matchLabels"]), "{object}"),
            "NetworkPolicy" => {
                let pods = &spec["podSelector"]["matchLabels"];
                assert!(pods.is_null() || some_pod(pods), "{object}");
                for port in spec["ingress"].as_array().into_iter().flatten().map(|rule| &rule["ports"][0]["port"]) {
                    assert!(ports.contains(&port.to_string()), "{object}");
                }
            }
            "Ingress" => {
                let service = &spec["rules"][0]["http"]["paths"][0]["backend"]["service"];
                let found = named("Service", service["name"].as_str().expect("a name"));
                assert_eq!(found["spec"]["ports"][0]["name"], service["port"]["name"]);
            }
            "ScaledObject" => {
                named("Deployment", spec["scaleTargetRef"]["name"].as_str().expect("a name"));
                named(
                    "TriggerAuthentication",
                    spec["triggers"][0]["authenticationRef"]["name"].as_str().expect("a name"),
                );
            }
            "TriggerAuthentication" => {
                let reference = &spec["secretTargetRef"][0];
                let secret = named("Secret", reference["name"].as_str().expect("a name"));
                assert!(secret["stringData"][reference["key"].as_str().expect("a key")].is_string());
            }
            "Namespace" | "ConfigMap" | "Secret" | "Job" => {}
            other => panic!("nothing is known of {other}"),
        }
    }
    let there = std::fs::read_dir(root().join(FOLDER)).expect("a folder").count();
    let [kustomization] = yaml(&format!("{FOLDER}/kustomization.yaml")).try_into().expect("one document");
    assert_eq!(strings(&kustomization["resources"]).len() + 2, there, "a file is not applied");
}

#[test]
fn workers_reach_their_stores_and_nothing_outside() {
    let worker = &templates()["meshmend-worker"]["metadata"]["labels"];
    let applies = |selector: &Value| {
        let wanted = selector["matchLabels"].as_object();
        wanted.into_iter().flatten().all(|(name, value)| worker.get(name) == Some(value))
    };
    let policies: Vec<_> = objects().into_iter().filter(|policy| policy["kind"] == "NetworkPolicy").collect();
    let closed =
        |policy: &&Value| policy["spec"]["podSelector"] == serde_json::json!({}) && policy["spec"]["egress"].is_null();
    let closed = policies.iter().find(closed).expect("a policy that denies everything");
    assert_eq!(strings(&closed["spec"]["policyTypes"]), ["Ingress", "Egress"]);
    let mut reached = 0;
    for policy in policies.iter().filter(|policy| applies(&policy["spec"]["podSelector"])) {
        for to in
            policy["spec"]["egress"].as_array().into_iter().flatten().flat_map(|rule| rule["to"].as_array()).flatten()
        {
            // A host outside the cluster, or pods of the cluster.
            let cidr = to["ipBlock"]["cidr"].as_str();
            assert!(cidr.is_none_or(|cidr| cidr.ends_with("/32") || cidr.ends_with("/128")), "{to}");
            assert!(cidr.is_some() || to["namespaceSelector"]["matchLabels"].is_object(), "{to}");
            reached += 1;
        }
    }
    assert!(reached >= 3, "DNS, the database and the file store");
    let webhooks =
        policies.iter().find(|policy| policy["metadata"]["name"] == "allow-webhooks").expect("the API's way out");
    assert!(!applies(&webhooks["spec"]["podSelector"]));
    let out = webhooks["spec"]["egress"][0]["to"][0]["ipBlock"].clone();
    for private in ["10.0.0.0/8", "127.0.0.0/8", "169.254.0.0/16", "172.16.0.0/12", "192.168.0.0/16", "100.64.0.0/10"] {
        assert!(strings(&out["except"]).iter().any(|range| range == private), "{private}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_autoscalers_query_counts_the_jobs_that_wait_and_run() {
    let scaled = named("ScaledObject", "meshmend-worker");
    let query = scaled["spec"]["triggers"][0]["metadata"]["query"].as_str().expect("a query").to_owned();
    let cluster = Postgres::start();
    let store = PostgresStore::open(&cluster.url(), 4, None, RetryPolicy::default()).await.expect("a store");
    let mut database = sqlx::PgConnection::connect(&cluster.url()).await.expect("a connection");
    let mut count = async || {
        let query = sqlx::AssertSqlSafe(query.clone());
        sqlx::query_scalar::<_, i64>(query).fetch_one(&mut database).await.expect("a number")
    };
    assert_eq!(count().await, 0);
    for _ in 0..3 {
        let input = Input { key: "k".into(), name: "a.stl".into(), bytes: 1, sha256: "00".into(), format: Format::Stl };
        let (id, options) = (JobId::new(&SystemIds), JobOptions::default());
        let job = NewJob::new(id, "shop", vec![input], options);
        store.submit(job).await.expect("noted");
    }
    let claim =
        store.claim("worker", std::time::Duration::from_secs(60), u32::MAX).await.expect("an answer").expect("a job");
    assert_eq!(count().await, 3);
    store.cancel(claim.lease.id).await.expect("canceled");
    assert_eq!(count().await, 2);
}
