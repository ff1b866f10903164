//! The model as JSON, with what the rig gives of each joint or exports guess of it.

use super::joint::Hinge;
use linkage_planner_bridge::Rig;
use linkage_skill::object::Joint;
use linkage_skill::{ObjectModel, Pose};
use serde::Serialize;

/// A model, and what moves its joints and resists them.
#[derive(Serialize)]
pub struct ModelWithMechanics<'m> {
    #[serde(flatten)]
    model: &'m ObjectModel,
    /// Of each joint that turns, slides or screws.
    mechanics: Vec<Mechanics<'m>>,
}

/// What moves a joint and what resists it: SI units and radians, as in the other formats.
#[derive(Serialize)]
struct Mechanics<'m> {
    joint: &'m str,
    velocity: f64,
    effort: f64,
    damping: f64,
    friction: f64,
    /// Which of these nobody gave.
    guessed: Vec<&'static str>,
}

/// A model with its joints' mechanics.
pub fn json<'m>(model: &'m ObjectModel, rig: &Rig) -> ModelWithMechanics<'m> {
    let of = |joint: &'m Joint| {
        let described = Hinge::new(joint, &model.object, &Pose::identity(), rig).ok()?;
        let given = &described.given;
        let values =
            [("effort", given.effort), ("damping", given.damping), ("friction", given.friction)];
        let guessed = values.into_iter().filter(|(_, value)| value.is_none()).map(|(key, _)| key);
        Some(Mechanics {
            joint: &joint.name,
            velocity: described.velocity,
            effort: described.effort,
            damping: described.damping,
            friction: described.friction,
            guessed: guessed.collect(),
        })
    };
    ModelWithMechanics { model, mechanics: model.joints.iter().filter_map(of).collect() }
}
