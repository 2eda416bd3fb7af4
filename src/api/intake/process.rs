//! Replaces a tenant's own process profile in a job's options with its limits, so that later changes do not affect the job.

use serde_json::{Map, Value};

use super::submission::{SubmissionContext, job_options};
use crate::api::problem::{Problem, truncated};
use crate::jobs::{JobOptions, ProfileName, TenantProfile, with_whole_numbers};
use crate::printing::profile::{ProcessLimits, Profile};

/// The options that name the process and its limits.
const PROCESS: &str = "process";
const LIMITS: &str = "process_limits";

/// The options of a submission. `process_limits` includes the limits of the tenant's own profile, if the options name one.
#[derive(Default)]
pub struct SubmittedOptions {
    /// The job's options.
    pub options: JobOptions,
    /// The request's own `process_limits`, if limits of a tenant's profile were added to them.
    requested_limits: Option<Option<ProcessLimits>>,
}

impl SubmittedOptions {
    /// Reads the options of a job. The error names every invalid option.
    pub async fn read(context: SubmissionContext<'_>, fields: Map<String, Value>) -> Result<Self, Problem> {
        let (fields, requested_limits) = resolve(context, fields).await?;
        Ok(Self { options: job_options(fields)?, requested_limits })
    }

    /// The options as the request sent them. They identify a repeated request even if the tenant's profile has changed since.
    pub fn as_requested(&self) -> JobOptions {
        let mut options = self.options.clone();
        if let Some(limits) = &self.requested_limits {
            *options.process_limits_mut() = limits.clone();
        }
        options
    }
}

/// Adds the limits of a tenant's own profile that `process` or `process_limits.based_on` names. The request's own limits win. Values of
/// the wrong type stay for the validation.
async fn resolve(
    context: SubmissionContext<'_>,
    mut fields: Map<String, Value>,
) -> Result<(Map<String, Value>, Option<Option<ProcessLimits>>), Problem> {
    let requested = match fields.get(LIMITS).cloned() {
        None | Some(Value::Null) => Some(None),
        Some(mut limits) => {
            with_whole_numbers(&mut limits);
            serde_json::from_value::<ProcessLimits>(limits).ok().map(Some)
        }
    };
    let process = fields.get(PROCESS).and_then(Value::as_str).map(str::to_owned);
    let (Some(process), Some(requested_limits)) = (process, requested) else {
        return Ok((fields, None));
    };
    let mut limits = requested_limits.clone();
    let mut is_own = false;
    if let Some(own) = find(context, &process).await? {
        limits = Some(limits.unwrap_or_default().or(own.job_limits()));
        is_own = true;
    }
    let base = limits.as_ref().and_then(|limits| limits.based_on.clone());
    if let Some(base) = base.filter(|base| Profile::named(base).is_none()) {
        let own = find(context, &base).await?.ok_or_else(|| unknown_base(&base))?;
        let above = ProcessLimits { based_on: None, ..limits.unwrap_or_default() };
        limits = Some(above.or(own.job_limits()));
        is_own = true;
    }
    if !is_own {
        return Ok((fields, None));
    }
    let limits = serde_json::to_value(limits).map_err(|error| Problem::internal(&error))?;
    fields.insert(LIMITS.to_owned(), limits);
    Ok((fields, Some(requested_limits)))
}

/// The problem of limits that are based on a profile that does not exist.
fn unknown_base(base: &str) -> Problem {
    let field = format!("{LIMITS}.based_on");
    let message = format!("`{field}` must be a name that `GET /v1/profiles` lists; got `{}`.", truncated(base));
    Problem::invalid_field(&field, message)
}

/// The tenant's own profile of this name. A name that no profile can have need not reach the database.
async fn find(context: SubmissionContext<'_>, name: &str) -> Result<Option<TenantProfile>, Problem> {
    if name.parse::<ProfileName>().is_err() {
        return Ok(None);
    }
    Ok(context.state.store.profile(context.caller.tenant.as_str(), name).await?)
}
