//! What recognition answers when a follower asks it again.
//!
//! Recognition takes longer than a frame: its answer is about an older frame. In: the state when it
//! was asked, and what it found there (camera frame, metres and radians). Out: what it found, moved on
//! by what has been followed since.

use crate::math::rigid::{Pose, pose_from_array};
use crate::recognise::kinematics::{Articulated, State};
use crate::recognise::result::Recognised;

/// Where the object was when recognition was asked again.
#[derive(Debug, Clone)]
pub struct Asked(pub(super) State);

/// A state that recognition found, brought to the present.
pub struct Answer {
    /// Pose and configurations.
    pub state: State,
    /// Joints whose configuration it told.
    told: Vec<bool>,
    /// Standard deviation of each configuration, rad or m.
    deviations: Vec<Option<f64>>,
}

impl Answer {
    /// What was found in the frame in which the object was followed to `then`; it is `now` since.
    /// `None` where that has no pose.
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

    /// The standard deviation with which it confirms that a joint is at `q` now, if it told the
    /// joint's configuration and that is no farther away than `limit`.
    pub fn confirms(&self, joint: usize, q: f64, limit: f64) -> Option<f64> {
        let told = self.told[joint] && (self.state.q[joint] - q).abs() <= limit;
        told.then_some(self.deviations[joint]?)
    }
}

/// The state that a recognition tells; joints that it does not tell are where it assumes them.
pub fn state_of(found: &Recognised, articulated: &Articulated) -> Option<State> {
    let q = if found.assumed.len() == articulated.joints.len() {
        found.assumed.clone()
    } else {
        articulated.rest()
    };
    let camera_from_object: Pose = pose_from_array(&found.camera_from_object)?;
    Some(State { camera_from_object, q })
}

/// The joints whose configuration a recognition tells.
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
            assumed: vec![0.11],
        };
        let answer = Answer::new(&articulated, &Asked(at(0.1)), &at(0.2), &found).unwrap();
        assert!((answer.state.q[0] - 0.21).abs() < 1e-12);
        assert!((answer.state.camera_from_object.translation.y - 0.1).abs() < 1e-12);
    }
}
