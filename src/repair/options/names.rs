use serde::Deserialize;

use crate::repair::Operator;

/// Names of operators: an array, or one string with commas, as a query says it.
pub(super) fn operators<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Vec<Operator>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Names {
        Many(Vec<String>),
        One(String),
    }
    let names = match Names::deserialize(from)? {
        Names::Many(names) => names,
        Names::One(names) => {
            names.split(',').map(|name| name.trim().to_owned()).filter(|name| !name.is_empty()).collect()
        }
    };
    let known = || Operator::ALL.iter().map(|o| o.as_str()).collect::<Vec<_>>().join(", ");
    let of = |name: &String| Operator::ALL.iter().copied().find(|o| o.as_str() == name);
    let find = |name| {
        of(name).ok_or_else(|| serde::de::Error::custom(format!("there is no operator '{name}'; they are {}", known())))
    };
    names.iter().map(find).collect()
}
