use clap::Args;
use meshmend::inspect::{InspectOptions, Tolerances};
use meshmend::scene::Unit;
use serde_json::{Map, Value, json};

/// What is known of the model and the printer, and how closely things must agree.
#[derive(Debug, Args)]
pub struct MeasureArgs {
    /// The model's unit. Without it: mm.
    #[arg(long, env = "MESHMEND_UNIT", value_enum)]
    unit: Option<Unit>,
    /// The direction in which the model is built, of any length.
    #[arg(long, env = "MESHMEND_UP", value_name = "X,Y,Z", value_parser = three_numbers, default_value = "0,0,1", allow_hyphen_values = true)]
    up: [f64; 3],
    /// An angle from the vertical for which the area of overhangs is told, beside 30, 45 and 60 degrees.
    #[arg(long, env = "MESHMEND_OVERHANG", value_name = "DEGREES", default_value_t = InspectOptions::default().overhang_deg, allow_negative_numbers = true)]
    overhang: f64,
    /// Sides of the printer's build volume, in mm: tell whether the model fits.
    #[arg(long, env = "MESHMEND_BUILD_VOLUME", value_name = "X,Y,Z", value_parser = three_numbers, allow_hyphen_values = true)]
    build_volume: Option<[f64; 3]>,
    /// What is so small that it counts as nothing: a length in the model's unit, or with % a share of the diagonal of its
    /// box; 0 finds only what is exactly so. Several are parted by commas, or by giving the flag again: `0.01,slit=0.1%`.
    /// The names are linear (what is meant without a name), foldover_height, degenerate, slit, t_junction, sheet, which
    /// are as linear where they are not given; crack, tiny_part; and foldover_angle, in radians.
    #[arg(long, env = "MESHMEND_TOLERANCE", value_name = "[NAME=]VALUE", value_parser = tolerance, value_delimiter = ',', allow_negative_numbers = true)]
    tolerance: Vec<Named>,
}

impl MeasureArgs {
    /// The options, checked.
    ///
    /// # Errors
    /// What is wrong with the first that can't be used, and what is wanted.
    pub fn options(&self) -> Result<InspectOptions, String> {
        let options = InspectOptions {
            tolerances: tolerances(&self.tolerance)?,
            unit: self.unit,
            up: self.up,
            overhang_deg: self.overhang,
            build_volume: self.build_volume,
            ..InspectOptions::default()
        };
        options.validate().map_err(|error| error.to_string())?;
        Ok(options)
    }
}

/// A tolerance as it was given: its name, and its value in the form that [`Tolerances`] has in JSON.
#[derive(Debug, Clone, PartialEq)]
struct Named {
    name: String,
    value: Value,
}

fn tolerance(text: &str) -> Result<Named, String> {
    let (name, value) = text.split_once('=').unwrap_or(("linear", text));
    let name = name.trim().replace('-', "_");
    let value = value.trim();
    let (number, share) = value.strip_suffix('%').map_or((value, false), |number| (number.trim_end(), true));
    let number = number.parse().ok().filter(|number: &f64| number.is_finite());
    let value = match (number, name.as_str(), share) {
        (Some(radians), "foldover_angle", false) => json!(radians),
        (_, "foldover_angle", _) => return Err("an angle in radians is wanted, such as foldover_angle=0.01".to_owned()),
        (Some(percent), _, true) => json!({ "of_diagonal": percent / 100.0 }),
        (Some(length), _, false) => json!({ "absolute": length }),
        (None, ..) => {
            return Err("a length in the model's unit or a share of its diagonal is wanted, such as 0.01, 0.001% or \
                        slit=0.01"
                .to_owned());
        }
    };
    Ok(Named { name, value })
}

fn tolerances(given: &[Named]) -> Result<Tolerances, String> {
    let fields: Map<String, Value> = given.iter().map(|it| (it.name.clone(), it.value.clone())).collect();
    serde_json::from_value(Value::Object(fields)).map_err(|error| format!("--tolerance: {error}"))
}

fn three_numbers(text: &str) -> Result<[f64; 3], String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|word| word.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, z]) => Ok([x, y, z]),
        _ => Err("three numbers are wanted, such as 0,0,1".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use meshmend::inspect::Tolerance;

    use super::*;

    #[test]
    fn tolerances_are_lengths_or_shares_of_the_diagonal_and_the_last_of_a_name_holds() {
        let read = |texts: &[&str]| {
            let given: Result<Vec<Named>, String> = texts.iter().map(|text| tolerance(text)).collect();
            given.and_then(|given| tolerances(&given))
        };
        assert_eq!(read(&[]), Ok(Tolerances::default()));
        let some = Tolerances {
            linear: Tolerance::Absolute(0.25),
            slit: Some(Tolerance::OfDiagonal(0.005)),
            t_junction: Some(Tolerance::Absolute(3.0)),
            foldover_angle: 0.05,
            ..Tolerances::default()
        };
        assert_eq!(read(&["9", "0.25", "slit = 0.5 %", "t-junction=3", "foldover_angle=0.05"]), Ok(some));
        for (wrong, said) in [
            ("slits=1", "expected one of"),
            ("slit=", "such as 0.01"),
            ("nan", "such as 0.01"),
            ("1e999", "such as 0.01"),
            ("foldover_angle=1%", "in radians"),
        ] {
            let error = read(&[wrong]).err().unwrap_or_default();
            assert!(error.contains(said), "{wrong}: {error}");
        }
    }
}
