//! Probes, metrics, settings and logs for operators.

use std::process::{Command, Output};

use meshmend::telemetry::{METRICS, MetricKind};
use serde_json::{Value, json};

use crate::files;
use crate::postgres::Postgres;
use crate::server::{Api, Program, Start, until};
use crate::support::access::{create_key, start_with_keys};
use crate::support::fake_blender::fake_blender;

fn with_probes(start: Start<'_>) -> Start<'_> {
    start.arg("--metrics-listen", "127.0.0.1:0")
}

async fn probe(program: &Program, path: &str) -> (u16, String) {
    meshmend::tls::use_ring();
    let response = reqwest::get(format!("{}{path}", program.probes)).await.expect("a response");
    (response.status().as_u16(), response.text().await.expect("text"))
}

/// Waits until a series has an accepted value.
async fn measured(program: &Program, series: &str, will_do: impl Fn(f64) -> bool) {
    until(series, async || {
        let metrics = probe(program, "/metrics").await.1;
        let value = metrics.lines().find_map(|line| line.strip_prefix(series)?.strip_prefix(' '))?;
        will_do(value.parse().expect("a number")).then_some(())
    })
    .await;
}

/// Runs `meshmend config` with only these variables in its environment.
fn config(args: &[&str], variables: &[(&str, &str)]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_meshmend"));
    command.arg("config").args(args).env_clear().envs(variables.iter().copied()).output().expect("it runs")
}

#[test]
fn config_lists_effective_settings_with_their_sources_and_without_secrets() {
    let secret = "hunter2";
    let url = format!("postgres://operator:{secret}@db.example:5433/jobs?password={secret}");
    let collector = format!("http://{secret}@127.0.0.1:4318?key={secret}");
    let variables = [
        ("MESHMEND_DATABASE_URL", url.as_str()),
        ("MESHMEND_WORKERS", "3"),
        ("MESHMEND_WORKRES", secret),
        ("MESHMEND_BLENDER", collector.as_str()),
    ];
    let printed = config(&["--format", "json", "serve", "--listen", "127.0.0.1:1"], &variables);
    assert_eq!(printed.status.code(), Some(2), "serve rejects the unknown variable too");
    let message = String::from_utf8_lossy(&printed.stderr).into_owned();
    assert!(message.contains("MESHMEND_WORKRES is set, but no command"), "{message}");
    let text = String::from_utf8(printed.stdout).expect("text");
    assert!(!text.contains(secret), "{text}");
    let printed: Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(printed["command"], "serve");
    assert_eq!(printed["unknown_variables"], json!(["MESHMEND_WORKRES"]));
    let settings = printed["settings"].as_array().expect("settings");
    let setting = |flag: &str| settings.iter().find(|setting| setting["flag"] == flag).expect("a setting").clone();
    let of = |flag: &str| [setting(flag)["value"].clone(), setting(flag)["source"].clone()];
    assert_eq!(of("--listen"), [json!("127.0.0.1:1"), json!("flag")]);
    assert_eq!(of("--workers"), [json!("3"), json!("environment")]);
    assert_eq!(of("--lease-s"), [json!("15"), json!("default")]);
    assert_eq!(of("--no-workers"), [json!("false"), json!("default")]);
    assert_eq!(of("--metrics-listen"), [Value::Null, json!("default")]);
    assert_eq!(of("--database-url"), [json!("postgres://***@db.example:5433/***"), json!("environment")]);
    assert_eq!(setting("--database-url")["secret"], true);

    let table = config(&["work"], &variables);
    let table = String::from_utf8(table.stdout).expect("text");
    assert!(!table.contains(secret) && !table.contains("--listen "), "{table}");
    let line = table.lines().find(|line| line.starts_with("--workers ")).expect("a line");
    assert_eq!(line.split_whitespace().collect::<Vec<_>>(), ["--workers", "3", "environment", "MESHMEND_WORKERS"]);

    let bare = config(&["--format", "json", "serve", "--data-dir", "/data"], &[]);
    assert!(bare.status.success(), "{}", String::from_utf8_lossy(&bare.stderr));
    let bare: Value = serde_json::from_slice(&bare.stdout).expect("JSON");
    let computed = |flag: &str| {
        let setting = bare["settings"].as_array().expect("settings").iter().find(|setting| setting["flag"] == flag);
        let setting = setting.expect("a setting");
        assert_eq!(setting["source"], "computed", "{setting}");
        setting["value"].as_str().expect("a value").to_owned()
    };
    assert_eq!(computed("--database-url"), "sqlite:/data/meshmend.db");
    assert_eq!(computed("--blob-url"), "/data/files");
    assert_eq!(computed("--tenant-max-queued"), "10000");
    for number in ["--workers", "--blender-total-memory-mib"] {
        assert!(computed(number).parse::<u64>().is_ok_and(|number| number > 0), "{number}");
    }
    let none = config(&["serve", "--no-workers"], &[]);
    let table = String::from_utf8(none.stdout).expect("text");
    let row = |flag: &str| {
        let line = table.lines().find(|line| line.split_whitespace().next() == Some(flag)).expect("a line");
        line.split_whitespace().nth(1).expect("a value").to_owned()
    };
    assert_eq!((row("--workers"), row("--metrics-listen")), ("0".to_owned(), "none".to_owned()));

    let refused = config(&["serve", "--workers", "many"], &[]);
    assert_eq!(refused.status.code(), Some(2), "an invalid command line is rejected");
}

#[tokio::test]
async fn metrics_count_queued_jobs_by_tenant_class() {
    let data = tempfile::tempdir().expect("a folder");
    let meshmend = |args: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_meshmend"));
        let response = command.args(args).arg("--data-dir").arg(data.path()).output().expect("it runs");
        assert!(response.status.success(), "{args:?}");
        String::from_utf8(response.stdout).expect("text").trim().to_owned()
    };
    let tenant = meshmend(&["tenants", "set", "big-shop", "--json", "--class", "gold"]);
    assert!(tenant.contains(r#""class":"gold""#), "{tenant}");
    let keys = ["big-shop", "corner-shop"].map(|tenant| meshmend(&["keys", "create", "--tenant", tenant]));
    let server = with_probes(Start::serve(data.path())).env("MESHMEND_NO_WORKERS", "true").start();
    for key in &keys[..1] {
        let request = Api::new(&server).post("/v1/jobs").bearer_auth(key).body(files::broken_box());
        assert_eq!(request.send().await.expect("a response").status(), 202);
    }
    measured(&server, r#"meshmend_class_jobs{class="gold",status="queued"}"#, |n| n == 1.0).await;
    measured(&server, r#"meshmend_class_queue_wait_seconds{class="gold"}"#, |seconds| seconds > 0.0).await;
    let request = Api::new(&server).post("/v1/jobs").bearer_auth(&keys[1]).body(files::broken_box());
    assert_eq!(request.send().await.expect("a response").status(), 202);
    measured(&server, r#"meshmend_class_jobs{class="standard",status="queued"}"#, |n| n == 1.0).await;

    let _worker = Start::work(data.path()).start();
    for class in ["gold", "standard"] {
        let of_class = |status: &str| format!("meshmend_class_jobs{{class=\"{class}\",status=\"{status}\"}}");
        measured(&server, &of_class("queued"), |n| n == 0.0).await;
        measured(&server, &of_class("running"), |n| n == 0.0).await;
    }
    measured(&server, r#"meshmend_class_queue_wait_seconds{class="gold"}"#, |seconds| seconds == 0.0).await;
}

#[tokio::test]
async fn servers_and_workers_answer_probes_and_metrics_on_a_separate_listener() {
    let data = tempfile::tempdir().expect("a folder");
    let server = with_probes(Start::serve(data.path())).env("MESHMEND_NO_WORKERS", "true").start();
    let api = Api::new(&server);
    let job = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    measured(&server, "meshmend_jobs{status=\"queued\"}", |jobs| jobs == 1.0).await;
    measured(&server, "meshmend_queue_wait_seconds", |seconds| seconds > 0.0).await;

    let mut worker = with_probes(Start::work(data.path())).arg("--workers", "3").start();
    assert_eq!(api.finished(&job).await["status"], "succeeded");
    for program in [&server, &worker] {
        assert_eq!(probe(program, "/livez").await.0, 200);
        let (status, ready) = probe(program, "/readyz").await;
        assert_eq!(status, 200, "{ready}");
        let ready: Value = serde_json::from_str(&ready).expect("JSON");
        for check in ["store", "blobs", "disk", "scratch"] {
            assert_eq!(ready["checks"][check], "ok", "{ready}");
        }
        assert!(ready["checks"]["blender"].as_str().is_some_and(|state| state.starts_with("missing")), "{ready}");
        assert_eq!(probe(program, "/v1/jobs").await.0, 404, "the listener serves nothing else");
        measured(program, "meshmend_jobs{status=\"succeeded\"}", |jobs| jobs == 1.0).await;
        measured(program, "meshmend_queue_wait_seconds", |seconds| seconds == 0.0).await;
        measured(program, "meshmend_leases_lost_total", |jobs| jobs == 0.0).await;
    }
    measured(&worker, "meshmend_attempts_total{status=\"succeeded\",outcome=\"repaired\"}", |n| n == 1.0).await;
    measured(&worker, "meshmend_job_wait_seconds_count", |n| n == 1.0).await;
    measured(&worker, "meshmend_worker_slots{state=\"idle\"}", |n| n == 3.0).await;
    measured(&worker, "meshmend_worker_slots{state=\"busy\"}", |n| n == 0.0).await;

    std::fs::remove_dir_all(data.path().join("scratch")).expect("removed");
    let (status, ready) = probe(&worker, "/readyz").await;
    assert_eq!(status, 503, "{ready}");
    assert!(!ready.contains("\"scratch\":\"ok\""), "{ready}");
    worker.terminate();
    assert_eq!(worker.wait(), Some(0));
}

#[tokio::test]
async fn every_metric_is_in_the_table_and_has_a_description() {
    let data = tempfile::tempdir().expect("a folder");
    let program = with_probes(Start::serve(data.path())).start();
    let api = Api::new(&program);
    let job = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    api.finished(&job).await;
    measured(&program, "meshmend_attempt_seconds_count", |n| n == 1.0).await;
    let (_, metrics) = probe(&program, "/metrics").await;
    let mut seen = 0;
    for line in metrics.lines().filter(|line| !line.starts_with('#') && !line.is_empty()) {
        let series = line.split(['{', ' ']).next().expect("a name");
        let metric = METRICS.iter().find(|metric| match series.strip_prefix(metric.name) {
            Some(rest) if metric.kind == MetricKind::Histogram => ["_bucket", "_sum", "_count"].contains(&rest),
            Some(rest) => rest.is_empty(),
            None => false,
        });
        let metric = metric.unwrap_or_else(|| panic!("{series} is not in the table"));
        assert!(metrics.contains(&format!("# HELP {} {}\n", metric.name, metric.help)), "{series} has no help");
        assert!(metrics.contains(&format!("# TYPE {} {}\n", metric.name, metric.kind.as_str())), "{series}");
        let labels = line.split_once('{').and_then(|(_, rest)| rest.rsplit_once('}')).map_or("", |(labels, _)| labels);
        let labels = labels.split("\",").filter_map(|label| label.split_once('=')).map(|(name, _)| name);
        let labels: Vec<_> = labels.filter(|label| *label != "le").collect();
        assert_eq!(labels, metric.labels, "{line}");
        seen += 1;
    }
    assert!(seen > 50, "{seen} series");
}

#[tokio::test]
async fn killed_and_crashed_children_are_counted_with_the_reason() {
    let data = tempfile::tempdir().expect("a folder");
    let hangs = with_probes(Start::serve(data.path())).arg("--deadline-grace-s", "0.5");
    let hangs = hangs.env("FAILPOINTS", "child-inspect=sleep(600000)").start();
    let api = Api::new(&hangs);
    let late = api.submit(files::broken_box(), json!({"deadline_s": 1})).await;
    assert_eq!(api.finished(&late).await["problem"]["code"], "deadline_exceeded");
    measured(&hangs, "meshmend_kills_total{reason=\"deadline\"}", |n| n == 1.0).await;
    measured(&hangs, "meshmend_attempts_total{status=\"failed\",outcome=\"\"}", |n| n == 1.0).await;
    drop(hangs);

    let short = with_probes(Start::serve(data.path())).arg("--job-memory-mib", "160").start();
    let api = Api::new(&short);
    let large = api.submit(files::large_open_sphere(1_500_000), json!({"max_tier": 1})).await;
    assert_eq!(api.finished(&large).await["problem"]["code"], "out_of_memory");
    measured(&short, "meshmend_child_crashes_total{reason=\"out_of_memory\"}", |n| n == 1.0).await;
}

#[tokio::test]
async fn crashes_of_blender_and_its_repeated_runs_are_counted() {
    let data = tempfile::tempdir().expect("a folder");
    let blender = fake_blender(data.path(), "kill -SEGV $$");
    let program = with_probes(Start::serve(data.path())).blender(&blender).start();
    let api = Api::new(&program);
    let options = json!({"preset": "blender-remesh", "deadline_s": 60});
    let id = api.submit(files::boxes_on_an_edge(), options).await;
    assert_eq!(api.finished(&id).await["status"], "succeeded");
    let report: Value = serde_json::from_slice(&api.artifact(&id, "report.json").await).expect("JSON");
    let steps = report["steps"].as_array().expect("steps");
    let step = steps.iter().find(|step| step["action"] == "voxel_remesh").expect("a remesh");
    assert_eq!((&step["status"], &step["runs"]), (&json!("failed"), &json!(2)), "{step}");
    measured(&program, "meshmend_blender_runs_total", |n| n >= 2.0).await;
    measured(&program, "meshmend_blender_restarts_total", |n| n == 1.0).await;
    let failed = "meshmend_steps_total{tier=\"3\",action=\"voxel_remesh\",status=\"failed\"}";
    measured(&program, failed, |n| n == 1.0).await;
}

#[tokio::test]
async fn during_a_database_outage_probes_fail_and_unknown_metrics_are_not_numbers() {
    let (mut cluster, data) = (Postgres::start(), tempfile::tempdir().expect("a folder"));
    let program = with_probes(Start::serve(data.path())).env("MESHMEND_DATABASE_URL", &cluster.url()).start();
    assert_eq!(probe(&program, "/readyz").await.0, 200);
    measured(&program, "meshmend_jobs{status=\"queued\"}", |n| n == 0.0).await;
    cluster.kill();
    let (status, ready) = probe(&program, "/readyz").await;
    assert_eq!(status, 503, "{ready}");
    assert!(!ready.contains("\"store\":\"ok\"") && ready.contains("\"blobs\":\"ok\""), "{ready}");
    assert_eq!(probe(&program, "/livez").await.0, 200);
    for series in ["meshmend_jobs{status=\"queued\"}", "meshmend_queue_wait_seconds"] {
        measured(&program, series, f64::is_nan).await;
    }
    measured(&program, "meshmend_store_errors_total{kind=\"transient\"}", |n| n > 0.0).await;
    cluster.restart();
    until("the service is ready again", async || (probe(&program, "/readyz").await.0 == 200).then_some(())).await;
    measured(&program, "meshmend_jobs{status=\"queued\"}", |n| n == 0.0).await;
}

#[tokio::test]
async fn refused_requests_and_failed_jobs_are_logged_with_their_code_and_key() {
    let data = tempfile::tempdir().expect("a folder");
    let secret = create_key(data.path(), "shop", "jobs:read");
    let program = start_with_keys(Start::serve(data.path()).env("MESHMEND_LOG_FORMAT", "json"));
    let api = Api::new(&program);
    let request = api.post("/v1/jobs").bearer_auth(&secret).header("x-request-id", "the-request");
    assert_eq!(request.body(files::broken_box()).send().await.expect("a response").status(), 403);
    assert_eq!(api.get("/wp-login.php").send().await.expect("a response").status(), 404);
    assert_eq!(api.get("/v1/jobs").bearer_auth(&secret).send().await.expect("a response").status(), 200);
    let line = until("the log has the line", async || {
        let log = program.log();
        let line = log.lines().find(|line| line.contains("request rejected"))?;
        Some(serde_json::from_str::<Value>(line).expect("JSON"))
    })
    .await;
    assert_eq!((&line["level"], &line["fields"]["code"]), (&json!("INFO"), &json!("forbidden")), "{line}");
    assert_eq!(line["fields"]["status"], 403);
    let span = &line["spans"][0];
    assert_eq!((&span["method"], &span["path"]), (&json!("POST"), &json!("/v1/jobs")), "{span}");
    assert_eq!((&span["request_id"], &span["tenant"]), (&json!("the-request"), &json!("shop")), "{span}");
    assert!(span["key_id"].as_str().is_some_and(|id| id.starts_with("key_")), "{span}");
    assert!(!program.log().contains(&secret[7..]), "no secret is logged");
    assert!(!program.log().contains("wp-login"), "scanners do not fill the log");
    drop(program);

    let program = Start::serve(data.path()).env("MESHMEND_LOG_FORMAT", "json").start();
    let api = Api::new(&program);
    let no_vertex_7 = "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n";
    let id = api.submit(no_vertex_7.into(), json!({"max_tier": 1})).await;
    assert_eq!(api.finished(&id).await["problem"]["code"], "bad_input");
    let fields = until("the log has the line", async || {
        let log = program.log();
        let line = log.lines().find(|line| line.contains("attempt ended"))?;
        Some(serde_json::from_str::<Value>(line).expect("JSON")["fields"].clone())
    })
    .await;
    assert_eq!((&fields["status"], &fields["code"]), (&json!("failed"), &json!("bad_input")), "{fields}");
    assert!(fields["outcome"].is_null(), "{fields}");
}

#[tokio::test]
async fn the_process_itself_is_measured_by_the_names_that_prometheus_gives() {
    let data = tempfile::tempdir().expect("a folder");
    let program = with_probes(Start::serve(data.path())).start();
    measured(&program, "process_resident_memory_bytes", |bytes| bytes > 1e6).await;
    measured(&program, "process_virtual_memory_bytes", |bytes| bytes > 1e6).await;
    measured(&program, "process_open_fds", |files| files > 3.0).await;
    measured(&program, "process_max_fds", |files| files > 3.0).await;
    measured(&program, "process_threads", |threads| threads >= 1.0).await;
    measured(&program, "process_start_time_seconds", |seconds| seconds > 1.5e9).await;
    measured(&program, "process_cpu_seconds_total", |seconds| seconds >= 0.0).await;
}
