//! The motions in time of the joints that a request moves, and of those that it leaves out while they
//! still move.
//!
//! In: the object as it was encountered, the request, the rig. Out: motions under the rig's limits,
//! radians or metres over seconds, each with its joint's number in the model.

use super::certainty::{assure, assure_configuration};
use super::error::PlanError;
use super::request::Request;
use crate::limits::Rig;
use crate::trajectory::{Task, together};
use linkage_realtime::{JointMotion, Moving};
use linkage_skill::object::ObjectModel;
use linkage_skill::predict::PredictionContext;
use linkage_skill::recognise::Recognised;

/// Motions of the joints that are asked for, with their numbers in the model.
pub fn asked_for(
    encountered: &PredictionContext,
    recognised: &Recognised,
    request: &Request,
    rig: &Rig,
) -> Result<Vec<(usize, JointMotion)>, PlanError> {
    let model = encountered.model();
    let wanted = encountered.motions(request.joint, request.target)?;
    let mut tasks = Vec::with_capacity(wanted.len());
    for m in &wanted {
        let joint = &model.joints[m.joint];
        assure(joint, &rig.safety)?;
        assure_configuration(joint, recognised.joints[m.joint].deviation, &rig.safety)?;
        let limits = *rig.limits(joint.kind);
        tasks.push(match request.moving.and_then(|moving| moving.joint(&joint.name)) {
            Some(now) => Task::within(&joint.name, now, m.to, limits, joint.range),
            None => Task::between(&joint.name, m.from, m.to, limits),
        });
    }
    let motions = together(&tasks, rig.streaming.synchronisation)?;
    Ok(wanted.iter().map(|m| m.joint).zip(motions).collect())
}

/// Motions of the joints that move, or have just come to rest, and are not asked for.
pub fn coming_to_rest(
    model: &ObjectModel,
    request: &Request,
    asked: &[(usize, JointMotion)],
    rig: &Rig,
) -> Result<Vec<(usize, JointMotion)>, PlanError> {
    let mut stopped = Vec::new();
    for (motion, now) in request.moving.into_iter().flat_map(Moving::unsettled) {
        let number = model.joints.iter().position(|j| j.name == motion.name());
        let Some(number) = number.filter(|n| asked.iter().all(|(a, _)| a != n)) else { continue };
        let joint = &model.joints[number];
        let limits = *rig.limits(joint.kind);
        let task = Task::within(&joint.name, now, now.position, limits, motion.bounds().range);
        stopped.push((number, task.stopping()?));
    }
    Ok(stopped)
}
