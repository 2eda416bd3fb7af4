//! A way to PostgreSQL that breaks off at a statement: a socket in a folder of its own, behind which every connection is passed on to the
//! server's, message by message (PostgreSQL's documentation, "Frontend/Backend Protocol").

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
    /// The statement never comes to the server.
    Before,
    /// The server has done it, and its answer never comes to the client.
    After,
}

/// What is known of all connections.
#[derive(Default)]
struct Watch {
    /// The statements that came, each once, in the order in which they first did.
    seen: Vec<String>,
    /// Where the next connection breaks that comes to it.
    cut: Option<(String, Side)>,
}

impl Watch {
    /// Notes a statement, and says whether its connection breaks now.
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
    /// Listens in front of the cluster, as a task of the runtime that it is called in.
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

    /// The address of the cluster's database by this way, on which nobody may ask for TLS.
    pub fn url(&self) -> String {
        format!("{}&sslmode=disable", Postgres::url_at(self.folder.path()))
    }

    /// Forgets which statements came.
    pub fn forget(&self) {
        self.watch.lock().expect("not poisoned").seen.clear();
    }

    /// The statements that came, in the order in which they first did. The end of a transaction is named by what came before it.
    pub fn seen(&self) -> Vec<String> {
        self.watch.lock().expect("not poisoned").seen.clone()
    }

    /// Lets the next connection break that comes to this statement.
    pub fn cut_at(&self, statement: &str, side: Side) {
        self.watch.lock().expect("not poisoned").cut = Some((statement.to_owned(), side));
    }

    /// Whether one has broken since.
    pub fn has_cut(&self) -> bool {
        self.watch.lock().expect("not poisoned").cut.is_none()
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.listener.abort();
    }
}

/// Passes one connection on until either side ends it or it breaks.
async fn pass_on(mut client: UnixStream, server: PathBuf, watch: Arc<Mutex<Watch>>) -> Option<()> {
    let mut server = UnixStream::connect(server).await.ok()?;
    // The first message alone has no type.
    let length = client.read_u32().await.ok()?;
    let mut startup = vec![0; usize::try_from(length).ok()?.checked_sub(4)?];
    client.read_exact(&mut startup).await.ok()?;
    server.write_u32(length).await.ok()?;
    server.write_all(&startup).await.ok()?;

    // The length is that of the message without its type, which is kept before it.
    let typed = || LengthDelimitedCodec::builder().length_field_offset(1).length_adjustment(1).num_skip(0).to_owned();
    let (asks, mut to_client) = client.into_split();
    let (answers, mut to_server) = server.into_split();
    let (mut asks, mut answers) = (typed().new_read(asks), typed().new_read(answers));
    let mut statements = Statements::default();
    // How many rounds were asked for and answered, and the one after which it breaks.
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
                // Ready for the next.
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
    /// Those that are prepared.
    prepared: HashMap<String, String>,
    /// The one whose parameters came last.
    bound: String,
    /// The one that was begun last.
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
