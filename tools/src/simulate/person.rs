//! The demonstrator: a hand that reaches, holds, follows and leaves, with the arm and the
//! body behind it.

use super::home::clothes;
use super::texture::{Richness, Texture};
use super::world::{Action, Material, PERSON, Scene, Solid};
use nalgebra::{Point3, Vector3};
use std::sync::Arc;

/// Seconds that a hand takes to reach, and to leave.
const REACH: f64 = 0.9;
/// Seconds between two actions on one joint over which the hand keeps its hold.
const KEEP_HOLD: f64 = 1.2;
/// Length of the forearm and of the upper arm, metres.
const FOREARM: f64 = 0.27;
const UPPER_ARM: f64 = 0.30;
/// How far the shoulder is from the wrist in the middle of an action, metres.
const COMFORTABLE: f64 = 0.46;
/// How far the body sways, metres, and how often, radians a second.
const SWAY: (f64, f64) = (0.012, 1.7);
/// How far the body of a person at home sways, metres.
const SWAY_AT_HOME: f64 = 0.025;

/// What the person wears.
pub struct Person {
    skin: Material,
    sleeve: Material,
    /// The trunk leans over the feet, head and the other arm are there; else the trunk follows the shoulder upright.
    is_whole: bool,
}

impl Person {
    /// A person whose clothes are drawn from a seed.
    pub fn new(seed: u64) -> Self {
        let material = |colour, richness, seed| Material {
            texture: Arc::new(Texture::new(colour, richness, seed)),
            depth_loss: 0.01,
        };
        let sleeves = [[60.0, 80.0, 130.0], [120.0, 50.0, 50.0], [70.0, 100.0, 70.0]];
        Self {
            skin: material([205.0, 155.0, 130.0], Richness::Poor, seed ^ 0x51),
            sleeve: material(sleeves[(seed % 3) as usize], Richness::Medium, seed ^ 0x52),
            is_whole: false,
        }
    }

    /// A person as one is at home: plain cloth, a trunk that leans, a head, the other arm.
    pub fn at_home(seed: u64) -> Self {
        let [sleeve, skin] = clothes(seed);
        Self { skin, sleeve, is_whole: true }
    }

    /// The person at a time, and who walks past; nobody where there is nothing to do.
    pub fn solids(&self, scene: &Scene, t: f64, start: &[f64]) -> Vec<Solid> {
        let mut solids = match reach_at(scene, t, start) {
            Some(reach) => {
                let far = if self.is_whole { SWAY_AT_HOME } else { SWAY.0 };
                let sway = Vector3::new(1.0, 0.6, 0.3) * far * (SWAY.1 * t).sin();
                self.arm(&reach, sway)
            }
            None => Vec::new(),
        };
        if scene.passer_by {
            solids.extend(self.passer_by(scene, t));
        }
        solids
    }

    /// Somebody who comes into the picture beside the object, and goes again.
    fn passer_by(&self, scene: &Scene, t: f64) -> Vec<Solid> {
        let side = -scene.joints.first().map_or(1.0, |j| j.person.x.signum());
        let near = (std::f64::consts::PI * t / scene.duration).sin();
        let step = 0.03 * (7.0 * t).sin();
        let at = |z: f64, lean: f64| {
            Point3::new(side * (1.7 - 0.75 * near) + lean, 0.30 + 0.5 * lean, z)
        };
        vec![
            Solid::rod(at(0.9, 0.0), at(1.45, step), 0.16, &self.sleeve, PERSON),
            Solid::rod(at(0.1, -step), at(0.85, 0.0), 0.09, &self.sleeve, PERSON),
            Solid::rod(at(1.68, step), at(1.74, step), 0.10, &self.skin, PERSON),
        ]
    }

    fn arm(&self, reach: &Reach, sway: Vector3<f64>) -> Vec<Solid> {
        let (hand, back) = (reach.hand, reach.towards);
        // The person stands beside what is moved, not between it and the camera.
        let outward = Vector3::new(back.x.signum(), 0.0, 0.0);
        let side = back.cross(&Vector3::z()).normalize();
        let wrist = hand + back * 0.10;
        let mut solids = vec![
            // The palm and four fingers round what is held.
            Solid::rod(
                hand + back * 0.03 - side * 0.025,
                hand + back * 0.03 + side * 0.025,
                0.028,
                &self.skin,
                PERSON,
            ),
            Solid::rod(hand + back * 0.05, wrist, 0.03, &self.skin, PERSON),
        ];
        for k in 0..4 {
            let shift = side * (0.021 * (f64::from(k) - 1.5));
            let knuckle = hand + back * 0.025 + shift;
            let tip = hand - back * 0.02 + shift - Vector3::z() * 0.012;
            solids.push(Solid::rod(knuckle, tip, 0.010, &self.skin, PERSON));
        }
        let up_and_back = (back + Vector3::z() * 0.25).normalize();
        let standing = reach.middle + back * 0.10 + up_and_back * COMFORTABLE + sway;
        let shoulder = leaning(standing, wrist);
        let elbow = elbow_of(wrist, shoulder, side * 0.3 - Vector3::z());
        solids.push(Solid::rod(wrist, elbow, 0.042, &self.sleeve, PERSON));
        solids.push(Solid::rod(elbow, shoulder, 0.052, &self.sleeve, PERSON));
        let chest = shoulder + outward * 0.2;
        if self.is_whole {
            self.add_trunk(&mut solids, chest, standing + outward * 0.2 - sway, outward);
        } else {
            let hip = chest - Vector3::z() * 0.5;
            solids.push(Solid::rod(chest, hip, 0.13, &self.sleeve, PERSON));
        }
        solids
    }

    /// Trunk from a chest to the hip below where the person stands upright, with legs, head and the other arm.
    fn add_trunk(
        &self,
        solids: &mut Vec<Solid>,
        chest: Point3<f64>,
        upright: Point3<f64>,
        outward: Vector3<f64>,
    ) {
        let hip = upright - Vector3::z() * 0.5;
        let feet = Point3::new(hip.x, hip.y, 0.08_f64.min(hip.z - 0.2));
        let neck = chest + (chest - hip).normalize() * 0.24;
        let other = chest + outward * 0.22;
        let hand = other - Vector3::z() * 0.5 - outward * 0.04;
        let rods = [
            (chest, hip, 0.13, &self.sleeve),
            (hip, feet, 0.11, &self.sleeve),
            (neck, neck + Vector3::z() * 0.06, 0.09, &self.skin),
            (other, hand, 0.045, &self.sleeve),
            (hand, hand - Vector3::z() * 0.12, 0.035, &self.skin),
        ];
        let rod = |(a, b, radius, material)| Solid::rod(a, b, radius, material, PERSON);
        solids.extend(rods.map(rod));
    }
}

/// The shoulder, nearer than where the person stands when the hand is too far away.
fn leaning(standing: Point3<f64>, wrist: Point3<f64>) -> Point3<f64> {
    let arm = standing - wrist;
    wrist + arm * (0.96 * (FOREARM + UPPER_ARM) / arm.norm()).min(1.0)
}

/// The elbow of an arm that bends towards `down`.
fn elbow_of(wrist: Point3<f64>, shoulder: Point3<f64>, down: Vector3<f64>) -> Point3<f64> {
    let arm = shoulder - wrist;
    let length = arm.norm();
    let along = arm / length;
    // Where the circle of possible elbows meets the line from wrist to shoulder.
    let foot = (length * length + FOREARM.powi(2) - UPPER_ARM.powi(2)) / (2.0 * length);
    let drop = (FOREARM.powi(2) - foot * foot).max(0.0).sqrt();
    let across = (down - along * along.dot(&down)).normalize();
    wrist + along * foot + across * drop
}

/// A hand that reaches for something.
struct Reach {
    hand: Point3<f64>,
    /// Unit direction to the person.
    towards: Vector3<f64>,
    /// Where the hand is in the middle of the action: the person stands there.
    middle: Point3<f64>,
}

/// Where the hand is; `None` while nobody is there.
fn reach_at(scene: &Scene, t: f64, start: &[f64]) -> Option<Reach> {
    let holds = |a: &Action, next: Option<&Action>| {
        next.is_some_and(|n| n.joint == a.joint && n.start - a.end < KEEP_HOLD)
    };
    let ease = |s: f64| s * s * (3.0 - 2.0 * s);
    for (i, a) in scene.actions.iter().enumerate() {
        let joint = &scene.joints[a.joint];
        let grasp_at = |t: f64| {
            scene.world_from_part(&scene.configurations(t, start))[joint.child] * joint.grasp
        };
        let grasp = grasp_at(t);
        let towards = Vector3::new(joint.person.x.signum(), -0.45, joint.person.z).normalize();
        let home = grasp + towards * 0.75 - Vector3::z() * 0.25;
        let reach = |hand| Some(Reach { hand, towards, middle: grasp_at(0.5 * (a.start + a.end)) });
        let next = scene.actions.get(i + 1);
        let held_before = i > 0 && holds(&scene.actions[i - 1], Some(a));
        let until = if holds(a, next) { next.map_or(a.end, |n| n.start) } else { a.end };
        if !held_before && t >= a.start - REACH && t < a.start {
            return reach(home + (grasp - home) * ease((t - a.start + REACH) / REACH));
        }
        if t >= a.start && t <= until {
            return reach(grasp);
        }
        if !holds(a, next) && t > a.end && t <= a.end + REACH {
            return reach(grasp + (home - grasp) * ease((t - a.end) / REACH));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arm_keeps_the_lengths_of_its_bones_wherever_the_hand_is() {
        for x in [-0.8, -0.2, 0.1, 0.5] {
            let wrist = Point3::new(x, 0.1, 0.9);
            let shoulder = leaning(Point3::new(0.3, -0.1, 1.3), wrist);
            let elbow = elbow_of(wrist, shoulder, -Vector3::z());
            assert!(((elbow - wrist).norm() - FOREARM).abs() < 1e-9);
            assert!(((shoulder - elbow).norm() - UPPER_ARM).abs() < 1e-9);
        }
    }
}
