//! The demonstrator: a hand that reaches, holds, follows and leaves, with the arm and the
//! body behind it.

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

/// What the person wears.
pub struct Person {
    skin: Material,
    sleeve: Material,
}

impl Person {
    /// Dresses someone.
    pub fn new(seed: u64) -> Self {
        let material = |colour, richness, seed| Material {
            texture: Arc::new(Texture::new(colour, richness, seed)),
            depth_loss: 0.01,
        };
        let sleeves = [[60.0, 80.0, 130.0], [120.0, 50.0, 50.0], [70.0, 100.0, 70.0]];
        Self {
            skin: material([205.0, 155.0, 130.0], Richness::Poor, seed ^ 0x51),
            sleeve: material(sleeves[(seed % 3) as usize], Richness::Medium, seed ^ 0x52),
        }
    }

    /// The person at a time; nobody where there is nothing to do.
    pub fn solids(&self, scene: &Scene, t: f64, start: &[f64]) -> Vec<Solid> {
        match hand_at(scene, t, start) {
            Some((hand, towards)) => self.arm(hand, towards),
            None => Vec::new(),
        }
    }

    fn arm(&self, hand: Point3<f64>, towards: Vector3<f64>) -> Vec<Solid> {
        let back = towards.normalize();
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
        // Shoulder at a comfortable distance, elbow hanging between.
        let shoulder = wrist + (back + Vector3::z() * 0.25).normalize() * 0.50;
        let half = 0.5 * (shoulder - wrist).norm();
        let mean = 0.5 * (FOREARM + UPPER_ARM);
        let drop = (mean * mean - half * half).max(0.0).sqrt();
        let elbow = nalgebra::center(&wrist, &shoulder) - Vector3::z() * drop + side * 0.04;
        solids.push(Solid::rod(wrist, elbow, 0.042, &self.sleeve, PERSON));
        solids.push(Solid::rod(elbow, shoulder, 0.052, &self.sleeve, PERSON));
        let chest = shoulder + outward * 0.2;
        let hip = chest - Vector3::z() * 0.5;
        solids.push(Solid::rod(chest, hip, 0.13, &self.sleeve, PERSON));
        solids
    }
}

/// Where the hand is, and the direction to the person; `None` while nobody is there.
fn hand_at(scene: &Scene, t: f64, start: &[f64]) -> Option<(Point3<f64>, Vector3<f64>)> {
    let holds = |a: &Action, next: Option<&Action>| {
        next.is_some_and(|n| n.joint == a.joint && n.start - a.end < KEEP_HOLD)
    };
    for (i, a) in scene.actions.iter().enumerate() {
        let joint = &scene.joints[a.joint];
        let poses = scene.world_from_part(&scene.configurations(t, start));
        let grasp = poses[joint.child] * joint.grasp;
        let away = Vector3::new(joint.person.x.signum(), -0.45, joint.person.z).normalize();
        let home = grasp + away * 0.75 - Vector3::z() * 0.25;
        let next = scene.actions.get(i + 1);
        let held_before = i > 0 && holds(&scene.actions[i - 1], Some(a));
        let until = if holds(a, next) { next.map_or(a.end, |n| n.start) } else { a.end };
        let ease = |s: f64| s * s * (3.0 - 2.0 * s);
        if !held_before && t >= a.start - REACH && t < a.start {
            let s = ease((t - a.start + REACH) / REACH);
            return Some((home + (grasp - home) * s, away));
        }
        if t >= a.start && t <= until {
            return Some((grasp, away));
        }
        if !holds(a, next) && t > a.end && t <= a.end + REACH {
            let s = ease((t - a.end) / REACH);
            return Some((grasp + (home - grasp) * s, away));
        }
    }
    None
}
