use std::io::Write;
use std::process::ExitCode;

use clap::{Args, Subcommand};
use meshmend::access::{AccessKey, KeyKind, KeyQuery, NewKey, Scope, Scopes, Secret, TenantName};
use serde_json::{Value, json};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

use super::service::{Room, ServiceError, run, to_stdout};
use super::settings::DataArgs;
use super::table::table;

/// Keys that are read from the database at once.
const PAGE: u32 = 200;

/// Arguments of `meshmend keys`.
#[derive(Debug, Args)]
pub struct KeysArgs {
    #[command(subcommand)]
    command: KeysCommand,
}

#[derive(Debug, Subcommand)]
enum KeysCommand {
    /// Make a key and print its secret, which is not shown again.
    Create {
        /// Whose key: lower-case letters, digits and hyphens. A tenant is made by its first key.
        #[arg(long, env = "MESHMEND_KEY_TENANT", default_value_t)]
        tenant: TenantName,
        /// What it allows, with commas between: jobs:read, jobs:write, webhooks, tokens, metrics, admin. All but metrics and admin where
        /// it is left out.
        #[arg(long, env = "MESHMEND_KEY_SCOPES", default_value_t = Scopes::of_a_tenant())]
        scopes: Scopes,
        /// What it is for, to tell it from others.
        #[arg(long, env = "MESHMEND_KEY_LABEL", default_value = "")]
        label: String,
        /// Days after which it expires; without it, never.
        #[arg(long, env = "MESHMEND_KEY_EXPIRES_D")]
        expires_d: Option<u32>,
        #[command(flatten)]
        data: DataArgs,
    },
    /// List keys, oldest first, without their secrets.
    List {
        /// Only this tenant's.
        #[arg(long, env = "MESHMEND_KEY_TENANT")]
        tenant: Option<TenantName>,
        /// Print one JSON object a line instead of a table.
        #[arg(long, env = "MESHMEND_JSON")]
        json: bool,
        #[command(flatten)]
        data: DataArgs,
    },
    /// Revoke a key, and the browser tokens made with it.
    Revoke {
        /// The key's id, as `keys list` shows it.
        id: String,
        #[command(flatten)]
        data: DataArgs,
    },
}

/// Runs `meshmend keys`.
pub fn keys(args: KeysArgs) -> ExitCode {
    match args.command {
        KeysCommand::Create { tenant, scopes, label, expires_d, data } => run(&data, async |room: Room| {
            let life_s = expires_d.map(|days| u64::from(days) * 24 * 3600);
            let kind = KeyKind::Api;
            let secret = Secret::new(kind);
            let new = NewKey { tenant, kind, label, scopes, origin: None, max_bytes: None, life_s, parent: None };
            let key = room.store.create_key(new, &secret.token()).await?;
            // The secret alone on standard output, for scripts.
            let _ = writeln!(std::io::stderr(), "{}", to_json(&key));
            to_stdout(secret.reveal())
        }),
        KeysCommand::List { tenant, json, data } => run(&data, async |room: Room| {
            let keys = all(&room, tenant).await?;
            if json {
                return keys.iter().try_for_each(|key| to_stdout(&to_json(key).to_string()));
            }
            let header = ["ID", "TENANT", "SCOPES", "CREATED", "EXPIRES", "REVOKED", "LAST USED", "LABEL"];
            to_stdout(&table(header, keys.iter().map(row)))
        }),
        KeysCommand::Revoke { id, data } => run(&data, async |room: Room| {
            if room.store.revoke_key(&id).await? {
                to_stdout(&format!("{id} is revoked"))
            } else {
                Err(ServiceError::Refused(format!(
                    "there is no key '{id}' that could be revoked; see meshmend keys list"
                )))
            }
        }),
    }
}

/// Every key, oldest first.
async fn all(room: &Room, tenant: Option<TenantName>) -> Result<Vec<AccessKey>, ServiceError> {
    let mut query = KeyQuery { tenant, limit: PAGE, ..KeyQuery::default() };
    let mut keys = Vec::new();
    loop {
        let page = room.store.keys(query.clone()).await?;
        keys.extend(page.items);
        query.before = page.next;
        if query.before.is_none() {
            keys.reverse();
            return Ok(keys);
        }
    }
}

fn rfc3339(time: Option<OffsetDateTime>) -> Option<String> {
    time.and_then(|time| time.format(&Rfc3339).ok())
}

fn to_json(key: &AccessKey) -> Value {
    json!({
        "id": key.id, "tenant": key.tenant.as_str(), "label": key.label,
        "scopes": key.scopes.iter().map(Scope::as_str).collect::<Vec<_>>(),
        "created_at": rfc3339(Some(key.created_at)), "expires_at": rfc3339(key.expires_at),
        "revoked_at": rfc3339(key.revoked_at), "last_used_at": rfc3339(key.last_used_at),
    })
}

fn row(key: &AccessKey) -> [String; 8] {
    // Whole seconds are enough for people.
    let time = |time: Option<OffsetDateTime>| {
        rfc3339(time.and_then(|time| time.replace_nanosecond(0).ok())).unwrap_or_else(|| "-".to_owned())
    };
    [
        key.id.clone(),
        key.tenant.to_string(),
        key.scopes.to_string(),
        time(Some(key.created_at)),
        time(key.expires_at),
        time(key.revoked_at),
        time(key.last_used_at),
        key.label.clone(),
    ]
}
