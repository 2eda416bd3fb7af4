use glam::{DAffine3, DMat3, DVec3};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::Scene;

/// Which axis points up, where a format says so: z in 3MF, y in glTF. Others leave it to whoever reads them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Up {
    /// The second axis.
    Y,
    /// The third axis.
    Z,
}

impl Up {
    /// A transform, and after it the quarter turn from these axes to `other`: (x, y, z) -> (x, -z, y) from y to z. Nothing is rounded.
    #[must_use]
    pub fn turned_to(self, other: Self, transform: DAffine3) -> DAffine3 {
        // A zero is to have no sign.
        let turn = |v: DVec3| match (self, other) {
            (Self::Y, Self::Z) => DVec3::new(v.x, -v.z, v.y) + DVec3::ZERO,
            (Self::Z, Self::Y) => DVec3::new(v.x, v.z, -v.y) + DVec3::ZERO,
            _ => v,
        };
        let DAffine3 { matrix3: m, translation } = transform;
        DAffine3 {
            matrix3: DMat3::from_cols(turn(m.x_axis), turn(m.y_axis), turn(m.z_axis)),
            translation: turn(translation),
        }
    }
}

impl Scene {
    /// Where an item stands when `up` points up; as it is where nothing says how it stands now.
    #[must_use]
    pub fn stood(&self, up: Up, transform: DAffine3) -> DAffine3 {
        self.up.map_or(transform, |own| own.turned_to(up, transform))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_turned_there_and_back_is_as_it_was() {
        let transform = DAffine3::from_cols_array(&[0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, -1.2]);
        assert_eq!(Up::Z.turned_to(Up::Y, Up::Y.turned_to(Up::Z, transform)), transform);
        assert_eq!(Up::Y.turned_to(Up::Z, DAffine3::IDENTITY).transform_point3(DVec3::Y), DVec3::Z);
        assert_eq!(Up::Z.turned_to(Up::Z, transform), transform);
    }

    #[test]
    fn what_does_not_say_how_it_stands_is_left_as_it_is() {
        let scene = Scene::default();
        assert_eq!(scene.stood(Up::Y, DAffine3::IDENTITY), DAffine3::IDENTITY);
        assert_ne!(Scene { up: Some(Up::Z), ..scene }.stood(Up::Y, DAffine3::IDENTITY), DAffine3::IDENTITY);
    }
}
