//! A proxy between a client and the service that forwards, loses, damages or replaces responses.

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

/// What the proxy does with a request.
pub enum Action {
    /// Forwards the request and the response.
    Pass,
    /// Forwards the request, and breaks the connection before the response.
    LoseResponse,
    /// Forwards the request, and changes one byte of the response's body.
    Damage,
    /// Responds with this status, some text, and a `retry-after` header.
    Respond(u16, &'static str),
}

pub struct Interceptor {
    pub url: String,
    task: JoinHandle<()>,
}

impl Interceptor {
    /// Starts a proxy for a service; `action` gets the method and the path of each request.
    pub async fn start(program: &Program, action: impl Fn(&str, &str) -> Action + Send + Sync + 'static) -> Self {
        meshmend::tls::use_ring();
        let (http, service, action) = (Client::new(), program.url.clone(), Arc::new(action));
        let router = Router::new().fallback(move |request: Request| {
            let (http, service, action) = (http.clone(), service.clone(), Arc::clone(&action));
            async move {
                let action = action(request.method().as_str(), request.uri().path());
                pass_on(&http, &service, request, action).await
            }
        });
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let url = format!("http://{}", listener.local_addr().expect("an address"));
        let task = tokio::spawn(async move { axum::serve(listener, router).await.expect("it serves") });
        Self { url, task }
    }
}

impl Drop for Interceptor {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn pass_on(http: &Client, service: &str, request: Request, action: Action) -> Response {
    if let Action::Respond(status, text) = action {
        let status = StatusCode::from_u16(status).expect("a status");
        return (status, [(header::RETRY_AFTER, "1")], text).into_response();
    }
    let (mut parts, body) = request.into_parts();
    parts.headers.remove(header::HOST);
    let path = parts.uri.path_and_query().expect("a path");
    let body = to_bytes(body, 64 << 20).await.expect("a body");
    let asked = http.request(parts.method, format!("{service}{path}")).headers(parts.headers).body(body);
    let answer = asked.send().await.expect("a response");
    let (status, headers) = (answer.status(), answer.headers().clone());
    let body = match action {
        Action::LoseResponse => std::panic::resume_unwind(Box::new("the connection breaks")),
        Action::Damage => {
            let mut bytes = answer.bytes().await.expect("a body").to_vec();
            let middle = bytes.len() / 2;
            bytes[middle] ^= 1;
            Body::from(bytes)
        }
        _ => Body::from_stream(answer.bytes_stream()),
    };
    (status, headers, body).into_response()
}
