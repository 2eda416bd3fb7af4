//! A proxy for PostgreSQL that breaks a connection at a chosen statement.
//!
//! It forwards connections message by message (PostgreSQL's documentation, "Frontend/Backend Protocol").

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use bytes::BytesMut;
use futures::StreamExt;
use tempfile::TempDir;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{UnixListener, UnixStream};
use tokio::task::JoinHandle;
use tokio_util::codec::length_delimited::LengthDelimitedCodec;

use crate::postgres::Postgres;

const SOCKET: &str = ".s.PGSQL.5432";

/// When a connection breaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The server never receives the statement.
    Before,
    /// The server executes the statement, and the client never receives its response.
    After,
}

/// State of all connections.
#[derive(Default)]
struct Watch {
    /// The statements so far, each once, in the order of their first occurrence.
    seen: Vec<String>,
    /// The statement at which a connection breaks.
    cut: Option<(String, Side)>,
}

impl Watch {
    /// Records a statement, and returns how its connection breaks, if it does.
    fn pass(&mut self, statement: &str) -> Option<Side> {
        if !self.seen.iter().any(|seen| seen == statement) {
            self.seen.push(statement.to_owned());
        }
        let (_, side) = self.cut.take_if(|(cut, _)| cut == statement)?;
        Some(side)
    }
}

pub struct Proxy {
    folder: TempDir,
    watch: Arc<Mutex<Watch>>,
    listener: JoinHandle<()>,
}

impl Proxy {
    /// Starts a proxy for the cluster as a task of the current runtime.
    pub fn start(cluster: &Postgres) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let listener = UnixListener::bind(folder.path().join(SOCKET)).expect("a socket");
        let watch = Arc::<Mutex<Watch>>::default();
        let (server, watching) = (cluster.folder().join(SOCKET), Arc::clone(&watch));
        let listener = tokio::spawn(async move {
            while let Ok((client, _)) = listener.accept().await {
                tokio::spawn(pass_on(client, server.clone(), Arc::clone(&watching)));
            }
        });
        Self { folder, watch, listener }
    }

    /// The URL of the cluster's database through the proxy, without TLS.
    pub fn url(&self) -> String {
        format!("{}&sslmode=disable", Postgres::url_at(self.folder.path()))
    }

    /// Forgets the statements so far.
    pub fn forget(&self) {
        self.watch.lock().expect("not poisoned").seen.clear();
    }

    /// The statements so far, in the order of their first occurrence. A COMMIT is named after the statement before it.
    pub fn seen(&self) -> Vec<String> {
        self.watch.lock().expect("not poisoned").seen.clone()
    }

    /// Breaks the next connection that sends this statement.
    pub fn cut_at(&self, statement: &str, side: Side) {
        self.watch.lock().expect("not poisoned").cut = Some((statement.to_owned(), side));
    }

    /// Whether a connection has broken since `cut_at`.
    pub fn has_cut(&self) -> bool {
        self.watch.lock().expect("not poisoned").cut.is_none()
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.listener.abort();
    }
}

/// Forwards one connection until either side closes it or it breaks.
async fn pass_on(mut client: UnixStream, server: PathBuf, watch: Arc<Mutex<Watch>>) -> Option<()> {
    let mut server = UnixStream::connect(server).await.ok()?;
    // Only the first message has no type.
    let length = client.read_u32().await.ok()?;
    let mut startup = vec![0; usize::try_from(length).ok()?.checked_sub(4)?];
    client.read_exact(&mut startup).await.ok()?;
    server.write_u32(length).await.ok()?;
    server.write_all(&startup).await.ok()?;

    // The length excludes the type byte, which is kept in front of it.
    let typed = || LengthDelimitedCodec::builder().length_field_offset(1).length_adjustment(1).num_skip(0).to_owned();
    let (asks, mut to_client) = client.into_split();
    let (answers, mut to_server) = server.into_split();
    let (mut asks, mut answers) = (typed().new_read(asks), typed().new_read(answers));
    let mut statements = Statements::default();
    // The numbers of queries sent and answered, and the query after which the connection breaks.
    let (mut asked, mut answered, mut last) = (0_u64, 0_u64, None);
    loop {
        tokio::select! {
            message = asks.next() => {
                let message = message?.ok()?;
                if let Some(statement) = statements.begun_by(&message) {
                    match watch.lock().expect("not poisoned").pass(&statement) {
                        Some(Side::Before) => return None,
                        Some(Side::After) => last = Some(asked + 1),
                        None => {}
                    }
                }
                // A simple query, or the end of an extended one.
                asked += u64::from(matches!(message[0], b'Q' | b'S'));
                to_server.write_all(&message).await.ok()?;
            }
            message = answers.next() => {
                let message = message?.ok()?;
                if last != Some(answered + 1) {
                    to_client.write_all(&message).await.ok()?;
                }
                // ReadyForQuery.
                answered += u64::from(message[0] == b'Z');
                if last == Some(answered) {
                    return None;
                }
            }
        }
    }
}

/// The statements of one connection.
#[derive(Default)]
struct Statements {
    /// Prepared statements by name.
    prepared: HashMap<String, String>,
    /// The statement that was bound last.
    bound: String,
    /// The statement that was begun last.
    last: String,
}

impl Statements {
    /// The statement that begins with this message, if one does.
    fn begun_by(&mut self, message: &BytesMut) -> Option<String> {
        let mut texts = message[5..].split(|byte| *byte == 0).map(|text| String::from_utf8_lossy(text).into_owned());
        let statement = match message[0] {
            b'P' => {
                let (name, statement) = (texts.next()?, texts.next()?);
                self.prepared.insert(name, statement);
                return None;
            }
            b'B' => {
                let name = texts.nth(1)?;
                self.bound = self.prepared.get(&name)?.clone();
                return None;
            }
            b'E' => self.bound.clone(),
            b'Q' => texts.next()?,
            _ => return None,
        };
        let before = std::mem::replace(&mut self.last, statement.clone());
        Some(if statement == "COMMIT" { format!("COMMIT of {before}") } else { statement })
    }
}
