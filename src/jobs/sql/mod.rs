//! The store over SQL: the statements that both databases share, by subject, and what each database does in its own way.

mod jobs;
mod outbox;
mod postgres;
mod profiles;
mod queue;
mod sqlite;
mod statement;
mod store;
mod tenants;

pub use postgres::PostgresStore;
pub use sqlite::{BackupError, SqliteStore};
pub use store::SqlStore;
