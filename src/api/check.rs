//! Compares what a client sent with the schemas of the OpenAPI document, and says of every field what is wrong with it. The document and
//! the messages come from the same types, so they agree.

use std::sync::OnceLock;

use serde_json::{Map, Number, Value};
use utoipa::openapi::OpenApi;

use super::problem::FieldError;

/// Characters of a wrong value that a message repeats.
const SHOWN: usize = 40;

static SCHEMAS: OnceLock<Map<String, Value>> = OnceLock::new();

/// Takes the schemas of the OpenAPI document, which is the same at each call. Nothing is found wrong before the first.
pub(super) fn use_document(document: &OpenApi) {
    SCHEMAS.get_or_init(|| {
        let document = serde_json::to_value(document).unwrap_or_default();
        document.pointer("/components/schemas").and_then(Value::as_object).cloned().unwrap_or_default()
    });
}

fn named_schema(name: &str) -> Option<&'static Value> {
    SCHEMAS.get()?.get(name)
}

/// The schema of a field of an object, which the document names, such as `max_tier` of `Options`.
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

/// What is wrong with an object, field by field.
pub(super) fn object_errors(name: &str, object: &Map<String, Value>) -> Vec<FieldError> {
    let mut errors = Vec::new();
    if let Some(schema) = named_schema(name) {
        check_object("", resolve(schema), object, &mut errors);
    }
    errors
}

/// What is wrong with the value of a field, whose schema is given.
pub(super) fn value_errors(field: &str, schema: &Value, value: &Value) -> Vec<FieldError> {
    let mut errors = Vec::new();
    check(field, schema, value, &mut errors);
    errors
}

/// That there is no field of that name, and which one was probably meant.
pub(super) fn unknown_field<'a>(field: &str, known: impl Iterator<Item = &'a str>, kind: &str) -> FieldError {
    let name = field.rsplit('.').next().unwrap_or(field);
    let similar = known
        .map(|known| (strsim::damerau_levenshtein(name, known), known))
        .filter(|&(distance, known)| distance <= 2 && distance < known.len())
        .min();
    let hint = similar.map_or_else(String::new, |(_, known)| format!(" Did you mean `{known}`?"));
    FieldError::new(field, format!("There is no {kind} `{}`.{hint}", shown(field)))
}

/// The schema that a reference names, or the schema itself.
fn resolve(schema: &Value) -> &Value {
    let name = schema.get("$ref").and_then(Value::as_str).and_then(|path| path.rsplit('/').next());
    name.and_then(named_schema).unwrap_or(schema)
}

fn check(field: &str, schema: &Value, value: &Value, errors: &mut Vec<FieldError>) {
    let schema = resolve(schema);
    if let Some(variants) = union(schema) {
        check_union(field, &variants, value, errors);
        return;
    }
    if value.is_null() && types(schema).any(|kind| kind == "null") {
        return;
    }
    let fits = match value {
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
    // A schema without a type takes anything.
    let has_range_error = || value.as_f64().is_some_and(|number| !is_within(schema, number));
    let is_other = || {
        let values = schema.get("enum").and_then(Value::as_array);
        values.is_some_and(|values| !values.contains(value))
    };
    if (!fits && types(schema).next().is_some()) || has_range_error() || is_other() || !has_its_length(schema, value) {
        errors.push(FieldError::new(field, format!("`{field}` must be {}; got {}.", expected(schema), given(value))));
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

fn check_object(path: &str, schema: &Value, object: &Map<String, Value>, errors: &mut Vec<FieldError>) {
    let named = |name: &str| if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") };
    let known = schema.get("properties").and_then(Value::as_object);
    let is_open = schema.get("additionalProperties").is_some_and(|more| more != &Value::Bool(false));
    for (name, value) in object {
        match (known.and_then(|known| known.get(name)), schema.get("additionalProperties")) {
            (Some(schema), _) => check(&named(name), schema, value, errors),
            (None, Some(schema)) if schema.is_object() => check(&named(name), schema, value, errors),
            (None, _) if is_open => {}
            (None, _) => {
                let names = known.into_iter().flat_map(Map::keys).map(String::as_str);
                errors.push(unknown_field(&named(name), names, "field"));
            }
        }
    }
    for name in schema.get("required").and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_str) {
        if !object.contains_key(name) {
            errors.push(FieldError::new(&named(name), format!("`{}` is missing.", named(name))));
        }
    }
}

/// The variants of a union; none for other schemas.
fn union(schema: &Value) -> Option<Vec<&Value>> {
    let variants = schema.get("oneOf").or_else(|| schema.get("anyOf"))?.as_array()?;
    Some(variants.iter().map(resolve).collect())
}

fn check_union(field: &str, variants: &[&Value], value: &Value, errors: &mut Vec<FieldError>) {
    let of_kind: Vec<_> = variants.iter().filter(|variant| takes_kind(variant, value)).collect();
    match (&of_kind[..], value) {
        ([only], _) => check(field, only, value, errors),
        // The reader of the object tells its variants apart.
        ([_, ..], _) => {
            let tried = of_kind.iter().map(|variant| value_errors(field, variant, value));
            let fewest = tried.min_by_key(Vec::len).unwrap_or_default();
            let is_tagged = of_kind.iter().any(|variant| variant.get("allOf").is_some());
            errors.extend(fewest.into_iter().filter(|_| !is_tagged));
        }
        ([], _) => {
            let kinds: Vec<_> =
                variants.iter().map(|variant| expected(variant)).filter(|kind| kind != "null").collect();
            errors.push(FieldError::new(
                field,
                format!("`{field}` must be {}; got {}.", kinds.join(" or "), given(value)),
            ));
        }
    }
}

/// Whether a schema takes values of this kind, whatever their content.
fn takes_kind(schema: &Value, value: &Value) -> bool {
    let kind = match value {
        Value::Null => "null",
        Value::Bool(_) => "boolean",
        Value::Number(_) => "number",
        Value::String(_) => "string",
        Value::Array(_) => "array",
        Value::Object(_) => "object",
    };
    if let Some(variants) = union(schema) {
        return variants.iter().any(|variant| takes_kind(variant, value));
    }
    let is_object = schema.get("allOf").is_some() && kind == "object";
    is_object || types(schema).any(|it| it == kind || (it == "integer" && kind == "number"))
}

fn types(schema: &Value) -> impl Iterator<Item = &str> {
    let (one, many) = match schema.get("type") {
        Some(Value::String(one)) => (Some(one.as_str()), None),
        Some(Value::Array(many)) => (None, Some(many)),
        _ => (None, None),
    };
    one.into_iter().chain(many.into_iter().flatten().filter_map(Value::as_str))
}

/// Whether a number is whole and of the format `int64`, the widest of the document.
fn is_whole(number: &Number) -> bool {
    /// The first number beyond the format.
    const BEYOND: f64 = (1_u64 << 63) as f64;
    let is_small = |number: f64| number.fract() == 0.0 && (-BEYOND..BEYOND).contains(&number);
    number.is_i64() || (!number.is_u64() && number.as_f64().is_some_and(is_small))
}

fn is_within(schema: &Value, number: f64) -> bool {
    let bound = |name: &str| schema.get(name).and_then(Value::as_f64);
    bound("minimum").is_none_or(|least| number >= least)
        && bound("maximum").is_none_or(|most| number <= most)
        && bound("exclusiveMinimum").is_none_or(|least| number > least)
        && bound("exclusiveMaximum").is_none_or(|most| number < most)
}

fn has_its_length(schema: &Value, value: &Value) -> bool {
    let bound = |name: &str| schema.get(name).and_then(Value::as_u64);
    let within = |length: usize, least: &str, most: &str| {
        let length = length as u64;
        bound(least).is_none_or(|least| length >= least) && bound(most).is_none_or(|most| length <= most)
    };
    match value {
        Value::String(text) => within(text.chars().count(), "minLength", "maxLength"),
        Value::Array(items) => within(items.len(), "minItems", "maxItems"),
        _ => true,
    }
}

/// What a schema asks for, in words.
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
        (Some(least), Some(most), _) => format!(" from {least} to {most}"),
        (Some(least), None, _) => format!(" of at least {least}"),
        (None, Some(most), Some(least)) => format!(" above {least} and up to {most}"),
        (None, None, Some(least)) => format!(" above {least}"),
        (None, Some(most), None) => format!(" of at most {most}"),
        (None, None, None) => String::new(),
    };
    let length = |least: &str, most: &str, of: &str| match (schema.get(least), schema.get(most)) {
        (Some(least), Some(most)) if least == most => format!(" of {least} {of}"),
        (Some(least), Some(most)) => format!(" of {least} to {most} {of}"),
        (Some(least), None) => format!(" of at least {least} {of}"),
        (None, Some(most)) => format!(" of at most {most} {of}"),
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

/// A wrong value as a message repeats it.
fn given(value: &Value) -> String {
    match value {
        Value::Null => "null".to_owned(),
        Value::String(text) => format!("\"{}\" (text)", shown(text)),
        Value::Array(items) => format!("a list of {} items", items.len()),
        Value::Object(_) => "an object".to_owned(),
        Value::Bool(_) | Value::Number(_) => value.to_string(),
    }
}

fn shown(text: &str) -> String {
    match text.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn of_options(options: &Value) -> Vec<String> {
        use_document(&crate::api::document());
        let options = options.as_object().expect("an object").iter();
        let errors = options
            .flat_map(|(name, value)| value_errors(name, field_schema("Options", name).expect("an option"), value));
        errors.map(|error| error.message).collect()
    }

    #[test]
    fn a_message_says_what_an_option_must_be_and_what_it_was() {
        for (options, message) in [
            (json!({"max_tier": "2"}), r#"`max_tier` must be a whole number from 1 to 3; got "2" (text)."#),
            (json!({"max_tier": 9}), "`max_tier` must be a whole number from 1 to 3; got 9."),
            (json!({"max_tier": 1.5}), "`max_tier` must be a whole number from 1 to 3; got 1.5."),
            (json!({"deadline_s": null}), "`deadline_s` must be a number from 1 to 3600; got null."),
            (json!({"pictures": 1}), "`pictures` must be true or false; got 1."),
            (json!({"require": "gold"}), r#"`require` must be one of `any`, `printable`; got "gold" (text)."#),
            (json!({"with": "sew"}), r#"`with` must be a list; got "sew" (text)."#),
            (json!({"voxel_size": 0}), "`voxel_size` must be a number above 0; got 0."),
        ] {
            assert_eq!(of_options(&options), [message]);
        }
        let unit = of_options(&json!({"unit": "parsec"}));
        assert!(unit[0].starts_with("`unit` must be one of `um`, `mm`,"), "{unit:?}");
        let operators = of_options(&json!({"with": ["sew", 5, "fly"]}));
        assert!(operators[0].starts_with("`with[1]` must be one of"), "{operators:?}");
        assert_eq!(operators.len(), 2);
    }

    #[test]
    fn what_the_document_allows_is_taken() {
        let options = json!({"max_tier": 2.0, "unit": null, "scale_to": "mm", "with": ["sew"], "max_faces": 400, "voxel_size": 0.5});
        assert_eq!(of_options(&options), [""; 0]);
    }

    #[test]
    fn errors_within_an_object_are_named_by_their_path() {
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
