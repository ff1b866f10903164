//! One take of a scene: what is where at any time, and the truth about it.
//!
//! In: a scene (world frame, metres), how it is filmed, a seed. Out: at a time the pose of the camera,
//! the solids with their poses, the person; and the truth of a whole recording, in the camera frame.

use super::kit::{GREY, Look, Palette};
use super::person::Person;
use super::render::Light;
use super::texture::{Richness, TextureClass};
use super::world::{Scene, Solid};
use crate::truth::{TrueJoint, TruePart, TrueSolid, Truth};
use linkage_driver::PinholeCamera;
use linkage_skill::{Pose, pose_to_array};
use nalgebra::{Point3, Rotation3, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::ops::Range;

/// Frames a second.
pub const RATE: f64 = 15.0;
/// Time stamp of the first frame, seconds.
pub const START: f64 = 1_400_000_000.0;

/// How a scene is filmed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Take {
    /// A person demonstrates.
    Demonstration,
    /// Nobody is there: one second, another viewpoint, another configuration.
    Encounter,
    /// Nobody is there: one frame from a chosen viewpoint, in a chosen configuration.
    Still(Shot),
}

/// Viewpoint, as it differs from the demonstration's, and state of a still.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shot {
    /// Turn about the vertical through what is looked at, degrees.
    pub turn_deg: f64,
    /// Turn upwards about what is looked at, degrees.
    pub lift_deg: f64,
    /// Turn about the line of sight, degrees.
    pub roll_deg: f64,
    /// Factor on the distance.
    pub distance: f64,
    /// Factor on the light.
    pub light: f64,
    /// Share of what the demonstration showed that each joint is open.
    pub open: f64,
    /// Something stands between.
    pub occluded: bool,
}

impl Take {
    /// Frames of a scene's take.
    pub fn frames(self, scene: &Scene) -> usize {
        match self {
            Self::Demonstration => (scene.duration * RATE) as usize,
            Self::Encounter => RATE as usize,
            Self::Still(_) => 1,
        }
    }
}

/// One take of a scene, ready to be rendered at any time.
pub struct Film<'s> {
    /// The scene.
    pub scene: &'s Scene,
    take: Take,
    /// The camera.
    pub camera: PinholeCamera,
    /// Configurations at the beginning.
    start: Vec<f64>,
    person: Person,
    /// The light.
    pub light: Light,
    /// Azimuth and elevation of the camera, degrees, and its distance, metres.
    eye: [f64; 3],
    /// Turn of the camera about its line of sight, radians.
    roll: f64,
    /// Phases of the sway of a hand that holds the camera, radians.
    sway: [f64; 6],
    occluder: Option<Solid>,
}

/// The configuration farthest from 0 that a demonstration shows of a joint.
fn farthest(scene: &Scene, joint: &str) -> f64 {
    scene
        .actions
        .iter()
        .filter(|a| scene.joints[a.joint].name == joint)
        .map(|a| a.to)
        .fold(0.0, |far: f64, to| if to.abs() > far.abs() { to } else { far })
}

impl<'s> Film<'s> {
    /// A take of a scene, with viewpoint, light and person drawn from a seed.
    pub fn new(scene: &'s Scene, take: Take, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0xf11a);
        let mut start = vec![0.0; scene.joints.len()];
        let [mut azimuth, mut elevation, mut distance] = scene.view;
        azimuth += rng.random_range(-4.0..4.0);
        elevation += rng.random_range(-2.0..2.0);
        let mut gain = 1.0;
        let mut roll = 0.0;
        // Within what the demonstration showed.
        let ends: Vec<f64> = scene.joints.iter().map(|j| farthest(scene, &j.name)).collect();
        match take {
            Take::Demonstration => {}
            Take::Encounter => {
                let side = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
                azimuth += side * rng.random_range(20.0..32.0);
                elevation += rng.random_range(0.0..8.0);
                distance *= rng.random_range(0.95..1.1);
                for (q, end) in start.iter_mut().zip(&ends) {
                    *q = end * rng.random_range(0.2..0.8);
                }
            }
            Take::Still(shot) => {
                azimuth += shot.turn_deg;
                elevation += shot.lift_deg;
                distance *= shot.distance;
                roll = shot.roll_deg.to_radians();
                gain = shot.light;
                start = ends.iter().map(|end| end * shot.open).collect();
            }
        }
        let mut film = Self {
            scene,
            take,
            camera: PinholeCamera::kinect(),
            start,
            person: if scene.texture.is_some() { Person::at_home(seed) } else { Person::new(seed) },
            light: Light {
                lamp: Point3::new(rng.random_range(-1.5..1.5), rng.random_range(-2.5..-1.0), 2.6),
                ambient: rng.random_range(0.40..0.55),
                gain: gain * rng.random_range(0.95..1.15),
            },
            eye: [azimuth, elevation, distance],
            roll,
            sway: std::array::from_fn(|_| rng.random_range(0.0..std::f64::consts::TAU)),
            occluder: None,
        };
        if matches!(take, Take::Still(shot) if shot.occluded) {
            film.occluder = Some(film.post());
        }
        film
    }

    /// A post before a side of what is looked at.
    fn post(&self) -> Solid {
        let eye = self.camera_from_world(0.0).inverse() * Point3::origin();
        let aside = (self.scene.target - eye).cross(&Vector3::z()).normalize();
        let foot = nalgebra::center(&eye, &self.scene.target) + 0.06 * aside;
        let paint = Palette::new(Look { name: "post", richness: Richness::Medium }).paint(GREY);
        let low = Point3::new(foot.x, foot.y, 0.0);
        Solid::rod(low, low + 2.5 * Vector3::z(), 0.04, &paint, 0)
    }

    /// Pose of the camera at a time.
    pub fn camera_from_world(&self, t: f64) -> Pose {
        let [azimuth, elevation, distance] = self.eye;
        let (a, e) = (azimuth.to_radians(), elevation.to_radians());
        let back = Vector3::new(a.sin() * e.cos(), -a.cos() * e.cos(), e.sin());
        let mut eye = self.scene.target + back * distance;
        let mut target = self.scene.target;
        if self.is_camera_moving() {
            let wave = |k: usize, hz: f64| {
                (std::f64::consts::TAU * hz * t + self.sway[k]).sin() - self.sway[k].sin()
            };
            eye += Vector3::new(0.05 * wave(0, 0.13), 0.03 * wave(1, 0.17), 0.04 * wave(2, 0.11));
            target += Vector3::new(0.02 * wave(3, 0.19), 0.0, 0.02 * wave(4, 0.23));
        }
        let forward = (target - eye).normalize();
        let level = forward.cross(&Vector3::z()).normalize();
        let right = Rotation3::from_scaled_axis(forward * self.roll) * level;
        let down = forward.cross(&right);
        let rotation = Rotation3::from_basis_unchecked(&[right, down, forward]);
        Pose::from_parts(eye.coords.into(), UnitQuaternion::from_rotation_matrix(&rotation))
            .inverse()
    }

    /// Configurations of all joints at a time.
    pub fn configurations(&self, t: f64) -> Vec<f64> {
        match self.take {
            Take::Demonstration => self.scene.configurations(t, &self.start),
            Take::Encounter | Take::Still(_) => self.start.clone(),
        }
    }

    /// All solids at a time with the poses of their bodies.
    pub fn solids_at<'a>(&'a self, t: f64, person: &'a [Solid]) -> Vec<(&'a Solid, Pose)> {
        let poses = self.scene.world_from_part(&self.configurations(t));
        let object = self
            .scene
            .parts
            .iter()
            .zip(poses)
            .flat_map(|(part, pose)| part.solids.iter().map(move |s| (s, pose)));
        let still = self.scene.surroundings.iter().chain(&self.occluder).chain(person);
        object.chain(still.map(|s| (s, Pose::identity()))).collect()
    }

    /// Numbers of those of [`Self::solids_at`] that stay where they are before a camera that does too; none where
    /// the camera moves.
    pub fn still(&self) -> Range<usize> {
        let of_object: usize = self.scene.parts.iter().map(|part| part.solids.len()).sum();
        let around = self.scene.surroundings.len() + usize::from(self.occluder.is_some());
        if self.is_camera_moving() { 0..0 } else { of_object..of_object + around }
    }

    fn is_camera_moving(&self) -> bool {
        self.scene.moving_camera && self.take == Take::Demonstration
    }

    /// The person at a time; nobody in an encounter.
    pub fn person_at(&self, t: f64) -> Vec<Solid> {
        match self.take {
            Take::Demonstration => self.person.solids(self.scene, t, &self.start),
            Take::Encounter | Take::Still(_) => Vec::new(),
        }
    }

    /// The truth about the first frames, as it lies beside a recording.
    pub fn truth(&self, frames: usize) -> Truth {
        let times: Vec<f64> = (0..frames).map(|i| i as f64 / RATE).collect();
        let last = times.last().copied().unwrap_or(0.0);
        let configurations: Vec<Vec<f64>> = times.iter().map(|&t| self.configurations(t)).collect();
        let parts = self
            .scene
            .parts
            .iter()
            .enumerate()
            .map(|(i, part)| TruePart {
                name: part.name.clone(),
                label: i as u8 + 1,
                centroid: part.centroid().into(),
                camera_from_part: times
                    .iter()
                    .zip(&configurations)
                    .map(|(&t, q)| {
                        pose_to_array(
                            &(self.camera_from_world(t) * self.scene.world_from_part(q)[i]),
                        )
                    })
                    .collect(),
            })
            .collect();
        let joints = (0..self.scene.joints.len())
            .map(|j| self.true_joint(j, last, &configurations))
            .filter(|j| j.moved || self.take != Take::Demonstration)
            .collect();
        Truth {
            object: self.scene.name.clone(),
            category: self.scene.category.to_owned(),
            texture: self.scene.texture.map_or("rich", TextureClass::name).to_owned(),
            hand: self.take == Take::Demonstration,
            moving_camera: self.scene.moving_camera,
            encounter: self.take != Take::Demonstration,
            unknown: false,
            frames: times.iter().map(|t| START + t).collect(),
            world_from_camera: times
                .iter()
                .map(|&t| pose_to_array(&self.camera_from_world(t).inverse()))
                .collect(),
            parts,
            joints,
            solids: self.true_solids(),
        }
    }

    /// All solids in the first frame, except for the person.
    fn true_solids(&self) -> Vec<TrueSolid> {
        let camera_from_world = self.camera_from_world(0.0);
        let solids = self.solids_at(0.0, &[]);
        let in_camera = solids.into_iter().map(|(solid, world_from_body)| {
            let (form, half_m) = solid.form.truth();
            let pose = camera_from_world * world_from_body * solid.body_from_solid;
            TrueSolid { form, half_m, camera_from_solid: pose_to_array(&pose) }
        });
        in_camera.collect()
    }

    /// The truth about one joint over all frames.
    fn true_joint(&self, index: usize, last: f64, configurations: &[Vec<f64>]) -> TrueJoint {
        let joint = &self.scene.joints[index];
        let line_at = |t: f64, q: &[f64]| {
            let parent = self.scene.world_from_part(q)[joint.parent];
            joint.geometry().transformed(&(self.camera_from_world(t) * parent))
        };
        let first_line = line_at(0.0, &configurations[0]);
        let last_line = line_at(last, &configurations[configurations.len() - 1]);
        let configuration: Vec<f64> = configurations.iter().map(|q| q[index]).collect();
        let low = configuration.iter().copied().fold(f64::INFINITY, f64::min);
        let high = configuration.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        TrueJoint {
            name: joint.name.clone(),
            kind: joint.kind,
            parent: self.scene.parts[joint.parent].name.clone(),
            child: self.scene.parts[joint.child].name.clone(),
            axis: first_line.axis.into_inner().into(),
            origin: first_line.origin.into(),
            axis_last: last_line.axis.into_inner().into(),
            origin_last: last_line.origin.into(),
            pitch: first_line.pitch,
            configuration,
            range_observed: [low, high],
            moved: high - low > 1e-6,
            grasp: Some(
                (self.camera_from_world(0.0)
                    * self.scene.world_from_part(&configurations[0])[joint.child]
                    * joint.grasp)
                    .into(),
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::furniture::laptop;

    #[test]
    fn a_still_shows_each_joint_as_far_open_as_is_asked() {
        let scene = laptop(Look { name: "laptop", richness: Richness::Rich });
        let shot = Shot {
            turn_deg: 10.0,
            lift_deg: 0.0,
            roll_deg: 0.0,
            distance: 1.0,
            light: 1.0,
            open: 0.5,
            occluded: false,
        };
        let still = Film::new(&scene, Take::Still(shot), 7);
        assert_eq!(still.configurations(0.0), [0.5 * -1.55]);
        assert!(still.person_at(0.0).is_empty());
        let truth = still.truth(1);
        assert!(truth.encounter && truth.frames == [START]);
    }
}
