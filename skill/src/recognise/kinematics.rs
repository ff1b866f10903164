//! The kinematic tree as recognition needs it: an object's pose with the configuration of its joints.
//!
//! In: a model (object frame at configuration 0, metres and radians). Out: the pose of each part in the
//! camera frame in a state, how each point moves with each unknown (the Jacobian), and the state after
//! a step of the unknowns.

use crate::math::rigid::{Pose, matrix_pose};
use crate::object::joint_geometry::{JointGeometry, JointKind};
use crate::object::model::ObjectModel;
use nalgebra::{DVector, IsometryMatrix3, Point3, UnitQuaternion, Vector3};

/// Where the object is and how it stands.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Pose of the object frame.
    pub camera_from_object: Pose,
    /// Configuration of each joint.
    pub q: Vec<f64>,
}

/// A joint as recognition needs it.
pub struct ChainJoint {
    /// Its line in the object frame at configuration 0.
    pub geometry: JointGeometry,
    /// Carrying part.
    pub parent: usize,
    /// Moved part.
    pub child: usize,
    /// Range that was seen.
    pub range: [f64; 2],
    /// Lower end of the range, with a margin.
    pub low: f64,
    /// Upper end of the range, with a margin.
    pub high: f64,
}

impl ChainJoint {
    /// Of a line, the carrying and the moved part, and the range that was seen.
    pub fn new(geometry: JointGeometry, [parent, child]: [usize; 2], range: [f64; 2]) -> Self {
        let margin = 0.06 * (range[1] - range[0]) + 0.02;
        let (low, high) = (range[0] - margin, range[1] + margin);
        Self { geometry, parent, child, range, low, high }
    }

    /// Standard deviation of how far it moves beyond the range that was seen, rad or m.
    pub fn slack(&self) -> f64 {
        if self.geometry.kind == JointKind::Prismatic { SLIDE_SLACK } else { TURN_SLACK }
    }

    /// How far a configuration lies outside the range that was seen, below it negative.
    pub fn excess(&self, q: f64) -> f64 {
        q - q.clamp(self.range[0], self.range[1].max(self.range[0]))
    }
}

/// Standard deviation of how far hinges turn beyond the range that was seen, radians.
const TURN_SLACK: f64 = 0.02;
/// Standard deviation of how far slides move beyond it, metres.
const SLIDE_SLACK: f64 = 0.01;
/// Surfels that say as much as one unit of log-likelihood: neighbours err alike.
const SURFELS_PER_NAT: f64 = 5.0;

/// The object's kinematic tree.
pub struct Articulated {
    /// Number of parts.
    pub parts: usize,
    /// Joints, parents first.
    pub joints: Vec<ChainJoint>,
}

impl Articulated {
    /// Of a model.
    pub fn new(model: &ObjectModel) -> Self {
        let joints = model
            .joints
            .iter()
            .map(|j| ChainJoint::new(j.geometry(), [j.parent, j.child], j.range))
            .collect();
        Self { parts: model.parts.len(), joints }
    }

    /// The configuration in the middle of what was seen, nearest to 0.
    pub fn rest(&self) -> Vec<f64> {
        self.joints.iter().map(|j| 0.0_f64.clamp(j.low, j.high)).collect()
    }

    /// How much a state is less likely for joints that stand outside the range that was seen, in
    /// surfels of agreement.
    pub fn range_penalty(&self, state: &State) -> f64 {
        let excess = |(joint, q): (&ChainJoint, &f64)| (joint.excess(*q) / joint.slack()).powi(2);
        SURFELS_PER_NAT * 0.5 * self.joints.iter().zip(&state.q).map(excess).sum::<f64>()
    }

    /// `object_from_part` by part, relative to configuration 0.
    pub fn motions(&self, q: &[f64]) -> Vec<Pose> {
        let mut motions = vec![Pose::identity(); self.parts];
        for (joint, &q) in self.joints.iter().zip(q) {
            motions[joint.child] = motions[joint.parent] * joint.geometry.motion(q);
        }
        motions
    }

    /// `camera_from_part` by part.
    pub fn poses(&self, state: &State) -> Vec<Pose> {
        self.motions(&state.q).iter().map(|m| state.camera_from_object * m).collect()
    }

    /// The same, for moving many points.
    pub fn matrices(&self, state: &State) -> Vec<IsometryMatrix3<f64>> {
        self.poses(state).iter().map(matrix_pose).collect()
    }

    /// Parts that a joint moves, through its descendants.
    pub fn moved_by(&self, joint: usize) -> Vec<usize> {
        let mut moved = vec![self.joints[joint].child];
        for j in &self.joints {
            if moved.contains(&j.parent) && !moved.contains(&j.child) {
                moved.push(j.child);
            }
        }
        moved
    }

    /// The state in which `part` has a pose, for given configurations.
    pub fn state_with(&self, part: usize, camera_from_part: &Pose, q: Vec<f64>) -> State {
        let motion = self.motions(&q)[part];
        State { camera_from_object: camera_from_part * motion.inverse(), q }
    }

    /// How points move with each unknown, where parts have these poses.
    pub fn velocities(&self, poses: &[Pose]) -> Velocities {
        let of_joint = |j: usize| {
            let line = self.joints[j].geometry.transformed(&poses[self.joints[j].parent]);
            (line, self.moved_by(j))
        };
        Velocities((0..self.joints.len()).map(of_joint).collect())
    }

    /// Applies a step over the unknowns of [`Velocities`], shortened as a whole where it
    /// is too long (pose and configurations may compensate each other), kept in range.
    pub fn stepped(&self, state: &State, step: &DVector<f64>) -> State {
        let longest =
            |from: usize, to: usize| (from..to).map(|k| step[k].abs()).fold(0.0, f64::max);
        let excess = (longest(0, 3) / 0.1)
            .max(longest(3, 6) / 0.05)
            .max(longest(6, step.len()) / 0.3)
            .max(1.0);
        let step = step / excess;
        let turn = Vector3::new(step[0], step[1], step[2]);
        let shift = Vector3::new(step[3], step[4], step[5]);
        let increment = Pose::from_parts(shift.into(), UnitQuaternion::from_scaled_axis(turn));
        State {
            camera_from_object: increment * state.camera_from_object,
            q: self
                .joints
                .iter()
                .zip(&state.q)
                .enumerate()
                .map(|(j, (joint, q))| (q + step[6 + j]).clamp(joint.low, joint.high))
                .collect(),
        }
    }
}

/// Each joint's line in the camera frame, and the parts that it moves.
pub struct Velocities(Vec<(JointGeometry, Vec<usize>)>);

impl Velocities {
    /// Velocity of a point of a part, both in the camera frame, with each unknown: rotation of
    /// the whole (3), translation (3), configurations.
    pub fn of(&self, part: usize, at: &Point3<f64>) -> impl Iterator<Item = Vector3<f64>> {
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
        let with_joint = move |(line, moved): &(JointGeometry, Vec<usize>)| {
            if moved.contains(&part) { line.velocity(at) } else { Vector3::zeros() }
        };
        axes.map(|axis| axis.cross(&at.coords))
            .into_iter()
            .chain(axes)
            .chain(self.0.iter().map(with_joint))
    }
}
