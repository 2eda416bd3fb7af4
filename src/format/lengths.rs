use glam::DAffine3;

use super::{ReadFile, ReadMesh};
use crate::math::Box3;
use crate::mesh::Soup;
use crate::scene::{LengthUnit, Unit, UnitSource, Up};

/// Longest sides, in millimetres, of what people have printed. What was taken for millimetres and lies outside was most likely in metres
/// or inches, or in micrometres.
const USUAL_MM: [f64; 2] = [5.0, 2000.0];

impl ReadFile {
    /// Settles what the file's lengths are in: what is declared, else what the file says, else millimetres. Where another unit is asked for
    /// by `scale_to`, they are brought into it.
    pub fn settle_unit(&mut self, declared: Option<Unit>, scale_to: Option<Unit>) -> LengthUnit {
        let said = self.scene.as_ref().and_then(|scene| scene.unit);
        let (own, source) = match (declared, said) {
            (Some(declared), _) => (declared, UnitSource::Declared),
            (None, Some(said)) => (said, UnitSource::File),
            (None, None) => (Unit::Millimetre, UnitSource::Assumed),
        };
        let used = scale_to.unwrap_or(own);
        let note = match (source, said) {
            (UnitSource::Assumed, _) => {
                let doubt = doubt(&self.mesh.soup);
                self.mesh.warnings.extend(doubt.clone());
                let assumed = "the file says no unit, so lengths were taken for millimetres; declare another with unit";
                Some(doubt.unwrap_or_else(|| assumed.to_owned()))
            }
            (UnitSource::Declared, Some(said)) if said != own => {
                Some(format!("the file says {said}, and the request declares {own}, which was taken"))
            }
            _ => None,
        };
        let up = self.scene.as_ref().and_then(|scene| scene.up);
        let scaled = used != own;
        if scaled {
            let factor = own.to(used);
            self.mesh.soup.positions.iter_mut().for_each(|p| *p *= factor);
            self.scene = self.scene.take().map(|scene| scene.scaled(factor));
        }
        if let Some(scene) = &mut self.scene {
            scene.unit = Some(used);
        }
        self.unit.insert(LengthUnit { used, source, scaled_from: scaled.then_some(own), up, note }).clone()
    }

    /// All its triangles with lengths in another unit and with another axis up, without the file's normals; as they are where the file
    /// says neither.
    #[must_use]
    pub fn mesh_in(self, unit: Unit, up: Option<Up>) -> ReadMesh {
        let mut mesh = ReadMesh { normals: None, ..self.mesh };
        if let Some(scene) = self.scene {
            let factor = scene.unit.map_or(1.0, |own| own.to(unit));
            let turn = up.map_or(DAffine3::IDENTITY, |up| scene.stood(up, DAffine3::IDENTITY));
            if factor != 1.0 || turn != DAffine3::IDENTITY {
                mesh.soup.positions.iter_mut().for_each(|p| *p = turn.transform_point3(*p * factor));
            }
        }
        mesh
    }
}

/// Why lengths are hardly in millimetres, if so.
fn doubt(soup: &Soup) -> Option<String> {
    let finite = soup.positions.iter().copied().filter(|p| p.is_finite());
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
