use std::process::ExitCode;

use clap::{Args, Subcommand, ValueEnum};
use meshmend::access::{STANDARD_CLASS, Tenant, TenantChange, TenantClass, TenantLimits, TenantName};
use serde_json::json;

use super::service::{Room, ServiceError, run, to_stdout};
use super::settings::DataArgs;
use super::table::table;

/// Tenants that are read from the database at once.
const PAGE: u32 = 200;

/// Arguments of `meshmend tenants`.
#[derive(Debug, Args)]
pub struct TenantsArgs {
    #[command(subcommand)]
    command: TenantsCommand,
}

#[derive(Debug, Subcommand)]
enum TenantsCommand {
    /// Change settings of a tenant, and print all of them. What is left out stays; `--clear` takes a setting away.
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
        /// Settings to take away, with commas between: then the service's own limit holds, and the class is `standard`.
        #[arg(long, env = "MESHMEND_TENANT_SET_CLEAR", value_enum, value_delimiter = ',', value_name = "SETTINGS")]
        clear: Vec<Setting>,
        /// Print a JSON object instead of a table.
        #[arg(long, env = "MESHMEND_JSON")]
        json: bool,
        #[command(flatten)]
        data: DataArgs,
    },
    /// List the tenants that have a key or settings, by name. `-` stands for the service's own limit.
    List {
        /// Print one JSON object a line instead of a table.
        #[arg(long, env = "MESHMEND_JSON")]
        json: bool,
        #[command(flatten)]
        data: DataArgs,
    },
}

/// A setting of a tenant.
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
            run(&data, async |room: Room| {
                let change = TenantChange {
                    class: change(class, Setting::Class, &clear)?,
                    max_queued: change(max_queued, Setting::MaxQueued, &clear)?,
                    max_running: change(max_running, Setting::MaxRunning, &clear)?,
                    requests_per_minute: change(requests_per_minute, Setting::RequestsPerMinute, &clear)?,
                };
                print(&[room.store.change_tenant(&tenant, change).await?], json)
            })
        }
        TenantsCommand::List { json, data } => run(&data, async |room: Room| {
            let mut tenants: Vec<Tenant> = Vec::new();
            let mut after = None;
            loop {
                let page = room.store.tenants(after.as_deref(), PAGE).await?;
                tenants.extend(page.items);
                after = page.next;
                if after.is_none() {
                    return print(&tenants, json);
                }
            }
        }),
    }
}

/// A value to set, one to clear, or none to keep.
fn change<T>(given: Option<T>, setting: Setting, clear: &[Setting]) -> Result<Option<Option<T>>, ServiceError> {
    match (given, clear.contains(&setting)) {
        (Some(_), true) => {
            let name = setting.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned());
            Err(ServiceError::Refused(format!("--clear names {name}, and --{name} sets it. Give one of the two.")))
        }
        (Some(value), false) => Ok(Some(Some(value))),
        (None, true) => Ok(Some(None)),
        (None, false) => Ok(None),
    }
}

fn print(tenants: &[Tenant], json: bool) -> Result<(), ServiceError> {
    if json {
        return tenants.iter().try_for_each(|tenant| to_stdout(&to_json(tenant)));
    }
    to_stdout(&table(["TENANT", "CLASS", "MAX QUEUED", "MAX RUNNING", "REQUESTS PER MINUTE"], tenants.iter().map(row)))
}

fn class(tenant: &Tenant) -> &str {
    tenant.class.as_deref().unwrap_or(STANDARD_CLASS)
}

fn to_json(tenant: &Tenant) -> String {
    let TenantLimits { max_queued, max_running, requests_per_minute } = tenant.limits;
    json!({
        "tenant": tenant.name, "class": class(tenant), "max_queued": max_queued, "max_running": max_running,
        "requests_per_minute": requests_per_minute,
    })
    .to_string()
}

fn row(tenant: &Tenant) -> [String; 5] {
    let TenantLimits { max_queued, max_running, requests_per_minute } = tenant.limits;
    let limit = |limit: Option<u32>| limit.map_or_else(|| "-".to_owned(), |limit| limit.to_string());
    [tenant.name.clone(), class(tenant).to_owned(), limit(max_queued), limit(max_running), limit(requests_per_minute)]
}
