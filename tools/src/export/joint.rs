//! A joint as the formats hold it: its line in the export's frame, its range and its limits.

use anyhow::bail;
use linkage_planner_bridge::{JointMechanics, Rig};
use linkage_skill::Pose;
use linkage_skill::object::{Joint, JointGeometry, JointKind};

/// Damping where the rig gives none: newton metre seconds a radian, newton seconds a metre.
const DAMPING: [f64; 2] = [0.1, 1.0];
/// Dry friction where the rig gives none: newton metres, newtons.
const FRICTION: [f64; 2] = [0.05, 0.5];
/// What a drive may spend where the rig does not say: newton metres, newtons. The formats want a limit.
const EFFORT: [f64; 2] = [30.0, 100.0];

/// A joint of links that are named by their number.
#[derive(Debug, Clone)]
pub struct Hinge {
    pub name: String,
    pub parent: usize,
    pub child: usize,
    pub motion: Motion,
    /// Its line in the export's frame at configuration 0.
    pub line: JointGeometry,
    /// Radians or metres.
    pub range: [f64; 2],
    /// Radians or metres a second.
    pub velocity: f64,
    /// Newton metres or newtons.
    pub effort: f64,
    pub damping: f64,
    pub friction: f64,
    /// What of these three the rig gives; the others are guesses.
    pub given: JointMechanics,
}

/// How a joint moves along or about its axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Motion {
    Turns,
    Slides,
    /// Turns, and advances this many metres a turn.
    Screws(f64),
}

impl Hinge {
    /// A joint of an object, by the object's name, as the formats hold it.
    ///
    /// # Errors
    /// When it neither turns, slides nor screws.
    pub fn new(
        joint: &Joint,
        object: &str,
        world_from_object: &Pose,
        rig: &Rig,
    ) -> anyhow::Result<Self> {
        let motion = match joint.kind {
            JointKind::Revolute => Motion::Turns,
            JointKind::Prismatic => Motion::Slides,
            JointKind::Helical => Motion::Screws(joint.pitch),
            other => bail!(
                "{} is {}: only joints that turn, slide or screw can be described; use --format json",
                joint.name,
                other.name()
            ),
        };
        let slides = usize::from(motion == Motion::Slides);
        let given = rig.mechanics.of(object, joint.kind);
        Ok(Self {
            name: joint.name.clone(),
            parent: joint.parent,
            child: joint.child,
            motion,
            line: joint.geometry().transformed(world_from_object),
            range: joint.range,
            velocity: rig.limits(joint.kind).velocity,
            effort: given.effort.unwrap_or(EFFORT[slides]),
            damping: given.damping.unwrap_or(DAMPING[slides]),
            friction: given.friction.unwrap_or(FRICTION[slides]),
            given,
        })
    }

    pub fn axis(&self) -> [f64; 3] {
        self.line.axis.into_inner().into()
    }

    /// What URDF and SDF call its type.
    pub fn kind(&self) -> &'static str {
        match self.motion {
            Motion::Turns => "revolute",
            Motion::Slides => "prismatic",
            Motion::Screws(_) => "screw",
        }
    }

    /// True for a screw.
    pub fn is_screw(&self) -> bool {
        matches!(self.motion, Motion::Screws(_))
    }

    /// This many configurations from one end of the range to the other.
    pub fn configurations(&self, count: usize) -> Vec<f64> {
        let [low, high] = self.range;
        let share = |i: usize| i as f64 / (count.max(2) - 1) as f64;
        (0..count.max(2)).map(|i| low + (high - low) * share(i)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};

    fn hinge(line: &JointGeometry) -> Hinge {
        let joint = Joint { name: "lid".to_owned(), range: [-0.5, 1.5], ..Joint::of(line) };
        let world_from_object = Pose::new(Vector3::x(), Vector3::z() * std::f64::consts::FRAC_PI_2);
        Hinge::new(&joint, "box", &world_from_object, &Rig::default()).unwrap()
    }

    #[test]
    fn a_joint_is_described_in_the_frame_of_the_export() {
        let described = hinge(&JointGeometry::hinge(Vector3::x_axis(), Point3::new(0.0, 0.2, 0.0)));
        assert_eq!((described.kind(), described.is_screw()), ("revolute", false));
        let off = Vector3::from(described.axis()) - Vector3::y();
        assert!(off.norm() < 1e-12, "{:?}", described.axis());
        assert!((described.line.origin - Point3::new(0.8, 0.0, 0.0)).norm() < 1e-12);
    }

    #[test]
    fn a_slide_has_the_limits_of_slides_and_a_screw_its_pitch() {
        let (axis, origin) = (Vector3::y_axis(), Point3::origin());
        let slide = hinge(&JointGeometry::slide(axis, origin));
        assert_eq!((slide.kind(), slide.effort), ("prismatic", EFFORT[1]));
        assert_eq!(slide.velocity, Rig::default().limits(JointKind::Prismatic).velocity);
        let screw = hinge(&JointGeometry::screw(axis, origin, 0.01));
        assert_eq!((screw.kind(), screw.motion), ("screw", Motion::Screws(0.01)));
    }

    #[test]
    fn the_guesses_are_those_that_the_rig_s_file_shows() {
        for (table, slides) in [("revolute", 0), ("prismatic", 1)] {
            let (_, shown) =
                Rig::DEFAULT_TEXT.split_once(&format!("# [mechanics.{table}]")).unwrap();
            let value = |key: &str| {
                let (_, rest) = shown.split_once(&format!("# {key} = ")).unwrap();
                rest.split_whitespace().next().unwrap().parse::<f64>().unwrap()
            };
            let guesses = [EFFORT[slides], DAMPING[slides], FRICTION[slides]];
            assert_eq!(["effort", "damping", "friction"].map(value), guesses, "{table}");
        }
    }

    #[test]
    fn configurations_reach_from_one_end_of_the_range_to_the_other() {
        let described = hinge(&JointGeometry::hinge(Vector3::x_axis(), Point3::origin()));
        assert_eq!(described.configurations(3), [-0.5, 0.5, 1.5]);
        assert_eq!(described.configurations(0), [-0.5, 1.5], "both ends at least");
    }

    #[test]
    fn what_does_not_move_cannot_be_described() {
        let fixed = Joint {
            kind: JointKind::Fixed,
            ..Joint::of(&JointGeometry::slide(Vector3::x_axis(), Point3::origin()))
        };
        let error = Hinge::new(&fixed, "box", &Pose::identity(), &Rig::default()).unwrap_err();
        assert!(error.to_string().contains("use --format json"), "{error}");
    }
}
