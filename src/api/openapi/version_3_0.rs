//! Conversion of the OpenAPI document from 3.1 to 3.0.3, for code generators without support for 3.1.
//!
//! Source: "OpenAPI Specification v3.0.3", Schema Object and Media Type Object.

use serde_json::{Map, Value, json};

/// The media type that is kept if a body has several.
const BYTES: &str = "application/octet-stream";

/// Converts a document of version 3.1 to 3.0.3.
pub(super) fn narrow(mut document: Value) -> Value {
    if let Value::Object(root) = &mut document {
        root.insert("openapi".to_owned(), "3.0.3".into());
        root.remove("webhooks");
        // In 3.0 a licence has no identifier.
        if let Some(Value::Object(license)) = root.get_mut("info").and_then(|info| info.get_mut("license")) {
            license.remove("identifier");
        }
        for path in objects(root.get_mut("paths")) {
            objects(Some(path)).for_each(narrow_operation);
        }
    }
    convert_schemas(&mut document);
    document
}

fn objects(value: Option<&mut Value>) -> impl Iterator<Item = &mut Value> {
    value.and_then(Value::as_object_mut).into_iter().flat_map(Map::values_mut)
}

fn narrow_operation(operation: &mut Value) {
    if let Some(body) = operation.get_mut("requestBody") {
        keep_one_media_type(body);
    }
    if let Some(Value::Object(responses)) = operation.get_mut("responses") {
        responses.retain(|status, _| !status.starts_with('3'));
        responses.values_mut().for_each(keep_one_media_type);
    }
    let parameters = operation.get_mut("parameters").and_then(Value::as_array_mut);
    for parameter in parameters.into_iter().flatten().filter_map(Value::as_object_mut) {
        if parameter.remove("content").is_some() {
            parameter.insert("schema".to_owned(), json!({"type": "string", "description": "JSON"}));
        }
    }
}

fn keep_one_media_type(message: &mut Value) {
    let Some(Value::Object(content)) = message.get_mut("content") else { return };
    if content.len() > 1 && content.contains_key(BYTES) {
        *content = Map::from_iter([(BYTES.to_owned(), json!({"schema": {"type": "string", "format": "binary"}}))]);
    }
}

/// Converts every schema below a value.
fn convert_schemas(value: &mut Value) {
    match value {
        Value::Object(fields) => {
            for (name, field) in fields {
                match (name.as_str(), field) {
                    ("schema", schema) => convert(schema),
                    ("schemas", schemas) => objects(Some(schemas)).for_each(convert),
                    (_, other) => convert_schemas(other),
                }
            }
        }
        Value::Array(items) => items.iter_mut().for_each(convert_schemas),
        _ => {}
    }
}

/// Converts a schema and the schemas nested in it.
fn convert(schema: &mut Value) {
    let Value::Object(schema) = schema else { return };
    for name in ["items", "additionalProperties", "not"] {
        if let Some(inner) = schema.get_mut(name) {
            convert(inner);
        }
    }
    objects(schema.get_mut("properties")).for_each(convert);
    for name in ["allOf", "anyOf", "oneOf", "prefixItems"] {
        let inner = schema.get_mut(name).and_then(Value::as_array_mut);
        inner.into_iter().flatten().for_each(convert);
    }
    convert_tuple(schema);
    convert_null(schema);
    convert_keywords(schema);
}

/// Converts a tuple to a list of the same length whose items may have any of the tuple's types.
fn convert_tuple(schema: &mut Map<String, Value>) {
    let Some(Value::Array(items)) = schema.remove("prefixItems") else { return };
    let count = items.len();
    let mut kinds: Vec<Value> = Vec::new();
    for item in items {
        if !kinds.contains(&item) {
            kinds.push(item);
        }
    }
    let item = if kinds.len() == 1 { kinds.remove(0) } else { json!({"anyOf": kinds}) };
    schema.insert("items".to_owned(), item);
    schema.insert("minItems".to_owned(), count.into());
    schema.insert("maxItems".to_owned(), count.into());
}

/// Converts the type `null` to the keyword `nullable`.
fn convert_null(schema: &mut Map<String, Value>) {
    let mut is_nullable = false;
    if let Some(Value::Array(types)) = schema.get("type") {
        let mut types = types.clone();
        is_nullable = types.iter().any(|kind| kind == "null");
        types.retain(|kind| kind != "null");
        match &types[..] {
            [kind] => schema.insert("type".to_owned(), kind.clone()),
            _ => {
                schema.remove("type");
                let kinds: Vec<Value> = types.iter().map(|kind| json!({"type": kind})).collect();
                schema.insert("anyOf".to_owned(), kinds.into())
            }
        };
    }
    for name in ["oneOf", "anyOf"] {
        let Some(Value::Array(variants)) = schema.get_mut(name) else { continue };
        let all = variants.len();
        variants.retain(|variant| variant != &json!({"type": "null"}));
        if variants.len() < all {
            is_nullable = true;
            if variants.len() == 1
                && let Some(only) = schema.remove(name)
            {
                schema.insert("allOf".to_owned(), only);
            }
        }
    }
    if is_nullable {
        schema.insert("nullable".to_owned(), true.into());
    }
    // 3.0 generators reject a default that is or contains null.
    if schema.get("default").is_some_and(has_null) {
        schema.remove("default");
    }
}

fn has_null(value: &Value) -> bool {
    match value {
        Value::Null => true,
        Value::Array(items) => items.iter().any(has_null),
        Value::Object(fields) => fields.values().any(has_null),
        _ => false,
    }
}

fn convert_keywords(schema: &mut Map<String, Value>) {
    schema.remove("propertyNames");
    if let Some(value) = schema.remove("const") {
        schema.insert("enum".to_owned(), json!([value]));
    }
    if let Some(Value::Array(examples)) = schema.remove("examples") {
        schema.extend(examples.into_iter().next().map(|example| ("example".to_owned(), example)));
    }
    for (exclusive, bound) in [("exclusiveMinimum", "minimum"), ("exclusiveMaximum", "maximum")] {
        if let Some(number) = schema.get(exclusive).filter(|value| value.is_number()).cloned() {
            schema.insert(bound.to_owned(), number);
            schema.insert(exclusive.to_owned(), true.into());
        }
    }
    // In 3.0 a reference may have no sibling keywords.
    if schema.len() > 1
        && let Some(reference) = schema.remove("$ref")
    {
        schema.insert("allOf".to_owned(), json!([{"$ref": reference}]));
    }
}
