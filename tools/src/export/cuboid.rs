//! Boxes, and the mass that they stand for.
//!
//! A link's shape is a set of boxes. Nobody weighed the object: its mass is the volume of its boxes at
//! the density of hollow furniture, or of wood where they are boards, and the moments of inertia follow
//! from it.

use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};

/// Kilograms a cubic metre: a guess. Furniture is mostly hollow.
pub const DENSITY_KG_PER_M3: f64 = 150.0;
/// The same of boards: a guess. They are solid wood, or sheet metal with air behind it.
pub const BOARD_KG_PER_M3: f64 = 600.0;
/// A box with a shorter side is a board, metres.
pub const BOARD_M: f64 = 0.03;
/// Least mass of a link, kilograms.
pub const LEAST_MASS_KG: f64 = 0.05;
/// Shortest side of a box, metres.
pub const LEAST_SIDE_M: f64 = 0.01;
/// Side of the box that stands for a part whose surface was not seen, metres.
pub const UNSEEN_SIDE_M: f64 = 0.04;
/// Share of the surface beyond either side of a box.
const STRAYS: f64 = 0.01;
/// Least number of places that a box is put around.
pub const LEAST_PLACES: usize = 10;

/// A box in some frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Cuboid {
    pub center: Point3<f64>,
    /// The frame's axes from the box's own.
    pub rotation: UnitQuaternion<f64>,
    /// Lengths of its sides, metres.
    pub size: Vector3<f64>,
}

/// Mass, its centre and its moments about that, in the axes of the frame of the boxes.
#[derive(Debug, Clone, PartialEq)]
pub struct Inertia {
    pub mass_kg: f64,
    pub center: Point3<f64>,
    /// Kilograms times square metres.
    pub moments: Matrix3<f64>,
}

impl Cuboid {
    /// Around a surface, its sides along the axes of `rotation`; `None` with too little of it.
    pub fn around(surface: &[Vector3<f64>], rotation: UnitQuaternion<f64>) -> Option<Self> {
        if surface.len() < LEAST_PLACES {
            return None;
        }
        let own: Vec<Vector3<f64>> = surface.iter().map(|p| rotation.inverse() * p).collect();
        let (mut low, mut high) = (Vector3::zeros(), Vector3::zeros());
        for k in 0..3 {
            let mut along: Vec<f64> = own.iter().map(|p| p[k]).collect();
            along.sort_by(f64::total_cmp);
            let strays = (STRAYS * along.len() as f64) as usize;
            (low[k], high[k]) = (along[strays], along[along.len() - 1 - strays]);
        }
        Some(Self::between(low, high, rotation))
    }

    /// Between two corners that are given in the box's own axes.
    pub fn between(low: Vector3<f64>, high: Vector3<f64>, rotation: UnitQuaternion<f64>) -> Self {
        Self {
            center: Point3::from(rotation * (0.5 * (low + high))),
            rotation,
            size: (high - low).map(|side| side.max(LEAST_SIDE_M)),
        }
    }

    /// What stands for a part whose surface was not seen.
    pub fn unseen(center: Point3<f64>, rotation: UnitQuaternion<f64>) -> Self {
        Self { center, rotation, size: Vector3::repeat(UNSEEN_SIDE_M) }
    }

    /// Its least and greatest corner in its own axes.
    pub fn corners_along_sides(&self) -> (Vector3<f64>, Vector3<f64>) {
        let center = self.rotation.inverse() * self.center.coords;
        (center - 0.5 * self.size, center + 0.5 * self.size)
    }

    /// The same box in a frame whose origin lies at `origin`.
    pub fn seen_from(&self, origin: &Point3<f64>) -> Self {
        Self { center: self.center - origin.coords, ..self.clone() }
    }

    /// Its eight corners.
    pub fn corners(&self) -> [Point3<f64>; 8] {
        std::array::from_fn(|i| {
            let sign = |bit: usize| if i >> bit & 1 == 0 { -0.5 } else { 0.5 };
            let offset = Vector3::new(sign(0), sign(1), sign(2)).component_mul(&self.size);
            self.center + self.rotation * offset
        })
    }

    pub fn volume(&self) -> f64 {
        self.size.product()
    }

    /// What it may weigh.
    fn mass_kg(&self) -> f64 {
        let density = if self.size.min() < BOARD_M { BOARD_KG_PER_M3 } else { DENSITY_KG_PER_M3 };
        density * self.volume()
    }

    /// Roll, pitch and yaw.
    pub fn rpy(&self) -> [f64; 3] {
        let (roll, pitch, yaw) = self.rotation.euler_angles();
        [roll, pitch, yaw]
    }
}

impl Inertia {
    /// Of boxes that do not overlap.
    pub fn of(boxes: &[Cuboid]) -> Self {
        let guessed: f64 = boxes.iter().map(Cuboid::mass_kg).sum();
        let mass_kg = guessed.max(LEAST_MASS_KG);
        let share = |b: &Cuboid| mass_kg * b.mass_kg() / guessed;
        let center: Vector3<f64> = boxes.iter().map(|b| b.center.coords * share(b) / mass_kg).sum();
        let moments = boxes.iter().map(|b| {
            let [x, y, z] = b.size.map(|side| side * side).into();
            let own = Matrix3::from_diagonal(&(Vector3::new(y + z, x + z, x + y) / 12.0));
            let turned = b.rotation.to_rotation_matrix();
            let arm = b.center.coords - center;
            let apart = Matrix3::identity() * arm.norm_squared() - arm * arm.transpose();
            (turned.matrix() * own * turned.matrix().transpose() + apart) * share(b)
        });
        Self { mass_kg, center: Point3::from(center), moments: moments.sum() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_halves_weigh_and_turn_like_the_whole() {
        let rotation = UnitQuaternion::from_euler_angles(0.3, -0.2, 0.5);
        let block = |low: [f64; 3], high: [f64; 3]| {
            Cuboid::between(Vector3::from(low), Vector3::from(high), rotation)
        };
        let whole = Inertia::of(&[block([0.0, 0.0, 0.0], [0.4, 0.3, 0.2])]);
        let halves =
            [block([0.0, 0.0, 0.0], [0.1, 0.3, 0.2]), block([0.1, 0.0, 0.0], [0.4, 0.3, 0.2])];
        let halves = Inertia::of(&halves);
        assert!((whole.mass_kg - 3.6).abs() < 1e-9 && (halves.mass_kg - 3.6).abs() < 1e-9);
        assert!((whole.center - halves.center).norm() < 1e-12);
        assert!((whole.moments - halves.moments).amax() < 1e-12, "{}", halves.moments);
    }

    #[test]
    fn a_board_is_solid_and_a_case_is_hollow() {
        let weighs = |size: [f64; 3]| {
            let shape = Cuboid::between(Vector3::zeros(), size.into(), UnitQuaternion::identity());
            Inertia::of(&[shape]).mass_kg
        };
        assert!((weighs([0.6, 0.8, 0.02]) - 5.76).abs() < 1e-9);
        assert!((weighs([0.6, 0.8, 0.4]) - 28.8).abs() < 1e-9);
    }

    #[test]
    fn the_box_is_the_surface_s_but_for_strays() {
        let door = (0..41).flat_map(|i| (0..81).map(move |k| (f64::from(i), f64::from(k))));
        let mut surface: Vec<Vector3<f64>> =
            door.map(|(i, k)| Vector3::new(0.01 * i, 0.01 * k, 0.0)).collect();
        surface.push(Vector3::new(5.0, 5.0, 5.0));
        let shape = Cuboid::around(&surface, UnitQuaternion::identity()).unwrap();
        let wanted = Vector3::new(0.4, 0.8, LEAST_SIDE_M);
        assert!((shape.size - wanted).amax() < 0.03, "{}", shape.size);
        assert!((shape.center - Point3::new(0.2, 0.4, 0.0)).norm() < 0.02);
    }
}
