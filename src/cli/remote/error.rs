use std::error::Error;
use std::fmt::Write;
use std::time::Duration;

use meshmend::api::{FieldError, Problem, ProblemCode};
use reqwest::{Response, StatusCode, header};

use crate::cli::exit;

/// Why a service did not do what it was asked for.
#[derive(Debug, thiserror::Error)]
pub enum RemoteError {
    /// It can't be reached, or was lost on the way.
    #[error("{server} {what}: {cause}.{advice}")]
    Unreachable { server: String, what: &'static str, cause: String, advice: &'static str },
    /// It is not known to be who it says it is.
    #[error(
        "{server} can't be trusted: {cause}. If its authority is your own, name a file with its reason in SSL_CERT_FILE."
    )]
    Untrusted { server: String, cause: String },
    /// It said why not.
    #[error("{}", in_words(.0))]
    Refused(Box<Problem>, Option<Duration>),
    /// Something answered that is no meshmend, or stands before one.
    #[error("{server} answered {status}, and not as meshmend does. {}", advice(*.status))]
    Strange { server: String, status: StatusCode, retry_after: Option<Duration> },
    /// A file that came is not the one that the service has.
    #[error("{name} came with other bytes than the service has, so nothing was written. Try again.")]
    Damaged { name: String },
    /// A local file or argument can't be used.
    #[error("{0}")]
    Local(String),
}

impl RemoteError {
    /// That a local file can't be used.
    pub fn local(name: impl std::fmt::Display, error: impl std::fmt::Display) -> Self {
        Self::Local(format!("{name}: {error}"))
    }

    /// That the service can't be reached, or did not go on.
    pub fn unreachable(server: &str, error: &reqwest::Error) -> Self {
        let (server, cause) = (server.to_owned(), innermost(error));
        if cause.contains("reason") || cause.contains("UnknownIssuer") {
            return Self::Untrusted { server, cause };
        }
        let advice = if cause.contains("InvalidContentType") {
            " It speaks no TLS there; is its address one with http://?"
        } else {
            " Is that the address, and does the service run?"
        };
        if error.is_timeout() {
            let cause = "no answer came in time".to_owned();
            return Self::Unreachable { server, what: "does not answer", cause, advice };
        }
        let (what, advice) =
            if error.is_connect() { ("can't be reached", advice) } else { ("was lost on the way", " Try again.") };
        Self::Unreachable { server, what, cause, advice }
    }

    /// That nothing came for so long.
    pub fn silent(server: &str) -> Self {
        let cause = "nothing came for a while".to_owned();
        Self::Unreachable { server: server.to_owned(), what: "was lost on the way", cause, advice: " Try again." }
    }

    /// What an answer that is no success says.
    pub async fn of(server: &str, response: Response) -> Self {
        let status = response.status();
        let after = response.headers().get(header::RETRY_AFTER).and_then(|value| value.to_str().ok()?.parse().ok());
        let retry_after = after.map(Duration::from_secs);
        let problem = response.bytes().await.ok().and_then(|body| serde_json::from_slice(&body).ok());
        match problem {
            Some(problem) => Self::Refused(Box::new(problem), retry_after),
            None => Self::Strange { server: server.to_owned(), status, retry_after },
        }
    }

    /// Whether the same request may be answered otherwise a little later.
    pub fn may_pass(&self) -> bool {
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
            Self::Strange { status, .. } => matches!(status.as_u16(), 408 | 429 | 502 | 503 | 504),
            Self::Untrusted { .. } | Self::Damaged { .. } | Self::Local(_) => false,
        }
    }

    /// When the service wants to be asked again.
    pub fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::Refused(_, after) | Self::Strange { retry_after: after, .. } => *after,
            _ => None,
        }
    }

    /// The same in a few words.
    pub fn brief(&self) -> String {
        match self {
            Self::Unreachable { what, cause, .. } => format!("the service {what} ({cause})"),
            Self::Refused(problem, _) => problem.title.to_lowercase(),
            Self::Untrusted { cause, .. } => format!("the service can't be trusted ({cause})"),
            Self::Strange { status, .. } => format!("the service answered {status}"),
            Self::Damaged { .. } | Self::Local(_) => self.to_string(),
        }
    }

    /// Whether the job that was asked for is not there, or not any more.
    pub fn is_gone(&self) -> bool {
        let gone = [ProblemCode::JobNotFound, ProblemCode::JobDeleted, ProblemCode::JobExpired];
        self.problem().is_some_and(|problem| gone.contains(&problem.code))
    }

    /// The exit code that says so.
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
            Self::Unreachable { .. } | Self::Untrusted { .. } | Self::Strange { .. } | Self::Damaged { .. } => {
                exit::REFUSED
            }
        }
    }

    /// The problem that the service named, for programs.
    pub fn problem(&self) -> Option<&Problem> {
        match self {
            Self::Refused(problem, _) => Some(problem),
            _ => None,
        }
    }
}

/// What the innermost of an error's causes says, which is what the system or the other side said.
fn innermost(error: &reqwest::Error) -> String {
    let mut cause: &dyn Error = error;
    while let Some(inner) = cause.source() {
        cause = inner;
    }
    cause.to_string()
}

/// A problem as a person reads it: what happened, what to do, and what to name when asking somebody.
fn in_words(problem: &Problem) -> String {
    let Problem { title, detail, code, request_id, errors, .. } = problem;
    let mut text = format!("{title}. {detail}");
    for FieldError { message, .. } in errors.iter().filter(|error| error.message != *detail) {
        let _ = write!(text, "\n  {message}");
    }
    let next = match code {
        ProblemCode::Unauthorized => {
            "Put a key into MESHMEND_API_KEY, or into a file that --api-key-file names; the operator makes keys with 'meshmend keys \
             create'."
        }
        ProblemCode::QueueFull | ProblemCode::RateLimited => "Try again later, or wait longer with --timeout-s.",
        ProblemCode::UnsupportedModel => "Send a model; 'meshmend inspect' tells what it makes of the file.",
        ProblemCode::JobNotFound => "Check the id, and that the key and the address are those it was submitted with.",
        code => code.describe().2,
    };
    let _ = write!(text, "\n  {next}\n  ({}", code.name());
    if !request_id.is_empty() {
        let _ = write!(text, ", request {request_id}");
    }
    text.push(')');
    text
}

fn advice(status: StatusCode) -> &'static str {
    match status.as_u16() {
        401 | 403 | 407 => "Something before the service asks for other credentials.",
        413 => "Something before the service takes only smaller files.",
        502..=504 => "Something before the service does not reach it.",
        _ => "Is the address that of a meshmend service?",
    }
}
