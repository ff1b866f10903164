//! The kinematic tree of an object in the form that recognition needs.
//!
//! In: a model (object frame at configuration 0, metres and radians).
//! Out: the pose of each part in the camera frame in a state, how points move with each unknown (the Jacobian), and
//! the state after a step of the unknowns.
//! From: forward kinematics of a tree of joints.

use crate::math::rigid::{Pose, matrix_pose};
use crate::object::joint_geometry::{JointGeometry, JointKind};
use crate::object::model::ObjectModel;
use nalgebra::{DVector, IsometryMatrix3, Point3, UnitQuaternion, Vector3};

/// Pose and configurations of an object.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Pose of the object frame in the camera frame.
    pub camera_from_object: Pose,
    /// Configuration of each joint, rad or m.
    pub q: Vec<f64>,
}

/// A joint in the form that recognition needs.
pub struct ChainJoint {
    /// Line of the joint, object frame at configuration 0.
    pub geometry: JointGeometry,
    /// Index of the carrying part.
    pub parent: usize,
    /// Index of the moved part.
    pub child: usize,
    /// Range seen in the demonstrations, rad or m.
    pub range: [f64; 2],
    /// Lower end of the range with a margin, rad or m.
    pub low: f64,
    /// Upper end of the range with a margin, rad or m.
    pub high: f64,
}

impl ChainJoint {
    /// Joint of a line, of the carrying and the moved part, and of the demonstrated range.
    pub fn new(geometry: JointGeometry, [parent, child]: [usize; 2], range: [f64; 2]) -> Self {
        let margin = 0.06 * (range[1] - range[0]) + 0.02;
        let (low, high) = (range[0] - margin, range[1] + margin);
        Self { geometry, parent, child, range, low, high }
    }

    /// Standard deviation of the motion beyond the demonstrated range, rad or m.
    pub fn slack(&self) -> f64 {
        if self.geometry.kind == JointKind::Prismatic { SLIDE_SLACK } else { TURN_SLACK }
    }

    /// How far a configuration lies outside the demonstrated range, rad or m; negative below the range, 0 within.
    pub fn excess(&self, q: f64) -> f64 {
        q - q.clamp(self.range[0], self.range[1].max(self.range[0]))
    }
}

/// Standard deviation of the rotation of hinges beyond the demonstrated range, radians.
const TURN_SLACK: f64 = 0.02;
/// Standard deviation of the motion of slides beyond the demonstrated range, metres.
const SLIDE_SLACK: f64 = 0.01;
/// This many surfels give one nat of evidence, because residuals of neighbours are correlated.
const SURFELS_PER_NAT: f64 = 5.0;

/// Kinematic tree of an object.
pub struct Articulated {
    /// Number of parts.
    pub parts: usize,
    /// Joints, parents first.
    pub joints: Vec<ChainJoint>,
}

impl Articulated {
    /// Kinematic tree of a model.
    pub fn new(model: &ObjectModel) -> Self {
        let joints = model
            .joints
            .iter()
            .map(|j| ChainJoint::new(j.geometry(), [j.parent, j.child], j.range))
            .collect();
        Self { parts: model.parts.len(), joints }
    }

    /// Configuration 0 of each joint, clamped to its range with margin.
    pub fn rest(&self) -> Vec<f64> {
        self.joints.iter().map(|j| 0.0_f64.clamp(j.low, j.high)).collect()
    }

    /// Cost of joints outside the demonstrated range, in surfels of agreement.
    pub fn range_penalty(&self, state: &State) -> f64 {
        let excess = |(joint, q): (&ChainJoint, &f64)| (joint.excess(*q) / joint.slack()).powi(2);
        SURFELS_PER_NAT * 0.5 * self.joints.iter().zip(&state.q).map(excess).sum::<f64>()
    }

    /// `object_from_part` of each part: its motion since configuration 0.
    pub fn motions(&self, q: &[f64]) -> Vec<Pose> {
        let mut motions = vec![Pose::identity(); self.parts];
        for (joint, &q) in self.joints.iter().zip(q) {
            motions[joint.child] = motions[joint.parent] * joint.geometry.motion(q);
        }
        motions
    }

    /// `camera_from_part` of each part.
    pub fn poses(&self, state: &State) -> Vec<Pose> {
        self.motions(&state.q).iter().map(|m| state.camera_from_object * m).collect()
    }

    /// `camera_from_part` of each part as a matrix, for moving many points.
    pub fn matrices(&self, state: &State) -> Vec<IsometryMatrix3<f64>> {
        self.poses(state).iter().map(matrix_pose).collect()
    }

    /// Parts that a joint moves: its child and all descendants of the child.
    pub fn moved_by(&self, joint: usize) -> Vec<usize> {
        let mut moved = vec![self.joints[joint].child];
        for j in &self.joints {
            if moved.contains(&j.parent) && !moved.contains(&j.child) {
                moved.push(j.child);
            }
        }
        moved
    }

    /// State with configurations `q` in which `part` has the given pose.
    pub fn state_with(&self, part: usize, camera_from_part: &Pose, q: Vec<f64>) -> State {
        let motion = self.motions(&q)[part];
        State { camera_from_object: camera_from_part * motion.inverse(), q }
    }

    /// Velocities of points with each unknown, for parts at these poses.
    pub fn velocities(&self, poses: &[Pose]) -> Velocities {
        let of_joint = |j: usize| {
            let line = self.joints[j].geometry.transformed(&poses[self.joints[j].parent]);
            (line, self.moved_by(j))
        };
        Velocities((0..self.joints.len()).map(of_joint).collect())
    }

    /// State after a step over the unknowns of [`Velocities`]. A step that is too long is shortened as a whole,
    /// since pose and configurations may compensate each other; configurations are clamped to their range with
    /// margin.
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

/// Line of each joint in the camera frame, and the parts that it moves.
pub struct Velocities(Vec<(JointGeometry, Vec<usize>)>);

impl Velocities {
    /// Velocity of a point of a part, both in the camera frame, with each unknown: rotation of the object about the
    /// axes of the camera (3), translation (3), then each configuration.
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
