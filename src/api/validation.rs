//! Validates JSON against the schemas of the OpenAPI document, and reports an error for each invalid field. The document and the error
//! messages are generated from the same types, so they agree.

use std::sync::OnceLock;

use serde_json::{Map, Number, Value};
use utoipa::openapi::OpenApi;

use super::problem::FieldError;

/// Number of characters of an invalid value that a message quotes.
const QUOTED_CHARS: usize = 40;

/// The schemas of the OpenAPI document, by name.
static SCHEMAS: OnceLock<Map<String, Value>> = OnceLock::new();

/// Sets the schemas from the OpenAPI document, which is the same at each call. Until the first call, every value is valid.
pub(super) fn use_document(document: &OpenApi) {
    SCHEMAS.get_or_init(|| {
        let document = serde_json::to_value(document).unwrap_or_default();
        document.pointer("/components/schemas").and_then(Value::as_object).cloned().unwrap_or_default()
    });
}

fn named_schema(name: &str) -> Option<&'static Value> {
    SCHEMAS.get()?.get(name)
}

/// Returns the schema of a field of a named object, such as `max_tier` of `Options`.
pub(super) fn field_schema(object: &str, field: &str) -> Option<&'static Value> {
    fn find<'a>(schema: &'a Value, field: &str) -> Option<&'a Value> {
        let parts = || schema.get("allOf").and_then(Value::as_array).into_iter().flatten().map(resolve);
        schema
            .get("properties")
            .and_then(|fields| fields.get(field))
            .or_else(|| parts().find_map(|part| find(part, field)))
    }
    find(resolve(named_schema(object)?), field)
}

/// Validates an object against the schema `name`, and returns an error for each invalid field.
pub(super) fn object_errors(name: &str, object: &Map<String, Value>) -> Vec<FieldError> {
    let mut errors = Vec::new();
    if let Some(schema) = named_schema(name) {
        check_object("", resolve(schema), object, &mut errors);
    }
    errors
}

/// Validates the value of a field against a schema.
pub(super) fn value_errors(field: &str, schema: &Value, value: &Value) -> Vec<FieldError> {
    let mut errors = Vec::new();
    check(field, schema, value, &mut errors);
    errors
}

/// Creates the error for an unknown field. Suggests the most similar known name.
pub(super) fn unknown_field<'a>(field: &str, known: impl Iterator<Item = &'a str>, kind: &str) -> FieldError {
    let name = field.rsplit('.').next().unwrap_or(field);
    let similar = known
        .map(|candidate| (strsim::damerau_levenshtein(name, candidate), candidate))
        .filter(|&(distance, candidate)| distance <= 2 && distance < candidate.len())
        .min();
    let hint = similar.map_or_else(String::new, |(_, candidate)| format!(" Did you mean `{candidate}`?"));
    FieldError::new(field, format!("There is no {kind} `{}`.{hint}", truncated(field)))
}

/// Follows a schema's `$ref`, if it has one.
fn resolve(schema: &Value) -> &Value {
    let name = schema.get("$ref").and_then(Value::as_str).and_then(|path| path.rsplit('/').next());
    name.and_then(named_schema).unwrap_or(schema)
}

/// Validates a value, and appends its errors.
fn check(field: &str, schema: &Value, value: &Value, errors: &mut Vec<FieldError>) {
    let schema = resolve(schema);
    if let Some(variants) = union(schema) {
        check_union(field, &variants, value, errors);
        return;
    }
    if value.is_null() && types(schema).any(|kind| kind == "null") {
        return;
    }
    let has_type = match value {
        Value::Null => false,
        Value::Bool(_) => types(schema).any(|kind| kind == "boolean"),
        Value::Number(number) => types(schema).any(|kind| match kind {
            "integer" => is_whole(number),
            kind => kind == "number",
        }),
        Value::String(_) => types(schema).any(|kind| kind == "string"),
        Value::Array(_) => types(schema).any(|kind| kind == "array"),
        Value::Object(_) => types(schema).any(|kind| kind == "object"),
    };
    // A schema without a type accepts every type.
    let has_range_error = || value.as_f64().is_some_and(|number| !is_within(schema, number));
    let is_outside_enum = || {
        let values = schema.get("enum").and_then(Value::as_array);
        values.is_some_and(|values| !values.contains(value))
    };
    let is_wrong_type = !has_type && types(schema).next().is_some();
    if is_wrong_type || has_range_error() || is_outside_enum() || !has_valid_length(schema, value) {
        let message = format!("`{field}` must be {}; got {}.", expected(schema), quoted(value));
        errors.push(FieldError::new(field, message));
        return;
    }
    match value {
        Value::Array(items) => {
            for (number, item) in items.iter().enumerate() {
                if let Some(schema) = schema.get("items").filter(|items| items.is_object()) {
                    check(&format!("{field}[{number}]"), schema, item, errors);
                }
            }
        }
        Value::Object(object) => check_object(field, schema, object, errors),
        _ => {}
    }
}

/// Validates the fields of an object, and appends the errors of unknown, invalid and missing fields.
fn check_object(path: &str, schema: &Value, object: &Map<String, Value>, errors: &mut Vec<FieldError>) {
    let path_of = |name: &str| if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") };
    let properties = schema.get("properties").and_then(Value::as_object);
    let is_open = schema.get("additionalProperties").is_some_and(|more| more != &Value::Bool(false));
    for (name, value) in object {
        match (properties.and_then(|properties| properties.get(name)), schema.get("additionalProperties")) {
            (Some(schema), _) => check(&path_of(name), schema, value, errors),
            (None, Some(schema)) if schema.is_object() => check(&path_of(name), schema, value, errors),
            (None, _) if is_open => {}
            (None, _) => {
                let names = properties.into_iter().flat_map(Map::keys).map(String::as_str);
                errors.push(unknown_field(&path_of(name), names, "field"));
            }
        }
    }
    for name in schema.get("required").and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_str) {
        if !object.contains_key(name) {
            errors.push(FieldError::new(&path_of(name), format!("`{}` is missing.", path_of(name))));
        }
    }
}

/// Returns the variants of a union, or `None` for another schema.
fn union(schema: &Value) -> Option<Vec<&Value>> {
    let variants = schema.get("oneOf").or_else(|| schema.get("anyOf"))?.as_array()?;
    Some(variants.iter().map(resolve).collect())
}

/// Validates a value against the variants of a union that accept its JSON type.
fn check_union(field: &str, variants: &[&Value], value: &Value, errors: &mut Vec<FieldError>) {
    let candidates: Vec<_> = variants.iter().filter(|variant| accepts_type(variant, value)).collect();
    match (&candidates[..], value) {
        ([only], _) => check(field, only, value, errors),
        // Of several object variants, the errors of the closest one are reported. Tagged variants are left to the deserializer.
        ([_, ..], _) => {
            let attempts = candidates.iter().map(|variant| value_errors(field, variant, value));
            let fewest = attempts.min_by_key(Vec::len).unwrap_or_default();
            let is_tagged = candidates.iter().any(|variant| variant.get("allOf").is_some());
            errors.extend(fewest.into_iter().filter(|_| !is_tagged));
        }
        ([], _) => {
            let kinds: Vec<_> =
                variants.iter().map(|variant| expected(variant)).filter(|kind| kind != "null").collect();
            errors.push(FieldError::new(
                field,
                format!("`{field}` must be {}; got {}.", kinds.join(" or "), quoted(value)),
            ));
        }
    }
}

/// Whether a schema accepts the JSON type of this value, regardless of its content.
fn accepts_type(schema: &Value, value: &Value) -> bool {
    let kind = match value {
        Value::Null => "null",
        Value::Bool(_) => "boolean",
        Value::Number(_) => "number",
        Value::String(_) => "string",
        Value::Array(_) => "array",
        Value::Object(_) => "object",
    };
    if let Some(variants) = union(schema) {
        return variants.iter().any(|variant| accepts_type(variant, value));
    }
    let is_object = schema.get("allOf").is_some() && kind == "object";
    is_object || types(schema).any(|name| name == kind || (name == "integer" && kind == "number"))
}

/// Returns the JSON types that a schema lists.
fn types(schema: &Value) -> impl Iterator<Item = &str> {
    let (single, several) = match schema.get("type") {
        Some(Value::String(name)) => (Some(name.as_str()), None),
        Some(Value::Array(names)) => (None, Some(names)),
        _ => (None, None),
    };
    single.into_iter().chain(several.into_iter().flatten().filter_map(Value::as_str))
}

/// Whether a number is whole and within `int64`, the widest format in the document.
fn is_whole(number: &Number) -> bool {
    /// The smallest number above the range of `int64`.
    const BEYOND: f64 = (1_u64 << 63) as f64;
    let is_in_range = |number: f64| number.fract() == 0.0 && (-BEYOND..BEYOND).contains(&number);
    number.is_i64() || (!number.is_u64() && number.as_f64().is_some_and(is_in_range))
}

/// Whether a number lies within the schema's bounds.
fn is_within(schema: &Value, number: f64) -> bool {
    let bound = |name: &str| schema.get(name).and_then(Value::as_f64);
    bound("minimum").is_none_or(|min| number >= min)
        && bound("maximum").is_none_or(|max| number <= max)
        && bound("exclusiveMinimum").is_none_or(|min| number > min)
        && bound("exclusiveMaximum").is_none_or(|max| number < max)
}

/// Whether a text or list has a length that the schema allows.
fn has_valid_length(schema: &Value, value: &Value) -> bool {
    let bound = |name: &str| schema.get(name).and_then(Value::as_u64);
    let within = |length: usize, min: &str, max: &str| {
        let length = length as u64;
        bound(min).is_none_or(|min| length >= min) && bound(max).is_none_or(|max| length <= max)
    };
    match value {
        Value::String(text) => within(text.chars().count(), "minLength", "maxLength"),
        Value::Array(items) => within(items.len(), "minItems", "maxItems"),
        _ => true,
    }
}

/// Describes the values that a schema accepts.
fn expected(schema: &Value) -> String {
    if let Some(values) = schema.get("enum").and_then(Value::as_array) {
        let values: Vec<_> = values.iter().filter_map(Value::as_str).map(|value| format!("`{value}`")).collect();
        return match &values[..] {
            [only] => only.clone(),
            _ => format!("one of {}", values.join(", ")),
        };
    }
    let bound = |name: &str| schema.get(name).filter(|bound| bound.is_number());
    let range = match (bound("minimum"), bound("maximum"), bound("exclusiveMinimum")) {
        (Some(min), Some(max), _) => format!(" from {min} to {max}"),
        (Some(min), None, _) => format!(" of at least {min}"),
        (None, Some(max), Some(min)) => format!(" above {min} and up to {max}"),
        (None, None, Some(min)) => format!(" above {min}"),
        (None, Some(max), None) => format!(" of at most {max}"),
        (None, None, None) => String::new(),
    };
    let length = |min: &str, max: &str, unit: &str| match (schema.get(min), schema.get(max)) {
        (Some(min), Some(max)) if min == max => format!(" of {min} {unit}"),
        (Some(min), Some(max)) => format!(" of {min} to {max} {unit}"),
        (Some(min), None) => format!(" of at least {min} {unit}"),
        (None, Some(max)) => format!(" of at most {max} {unit}"),
        (None, None) => String::new(),
    };
    let kinds: Vec<_> = types(schema)
        .filter(|kind| *kind != "null")
        .map(|kind| match kind {
            "integer" => format!("a whole number{range}"),
            "number" => format!("a number{range}"),
            "string" => format!("text{}", length("minLength", "maxLength", "characters")),
            "boolean" => "true or false".to_owned(),
            "array" => format!("a list{}", length("minItems", "maxItems", "items")),
            "object" => match schema.get("required").and_then(Value::as_array).map(Vec::as_slice) {
                Some([Value::String(only)]) => format!("an object with `{only}`"),
                _ => "an object".to_owned(),
            },
            other => other.to_owned(),
        })
        .collect();
    if kinds.is_empty() { "null".to_owned() } else { kinds.join(" or ") }
}

/// Quotes an invalid value for a message.
fn quoted(value: &Value) -> String {
    match value {
        Value::Null => "null".to_owned(),
        Value::String(text) => format!("\"{}\" (text)", truncated(text)),
        Value::Array(items) => format!("a list of {} items", items.len()),
        Value::Object(_) => "an object".to_owned(),
        Value::Bool(_) | Value::Number(_) => value.to_string(),
    }
}

/// Returns at most [`QUOTED_CHARS`] characters of a text, with an ellipsis if characters are missing.
fn truncated(text: &str) -> String {
    match text.char_indices().nth(QUOTED_CHARS) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn option_messages(options: &Value) -> Vec<String> {
        use_document(&crate::api::document());
        let options = options.as_object().expect("an object").iter();
        let errors = options
            .flat_map(|(name, value)| value_errors(name, field_schema("Options", name).expect("an option"), value));
        errors.map(|error| error.message).collect()
    }

    #[test]
    fn a_message_names_the_option_its_valid_values_and_the_given_value() {
        for (options, message) in [
            (json!({"max_tier": "2"}), r#"`max_tier` must be a whole number from 1 to 3; got "2" (text)."#),
            (json!({"max_tier": 9}), "`max_tier` must be a whole number from 1 to 3; got 9."),
            (json!({"max_tier": 1.5}), "`max_tier` must be a whole number from 1 to 3; got 1.5."),
            (json!({"deadline_s": null}), "`deadline_s` must be a number from 1 to 3600; got null."),
            (json!({"pictures": 1}), "`pictures` must be true or false; got 1."),
            (
                json!({"require": "gold"}),
                r#"`require` must be one of `any`, `printable`, `print_ready`; got "gold" (text)."#,
            ),
            (json!({"with": "sew"}), r#"`with` must be a list; got "sew" (text)."#),
            (json!({"voxel_size": 0}), "`voxel_size` must be a number above 0; got 0."),
        ] {
            assert_eq!(option_messages(&options), [message]);
        }
        let unit = option_messages(&json!({"unit": "parsec"}));
        assert!(unit[0].starts_with("`unit` must be one of `um`, `mm`,"), "{unit:?}");
        let operators = option_messages(&json!({"with": ["sew", 5, "fly"]}));
        assert!(operators[0].starts_with("`with[1]` must be one of"), "{operators:?}");
        assert_eq!(operators.len(), 2);
    }

    #[test]
    fn values_that_the_document_allows_are_valid() {
        let options = json!({"max_tier": 2.0, "unit": null, "scale_to": "mm", "with": ["sew"], "max_faces": 400, "voxel_size": 0.5});
        assert_eq!(option_messages(&options), [""; 0]);
    }

    #[test]
    fn an_error_in_a_nested_field_is_named_by_its_path() {
        use_document(&crate::api::document());
        let schema = field_schema("AnalyzeOptions", "tolerances").expect("an option");
        let messages = |value: Value| {
            value_errors("tolerances", schema, &value).into_iter().map(|error| error.message).collect::<Vec<_>>()
        };
        assert_eq!(messages(json!({"slit": {"absolute": 0.1}})), [""; 0]);
        let wrong = messages(json!({"slit": {"absolute": "wide"}}));
        assert_eq!(wrong, [r#"`tolerances.slit.absolute` must be a number; got "wide" (text)."#]);
        assert_eq!(messages(json!({"slot": 1})), ["There is no field `tolerances.slot`. Did you mean `slit`?"]);
    }
}
