use std::io::Write;
use std::process::ExitCode;

use clap::{Args, Subcommand};
use meshmend::access::{
    AccessKey, KeyKind, NewKey, STANDARD_CLASS, Scopes, Secret, Tenant, TenantClass, TenantLimits, TenantName,
};
use serde_json::json;
use time::format_description::well_known::Rfc3339;

use super::service::{Room, ServiceError, run, to_stdout};
use super::settings::DataArgs;

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
        /// What it allows, with commas between: jobs:read, jobs:write, webhooks, tokens, metrics. All but metrics where it is left out.
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
    /// List keys, without their secrets, one JSON object a line.
    List {
        /// Only this tenant's.
        #[arg(long, env = "MESHMEND_KEY_TENANT")]
        tenant: Option<TenantName>,
        #[command(flatten)]
        data: DataArgs,
    },
    /// Make a key worth nothing, and the browser tokens made with it.
    Revoke {
        /// The key's id, as `keys list` shows it.
        id: String,
        #[command(flatten)]
        data: DataArgs,
    },
}

/// Arguments of `meshmend tenants`.
#[derive(Debug, Args)]
pub struct TenantsArgs {
    #[command(subcommand)]
    command: TenantsCommand,
}

#[derive(Debug, Subcommand)]
enum TenantsCommand {
    /// Set what a tenant may use. What is left out goes back to the service's own limits.
    Set {
        /// The tenant.
        tenant: TenantName,
        /// What kind of tenant it is, in your own words, to tell jobs apart in the metrics: lower-case letters, digits and hyphens.
        #[arg(long, env = "MESHMEND_TENANT_SET_CLASS")]
        class: Option<TenantClass>,
        /// Most of its jobs that may wait.
        #[arg(long, env = "MESHMEND_TENANT_SET_MAX_QUEUED")]
        max_queued: Option<u32>,
        /// Most of its jobs that may run at the same time.
        #[arg(long, env = "MESHMEND_TENANT_SET_MAX_RUNNING")]
        max_running: Option<u32>,
        /// Most of its requests in a minute, on each process that serves.
        #[arg(long, env = "MESHMEND_TENANT_SET_REQUESTS_PER_MINUTE", value_parser = clap::value_parser!(u32).range(1..))]
        requests_per_minute: Option<u32>,
        #[command(flatten)]
        data: DataArgs,
    },
    /// List the tenants for whom something is set, one JSON object a line.
    List {
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
            let _ = writeln!(std::io::stderr(), "{}", describe(&key));
            to_stdout(secret.reveal())
        }),
        KeysCommand::List { tenant, data } => run(&data, async |room: Room| {
            room.store.keys(tenant.as_ref()).await?.iter().try_for_each(|key| to_stdout(&describe(key)))
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

/// Runs `meshmend tenants`.
pub fn tenants(args: TenantsArgs) -> ExitCode {
    match args.command {
        TenantsCommand::Set { tenant, class, max_queued, max_running, requests_per_minute, data } => {
            run(&data, async |room: Room| {
                let limits = TenantLimits { max_queued, max_running, requests_per_minute };
                room.store.set_tenant(&tenant, class.as_ref(), limits).await?;
                let class = class.map(|class| class.as_str().to_owned());
                to_stdout(&describe_tenant(&Tenant { name: tenant.to_string(), class, limits }))
            })
        }
        TenantsCommand::List { data } => run(&data, async |room: Room| {
            room.store.tenants().await?.iter().try_for_each(|tenant| to_stdout(&describe_tenant(tenant)))
        }),
    }
}

fn describe(key: &AccessKey) -> String {
    let time = |time: Option<time::OffsetDateTime>| time.and_then(|time| time.format(&Rfc3339).ok());
    json!({
        "id": key.id, "tenant": key.tenant.as_str(), "label": key.label, "scopes": key.scopes.to_string(),
        "created_at": time(Some(key.created_at)), "expires_at": time(key.expires_at),
        "revoked_at": time(key.revoked_at), "last_used_at": time(key.last_used_at),
    })
    .to_string()
}

fn describe_tenant(tenant: &Tenant) -> String {
    let TenantLimits { max_queued, max_running, requests_per_minute } = tenant.limits;
    let class = tenant.class.as_deref().unwrap_or(STANDARD_CLASS);
    json!({
        "tenant": tenant.name, "class": class, "max_queued": max_queued, "max_running": max_running,
        "requests_per_minute": requests_per_minute,
    })
    .to_string()
}
