//! A webhook receiver on a loopback port that gives set replies and keeps the messages.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use axum::body::to_bytes;
use axum::extract::Request;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use hyper::server::conn::http1;
use hyper_util::rt::TokioIo;
use hyper_util::service::TowerToHyperService;
use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, IsCa, KeyPair};
use rustls::ServerConfig;
use rustls::pki_types::PrivateKeyDer;
use serde_json::Value;
use standardwebhooks::Webhook;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpListener;
use tokio_rustls::TlsAcceptor;

use crate::server::until;

/// A reply to a message.
#[derive(Debug, Clone)]
pub enum Reply {
    Status(u16),
    Redirect(String),
    /// No reply.
    Hang,
}

/// A message as it was received.
#[derive(Debug, Clone)]
pub struct Seen {
    pub headers: HeaderMap,
    pub body: Vec<u8>,
}

impl Seen {
    pub fn id(&self) -> String {
        self.headers["webhook-id"].to_str().expect("text").to_owned()
    }

    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body).expect("JSON")
    }

    /// Whether the reference library accepts the signature with this secret.
    pub fn verifies(&self, secret: &Value) -> bool {
        let secret = secret.as_str().expect("a secret");
        Webhook::new(secret).expect("a secret").verify(&self.body, &self.headers).is_ok()
    }
}

pub struct Receiver {
    pub url: String,
    seen: Arc<Mutex<Vec<Seen>>>,
    away: Arc<AtomicBool>,
}

impl Receiver {
    /// Starts a receiver that gives these replies in order, then the last one forever.
    pub async fn start(replies: &[Reply]) -> Self {
        let (listener, this, answers) = Self::listen("http", replies).await;
        let away = Arc::clone(&this.away);
        tokio::spawn(async move {
            while let Ok((stream, _)) = listener.accept().await {
                if !away.load(Ordering::Relaxed) {
                    tokio::spawn(serve(stream, Arc::clone(&answers)));
                }
            }
        });
        this
    }

    /// Starts a receiver with TLS. Its certificate is signed by a new authority, whose certificate is written to `file`.
    pub async fn start_tls(replies: &[Reply], file: &Path) -> Self {
        meshmend::tls::use_ring();
        let mut params = CertificateParams::new(Vec::new()).expect("parameters");
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let authority =
            CertifiedIssuer::self_signed(params, KeyPair::generate().expect("a key")).expect("an authority");
        std::fs::write(file, authority.pem()).expect("a file");
        let key = KeyPair::generate().expect("a key");
        let params = CertificateParams::new(vec!["127.0.0.1".to_owned()]).expect("parameters");
        let certificate = params.signed_by(&key, &authority).expect("a certificate");
        let key = PrivateKeyDer::try_from(key.serialize_der()).expect("a key");
        let config = ServerConfig::builder().with_no_client_auth();
        let config = config.with_single_cert(vec![certificate.der().clone()], key).expect("a configuration");
        let acceptor = TlsAcceptor::from(Arc::new(config));
        let (listener, this, answers) = Self::listen("https", replies).await;
        tokio::spawn(async move {
            while let Ok((stream, _)) = listener.accept().await {
                if let Ok(stream) = acceptor.accept(stream).await {
                    tokio::spawn(serve(stream, Arc::clone(&answers)));
                }
            }
        });
        this
    }

    async fn listen(scheme: &str, replies: &[Reply]) -> (TcpListener, Self, Arc<Answers>) {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let url = format!("{scheme}://{}/hooks", listener.local_addr().expect("an address"));
        let seen = Arc::new(Mutex::new(Vec::new()));
        let answers = Arc::new(Answers { replies: replies.to_vec(), seen: Arc::clone(&seen) });
        (listener, Self { url, seen, away: Arc::default() }, answers)
    }

    /// Sets whether the receiver drops every connection at once.
    pub fn set_away(&self, away: bool) {
        self.away.store(away, Ordering::Relaxed);
    }

    pub fn seen(&self) -> Vec<Seen> {
        self.seen.lock().expect("not poisoned").clone()
    }

    /// Waits for this number of messages and returns all that were received.
    pub async fn got(&self, many: usize) -> Vec<Seen> {
        until("the messages have come", async || Some(self.seen()).filter(|seen| seen.len() >= many)).await
    }
}

struct Answers {
    replies: Vec<Reply>,
    seen: Arc<Mutex<Vec<Seen>>>,
}

impl Answers {
    async fn answer(&self, request: Request) -> Response {
        let (parts, body) = request.into_parts();
        let Ok(body) = to_bytes(body, 1 << 20).await else { return StatusCode::BAD_REQUEST.into_response() };
        let number = {
            let mut seen = self.seen.lock().expect("not poisoned");
            seen.push(Seen { headers: parts.headers, body: body.to_vec() });
            seen.len() - 1
        };
        match self.replies.get(number).or(self.replies.last()).cloned().expect("a reply") {
            Reply::Status(status) => StatusCode::from_u16(status).expect("a status").into_response(),
            Reply::Redirect(to) => (StatusCode::TEMPORARY_REDIRECT, [(header::LOCATION, to)]).into_response(),
            Reply::Hang => std::future::pending().await,
        }
    }
}

async fn serve(stream: impl AsyncRead + AsyncWrite + Unpin, answers: Arc<Answers>) {
    let service = tower::service_fn(move |request: hyper::Request<hyper::body::Incoming>| {
        let answers = Arc::clone(&answers);
        async move { Ok::<_, std::convert::Infallible>(answers.answer(request.map(axum::body::Body::new)).await) }
    });
    let _ = http1::Builder::new().serve_connection(TokioIo::new(stream), TowerToHyperService::new(service)).await;
}
