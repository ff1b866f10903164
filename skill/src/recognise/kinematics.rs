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

#[cfg(test)]
mod tests {
    use super::*;

    /// A door on its frame, with a slide on the door.
    fn door_with_slide() -> (Articulated, State) {
        let hinge = JointGeometry::hinge(Vector3::y_axis(), Point3::new(0.3, 0.0, 1.4));
        let slide = JointGeometry::slide(Vector3::x_axis(), Point3::origin());
        let joints = vec![
            ChainJoint::new(hinge, [0, 1], [0.0, 1.5]),
            ChainJoint::new(slide, [1, 2], [0.0, 0.3]),
        ];
        let turn = UnitQuaternion::from_euler_angles(0.1, -0.2, 0.3);
        let camera_from_object = Pose::from_parts(Vector3::new(0.1, -0.1, 0.4).into(), turn);
        (Articulated { parts: 3, joints }, State { camera_from_object, q: vec![0.7, 0.1] })
    }

    #[test]
    fn velocities_are_the_numerical_derivatives_of_places() {
        let (articulated, state) = door_with_slide();
        let point = Point3::new(-0.1, 0.2, 1.3);
        let place = |state: &State| articulated.poses(state)[2] * point;
        let velocities = articulated.velocities(&articulated.poses(&state));
        let by_formula: Vec<Vector3<f64>> = velocities.of(2, &place(&state)).collect();
        assert_eq!(by_formula.len(), 8);
        for (k, velocity) in by_formula.iter().enumerate() {
            let h = 1e-6;
            let stepped = |h: f64| {
                let mut step = DVector::zeros(8);
                step[k] = h;
                place(&articulated.stepped(&state, &step))
            };
            let numerical = (stepped(h) - stepped(-h)) / (2.0 * h);
            assert!((numerical - velocity).norm() < 1e-8, "unknown {k}: {numerical} {velocity}");
        }
    }

    #[test]
    fn a_joint_moves_what_hangs_on_its_part_too() {
        let (articulated, state) = door_with_slide();
        assert_eq!(articulated.moved_by(0), [1, 2]);
        assert_eq!(articulated.moved_by(1), [2]);
        let camera_from_slide = articulated.poses(&state)[2];
        let again = articulated.state_with(2, &camera_from_slide, state.q.clone());
        assert!(
            (again.camera_from_object.inverse() * state.camera_from_object).rotation.angle()
                < 1e-12
        );
    }

    #[test]
    fn a_configuration_outside_the_range_costs_and_one_inside_does_not() {
        let (articulated, state) = door_with_slide();
        assert_eq!(articulated.range_penalty(&state), 0.0);
        let beyond = State { q: vec![1.52, 0.1], ..state };
        assert!((articulated.range_penalty(&beyond) - 0.5 * SURFELS_PER_NAT).abs() < 1e-9);
    }
}
