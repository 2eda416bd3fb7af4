//! Routes of process profiles: the built-in ones, and those of the caller's tenant.

use axum::Json;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde_json::{Map, Value};
use time::OffsetDateTime;
use utoipa::ToSchema;

use super::authenticate::{AnyCaller, Caller, RequireJobsWrite};
use super::extract::{ApiPath, contains_etag, json_object, read_small, text_header};
use super::problem::{FieldError, Problem, ProblemCode, truncated};
use super::state::ApiState;
use super::validation::object_errors;
use crate::jobs::{NewProfile, ProfileName, TenantProfile};
use crate::options::with_whole_numbers;
use crate::printing::profile::{ProcessLimits, Profile};

/// Maximum number of profiles of a tenant.
const MAX_PROFILES: u32 = 50;

/// A process profile: a built-in one, or one of your own.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ProcessProfile)]
pub(super) struct ProfileView {
    /// Whether the program brings the profile along. Every other profile is your own.
    built_in: bool,
    /// The profile with every limit.
    profile: Profile,
    /// The limits that you set, and the profile that has the others as `based_on`; null for a built-in profile.
    #[schema(required)]
    limits: Option<ProcessLimits>,
    /// When the limits were last changed; null for a built-in profile.
    #[serde(with = "crate::jobs::timestamp::option")]
    #[schema(required)]
    updated_at: Option<OffsetDateTime>,
}

/// The process profiles.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ProcessProfiles)]
pub(super) struct ProfilesView {
    /// The built-in profiles, then your own, sorted by name.
    profiles: Vec<ProfileView>,
}

impl ProfileView {
    fn built_in(profile: &Profile) -> Self {
        Self { built_in: true, profile: profile.clone(), limits: None, updated_at: None }
    }

    fn own(own: TenantProfile) -> Result<Self, Problem> {
        let profile = own.profile().map_err(|error| Problem::internal(&error))?;
        Ok(Self { built_in: false, profile, limits: Some(own.limits), updated_at: Some(own.updated_at) })
    }
}

/// The entity tag of a tenant's profile. The time distinguishes a profile that was deleted and created again.
fn etag(own: &TenantProfile) -> String {
    format!("\"{:x}-{}\"", own.created_at.unix_timestamp_nanos() / 1_000_000, own.version)
}

fn not_found(name: &str) -> Problem {
    let detail = format!("There is no process profile '{}'. GET /v1/profiles lists all.", truncated(name));
    Problem::new(ProblemCode::ProfileNotFound, detail)
}

/// Returns the caller's own profile of this name. A name that no profile can have need not reach the database.
async fn find_own(state: &ApiState, caller: &Caller, name: &str) -> Result<Option<TenantProfile>, Problem> {
    if name.parse::<ProfileName>().is_err() {
        return Ok(None);
    }
    Ok(state.store.profile(caller.tenant.as_str(), name).await?)
}

/// List process profiles.
///
/// Lists the built-in profiles with the sources of each limit, then your own. The option `process` of a job names one of them.
#[utoipa::path(
    get, path = "/v1/profiles", tag = "profiles",
    responses(
        (status = 200, description = "The profiles", body = ProfilesView),
    )
)]
pub(super) async fn list_profiles(
    State(state): State<ApiState>,
    AnyCaller(caller): AnyCaller,
) -> Result<Json<ProfilesView>, Problem> {
    let own = state.store.profiles(caller.tenant.as_str()).await?;
    // A profile whose base this version lacks is logged, and does not hide the others.
    let own = own.into_iter().filter_map(|own| ProfileView::own(own).ok());
    let profiles = Profile::built_in().iter().map(ProfileView::built_in).chain(own).collect();
    Ok(Json(ProfilesView { profiles }))
}

/// Get a process profile.
///
/// A built-in profile is also found by its aliases, such as `sls`. Your own profiles have an entity tag.
#[utoipa::path(
    get, path = "/v1/profiles/{name}", tag = "profiles",
    params(
        ("name" = String, Path, description = "The profile's name"),
        ("If-None-Match" = Option<String>, Header, description = "The ETag of an earlier response. If your profile has not changed, the response is 304"),
    ),
    responses(
        (status = 200, description = "The profile", body = ProfileView, headers(("ETag" = String, description = "The version of your own profile"))),
        (status = 304, description = "The profile is unchanged"),
        (status = 400, description = "The path is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "Profile not found", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_profile(
    State(state): State<ApiState>,
    AnyCaller(caller): AnyCaller,
    ApiPath(name): ApiPath<String>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    if let Some(own) = find_own(&state, &caller, &name).await? {
        let tag = etag(&own);
        if text_header(&headers, &header::IF_NONE_MATCH).is_some_and(|list| contains_etag(list, &tag)) {
            return Ok((StatusCode::NOT_MODIFIED, [(header::ETAG, tag)]).into_response());
        }
        return Ok(([(header::ETAG, tag)], Json(ProfileView::own(own)?)).into_response());
    }
    let built_in = Profile::named(&name).ok_or_else(|| not_found(&name))?;
    Ok(Json(ProfileView::built_in(built_in)).into_response())
}

/// Create or replace a process profile of your own.
///
/// The body holds the limits that differ from those of the built-in profile in `based_on`. Jobs that name the profile use its
/// limits at the time of their submission: a later change does not affect queued jobs. Requires the scope `jobs:write`; browser tokens
/// can't change profiles.
#[utoipa::path(
    put, path = "/v1/profiles/{name}", tag = "profiles",
    params(
        ("name" = String, Path, description = "The profile's name: 1 to 63 lower-case letters, digits, hyphens, underscores and dots. Names and aliases of built-in profiles are taken"),
        ("If-Match" = Option<String>, Header, description = "The ETag of the profile to replace. If the profile has changed since or was deleted, the response is 412"),
        ("If-None-Match" = Option<String>, Header, description = "`*` creates the profile only. If there is one, the response is 412"),
    ),
    request_body = ProcessLimits,
    responses(
        (status = 200, description = "The replaced profile", body = ProfileView, headers(("ETag" = String, description = "The profile's version"))),
        (status = 201, description = "The created profile", body = ProfileView, headers(("ETag" = String, description = "The profile's version"))),
        (status = 400, description = "The body or the path is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The maximum number of profiles exists", body = Problem, content_type = "application/problem+json"),
        (status = 412, description = "The profile does not match the precondition", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "The name is not allowed, or a limit is out of range", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn put_profile(
    State(state): State<ApiState>,
    RequireJobsWrite(caller): RequireJobsWrite,
    ApiPath(name): ApiPath<String>,
    request: Request,
) -> Result<Response, Problem> {
    let caller = without_browser_token(caller)?;
    let precondition = Precondition::of(request.headers());
    let limits = read_limits(json_object("The body", &read_small(&state, request).await?)?)?;
    let new = NewProfile::new(&name, limits).map_err(|error| match error.field() {
        Some(field) => Problem::invalid_field(field, format!("{error}.")),
        None => {
            Problem::invalid_value(format!("The profile name '{}' in the path is invalid: {error}.", truncated(&name)))
        }
    })?;
    let own = precondition.write(&state, &caller, &new).await?;
    tracing::info!(profile = own.name, version = own.version, "changed process profile");
    let status = if own.version == 1 { StatusCode::CREATED } else { StatusCode::OK };
    Ok((status, [(header::ETAG, etag(&own))], Json(ProfileView::own(own)?)).into_response())
}

/// Delete a process profile of your own.
///
/// Jobs that were submitted with the profile keep its limits. Requires the scope `jobs:write`; browser tokens can't delete profiles.
#[utoipa::path(
    delete, path = "/v1/profiles/{name}", tag = "profiles",
    params(
        ("name" = String, Path, description = "The profile's name"),
        ("If-Match" = Option<String>, Header, description = "The ETag of the profile to delete. If the profile has changed since, the response is 412"),
    ),
    responses(
        (status = 204, description = "The profile was deleted"),
        (status = 400, description = "The path is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "You have no profile of this name", body = Problem, content_type = "application/problem+json"),
        (status = 412, description = "The profile does not match the precondition", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn delete_profile(
    State(state): State<ApiState>,
    RequireJobsWrite(caller): RequireJobsWrite,
    ApiPath(name): ApiPath<String>,
    headers: HeaderMap,
) -> Result<StatusCode, Problem> {
    let caller = without_browser_token(caller)?;
    let own = find_own(&state, &caller, &name).await?.ok_or_else(|| not_found(&name))?;
    let expected = match Precondition::of(&headers) {
        Precondition::Matches(list) if contains_etag(&list, &etag(&own)) => Some(&own),
        Precondition::Matches(_) => return Err(precondition_failed()),
        Precondition::None | Precondition::IsAbsent => None,
    };
    match state.store.delete_profile(caller.tenant.as_str(), &name, expected).await? {
        true => Ok(StatusCode::NO_CONTENT),
        false if expected.is_some() => Err(precondition_failed()),
        false => Err(not_found(&name)),
    }
}

/// Rejects browser tokens: a page that may submit jobs may not change the rules for all jobs of its shop.
fn without_browser_token(caller: Caller) -> Result<Caller, Problem> {
    match caller.token_id() {
        Some(_) => Err(Problem::new(ProblemCode::Forbidden, "A browser token can't change profiles. Use an API key.")),
        None => Ok(caller),
    }
}

/// Reads limits from the fields of a body. The error names every invalid field.
fn read_limits(mut fields: Map<String, Value>) -> Result<ProcessLimits, Problem> {
    let mut errors = object_errors("ProcessLimits", &fields);
    fields.values_mut().for_each(with_whole_numbers);
    let is_readable = |name: &String, value: &Value| {
        serde_json::from_value::<ProcessLimits>(Map::from_iter([(name.clone(), value.clone())]).into()).is_ok()
    };
    if errors.is_empty() {
        let unreadable = fields.iter().filter(|(name, value)| !is_readable(name, value));
        errors.extend(unreadable.map(|(name, _)| FieldError::new(name, format!("`{name}` is out of range."))));
    }
    if !errors.is_empty() {
        return Err(Problem::of_fields(ProblemCode::InvalidOptions, errors));
    }
    serde_json::from_value(fields.into()).map_err(|error| Problem::internal(&error))
}

/// What a request expects of the stored profile (RFC 9110, 13.1).
enum Precondition {
    /// Nothing.
    None,
    /// That its entity tag is in this list.
    Matches(String),
    /// That there is none.
    IsAbsent,
}

fn precondition_failed() -> Problem {
    let detail = "The profile is not in the state that the request expects. Get the profile, then repeat the change.";
    Problem::new(ProblemCode::PreconditionFailed, detail)
}

impl Precondition {
    fn of(headers: &HeaderMap) -> Self {
        match text_header(headers, &header::IF_MATCH) {
            Some(list) => Self::Matches(list.to_owned()),
            None if text_header(headers, &header::IF_NONE_MATCH) == Some("*") => Self::IsAbsent,
            None => Self::None,
        }
    }

    /// Stores the profile if the precondition holds.
    async fn write(self, state: &ApiState, caller: &Caller, new: &NewProfile) -> Result<TenantProfile, Problem> {
        let (store, tenant) = (state.store.as_ref(), caller.tenant.as_str());
        let current = store.profile(tenant, new.name.as_str()).await?;
        let written = match (&self, &current) {
            (Self::Matches(list), Some(own)) if contains_etag(list, &etag(own)) => {
                store.replace_profile(tenant, new, Some(own)).await?
            }
            (Self::Matches(_), _) | (Self::IsAbsent, Some(_)) => None,
            (Self::None, Some(_)) => store.replace_profile(tenant, new, None).await?,
            (Self::None | Self::IsAbsent, None) => store.add_profile(tenant, new, MAX_PROFILES).await?,
        };
        if let Some(written) = written {
            return Ok(written);
        }
        let is_full = || async { Ok::<_, Problem>(store.profiles(tenant).await?.len() >= MAX_PROFILES as usize) };
        if current.is_none() && !matches!(self, Self::Matches(_)) && is_full().await? {
            let detail = format!("You already have {MAX_PROFILES} process profiles, the maximum. Delete one first.");
            return Err(Problem::new(ProblemCode::TooManyProfiles, detail));
        }
        // Without a precondition of its own, the request raced with another one about the same profile.
        Err(precondition_failed())
    }
}
