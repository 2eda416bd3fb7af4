//! The commands that administer the database of a service: `keys`, `tenants` and `backup`.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, Subcommand, ValueEnum};
use meshmend::access::{
    AccessKey, KeyKind, KeyQuery, NewKey, STANDARD_CLASS, Scope, Scopes, Secret, SystemIds, Tenant, TenantChange,
    TenantClass, TenantLimits, TenantName,
};
use meshmend::jobs::{BackupError, SqliteStore};
use serde_json::{Value, json};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

use super::config::table;
use super::exit;
use super::service::{ServiceData, run, start, to_stdout};
use super::service_error::{ServiceError, sqlite_error};
use super::settings::{DataArgs, database_file};

/// Keys or tenants per database query.
const PAGE_SIZE: u32 = 200;

/// Arguments of `meshmend keys`.
#[derive(Debug, Args)]
pub struct KeysArgs {
    #[command(subcommand)]
    command: KeysCommand,
}

#[derive(Debug, Subcommand)]
enum KeysCommand {
    /// Create a key and print its secret, which is never shown again.
    Create {
        /// Tenant that owns the key: lower-case letters, digits and hyphens. The first key of a tenant creates the
        /// tenant.
        #[arg(long, env = "MESHMEND_KEY_TENANT", default_value_t)]
        tenant: TenantName,
        /// Permissions of the key, comma-separated: jobs:read, jobs:write, webhooks, tokens, metrics, admin. Default:
        /// all except metrics and admin.
        #[arg(long, env = "MESHMEND_KEY_SCOPES", default_value_t = Scopes::of_a_tenant())]
        scopes: Scopes,
        /// Purpose of the key, to tell it from others.
        #[arg(long, env = "MESHMEND_KEY_LABEL", default_value = "")]
        label: String,
        /// Days until the key expires. Default: never.
        #[arg(long, env = "MESHMEND_KEY_EXPIRES_D")]
        expires_d: Option<u32>,
        #[command(flatten)]
        data: DataArgs,
    },
    /// List keys, oldest first, without their secrets.
    List {
        /// Only the keys of this tenant.
        #[arg(long, env = "MESHMEND_KEY_TENANT")]
        tenant: Option<TenantName>,
        /// Print one JSON object per line instead of a table.
        #[arg(long, env = "MESHMEND_JSON")]
        json: bool,
        #[command(flatten)]
        data: DataArgs,
    },
    /// Revoke a key and the browser tokens created with the key.
    Revoke {
        /// Id of the key, as shown by `keys list`.
        id: String,
        #[command(flatten)]
        data: DataArgs,
    },
}

/// Runs `meshmend keys`.
pub fn keys(args: KeysArgs) -> ExitCode {
    match args.command {
        KeysCommand::Create { tenant, scopes, label, expires_d, data } => run(&data, async |data: ServiceData| {
            let life_s = expires_d.map(|days| u64::from(days) * 24 * 3600);
            let kind = KeyKind::Api;
            let secret = Secret::new(kind, &SystemIds);
            let new = NewKey { tenant, kind, label, scopes, origin: None, max_bytes: None, life_s, parent: None };
            let key = data.store.create_key(new, &secret.hash()).await?;
            // Scripts read the secret from standard output, so only the secret goes there.
            let _ = writeln!(std::io::stderr(), "{}", key_json(&key));
            to_stdout(secret.reveal())
        }),
        KeysCommand::List { tenant, json, data } => run(&data, async |data: ServiceData| {
            let keys = all_keys(&data, tenant).await?;
            if json {
                return keys.iter().try_for_each(|key| to_stdout(&key_json(key).to_string()));
            }
            let header = ["ID", "TENANT", "SCOPES", "CREATED", "EXPIRES", "REVOKED", "LAST USED", "LABEL"];
            to_stdout(&table(header, keys.iter().map(key_row)))
        }),
        KeysCommand::Revoke { id, data } => run(&data, async |data: ServiceData| {
            if data.store.revoke_key(&id).await? {
                to_stdout(&format!("revoked {id}"))
            } else {
                Err(ServiceError::Refused(format!(
                    "no active key has the id '{id}'; `meshmend keys list` shows all ids"
                )))
            }
        }),
    }
}

/// Every key, oldest first.
async fn all_keys(data: &ServiceData, tenant: Option<TenantName>) -> Result<Vec<AccessKey>, ServiceError> {
    let mut query = KeyQuery { tenant, limit: PAGE_SIZE, ..KeyQuery::default() };
    let mut keys = Vec::new();
    loop {
        let page = data.store.keys(query.clone()).await?;
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

fn key_json(key: &AccessKey) -> Value {
    json!({
        "id": key.id, "tenant": key.tenant.as_str(), "label": key.label,
        "scopes": key.scopes.iter().map(Scope::as_str).collect::<Vec<_>>(),
        "created_at": rfc3339(Some(key.created_at)), "expires_at": rfc3339(key.expires_at),
        "revoked_at": rfc3339(key.revoked_at), "last_used_at": rfc3339(key.last_used_at),
    })
}

fn key_row(key: &AccessKey) -> [String; 8] {
    // The table shows whole seconds.
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

/// Arguments of `meshmend tenants`.
#[derive(Debug, Args)]
pub struct TenantsArgs {
    #[command(subcommand)]
    command: TenantsCommand,
}

#[derive(Debug, Subcommand)]
enum TenantsCommand {
    /// Change settings of a tenant, and print all its settings. Omitted settings stay as they are; `--clear` removes
    /// a setting.
    Set {
        /// Name of the tenant.
        tenant: TenantName,
        /// Class of the tenant, a name of your choice that groups jobs in the metrics: lower-case letters, digits and
        /// hyphens.
        #[arg(long, env = "MESHMEND_TENANT_SET_CLASS")]
        class: Option<TenantClass>,
        /// Maximum number of queued jobs of the tenant.
        #[arg(long, env = "MESHMEND_TENANT_SET_MAX_QUEUED")]
        max_queued: Option<u32>,
        /// Maximum number of running jobs of the tenant.
        #[arg(long, env = "MESHMEND_TENANT_SET_MAX_RUNNING")]
        max_running: Option<u32>,
        /// Maximum number of requests of the tenant per minute and serving process.
        #[arg(long, env = "MESHMEND_TENANT_SET_REQUESTS_PER_MINUTE", value_parser = clap::value_parser!(u32).range(1..))]
        requests_per_minute: Option<u32>,
        /// Settings to remove, comma-separated. The service's own limit then applies, and the class is `standard`.
        #[arg(long, env = "MESHMEND_TENANT_SET_CLEAR", value_enum, value_delimiter = ',', value_name = "SETTINGS")]
        clear: Vec<Setting>,
        /// Print a JSON object instead of a table.
        #[arg(long, env = "MESHMEND_JSON")]
        json: bool,
        #[command(flatten)]
        data: DataArgs,
    },
    /// List the tenants that have a key or settings, by name. `-` means the service's own limit.
    List {
        /// Print one JSON object per line instead of a table.
        #[arg(long, env = "MESHMEND_JSON")]
        json: bool,
        #[command(flatten)]
        data: DataArgs,
    },
}

/// A setting of a tenant that `--clear` can remove.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Setting {
    Class,
    MaxQueued,
    MaxRunning,
    RequestsPerMinute,
}

/// Runs `meshmend tenants`.
pub fn tenants(args: TenantsArgs) -> ExitCode {
    match args.command {
        TenantsCommand::Set { tenant, class, max_queued, max_running, requests_per_minute, clear, json, data } => {
            run(&data, async |data: ServiceData| {
                let change = TenantChange {
                    class: change(class, Setting::Class, &clear)?,
                    max_queued: change(max_queued, Setting::MaxQueued, &clear)?,
                    max_running: change(max_running, Setting::MaxRunning, &clear)?,
                    requests_per_minute: change(requests_per_minute, Setting::RequestsPerMinute, &clear)?,
                };
                print_tenants(&[data.store.change_tenant(&tenant, change).await?], json)
            })
        }
        TenantsCommand::List { json, data } => run(&data, async |data: ServiceData| {
            let mut tenants: Vec<Tenant> = Vec::new();
            let mut after = None;
            loop {
                let page = data.store.tenants(after.as_deref(), PAGE_SIZE).await?;
                tenants.extend(page.items);
                after = page.next;
                if after.is_none() {
                    return print_tenants(&tenants, json);
                }
            }
        }),
    }
}

/// Converts a flag and `--clear` to a change: `Some(Some(value))` sets, `Some(None)` clears, `None` keeps the
/// setting.
///
/// # Errors
/// The setting is both set and cleared.
fn change<T>(given: Option<T>, setting: Setting, clear: &[Setting]) -> Result<Option<Option<T>>, ServiceError> {
    match (given, clear.contains(&setting)) {
        (Some(_), true) => {
            let name = setting.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned());
            Err(ServiceError::Refused(format!(
                "--clear {name} and --{name} contradict each other. Use only one of them."
            )))
        }
        (Some(value), false) => Ok(Some(Some(value))),
        (None, true) => Ok(Some(None)),
        (None, false) => Ok(None),
    }
}

fn print_tenants(tenants: &[Tenant], json: bool) -> Result<(), ServiceError> {
    if json {
        return tenants.iter().try_for_each(|tenant| to_stdout(&tenant_json(tenant)));
    }
    to_stdout(&table(
        ["TENANT", "CLASS", "MAX QUEUED", "MAX RUNNING", "REQUESTS PER MINUTE"],
        tenants.iter().map(tenant_row),
    ))
}

fn class(tenant: &Tenant) -> &str {
    tenant.class.as_deref().unwrap_or(STANDARD_CLASS)
}

fn tenant_json(tenant: &Tenant) -> String {
    let TenantLimits { max_queued, max_running, requests_per_minute } = tenant.limits;
    json!({
        "tenant": tenant.name, "class": class(tenant), "max_queued": max_queued, "max_running": max_running,
        "requests_per_minute": requests_per_minute,
    })
    .to_string()
}

fn tenant_row(tenant: &Tenant) -> [String; 5] {
    let TenantLimits { max_queued, max_running, requests_per_minute } = tenant.limits;
    let limit = |limit: Option<u32>| limit.map_or_else(|| "-".to_owned(), |limit| limit.to_string());
    [tenant.name.clone(), class(tenant).to_owned(), limit(max_queued), limit(max_running), limit(requests_per_minute)]
}

/// Arguments of `meshmend backup`.
#[derive(Debug, Args)]
pub struct BackupArgs {
    /// File for the copy, or an existing folder, in which `meshmend.db` is created. An existing file is never
    /// overwritten.
    #[arg(value_name = "FILE|FOLDER")]
    target: PathBuf,
    #[command(flatten)]
    data: DataArgs,
}

/// Runs `meshmend backup`.
pub fn backup(args: &BackupArgs) -> ExitCode {
    if args.data.database_url.is_some() {
        return exit::fail(
            exit::BAD_INPUT,
            "backup copies only SQLite, but --database-url (MESHMEND_DATABASE_URL) is set to a PostgreSQL database. Copy that \
             database with `pg_dump --format=custom --file=meshmend.dump URL`.",
        );
    }
    start(&args.data, async { back_up(&args.data.data_dir, &args.target).await })
}

async fn back_up(data_dir: &Path, target: &Path) -> Result<(), ServiceError> {
    let source = database_file(data_dir);
    if !source.is_file() {
        return Err(ServiceError::Refused(format!(
            "--data-dir (MESHMEND_DATA_DIR): there is no database {}. Use the data folder of the service.",
            source.display()
        )));
    }
    let target = if target.is_dir() { database_file(target) } else { target.to_owned() };
    SqliteStore::back_up(&source, &target).await.map_err(|error| match error {
        BackupError::Store(error) => sqlite_error(&source, &error),
        BackupError::Io(error) if error.kind() == io::ErrorKind::AlreadyExists => ServiceError::Refused(format!(
            "{}: the file exists and is not overwritten. Choose another name.",
            target.display()
        )),
        BackupError::Io(error) => {
            ServiceError::Refused(format!("{}: the copy cannot be written: {error}.", target.display()))
        }
    })?;
    to_stdout(&target.display().to_string())
}
