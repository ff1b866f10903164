//! What scenes are built of: paints, boxes, joints, actions of a hand.
//!
//! World frame: x right, y away from the viewer, z up; metres, radians, seconds.

use super::texture::{Richness, Texture};
use super::world::{Action, Material, Part, Scene, SceneJoint, Solid};
use linkage_skill::object::JointKind;
use nalgebra::{Point3, Vector3};
use std::sync::Arc;

/// Which one of its sort an object is, and how much there is to see on it.
#[derive(Clone, Copy)]
pub struct Look<'n> {
    /// Its name: paints follow from it, not from the seed.
    pub name: &'n str,
    /// How much there is to see.
    pub richness: Richness,
}

/// Paints of one object.
pub struct Palette {
    seed: u64,
    richness: Richness,
}

impl Palette {
    /// Of an object.
    pub fn new(look: Look) -> Self {
        let seed = look.name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| {
            (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3)
        });
        Self { seed, richness: look.richness }
    }

    /// The next paint.
    pub fn paint(&mut self, colour: [f64; 3]) -> Material {
        self.seed = self.seed.wrapping_add(1);
        Material {
            texture: Arc::new(Texture::new(colour, self.richness, self.seed)),
            depth_loss: 0.004,
        }
    }
}

/// White paint, RGB.
pub const WHITE: [f64; 3] = [205.0, 205.0, 200.0];
/// Wood, RGB.
pub const WOOD: [f64; 3] = [165.0, 120.0, 80.0];
/// Grey paint, RGB.
pub const GREY: [f64; 3] = [120.0, 122.0, 128.0];
/// Dark metal, RGB.
pub const DARK: [f64; 3] = [70.0, 72.0, 80.0];
/// Blue paint, RGB.
pub const BLUE: [f64; 3] = [90.0, 120.0, 170.0];

/// Label of the base; parts follow.
pub const BASE: u8 = 1;

/// A part of solids.
pub fn part(name: &str, solids: Vec<Solid>) -> Part {
    Part { name: name.to_owned(), solids }
}

/// A box by its centre and its size, metres.
pub fn cuboid(c: [f64; 3], s: [f64; 3], m: &Material, label: u8) -> Solid {
    Solid::cuboid(c, s, m, label)
}

/// Open, hold a moment, close: two actions on one joint.
pub fn there_and_back(joint: usize, to: f64, start: f64, seconds: f64) -> [Action; 2] {
    let pause = 0.7;
    [
        Action { joint, to, start, end: start + seconds },
        Action {
            joint,
            to: 0.0,
            start: start + seconds + pause,
            end: start + 2.0 * seconds + pause,
        },
    ]
}

/// A scene without parts: its name, its category, what the camera looks at, and from where (azimuth and
/// elevation in degrees, distance in metres).
pub fn scene_of(name: &str, category: &'static str, target: [f64; 3], view: [f64; 3]) -> Scene {
    Scene {
        name: name.to_owned(),
        category,
        parts: Vec::new(),
        joints: Vec::new(),
        actions: Vec::new(),
        surroundings: Vec::new(),
        target: Point3::from(target),
        view,
        moving_camera: false,
        passer_by: false,
        texture: None,
        duration: 10.0,
    }
}

/// A hinge that the base carries: its axis and a place on it, where a hand grasps, and from where a
/// person reaches.
pub fn hinge(
    name: &str,
    axis: [f64; 3],
    origin: [f64; 3],
    grasp: [f64; 3],
    person: [f64; 3],
) -> SceneJoint {
    SceneJoint {
        name: name.to_owned(),
        kind: JointKind::Revolute,
        parent: 0,
        child: 1,
        axis: Vector3::from(axis),
        origin: Point3::from(origin),
        pitch: 0.0,
        grasp: Point3::from(grasp),
        person: Vector3::from(person),
    }
}

/// A slide that the base carries.
pub fn slide(name: &str, axis: [f64; 3], grasp: [f64; 3], person: [f64; 3]) -> SceneJoint {
    SceneJoint { kind: JointKind::Prismatic, ..hinge(name, axis, grasp, grasp, person) }
}

/// A box with an open front: back, sides, floor, top.
pub fn shell(centre: [f64; 3], size: [f64; 3], wall: f64, m: &Material, label: u8) -> Vec<Solid> {
    let [x, y, z] = centre;
    let [w, d, h] = size;
    vec![
        cuboid([x, y + 0.5 * (d - wall), z], [w, wall, h], m, label),
        cuboid([x - 0.5 * (w - wall), y, z], [wall, d, h], m, label),
        cuboid([x + 0.5 * (w - wall), y, z], [wall, d, h], m, label),
        cuboid([x, y, z - 0.5 * (h - wall)], [w, d, wall], m, label),
        cuboid([x, y, z + 0.5 * (h - wall)], [w, d, wall], m, label),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_joint_goes_there_and_back_with_a_pause() {
        let [there, back] = there_and_back(0, 1.2, 1.0, 3.0);
        assert_eq!((there.to, there.start, there.end), (1.2, 1.0, 4.0));
        assert_eq!((back.to, back.end - back.start), (0.0, 3.0));
        assert!((back.start - there.end - 0.7).abs() < 1e-12);
    }
}
