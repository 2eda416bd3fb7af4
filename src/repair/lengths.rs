use super::{LengthUnit, Options, UnitSource};
use crate::format::ReadFile;
use crate::math::Box3;
use crate::scene::Unit;

/// Longest sides, in millimetres, of what people have printed. What was taken for millimetres and lies outside was most likely in metres
/// or inches, or in micrometres.
const USUAL_MM: [f64; 2] = [5.0, 2000.0];

/// What a file's lengths are in: what the request declares, else what the file says, else millimetres. Where another unit is asked for, the
/// file's lengths are brought into it. Answers whether that changed them.
pub(super) fn settle(file: &mut ReadFile, options: &Options) -> (LengthUnit, bool) {
    let said = file.scene.as_ref().and_then(|scene| scene.unit);
    let (own, source) = match (options.unit, said) {
        (Some(declared), _) => (declared, UnitSource::Declared),
        (None, Some(said)) => (said, UnitSource::File),
        (None, None) => (Unit::Millimetre, UnitSource::Assumed),
    };
    let used = options.scale_to.unwrap_or(own);
    let note = match (source, said) {
        (UnitSource::Assumed, _) => {
            let doubt = doubt(file);
            file.mesh.warnings.extend(doubt.clone());
            let assumed = "the file says no unit, so lengths were taken for millimetres; declare another with unit";
            Some(doubt.unwrap_or_else(|| assumed.to_owned()))
        }
        (UnitSource::Declared, Some(said)) if said != own => {
            Some(format!("the file says {said}, and the request declares {own}, which was taken"))
        }
        _ => None,
    };
    let up = file.scene.as_ref().and_then(|scene| scene.up);
    let scaled = used != own;
    if scaled {
        let factor = own.to(used);
        file.mesh.soup.positions.iter_mut().for_each(|p| *p *= factor);
        file.scene = file.scene.take().map(|scene| scene.scaled(factor));
    }
    if let Some(scene) = &mut file.scene {
        scene.unit = Some(used);
    }
    (LengthUnit { used, source, scaled_from: scaled.then_some(own), up, note }, scaled)
}

/// Why lengths are hardly in millimetres, if so.
fn doubt(file: &ReadFile) -> Option<String> {
    let finite = file.mesh.soup.positions.iter().copied().filter(|p| p.is_finite());
    let bounds = Box3::of(finite);
    let longest = (bounds.max - bounds.min).max_element();
    let likely = match longest {
        longest if !longest.is_finite() || longest <= 0.0 => return None,
        longest if longest < USUAL_MM[0] => "it is likely in inches, centimetres or metres",
        longest if longest > USUAL_MM[1] => "it is likely in micrometres, or very large",
        _ => return None,
    };
    Some(format!(
        "the file says no unit, and taken for millimetres the model is {longest:.3} mm long, so {likely}; declare its unit with unit"
    ))
}
