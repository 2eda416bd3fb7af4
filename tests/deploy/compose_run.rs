//! docker/compose.yaml's own commands with their environment, as processes: one job goes through all of them.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use meshmend::format::{Limits, read};
use serde_json::{Value, json};

use crate::files;
use crate::postgres::Postgres;
use crate::s3::S3;
use crate::server::{Api, Program, Start};
use crate::support::compose::{compose, services, variables};
use crate::support::image::Image;
use crate::support::source::strings;

/// The stores, in place of the services `postgres` and `garage`.
struct Stores {
    database: Postgres,
    bucket: S3,
}

impl Stores {
    /// The variables of a service: the image's and its own, with the addresses of these stores and of this machine.
    fn variables(&self, service: &Value, data: &Path) -> BTreeMap<String, String> {
        let mut variables: BTreeMap<_, _> = Image::read().variables();
        // With `secret` for each value that docker/.env has.
        variables.extend(crate::support::compose::variables(service));
        let here = [
            ("MESHMEND_DATABASE_URL", self.database.url()),
            ("MESHMEND_S3_ENDPOINT", self.bucket.endpoint()),
            ("MESHMEND_DATA_DIR", data.display().to_string()),
            ("MESHMEND_LISTEN", "127.0.0.1:0".to_owned()),
            ("MESHMEND_METRICS_LISTEN", "127.0.0.1:0".to_owned()),
        ];
        for (name, value) in here {
            assert!(variables.insert(name.to_owned(), value).is_some(), "{name} is set for the network of containers");
        }
        // Other tests have a real Blender, and all of them share this machine's processors.
        variables.insert("MESHMEND_BLENDER".to_owned(), "/nonexistent/blender".to_owned());
        variables
    }

    /// A command line of the program in a service's container.
    fn command(&self, service: &Value, line: &[String], data: &Path) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_meshmend"));
        command.args(line).env_clear().envs(self.variables(service, data)).current_dir(data);
        command
    }

    fn start(&self, service: &Value, data: &Path) -> Program {
        Start::of(self.command(service, &strings(&service["command"]), data), data).start()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn one_job_goes_through_the_processes_of_the_compose_file() {
    let compose = compose();
    let services = services(&compose);
    let (api, worker, migrate) = (&services["api"], &services["worker"], &services["migrate"]);
    let shared = variables(api);
    let bucket = S3::start_with(
        &shared["MESHMEND_BLOB_URL"],
        &shared["MESHMEND_S3_ACCESS_KEY_ID"],
        &shared["MESHMEND_S3_SECRET_ACCESS_KEY"],
    );
    let stores = Stores { database: Postgres::start(), bucket };
    let folders = [(); 4].map(|()| tempfile::tempdir().expect("a folder"));

    let migrated = stores.command(migrate, &strings(&migrate["command"]), folders[0].path()).output().expect("it runs");
    assert!(migrated.status.success(), "{}", String::from_utf8_lossy(&migrated.stderr));
    let server = stores.start(api, folders[1].path());
    let replicas = worker["deploy"]["replicas"].as_u64().expect("a number");
    let workers: Vec<_> = folders[2..].iter().map(|folder| stores.start(worker, folder.path())).collect();
    assert_eq!(workers.len() as u64, replicas);

    // As the file's first lines say: docker compose run --rm api keys create ...
    let line = "keys create --tenant demo --scopes jobs:read,jobs:write".split(' ').map(str::to_owned);
    let created = stores.command(api, &line.collect::<Vec<_>>(), folders[0].path()).output().expect("it runs");
    assert!(created.status.success(), "{}", String::from_utf8_lossy(&created.stderr));
    let key = String::from_utf8(created.stdout).expect("text");
    let mut client = Api::new(&server);
    let refused = client.try_submit("box.stl", files::broken_box(), json!({})).await;
    assert_eq!(refused.status(), 401);
    let bearer = format!("Bearer {}", key.trim()).parse().expect("a header");
    client.http = reqwest::Client::builder()
        .default_headers([(reqwest::header::AUTHORIZATION, bearer)].into_iter().collect())
        .build()
        .expect("a client");

    let id = client.submit(files::broken_box(), json!({"output": "stl"})).await;
    let job = client.finished(&id).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    assert_eq!(job["report"]["outcome"], "repaired", "{job}");
    let model = client.artifact(&id, "model").await;
    assert_eq!(read(&model, &Limits::default()).expect("a model").soup.faces.len(), 12);
    assert!(stores.bucket.files().iter().any(|key| key.contains(&id)), "{:?}", stores.bucket.files());
    for folder in &folders {
        assert!(!folder.path().join("files").exists(), "all files are in the bucket");
    }

    // Stopping is clean.
    for mut program in workers.into_iter().chain([server]) {
        program.terminate();
        assert_eq!(program.wait(), Some(0), "{}", program.log());
    }
}
