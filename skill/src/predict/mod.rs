//! Prediction (paper, section III-E): from the present configuration of a recognised object
//! to a target, the motion of each joint and of each part that moves.
//!
//! In: a model, its recognition in a frame, and a target (rad or m). Out: start and end of each joint's
//! motion, and the pose of each part on the way, in the camera frame, metres.

mod surface;

pub use surface::moved_surface;

use crate::math::rigid::{Pose, pose_from_array};
use crate::object::joint_geometry::JointKind;
use crate::object::model::{Joint, ObjectModel};
use crate::recognise::Recognised;

/// Where a joint is to go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Target {
    /// The end of the range away from where the demonstration began.
    Open,
    /// Where the demonstration began, or the end of the range nearest to it.
    Closed,
    /// A configuration that was seen, radians or metres.
    Value(f64),
    /// A configuration, whether it was seen or not, at most a turn or a metre outside the range that was seen.
    Unseen(f64),
}

impl std::str::FromStr for Target {
    type Err = PredictError;

    fn from_str(text: &str) -> Result<Self, PredictError> {
        match text {
            "open" => Ok(Self::Open),
            "closed" => Ok(Self::Closed),
            _ => match text.parse::<f64>() {
                Ok(value) if value.is_finite() => Ok(Self::Value(value)),
                _ => Err(PredictError::Target { text: text.to_owned() }),
            },
        }
    }
}

/// A prediction that cannot be made.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum PredictError {
    /// No joint goes by that name.
    #[error("{object} has no joint \"{joint}\"; it has: {known}")]
    UnknownJoint {
        /// The object.
        object: String,
        /// As asked.
        joint: String,
        /// What there is.
        known: String,
    },
    /// The target was never seen to be reached.
    #[error(
        "{joint} was seen between {low:.3} and {high:.3} {unit} only; {} lies outside",
        short(*target)
    )]
    OutsideRange {
        /// The joint.
        joint: String,
        /// Target.
        target: f64,
        /// Least.
        low: f64,
        /// Greatest.
        high: f64,
        /// rad or m.
        unit: &'static str,
    },
    /// The target is so far outside the range that it must be a mistake.
    #[error(
        "{joint} was seen between {low:.3} and {high:.3} {unit}; {} lies more than {most:.2} {unit} outside",
        short(*target)
    )]
    FarOutside {
        /// The joint.
        joint: String,
        /// Target.
        target: f64,
        /// Least.
        low: f64,
        /// Greatest.
        high: f64,
        /// How far outside a target may be.
        most: f64,
        /// rad or m.
        unit: &'static str,
    },
    /// The present configuration is not known.
    #[error("the present configuration of {joint} could not be seen")]
    Unseen {
        /// The joint.
        joint: String,
    },
    /// Not a target.
    #[error("\"{text}\" is no target; give open, closed or a number")]
    Target {
        /// As given.
        text: String,
    },
    /// The recognition is of another object, or has no pose.
    #[error("the recognition does not fit the model of {object}")]
    Mismatch {
        /// The object.
        object: String,
    },
}

/// How far beyond the observed range a target may lie, as a share of it: the ends of a
/// motion are seen least well.
const RANGE_TOLERANCE: f64 = 0.02;

/// How far outside the observed range the target of a hinge may lie where that is allowed, radians. What is farther
/// away is taken for a wrong unit or digit: a robot that follows it pulls until something breaks.
const MOST_OUTSIDE_RAD: f64 = std::f64::consts::TAU;
/// The same for a slide, metres.
const MOST_OUTSIDE_M: f64 = 1.0;

/// A number with three digits behind the point, or as a power of ten where it is huge.
fn short(number: f64) -> String {
    if number.abs() < 1e6 { format!("{number:.3}") } else { format!("{number:.3e}") }
}

/// Start and end of one joint's motion.
#[derive(Debug, Clone, PartialEq)]
pub struct JointMotion {
    /// Index of the joint in the model.
    pub joint: usize,
    /// Present configuration.
    pub from: f64,
    /// Target configuration.
    pub to: f64,
}

/// A recognised object with its model: what predictions start from.
pub struct PredictionContext<'m> {
    model: &'m ObjectModel,
    camera_from_object: Pose,
    configurations: Vec<Option<f64>>,
}

impl<'m> PredictionContext<'m> {
    /// Puts a recognition and its model together.
    ///
    /// # Errors
    /// [`PredictError::Mismatch`] when they are not of one object.
    pub fn new(model: &'m ObjectModel, recognised: &Recognised) -> Result<Self, PredictError> {
        let mismatch = || PredictError::Mismatch { object: model.object.clone() };
        if recognised.object != model.object || recognised.joints.len() != model.joints.len() {
            return Err(mismatch());
        }
        Ok(Self {
            model,
            camera_from_object: pose_from_array(&recognised.camera_from_object)
                .ok_or_else(mismatch)?,
            configurations: recognised.joints.iter().map(|j| j.configuration).collect(),
        })
    }

    /// The motion of one joint, or of all whose configuration was seen when `joint` is
    /// `None`.
    ///
    /// # Errors
    /// [`PredictError::UnknownJoint`], [`PredictError::OutsideRange`],
    /// [`PredictError::Unseen`].
    pub fn motions(
        &self,
        joint: Option<&str>,
        target: Target,
    ) -> Result<Vec<JointMotion>, PredictError> {
        if let Some(name) = joint {
            let index = self.model.joints.iter().position(|j| j.name == name).ok_or_else(|| {
                PredictError::UnknownJoint {
                    object: self.model.object.clone(),
                    joint: name.to_owned(),
                    known: self
                        .model
                        .joints
                        .iter()
                        .map(|j| j.name.as_str())
                        .collect::<Vec<_>>()
                        .join(", "),
                }
            })?;
            return Ok(vec![self.motion(index, target)?]);
        }
        let seen: Vec<usize> =
            (0..self.model.joints.len()).filter(|&i| self.configurations[i].is_some()).collect();
        if let (true, Some(first)) = (seen.is_empty(), self.model.joints.first()) {
            return Err(PredictError::Unseen { joint: first.name.clone() });
        }
        seen.into_iter().map(|i| self.motion(i, target)).collect()
    }

    fn motion(&self, index: usize, target: Target) -> Result<JointMotion, PredictError> {
        let joint = &self.model.joints[index];
        let from = self.configurations[index]
            .ok_or_else(|| PredictError::Unseen { joint: joint.name.clone() })?;
        Ok(JointMotion { joint: index, from, to: resolve(joint, target)? })
    }

    /// `camera_from_part` of every part for given configurations of some joints, the others
    /// staying as they are. Part axes are the object's at configuration 0.
    #[must_use]
    pub fn part_poses(&self, moved: &[(usize, f64)]) -> Vec<Pose> {
        let mut q: Vec<f64> = self
            .configurations
            .iter()
            .zip(&self.model.joints)
            .map(|(q, j)| q.unwrap_or(0.0_f64.clamp(j.range[0], j.range[1])))
            .collect();
        for &(joint, value) in moved {
            q[joint] = value;
        }
        self.model.part_motions(&q).iter().map(|m| self.camera_from_object * m).collect()
    }

    /// The model.
    pub fn model(&self) -> &ObjectModel {
        self.model
    }

    /// Pose of the object frame.
    pub fn camera_from_object(&self) -> &Pose {
        &self.camera_from_object
    }
}

/// The configuration that a target means for a joint. The demonstration begins with the
/// thing closed: configuration 0.
fn resolve(joint: &Joint, target: Target) -> Result<f64, PredictError> {
    let [low, high] = joint.range;
    match target {
        Target::Open => Ok(if high.abs() >= low.abs() { high } else { low }),
        Target::Closed => Ok(0.0_f64.clamp(low, high)),
        Target::Value(value) => {
            let slack = RANGE_TOLERANCE * (high - low);
            if value < low - slack || value > high + slack {
                return Err(PredictError::OutsideRange {
                    joint: joint.name.clone(),
                    target: value,
                    low,
                    high,
                    unit: joint.kind.unit(),
                });
            }
            Ok(value.clamp(low, high))
        }
        Target::Unseen(value) => {
            let most = match joint.kind {
                JointKind::Revolute | JointKind::Helical => MOST_OUTSIDE_RAD,
                _ => MOST_OUTSIDE_M,
            };
            if !(low - most..=high + most).contains(&value) {
                let (joint, unit) = (joint.name.clone(), joint.kind.unit());
                return Err(PredictError::FarOutside {
                    joint,
                    target: value,
                    low,
                    high,
                    most,
                    unit,
                });
            }
            Ok(value)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object::joint_geometry::JointGeometry;
    use nalgebra::{Point3, Vector3};
    use std::f64::consts::TAU;

    fn drawer(range: [f64; 2]) -> Joint {
        Joint { range, ..Joint::of(&JointGeometry::slide(Vector3::x_axis(), Point3::origin())) }
    }

    #[test]
    fn open_is_the_end_of_the_range_away_from_where_the_demonstration_began() {
        assert_eq!(resolve(&drawer([0.0, 0.4]), Target::Open), Ok(0.4));
        assert_eq!(resolve(&drawer([-0.4, 0.01]), Target::Open), Ok(-0.4));
        assert_eq!(resolve(&drawer([-0.4, 0.01]), Target::Closed), Ok(0.0));
        assert_eq!(resolve(&drawer([0.1, 0.4]), Target::Closed), Ok(0.1));
    }

    #[test]
    fn a_value_a_little_outside_the_range_becomes_its_end_and_one_far_outside_is_refused() {
        let drawer = drawer([0.0, 0.4]);
        assert_eq!(resolve(&drawer, Target::Value(0.405)), Ok(0.4));
        assert_eq!(resolve(&drawer, Target::Unseen(0.5)), Ok(0.5));
        let refused = resolve(&drawer, Target::Value(0.5)).unwrap_err();
        assert!(refused.to_string().contains("between 0.000 and 0.400 m"), "{refused}");
    }

    #[test]
    fn no_target_lies_farther_outside_the_range_than_a_turn_or_a_metre() {
        let door = JointGeometry::hinge(Vector3::x_axis(), Point3::origin());
        let door = Joint { range: [0.0, 1.5], ..Joint::of(&door) };
        let ends = [(drawer([0.0, 0.4]), -1.0, 1.4), (door, -TAU, 1.5 + TAU)];
        for (joint, least, greatest) in ends {
            for value in [least, greatest] {
                assert_eq!(resolve(&joint, Target::Unseen(value)), Ok(value));
            }
            for value in [least - 0.01, greatest + 0.01, 1e6, -1e300, f64::INFINITY, f64::NAN] {
                let refused = resolve(&joint, Target::Unseen(value)).unwrap_err().to_string();
                assert!(refused.contains("outside") && refused.len() < 120, "{refused}");
            }
        }
    }
}
