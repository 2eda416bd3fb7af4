//! Why a request to a service failed: the message, the exit code, and whether a retry may help.

use std::error::Error;
use std::fmt::Write;
use std::time::Duration;

use meshmend::api::{FieldError, Problem, ProblemCode};
use reqwest::{Response, StatusCode, header};

use crate::cli::exit;

/// Why a request to a service failed.
#[derive(Debug, thiserror::Error)]
pub enum RemoteError {
    /// The service cannot be reached, or the connection broke.
    #[error("{server} {event}: {cause}.{advice}")]
    Unreachable { server: String, event: &'static str, cause: String, advice: &'static str },
    /// The TLS certificate of the service is not trusted.
    #[error(
        "the TLS certificate of {server} is not trusted: {cause}. For a private certificate authority, set SSL_CERT_FILE to a file \
         with its certificate."
    )]
    Untrusted { server: String, cause: String },
    /// The service answered with a problem.
    #[error("{}", problem_text(.0))]
    Refused(Box<Problem>, Option<Duration>),
    /// The answer is not from meshmend, but from another program or from a proxy.
    #[error("{server} answered {status}, but not as a meshmend service. {}", advice(*.status))]
    NotMeshmend { server: String, status: StatusCode, retry_after: Option<Duration> },
    /// A downloaded file has the wrong checksum.
    #[error("{name}: the checksum of the download is wrong, so nothing was written. Try again.")]
    Damaged { name: String },
    /// A local file or argument is unusable.
    #[error("{0}")]
    Local(String),
}

impl RemoteError {
    /// An unusable local file: its name and the reason.
    pub fn local(name: impl std::fmt::Display, error: impl std::fmt::Display) -> Self {
        Self::Local(format!("{name}: {error}"))
    }

    /// A connection that failed or broke.
    pub fn unreachable(server: &str, error: &reqwest::Error) -> Self {
        let (server, cause) = (server.to_owned(), innermost_cause(error));
        if cause.contains("certificate") || cause.contains("UnknownIssuer") {
            return Self::Untrusted { server, cause };
        }
        let advice = if cause.contains("InvalidContentType") {
            " The server does not use TLS at this address. Try http:// instead of https://."
        } else {
            " Check the address, and that the service is running."
        };
        if error.is_timeout() {
            let cause = "the request timed out".to_owned();
            return Self::Unreachable { server, event: "does not answer", cause, advice };
        }
        let (event, advice) =
            if error.is_connect() { ("cannot be reached", advice) } else { ("closed the connection", " Try again.") };
        Self::Unreachable { server, event, cause, advice }
    }

    /// A connection without data for too long.
    pub fn silent(server: &str) -> Self {
        let cause = "no data arrived for a while".to_owned();
        Self::Unreachable { server: server.to_owned(), event: "stopped responding", cause, advice: " Try again." }
    }

    /// The error of an unsuccessful response.
    pub async fn of(server: &str, response: Response) -> Self {
        let status = response.status();
        let after = response.headers().get(header::RETRY_AFTER).and_then(|value| value.to_str().ok()?.parse().ok());
        let retry_after = after.map(Duration::from_secs);
        let problem = response.bytes().await.ok().and_then(|body| serde_json::from_slice(&body).ok());
        match problem {
            Some(problem) => Self::Refused(Box::new(problem), retry_after),
            None => Self::NotMeshmend { server: server.to_owned(), status, retry_after },
        }
    }

    /// Whether a retry of the same request may succeed later.
    pub fn is_transient(&self) -> bool {
        match self {
            Self::Unreachable { .. } => true,
            Self::Refused(problem, _) => matches!(
                problem.code,
                ProblemCode::RateLimited
                    | ProblemCode::QueueFull
                    | ProblemCode::Unavailable
                    | ProblemCode::StorageFull
                    | ProblemCode::IdempotencyKeyInUse
                    | ProblemCode::UploadTimeout
                    | ProblemCode::UploadInterrupted
            ),
            Self::NotMeshmend { status, .. } => matches!(status.as_u16(), 408 | 429 | 502 | 503 | 504),
            Self::Untrusted { .. } | Self::Damaged { .. } | Self::Local(_) => false,
        }
    }

    /// The delay that the service asks for before a retry.
    pub fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::Refused(_, after) | Self::NotMeshmend { retry_after: after, .. } => *after,
            _ => None,
        }
    }

    /// A short message for the progress display.
    pub fn brief(&self) -> String {
        match self {
            Self::Unreachable { event, cause, .. } => format!("the service {event} ({cause})"),
            Self::Refused(problem, _) => problem.title.to_lowercase(),
            Self::Untrusted { cause, .. } => format!("the TLS certificate is not trusted ({cause})"),
            Self::NotMeshmend { status, .. } => format!("the service answered {status}"),
            Self::Damaged { .. } | Self::Local(_) => self.to_string(),
        }
    }

    /// Whether the job does not exist, or no longer exists.
    pub fn is_gone(&self) -> bool {
        let gone = [ProblemCode::JobNotFound, ProblemCode::JobDeleted, ProblemCode::JobExpired];
        self.problem().is_some_and(|problem| gone.contains(&problem.code))
    }

    /// The exit code for this error.
    pub fn code(&self) -> u8 {
        match self {
            Self::Local(_) => exit::BAD_INPUT,
            Self::Refused(problem, _) => match problem.code {
                ProblemCode::InvalidOptions
                | ProblemCode::MissingFile
                | ProblemCode::PayloadTooLarge
                | ProblemCode::UnsupportedModel => exit::BAD_INPUT,
                _ => exit::REFUSED,
            },
            Self::Unreachable { .. } | Self::Untrusted { .. } | Self::NotMeshmend { .. } | Self::Damaged { .. } => {
                exit::REFUSED
            }
        }
    }

    /// The problem in the answer of the service, for `--json`.
    pub fn problem(&self) -> Option<&Problem> {
        match self {
            Self::Refused(problem, _) => Some(problem),
            _ => None,
        }
    }
}

/// The message of the innermost cause, which comes from the operating system or the peer.
fn innermost_cause(error: &reqwest::Error) -> String {
    let mut cause: &dyn Error = error;
    while let Some(inner) = cause.source() {
        cause = inner;
    }
    cause.to_string()
}

/// Formats a problem: what happened, what to do, and the code and request id for support.
fn problem_text(problem: &Problem) -> String {
    let Problem { title, detail, code, request_id, errors, .. } = problem;
    let mut text = format!("{title}. {detail}");
    for FieldError { message, .. } in errors.iter().filter(|error| error.message != *detail) {
        let _ = write!(text, "\n  {message}");
    }
    let next = match code {
        ProblemCode::Unauthorized => {
            "Set MESHMEND_API_KEY to a key, or --api-key-file to a file with a key. The operator creates keys with \
             'meshmend keys create'."
        }
        ProblemCode::QueueFull | ProblemCode::RateLimited => "Try again later, or wait longer with --timeout-s.",
        ProblemCode::UnsupportedModel => {
            "Send a model file; 'meshmend inspect FILE' shows whether the file is readable."
        }
        ProblemCode::JobNotFound => "Check the id, and use the key and the address with which the job was submitted.",
        code => code.describe().2,
    };
    let _ = write!(text, "\n  {next}\n  ({}", code.name());
    if !request_id.is_empty() {
        let _ = write!(text, ", request {request_id}");
    }
    text.push(')');
    text
}

/// What to do about an answer that is not from meshmend.
fn advice(status: StatusCode) -> &'static str {
    match status.as_u16() {
        401 | 403 | 407 => "A proxy in front of the service requires other credentials.",
        413 => "A proxy in front of the service accepts only smaller files.",
        502..=504 => "A proxy in front of the service cannot reach the service.",
        _ => "Check that this is the address of a meshmend service.",
    }
}
