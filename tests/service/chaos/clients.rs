//! Clients that submit continuously and retry as the documentation says.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use reqwest::Client;
use serde_json::Value;
use tokio::task::JoinHandle;

use crate::files;

const CLIENTS: usize = 4;

/// State that the clients share.
#[derive(Default)]
pub struct Load {
    addresses: Vec<String>,
    stop: AtomicBool,
    accepted: Mutex<Vec<String>>,
    pub refused: AtomicUsize,
    /// Unexpected responses: anything but 202, 409 for the client's own key, 429 and 503.
    wrong: Mutex<Vec<String>>,
}

/// Running clients.
pub struct Clients {
    pub load: Arc<Load>,
    tasks: Vec<JoinHandle<()>>,
}

impl Clients {
    pub fn start(addresses: Vec<String>) -> Self {
        meshmend::tls::use_ring();
        let load = Arc::new(Load { addresses, ..Load::default() });
        let tasks = (0..CLIENTS).map(|number| tokio::spawn(client(Arc::clone(&load), number))).collect();
        Self { load, tasks }
    }

    /// Stops the clients and returns the ids of accepted jobs.
    pub async fn stop(&mut self) -> Vec<String> {
        self.load.stop.store(true, Ordering::Relaxed);
        for task in self.tasks.drain(..) {
            task.await.expect("a client's end");
        }
        assert_eq!(*self.load.wrong.lock().expect("a list"), [""; 0]);
        self.load.accepted.lock().expect("a list").clone()
    }
}

/// Submits one job after another, and repeats each with the same key, to either server, until a response arrives.
async fn client(load: Arc<Load>, number: usize) {
    let http = Client::builder().timeout(Duration::from_secs(20)).build().expect("a client");
    let mut tries = number;
    for turn in 0.. {
        let key = format!("client-{number}-{turn}");
        loop {
            if load.stop.load(Ordering::Relaxed) {
                return;
            }
            tries += 1;
            let address = &load.addresses[tries % load.addresses.len()];
            let request = http.post(format!("http://{address}/v1/jobs?max_tier=1&pictures=false"));
            let request = request.header("idempotency-key", &key).header("cache-control", "no-cache");
            match request.body(files::broken_box()).send().await {
                Ok(response) if response.status() == 202 => {
                    let Ok(job) = response.json::<Value>().await else { continue };
                    load.accepted.lock().expect("a list").push(job["id"].as_str().expect("an id").to_owned());
                    break;
                }
                Ok(response) if [409, 429, 503].contains(&response.status().as_u16()) => {
                    load.refused.fetch_add(1, Ordering::Relaxed);
                }
                Ok(response) => {
                    let text = format!("{} {}", response.status(), response.text().await.unwrap_or_default());
                    load.wrong.lock().expect("a list").push(text);
                }
                // The server is being killed.
                Err(_) => {}
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        tokio::time::sleep(Duration::from_millis(150)).await;
    }
}
