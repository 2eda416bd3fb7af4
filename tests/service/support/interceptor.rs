//! What may stand between a client and the service: it passes requests and answers on, and now and then does not.

use std::sync::Arc;

use axum::Router;
use axum::body::{Body, to_bytes};
use axum::extract::Request;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use reqwest::Client;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;

use crate::server::Program;

/// What becomes of a request.
pub enum Fate {
    /// It is passed on, and so is the answer.
    Pass,
    /// It is passed on, and the connection breaks before the answer.
    LoseAnswer,
    /// It is passed on, and one byte of the answer's body is another.
    Damage,
    /// It is answered with this status, some text, and when to ask again.
    Answer(u16, &'static str),
}

pub struct Between {
    pub url: String,
    task: JoinHandle<()>,
}

impl Between {
    /// Stands before a service; `fate` is told the method and the path of each request.
    pub async fn start(program: &Program, fate: impl Fn(&str, &str) -> Fate + Send + Sync + 'static) -> Self {
        meshmend::tls::use_ring();
        let (http, service, fate) = (Client::new(), program.url.clone(), Arc::new(fate));
        let router = Router::new().fallback(move |request: Request| {
            let (http, service, fate) = (http.clone(), service.clone(), Arc::clone(&fate));
            async move {
                let fate = fate(request.method().as_str(), request.uri().path());
                pass_on(&http, &service, request, fate).await
            }
        });
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let url = format!("http://{}", listener.local_addr().expect("an address"));
        let task = tokio::spawn(async move { axum::serve(listener, router).await.expect("it serves") });
        Self { url, task }
    }
}

impl Drop for Between {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn pass_on(http: &Client, service: &str, request: Request, fate: Fate) -> Response {
    if let Fate::Answer(status, text) = fate {
        let status = StatusCode::from_u16(status).expect("a status");
        return (status, [(header::RETRY_AFTER, "1")], text).into_response();
    }
    let (mut parts, body) = request.into_parts();
    parts.headers.remove(header::HOST);
    let path = parts.uri.path_and_query().expect("a path");
    let body = to_bytes(body, 64 << 20).await.expect("a body");
    let asked = http.request(parts.method, format!("{service}{path}")).headers(parts.headers).body(body);
    let answer = asked.send().await.expect("an answer");
    let (status, headers) = (answer.status(), answer.headers().clone());
    let body = match fate {
        Fate::LoseAnswer => std::panic::resume_unwind(Box::new("the connection breaks")),
        Fate::Damage => {
            let mut bytes = answer.bytes().await.expect("a body").to_vec();
            let middle = bytes.len() / 2;
            bytes[middle] ^= 1;
            Body::from(bytes)
        }
        _ => Body::from_stream(answer.bytes_stream()),
    };
    (status, headers, body).into_response()
}
