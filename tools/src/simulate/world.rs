//! Solids, the bodies that they make up, and joints between them.

use super::texture::{Texture, TextureClass};
use crate::truth::TrueForm;
use linkage_skill::Pose;
use linkage_skill::object::{JointGeometry, JointKind};
use nalgebra::{Point3, UnitVector3, Vector3};
use parry3d::math::Vector as PVector;
use parry3d::query::{Ray, RayCast, RayIntersection};
use parry3d::shape::{Capsule, Cuboid, Cylinder};
use std::sync::Arc;

/// Label of the person in label pictures.
pub const PERSON: u8 = 250;

/// What a solid is made of.
#[derive(Clone)]
pub struct Material {
    /// Its surface.
    pub texture: Arc<Texture>,
    /// Share of depth readings that get lost on it.
    pub depth_loss: f64,
}

/// Form of a solid, about its own centre.
#[derive(Clone)]
pub enum Form {
    /// A box.
    Box(Cuboid),
    /// A rounded rod along its own y.
    Rod(Capsule),
    /// A cylinder along its own y.
    Drum(Cylinder),
    /// Paper across its own z, printed from its middle.
    Plate(Cuboid),
}

impl Form {
    /// As `truth.json` tells it: the form, and half of its sides.
    pub fn truth(&self) -> (TrueForm, [f64; 3]) {
        match self {
            Self::Box(b) | Self::Plate(b) => {
                (TrueForm::Box, b.half_extents.to_array().map(f64::from))
            }
            Self::Rod(c) => (TrueForm::Rod, [c.radius, c.half_height(), c.radius].map(f64::from)),
            Self::Drum(c) => (TrueForm::Drum, [c.radius, c.half_height, c.radius].map(f64::from)),
        }
    }
}

/// A solid in the frame of its body.
#[derive(Clone)]
pub struct Solid {
    /// Form.
    pub form: Form,
    /// Where it is.
    pub body_from_solid: Pose,
    /// Material.
    pub material: Material,
    /// Label of its body.
    pub label: u8,
}

/// Where a ray meets a solid.
#[derive(Clone, Copy)]
pub struct Hit {
    /// Length of the ray.
    pub distance: f32,
    /// Normal in the solid's frame.
    pub normal: Vector3<f64>,
    /// Place in the solid's frame.
    pub point: Vector3<f64>,
}

impl Solid {
    /// A box from its centre and sides.
    pub fn cuboid(centre: [f64; 3], sides: [f64; 3], material: &Material, label: u8) -> Self {
        let half = sides.map(|s| 0.5 * s as f32);
        Self {
            form: Form::Box(Cuboid::new(PVector::new(half[0], half[1], half[2]))),
            body_from_solid: Pose::translation(centre[0], centre[1], centre[2]),
            material: material.clone(),
            label,
        }
    }

    /// A rounded rod between two places.
    pub fn rod(
        a: Point3<f64>,
        b: Point3<f64>,
        radius: f64,
        material: &Material,
        label: u8,
    ) -> Self {
        let axis = b - a;
        let half = (0.5 * axis.norm()).max(1e-4);
        let form = Form::Rod(Capsule::new_y(half as f32, radius as f32));
        Self { form, body_from_solid: along(a, b), material: material.clone(), label }
    }

    /// A cylinder between two places.
    pub fn drum(
        a: Point3<f64>,
        b: Point3<f64>,
        radius: f64,
        material: &Material,
        label: u8,
    ) -> Self {
        let half = (0.5 * (b - a).norm()).max(1e-4);
        let form = Form::Drum(Cylinder::new(half as f32, radius as f32));
        Self { form, body_from_solid: along(a, b), material: material.clone(), label }
    }

    /// Radius of a ball about its centre that holds it.
    pub fn bounding_radius(&self) -> f64 {
        f64::from(match &self.form {
            Form::Box(b) | Form::Plate(b) => b.half_extents.length(),
            Form::Rod(c) => c.half_height() + c.radius,
            Form::Drum(c) => c.half_height.hypot(c.radius),
        })
    }

    /// The same, moved.
    pub fn shifted(mut self, by: &Vector3<f64>) -> Self {
        self.body_from_solid.translation.vector += by;
        self
    }

    /// The same, stretched along the axes of its body about a place; negative: mirrored.
    pub fn reshaped(&self, about: &Point3<f64>, stretch: &Vector3<f64>) -> Self {
        let moved = |p: &Point3<f64>| about + (p - about).component_mul(stretch);
        let (label, material) = (self.label, &self.material);
        let ends = |half: f32| {
            let end = |side: f64| {
                moved(&(self.body_from_solid * Point3::new(0.0, side * f64::from(half), 0.0)))
            };
            (end(-1.0), end(1.0))
        };
        match &self.form {
            Form::Box(b) | Form::Plate(b) => {
                let half = [b.half_extents.x, b.half_extents.y, b.half_extents.z].map(f64::from);
                let centre = moved(&Point3::from(self.body_from_solid.translation.vector));
                let sides = [0, 1, 2].map(|k| 2.0 * half[k] * stretch[k].abs());
                Self::cuboid(centre.into(), sides, material, label)
            }
            Form::Rod(c) => {
                let (a, b) = ends(c.half_height());
                Self::rod(a, b, f64::from(c.radius), material, label)
            }
            Form::Drum(c) => {
                let (a, b) = ends(c.half_height);
                Self::drum(a, b, f64::from(c.radius) * stretch.z, material, label)
            }
        }
    }

    /// Corners of a box.
    pub fn corners(&self) -> Option<[Point3<f64>; 8]> {
        let (Form::Box(b) | Form::Plate(b)) = &self.form else { return None };
        let half = [b.half_extents.x, b.half_extents.y, b.half_extents.z].map(f64::from);
        Some(std::array::from_fn(|i| {
            let side = |k: usize| if i >> k & 1 == 1 { half[k] } else { -half[k] };
            Point3::new(side(0), side(1), side(2))
        }))
    }

    /// Where a ray of the solid's frame meets it, nearer than `limit`.
    pub fn cast(&self, origin: &Vector3<f64>, direction: &Vector3<f64>, limit: f32) -> Option<Hit> {
        if self.surely_missed(origin, direction) {
            return None;
        }
        let vector = |v: &Vector3<f64>| PVector::new(v.x as f32, v.y as f32, v.z as f32);
        let ray = Ray::new(vector(origin), vector(direction));
        let (distance, n) = match &self.form {
            Form::Box(b) | Form::Plate(b) => box_hit(&b.half_extents, &ray, limit),
            Form::Rod(c) => c.cast_local_ray_and_get_normal(&ray, limit, true).map(of_parry),
            Form::Drum(c) => c.cast_local_ray_and_get_normal(&ray, limit, true).map(of_parry),
        }?;
        Some(Hit {
            distance,
            normal: Vector3::new(f64::from(n.x), f64::from(n.y), f64::from(n.z)),
            point: origin + direction * f64::from(distance),
        })
    }

    /// A cheap test before the exact one: the ray's line passes the rod's own line at too
    /// great a distance.
    fn surely_missed(&self, origin: &Vector3<f64>, direction: &Vector3<f64>) -> bool {
        let Form::Rod(rod) = &self.form else { return false };
        let across = direction.cross(&Vector3::y());
        let length = across.norm();
        length > 1e-9 && (origin.dot(&across) / length).abs() > f64::from(rod.radius)
    }

    /// Surface coordinates in metres for the texture; each side of a box has its own place.
    pub fn surface_coordinates(&self, hit: &Hit) -> (f64, f64) {
        let p = hit.point;
        match self.form {
            Form::Box(_) => {
                let side = hit.normal.iamax();
                let shift = 0.37 * (2.0 * side as f64 + f64::from(hit.normal[side] > 0.0));
                match side {
                    0 => (p.y + shift, p.z),
                    1 => (p.x + shift, p.z),
                    _ => (p.x + shift, p.y),
                }
            }
            Form::Plate(_) => (p.x, p.y),
            Form::Drum(_) if hit.normal.y.abs() > 0.9 => (p.x + hit.normal.y, p.z),
            Form::Rod(_) | Form::Drum(_) => (0.06 * p.x.atan2(p.z), p.y),
        }
    }
}

fn of_parry(hit: RayIntersection) -> (f32, PVector) {
    (hit.time_of_impact, hit.normal)
}

/// Where a ray from outside enters a box, not beyond `limit`, and the normal there: what parry3d says, bit
/// for bit, without what only others need of it.
fn box_hit(half: &PVector, ray: &Ray, limit: f32) -> Option<(f32, PVector)> {
    let (half, origin, direction) = (half.to_array(), ray.origin.to_array(), ray.dir.to_array());
    let (mut enters, mut leaves) = (f32::MIN, limit);
    let (mut axis, mut side, mut is_edge) = (0, -1.0, false);
    for k in 0..3 {
        if direction[k] == 0.0 {
            if origin[k].abs() > half[k] {
                return None;
            }
            continue;
        }
        let inverse = 1.0 / direction[k];
        let (a, b) = ((-half[k] - origin[k]) * inverse, (half[k] - origin[k]) * inverse);
        let (near, far, its_side) = if a > b { (b, a, 1.0) } else { (a, b, -1.0) };
        if near > enters {
            (enters, axis, side, is_edge) = (near, k, its_side, false);
        } else if near == enters {
            is_edge = true;
        }
        leaves = leaves.min(far);
        if leaves < 0.0 || enters > leaves {
            return None;
        }
    }
    if enters < 0.0 {
        return None;
    }
    if is_edge {
        return Some((enters, -ray.dir.normalize()));
    }
    let mut normal = [0.0; 3];
    normal[axis] = side;
    Some((enters, PVector::from_array(normal)))
}

/// The pose of a rod along its own y between two places.
fn along(a: Point3<f64>, b: Point3<f64>) -> Pose {
    let axis = (b - a).try_normalize(1e-9).unwrap_or(Vector3::y());
    let rotation =
        nalgebra::UnitQuaternion::rotation_between(&Vector3::y(), &axis).unwrap_or_else(|| {
            nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
        });
    Pose::from_parts(nalgebra::center(&a, &b).coords.into(), rotation)
}

/// A rigid part of the object.
#[derive(Clone)]
pub struct Part {
    /// Name.
    pub name: String,
    /// Its solids, where they are at configuration 0.
    pub solids: Vec<Solid>,
}

impl Part {
    /// Mean of its solids' centres.
    pub fn centroid(&self) -> Point3<f64> {
        let sum: Vector3<f64> =
            self.solids.iter().map(|s| s.body_from_solid.translation.vector).sum();
        Point3::from(sum / self.solids.len().max(1) as f64)
    }
}

/// A joint, in the world at configuration 0.
#[derive(Clone)]
pub struct SceneJoint {
    /// Name.
    pub name: String,
    /// Kind.
    pub kind: JointKind,
    /// Index of the carrying part.
    pub parent: usize,
    /// Index of the moved part.
    pub child: usize,
    /// Direction.
    pub axis: Vector3<f64>,
    /// A point on it.
    pub origin: Point3<f64>,
    /// Metres a turn, for screws; else 0.
    pub pitch: f64,
    /// Where a hand takes hold of the moved part.
    pub grasp: Point3<f64>,
    /// Direction from the grasp to where the person stands.
    pub person: Vector3<f64>,
}

impl SceneJoint {
    /// Its line.
    pub fn geometry(&self) -> JointGeometry {
        JointGeometry {
            kind: self.kind,
            axis: UnitVector3::new_normalize(self.axis),
            origin: self.origin,
            pitch: self.pitch,
        }
    }
}

/// Someone moves a joint.
#[derive(Clone, Copy)]
pub struct Action {
    /// Index of the joint.
    pub joint: usize,
    /// Configuration at its end.
    pub to: f64,
    /// Seconds.
    pub start: f64,
    /// Seconds.
    pub end: f64,
}

/// A scene: an object in a room, and what is done to it.
#[derive(Clone)]
pub struct Scene {
    /// Name.
    pub name: String,
    /// Kind of thing.
    pub category: &'static str,
    /// Parts, the base first.
    pub parts: Vec<Part>,
    /// Joints, parents first.
    pub joints: Vec<SceneJoint>,
    /// What happens, in order.
    pub actions: Vec<Action>,
    /// Room and clutter.
    pub surroundings: Vec<Solid>,
    /// What the camera looks at.
    pub target: Point3<f64>,
    /// Azimuth and elevation of the camera, degrees, and its distance, metres.
    pub view: [f64; 3],
    /// The camera is held by hand.
    pub moving_camera: bool,
    /// Somebody else walks past at the side.
    pub passer_by: bool,
    /// How much there is to see on the thing where surfaces are those of a home; `None`: speckles everywhere.
    pub texture: Option<TextureClass>,
    /// Seconds.
    pub duration: f64,
}

impl Scene {
    /// Configurations of all joints at a time, minimum-jerk between the ends of actions.
    pub fn configurations(&self, t: f64, start: &[f64]) -> Vec<f64> {
        let mut q = start.to_vec();
        for a in &self.actions {
            if t <= a.start {
                continue;
            }
            let s = ((t - a.start) / (a.end - a.start)).min(1.0);
            let blend = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s);
            q[a.joint] += (a.to - q[a.joint]) * blend;
        }
        q
    }

    /// Pose of each part for given configurations.
    pub fn world_from_part(&self, q: &[f64]) -> Vec<Pose> {
        let mut poses = vec![Pose::identity(); self.parts.len()];
        for (joint, &q) in self.joints.iter().zip(q) {
            poses[joint.child] = poses[joint.parent] * joint.geometry().motion(q);
        }
        poses
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Whole steps, so that rays meet edges and run along sides too.
    fn step(size: f32) -> impl Strategy<Value = f32> {
        prop_oneof![-4.0..4.0_f32, (-4..=4).prop_map(|x| x as f32)].prop_map(move |x| x * size)
    }

    fn vector(size: f32) -> impl Strategy<Value = PVector> {
        (step(size), step(size), step(size)).prop_map(|(x, y, z)| PVector::new(x, y, z))
    }

    proptest! {
        #[test]
        fn a_box_is_met_where_parry3d_says(
            half in vector(0.25), origin in vector(1.0), to in vector(0.5), limit in 0.1..20.0_f32,
        ) {
            let half = half.abs();
            let ray = Ray::new(origin, to - origin);
            prop_assume!(ray.dir.length() > 0.0);
            let found = box_hit(&half, &ray, limit);
            let expected = Cuboid::new(half).cast_local_ray_and_get_normal(&ray, limit, true);
            // From inside parry3d tells distance 0: nothing is seen there.
            let expected = expected.map(of_parry).filter(|(distance, _)| *distance > 0.0);
            prop_assert_eq!(found.filter(|(distance, _)| *distance > 0.0), expected);
        }
    }
}
