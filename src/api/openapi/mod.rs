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

use super::authenticate::readable;
use super::intake::upload;
use super::problem::Problem;
use super::state::ApiState;
use super::{artifacts, jobs, keys, service, submit, tenants, webhook_deliveries, webhook_endpoints};

#[derive(OpenApi)]
#[openapi(
    info(
        title = "meshmend",
        description = "Repairs broken 3D models, proves that the result is printable, and gives an honest account of \
                       what changed. Or only looks, and tells what is wrong where.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0"),
    ),
    tags(
        (name = "jobs", description = "Send a model, follow its job, download the result"),
        (name = "uploads", description = "Send a large file, or one from a browser, before its job"),
        (name = "webhooks", description = "Be told of jobs that end, in the form of the Standard Webhooks specification"),
        (name = "access", description = "Tokens for the pages of a storefront, and the keys and tenants of the service"),
        (name = "service", description = "What the service can do and how it is"),
    ),
    components(schemas(Problem, crate::jobs::JobReport, crate::jobs::JobMessage)),
)]
struct Document;

/// The addresses that ask who is there.
pub(super) fn guarded() -> OpenApiRouter<ApiState> {
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
        .routes(routes!(service::get_capabilities))
        .routes(routes!(service::get_metrics));
    document_admission(routes.get_openapi_mut());
    document_submission(routes.get_openapi_mut());
    routes
}

/// The addresses that anybody may ask.
pub(super) fn open() -> OpenApiRouter<ApiState> {
    OpenApiRouter::new()
        // Whoever has the address may send the file, from any page.
        .routes(routes!(upload::put_upload).layer(map_response(readable)))
        .routes(routes!(service::livez))
        .routes(routes!(service::readyz))
        .routes(routes!(service::list_problems))
        .routes(routes!(service::get_problem))
}

/// The OpenAPI document (3.1), as kept in `openapi/openapi.json`.
#[must_use]
pub fn document() -> OpenApiDocument {
    complete(guarded().merge(open()).into_openapi())
}

/// The OpenAPI document in version 3.0.3, narrowed to what generators of that version take: each body has one media type (a job is
/// submitted as raw bytes with its options in the query), parameters written as JSON are texts, and redirects and webhooks are left out.
///
/// # Errors
/// When the document can't be written as JSON.
pub fn document_3_0() -> serde_json::Result<serde_json::Value> {
    serde_json::to_value(document()).map(version_3_0::narrow)
}

/// Adds what concerns the document as a whole: the server, the webhooks, the operations without a key, and names for schemas that
/// code generators need.
pub(super) fn complete(mut document: OpenApiDocument) -> OpenApiDocument {
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

/// The messages that the service sends.
fn webhooks() -> Paths {
    let message = ContentBuilder::new().schema(Some(Ref::from_schema_name("WebhookMessage"))).build();
    let ended = OperationBuilder::new()
        .operation_id(Some("job_ended"))
        .summary(Some("A job has ended"))
        .description(Some(
            "Posted to every webhook endpoint whose events include the message's `type`, and to the job's `callback_url`. \
             Signed in the form of the Standard Webhooks specification. Sent again until the receiver answers 2xx.",
        ))
        .tag("webhooks")
        .securities(Some(Vec::<SecurityRequirement>::new()))
        .request_body(Some(RequestBodyBuilder::new().content("application/json", message).required(Some(Required::True)).build()))
        .response("2XX", ResponseBuilder::new().description("The receiver has the message").build())
        .response("4XX", ResponseBuilder::new().description("The receiver refuses the message; it is sent again later").build());
    PathsBuilder::new().path("job_ended", PathItem::new(HttpMethod::Post, ended.build())).build()
}

/// Makes each titled variant of a union a schema of its own, named by its title: generators need a name for each.
fn name_variants(document: &mut OpenApiDocument) {
    let Some(components) = document.components.as_mut() else { return };
    let mut named = Vec::new();
    for schema in components.schemas.values_mut() {
        let RefOr::T(Schema::OneOf(union)) = schema else { continue };
        for variant in &mut union.items {
            let title = match variant {
                RefOr::T(Schema::AllOf(it)) => it.title.take(),
                RefOr::T(Schema::Object(it)) => it.title.take(),
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

fn operations(document: &mut OpenApiDocument) -> impl Iterator<Item = &mut Operation> {
    document.paths.paths.values_mut().flat_map(|path| {
        [&mut path.get, &mut path.post, &mut path.put, &mut path.patch, &mut path.delete]
            .into_iter()
            .filter_map(Option::as_mut)
    })
}

/// Adds what `authenticate` and any handler may answer, and what is asked for.
fn document_admission(document: &mut OpenApiDocument) {
    let scheme = SecurityScheme::Http(
        HttpBuilder::new()
            .scheme(HttpAuthScheme::Bearer)
            .description(Some(
                "An API key, or a browser token. A service that listens on this machine only asks for none.",
            ))
            .build(),
    );
    document.components.get_or_insert_default().add_security_scheme("key", scheme);
    let answers = [
        ("401", "No key, or one that is worth nothing"),
        ("403", "The key lacks a scope, or the page is of another origin"),
        ("429", "Too many requests came"),
        ("500", "A fault of the service"),
        ("503", "The database does not answer now"),
    ];
    for operation in operations(document) {
        operation.security = Some(vec![SecurityRequirement::default(), SecurityRequirement::new("key", [""; 0])]);
        let of_bodies = [("408", "The body stopped coming"), ("413", "The body is too large")];
        let of_bodies = of_bodies.into_iter().filter(|_| operation.request_body.is_some());
        for (status, description) in answers.into_iter().chain(of_bodies) {
            let content = ContentBuilder::new().schema(Some(Ref::from_schema_name("Problem"))).build();
            let answer = ResponseBuilder::new().description(description).content("application/problem+json", content);
            operation.responses.responses.entry(status.to_owned()).or_insert_with(|| answer.build().into());
        }
    }
}

/// Query fields of `POST /v1/jobs` whose values are written as JSON.
const JSON_FIELDS: [&str; 4] = ["metadata", "tolerances", "up", "build_volume"];

/// Says of `POST /v1/jobs` that its form has no other parts, and of each field of its query what is said of it in a body, such as its
/// range, so that it is said in one place.
fn document_submission(document: &mut OpenApiDocument) {
    let Some(schemas) = document.components.as_mut().map(|components| &mut components.schemas) else { return };
    if let Some(RefOr::T(Schema::Object(form))) = schemas.get_mut("SubmitForm") {
        form.additional_properties = Some(Box::new(AdditionalProperties::FreeForm(false)));
    }
    let bodies = ["Options", "InspectOptions", "SubmitUpload"].into_iter().filter_map(|name| match schemas.get(name) {
        Some(RefOr::T(Schema::Object(body))) => Some(&body.properties),
        _ => None,
    });
    let known: BTreeMap<String, RefOr<Schema>> =
        bodies.flatten().map(|(name, it)| (name.clone(), it.clone())).collect();
    let submit = document.paths.paths.get_mut("/v1/jobs").and_then(|path| path.post.as_mut());
    let Some(parameters) = submit.and_then(|submit| submit.parameters.as_mut()) else { return };
    // Options that both modes have come twice, and a document may name a parameter once.
    let mut named = BTreeSet::new();
    parameters.retain(|field| matches!(field, RefOr::T(field) if named.insert(field.name.clone())));
    for field in parameters {
        let RefOr::T(field) = field else { continue };
        let Some(mut schema) = known.get(&field.name).filter(|_| field.parameter_in == ParameterIn::Query).cloned()
        else {
            continue;
        };
        // Generated clients send every default, and options of both modes stand side by side here; the bodies tell the defaults.
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

/// A parameter that is not required is left out; it can't be null.
fn remove_null(schema: &mut RefOr<Schema>) {
    match schema {
        RefOr::T(Schema::Object(it)) => {
            if let SchemaType::Array(types) = &mut it.schema_type {
                types.retain(|kind| *kind != Type::Null);
                if let [kind] = &types[..] {
                    it.schema_type = SchemaType::Type(kind.clone());
                }
            }
        }
        RefOr::T(Schema::OneOf(it)) => {
            it.items.retain(
                |item| !matches!(item, RefOr::T(Schema::Object(it)) if it.schema_type == SchemaType::Type(Type::Null)),
            );
            if it.items.len() == 1 {
                *schema = it.items.remove(0);
            }
        }
        _ => {}
    }
}

fn remove_default(schema: &mut RefOr<Schema>) {
    match schema {
        RefOr::Ref(it) => it.default = None,
        RefOr::T(Schema::Object(it)) => it.default = None,
        RefOr::T(Schema::Array(it)) => it.default = None,
        RefOr::T(Schema::OneOf(it)) => it.default = None,
        RefOr::T(Schema::AllOf(it)) => it.default = None,
        RefOr::T(Schema::AnyOf(it)) => it.default = None,
        RefOr::T(_) => {}
    }
}
