//! The answer of recognition when a follower requests it again, carried to the present: recognition takes longer
//! than a frame, so that its answer refers to an older frame.
//!
//! In: the followed state then and now, and what recognition found then (camera frame, metres and radians).
//! Out: the found state, moved by what was followed since.

use crate::math::rigid::{Pose, pose_from_array};
use crate::recognise::kinematics::{Articulated, State};
use crate::recognise::result::Recognised;

/// State of the object when recognition was requested again.
#[derive(Debug, Clone)]
pub struct Asked(pub(super) State);

/// A state that recognition found, carried to the present.
pub struct Answer {
    /// Pose and configurations.
    pub state: State,
    /// For each joint, true if recognition reported its configuration.
    told: Vec<bool>,
    /// Standard deviation of each configuration, rad or m.
    deviations: Vec<Option<f64>>,
}

impl Answer {
    /// Carries `found` from the frame of the state `then` to the state `now`; `None` if the found pose is invalid.
    pub fn new(
        articulated: &Articulated,
        Asked(then): &Asked,
        now: &State,
        found: &Recognised,
    ) -> Option<Self> {
        let seen = state_of(found, articulated)?;
        let since = now.camera_from_object * then.camera_from_object.inverse();
        let moved = now.q.iter().zip(&then.q).map(|(now, then)| now - then);
        let q = seen
            .q
            .iter()
            .zip(moved)
            .zip(&articulated.joints)
            .map(|((q, moved), j)| (q + moved).clamp(j.low, j.high))
            .collect();
        let state = State { camera_from_object: since * seen.camera_from_object, q };
        let deviations = found.joints.iter().map(|j| j.deviation).collect();
        Some(Self { state, told: told_by(found), deviations })
    }

    /// Standard deviation with which the answer confirms that a joint is at `q` now; `None` if recognition did not
    /// report its configuration, or reported a value farther away than `limit`.
    pub fn confirms(&self, joint: usize, q: f64, limit: f64) -> Option<f64> {
        let told = self.told[joint] && (self.state.q[joint] - q).abs() <= limit;
        told.then_some(self.deviations[joint]?)
    }
}

/// State of a recognition; joints whose configuration is not reported are at the assumed one.
pub fn state_of(found: &Recognised, articulated: &Articulated) -> Option<State> {
    let q = if found.assumed.len() == articulated.joints.len() {
        found.assumed.clone()
    } else {
        articulated.rest()
    };
    let camera_from_object: Pose = pose_from_array(&found.camera_from_object)?;
    Some(State { camera_from_object, q })
}

/// For each joint, true if a recognition reports its configuration.
pub fn told_by(found: &Recognised) -> Vec<bool> {
    found.joints.iter().map(|j| j.configuration.is_some()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::pose_to_array;
    use crate::object::joint_geometry::JointGeometry;
    use crate::recognise::kinematics::ChainJoint;
    use nalgebra::{Point3, Vector3};

    #[test]
    fn an_answer_is_moved_on_by_what_was_followed_since() {
        let slide = JointGeometry::slide(Vector3::x_axis(), Point3::origin());
        let joints = vec![ChainJoint::new(slide, [0, 1], [0.0, 0.4])];
        let articulated = Articulated { parts: 2, joints };
        let at =
            |q: f64| State { camera_from_object: Pose::translation(0.0, 0.0, 1.0), q: vec![q] };
        let found = Recognised {
            object: "drawer".to_owned(),
            score: 0.9,
            inliers: 30,
            camera_from_object: pose_to_array(&Pose::translation(0.0, 0.1, 1.0)),
            base_known: true,
            joints: Vec::new(),
            evidence: Vec::new(),
            assumed: vec![0.11],
        };
        let answer = Answer::new(&articulated, &Asked(at(0.1)), &at(0.2), &found).unwrap();
        assert!((answer.state.q[0] - 0.21).abs() < 1e-12);
        assert!((answer.state.camera_from_object.translation.y - 0.1).abs() < 1e-12);
    }
}
