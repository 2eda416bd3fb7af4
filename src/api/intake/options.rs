//! Reads the options of a job. Replaces a tenant's own process profile with its limits, so that later changes do not affect the job.

use serde_json::{Map, Value};

use crate::api::authenticate::Caller;
use crate::api::problem::{FieldError, Problem, ProblemCode, truncated};
use crate::api::state::ApiState;
use crate::api::validation::{field_schema, unknown_field, value_errors};
use crate::jobs::{JobOptions, Mode, ProfileName, TenantProfile};
use crate::options::with_whole_numbers;
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
    pub async fn read(state: &ApiState, caller: &Caller, fields: Map<String, Value>) -> Result<Self, Problem> {
        let (fields, requested_limits) = resolve(state, caller, fields).await?;
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
    state: &ApiState,
    caller: &Caller,
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
    if let Some(own) = find(state, caller, &process).await? {
        limits = Some(limits.unwrap_or_default().or(own.job_limits()));
        is_own = true;
    }
    let base = limits.as_ref().and_then(|limits| limits.based_on.clone());
    if let Some(base) = base.filter(|base| Profile::named(base).is_none()) {
        let own = find(state, caller, &base).await?.ok_or_else(|| unknown_base(&base))?;
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
async fn find(state: &ApiState, caller: &Caller, name: &str) -> Result<Option<TenantProfile>, Problem> {
    if name.parse::<ProfileName>().is_err() {
        return Ok(None);
    }
    Ok(state.store.profile(caller.tenant.as_str(), name).await?)
}

/// Parses the options of a job. The error names every invalid option.
fn job_options(fields: Map<String, Value>) -> Result<JobOptions, Problem> {
    let mode = match fields.get("mode") {
        None => Mode::default(),
        Some(value) => match Mode::ALL.into_iter().find(|mode| value == mode.as_str()) {
            Some(mode) => mode,
            None => return Err(Problem::of_fields(ProblemCode::InvalidOptions, vec![unknown_mode(value)])),
        },
    };
    let errors: Vec<_> = fields.iter().flat_map(|(option, value)| option_errors(mode, option, value)).collect();
    if !errors.is_empty() {
        return Err(Problem::of_fields(ProblemCode::InvalidOptions, errors));
    }
    JobOptions::from_fields(fields).map_err(|error| match error.option() {
        Some(option) => Problem::invalid_field(option, error.to_string()),
        None => Problem::invalid_value(error.to_string()),
    })
}

fn unknown_mode(value: &Value) -> FieldError {
    let names = Mode::ALL.map(|mode| format!("`{}`", mode.as_str())).join(" or ");
    FieldError::new("mode", format!("`mode` must be {names}; got {}.", truncated(&value.to_string())))
}

/// Validates one option against the documented schema of its mode.
fn option_errors(mode: Mode, option: &str, value: &Value) -> Vec<FieldError> {
    let schema = match mode {
        Mode::Repair => "Options",
        Mode::Analyze => "AnalyzeOptions",
    };
    if option == "mode" {
        return Vec::new();
    }
    if let Some(schema) = field_schema(schema, option) {
        return value_errors(option, schema, value);
    }
    let other_mode = Mode::ALL.into_iter().find(|other| other.option_names().iter().any(|name| name == option));
    vec![match other_mode {
        Some(other) => {
            let (other, mode) = (other.as_str(), mode.as_str());
            let message = format!("`{option}` is an option of mode `{other}`; this job's mode is `{mode}`.");
            FieldError::new(option, message)
        }
        None => unknown_field(option, mode.option_names().iter().map(String::as_str), "option"),
    }]
}
