//! The OpenAPI document, generated from the handlers, and the list of all routes of the API.
use std::collections::{BTreeMap, BTreeSet};

use axum::middleware::map_response;
use utoipa::OpenApi;
use utoipa::openapi::path::{HttpMethod, Operation, OperationBuilder, Parameter, ParameterIn};
use utoipa::openapi::request_body::RequestBodyBuilder;
use utoipa::openapi::schema::{AdditionalProperties, SchemaType, Type};
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{
    ContentBuilder, OpenApi as OpenApiDocument, PathItem, Paths, PathsBuilder, Ref, RefOr, Required, ResponseBuilder,
    Schema, ServerBuilder,
};
use utoipa_axum::router::{OpenApiRouter, UtoipaMethodRouterExt};
use utoipa_axum::routes;

mod version_3_0;

use super::authenticate::allow_any_origin;
use super::intake::upload;
use super::problem::Problem;
use super::state::ApiState;
use super::{artifacts, jobs, keys, profiles, service, submit, tenants, webhook_deliveries, webhook_endpoints};

#[derive(OpenApi)]
#[openapi(
    info(
        title = "meshmend",
        description = "Repairs broken 3D models, proves that the result is printable, and reports exactly what changed. \
                       Analyses models without changing them.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0"),
    ),
    tags(
        (name = "jobs", description = "Submit models, follow jobs, download results"),
        (name = "uploads", description = "Send large files, or files from a browser, before their job"),
        (name = "webhooks", description = "Receive notifications when jobs end, as the Standard Webhooks specification says"),
        (name = "access", description = "Manage API keys, browser tokens and tenants"),
        (name = "profiles", description = "Rules of printing processes: built-in profiles and your own"),
        (name = "service", description = "Capabilities, health and metrics of the service"),
    ),
    components(schemas(Problem, crate::jobs::JobReport, crate::jobs::JobMessage)),
)]
struct Document;

/// The routes that need authentication.
pub(super) fn authenticated_routes() -> OpenApiRouter<ApiState> {
    let mut routes = OpenApiRouter::with_openapi(Document::openapi())
        .routes(routes!(submit::submit_job, jobs::list_jobs))
        .routes(routes!(jobs::get_job, jobs::delete_job))
        .routes(routes!(jobs::cancel_job))
        .routes(routes!(jobs::job_events))
        .routes(routes!(artifacts::get_artifact))
        .routes(routes!(upload::announce_upload))
        .routes(routes!(webhook_endpoints::create_endpoint, webhook_endpoints::list_endpoints))
        .routes(routes!(
            webhook_endpoints::get_endpoint,
            webhook_endpoints::change_endpoint,
            webhook_endpoints::delete_endpoint
        ))
        .routes(routes!(webhook_endpoints::rotate_endpoint))
        .routes(routes!(webhook_deliveries::test_endpoint))
        .routes(routes!(webhook_deliveries::list_of_endpoint))
        .routes(routes!(webhook_deliveries::list_deliveries))
        .routes(routes!(webhook_deliveries::redeliver))
        .routes(routes!(webhook_endpoints::get_secret))
        .routes(routes!(webhook_endpoints::rotate_secret))
        .routes(routes!(keys::make_token))
        .routes(routes!(keys::create_key, keys::list_keys))
        .routes(routes!(keys::get_key, keys::revoke_key))
        .routes(routes!(tenants::list_tenants))
        .routes(routes!(tenants::get_tenant, tenants::change_tenant))
        .routes(routes!(profiles::list_profiles))
        .routes(routes!(profiles::get_profile, profiles::put_profile, profiles::delete_profile))
        .routes(routes!(service::get_capabilities))
        .routes(routes!(service::get_metrics));
    document_authentication(routes.get_openapi_mut());
    document_submission(routes.get_openapi_mut());
    routes
}

/// The routes that need no authentication.
pub(super) fn public_routes() -> OpenApiRouter<ApiState> {
    OpenApiRouter::new()
        // The URL contains a secret token, so any page that has the URL may send the file.
        .routes(routes!(upload::put_upload).layer(map_response(allow_any_origin)))
        .routes(routes!(service::livez))
        .routes(routes!(service::readyz))
        .routes(routes!(service::list_problems))
        .routes(routes!(service::get_problem))
}

/// Returns the OpenAPI 3.1 document, as committed in `openapi/openapi.json`.
#[must_use]
pub fn document() -> OpenApiDocument {
    finish(authenticated_routes().merge(public_routes()).into_openapi())
}

/// Returns the OpenAPI document converted to version 3.0.3, for code generators without support for 3.1.
///
/// Each body has one media type: a job is submitted as raw bytes with its options in the query. Parameters in JSON become texts.
/// Redirects and webhooks are omitted.
///
/// # Errors
/// If the document can't be serialized as JSON.
pub fn document_3_0() -> serde_json::Result<serde_json::Value> {
    serde_json::to_value(document()).map(version_3_0::narrow)
}

/// Adds the parts that concern the whole document: the server, the webhooks, the operations without a key, and the schema names that
/// code generators need.
pub(super) fn finish(mut document: OpenApiDocument) -> OpenApiDocument {
    document.servers = Some(vec![ServerBuilder::new().url("/").description(Some("This service")).build()]);
    document.webhooks = Some(webhooks());
    for operation in operations(&mut document) {
        operation.security.get_or_insert_default();
        for parameter in operation.parameters.iter_mut().flatten() {
            if let RefOr::T(Parameter { schema: Some(schema), .. }) = parameter {
                remove_null(schema);
            }
        }
    }
    name_variants(&mut document);
    document
}

/// Describes the webhook messages that the service sends.
fn webhooks() -> Paths {
    let message = ContentBuilder::new().schema(Some(Ref::from_schema_name("WebhookMessage"))).build();
    let ended = OperationBuilder::new()
        .operation_id(Some("job_ended"))
        .summary(Some("A job has ended"))
        .description(Some(
            "Posted to every webhook endpoint whose events include the message's `type`, and to the job's `callback_url`. \
             Signed as the Standard Webhooks specification says. Retried until the receiver responds with 2xx.",
        ))
        .tag("webhooks")
        .securities(Some(Vec::<SecurityRequirement>::new()))
        .request_body(Some(RequestBodyBuilder::new().content("application/json", message).required(Some(Required::True)).build()))
        .response("2XX", ResponseBuilder::new().description("The receiver accepted the message").build())
        .response("4XX", ResponseBuilder::new().description("The receiver rejected the message; the service retries later").build());
    PathsBuilder::new().path("job_ended", PathItem::new(HttpMethod::Post, ended.build())).build()
}

/// Moves each titled variant of a union to a schema of its own, named by its title. Code generators need a name for each variant.
fn name_variants(document: &mut OpenApiDocument) {
    let Some(components) = document.components.as_mut() else { return };
    let mut named = Vec::new();
    for schema in components.schemas.values_mut() {
        let RefOr::T(Schema::OneOf(union)) = schema else { continue };
        for variant in &mut union.items {
            let title = match variant {
                RefOr::T(Schema::AllOf(schema)) => schema.title.take(),
                RefOr::T(Schema::Object(schema)) => schema.title.take(),
                _ => None,
            };
            if let Some(title) = title {
                let reference = RefOr::Ref(Ref::from_schema_name(&title));
                named.push((title, std::mem::replace(variant, reference)));
            }
        }
    }
    components.schemas.extend(named);
}

/// Iterates over all operations of the document.
fn operations(document: &mut OpenApiDocument) -> impl Iterator<Item = &mut Operation> {
    document.paths.paths.values_mut().flat_map(|path| {
        [&mut path.get, &mut path.post, &mut path.put, &mut path.patch, &mut path.delete]
            .into_iter()
            .filter_map(Option::as_mut)
    })
}

/// Adds the security scheme, and the error responses that authentication and every handler may produce.
fn document_authentication(document: &mut OpenApiDocument) {
    let scheme = SecurityScheme::Http(
        HttpBuilder::new()
            .scheme(HttpAuthScheme::Bearer)
            .description(Some(
                "An API key or a browser token. A service that listens on a loopback address only requires no key by default.",
            ))
            .build(),
    );
    document.components.get_or_insert_default().add_security_scheme("key", scheme);
    let responses = [
        ("401", "The API key is missing or invalid"),
        ("403", "The key lacks a scope, or the page's origin is not allowed"),
        ("429", "Too many requests"),
        ("500", "Internal error"),
        ("503", "The database is unavailable"),
    ];
    for operation in operations(document) {
        operation.security = Some(vec![SecurityRequirement::default(), SecurityRequirement::new("key", [""; 0])]);
        let of_bodies = [("408", "The body timed out"), ("413", "The body is too large")];
        let of_bodies = of_bodies.into_iter().filter(|_| operation.request_body.is_some());
        for (status, description) in responses.into_iter().chain(of_bodies) {
            let content = ContentBuilder::new().schema(Some(Ref::from_schema_name("Problem"))).build();
            let response = ResponseBuilder::new().description(description).content("application/problem+json", content);
            operation.responses.responses.entry(status.to_owned()).or_insert_with(|| response.build().into());
        }
    }
}

/// Query parameters of `POST /v1/jobs` whose values are written as JSON.
const JSON_FIELDS: [&str; 5] = ["metadata", "tolerances", "up", "build_volume", "process_limits"];

/// Completes the documentation of `POST /v1/jobs`. Closes the form to other parts, and copies each query parameter's schema, such as its
/// range, from the body's schema, where it is defined.
fn document_submission(document: &mut OpenApiDocument) {
    let Some(schemas) = document.components.as_mut().map(|components| &mut components.schemas) else { return };
    if let Some(RefOr::T(Schema::Object(form))) = schemas.get_mut("SubmitForm") {
        form.additional_properties = Some(Box::new(AdditionalProperties::FreeForm(false)));
    }
    let names = ["Options", "PrintOptions", "InspectOptions", "SubmitUpload"];
    let bodies = names.into_iter().filter_map(|name| schemas.get(name)).flat_map(own_fields);
    let body_schemas: BTreeMap<String, RefOr<Schema>> =
        bodies.map(|(name, schema)| (name.clone(), schema.clone())).collect();
    let submit = document.paths.paths.get_mut("/v1/jobs").and_then(|path| path.post.as_mut());
    let Some(parameters) = submit.and_then(|submit| submit.parameters.as_mut()) else { return };
    // Options of both modes occur twice, but parameter names must be unique.
    let mut named = BTreeSet::new();
    parameters.retain(|field| matches!(field, RefOr::T(field) if named.insert(field.name.clone())));
    for field in parameters {
        let RefOr::T(field) = field else { continue };
        let Some(mut schema) =
            body_schemas.get(&field.name).filter(|_| field.parameter_in == ParameterIn::Query).cloned()
        else {
            continue;
        };
        // Generated clients send every default, and the query mixes the options of both modes. Only the bodies have defaults.
        remove_default(&mut schema);
        if JSON_FIELDS.contains(&field.name.as_str()) {
            let content = ContentBuilder::new().schema(Some(schema)).build();
            field.content = BTreeMap::from([("application/json".to_owned(), content.into())]);
            field.schema = None;
        } else {
            field.schema = Some(schema);
        }
    }
}

/// Iterates over the fields of an object's schema, without those that it takes from a named schema.
fn own_fields(schema: &RefOr<Schema>) -> Box<dyn Iterator<Item = (&String, &RefOr<Schema>)> + '_> {
    match schema {
        RefOr::T(Schema::Object(object)) => Box::new(object.properties.iter()),
        RefOr::T(Schema::AllOf(all)) => Box::new(all.items.iter().flat_map(own_fields)),
        _ => Box::new(std::iter::empty()),
    }
}

/// Removes `null` from a parameter's schema: an optional parameter is omitted, never null.
fn remove_null(schema: &mut RefOr<Schema>) {
    match schema {
        RefOr::T(Schema::Object(object)) => {
            if let SchemaType::Array(types) = &mut object.schema_type {
                types.retain(|kind| *kind != Type::Null);
                if let [kind] = &types[..] {
                    object.schema_type = SchemaType::Type(kind.clone());
                }
            }
        }
        RefOr::T(Schema::OneOf(union)) => {
            union.items.retain(
                |item| !matches!(item, RefOr::T(Schema::Object(object)) if object.schema_type == SchemaType::Type(Type::Null)),
            );
            if union.items.len() == 1 {
                *schema = union.items.remove(0);
            }
        }
        _ => {}
    }
}

/// Removes the default of a schema.
fn remove_default(schema: &mut RefOr<Schema>) {
    match schema {
        RefOr::Ref(schema) => schema.default = None,
        RefOr::T(Schema::Object(schema)) => schema.default = None,
        RefOr::T(Schema::Array(schema)) => schema.default = None,
        RefOr::T(Schema::OneOf(schema)) => schema.default = None,
        RefOr::T(Schema::AllOf(schema)) => schema.default = None,
        RefOr::T(Schema::AnyOf(schema)) => schema.default = None,
        RefOr::T(_) => {}
    }
}
