//! An object as it is shown in one frame, whether it is being learned, recognised or predicted.

use super::frame_names;
use crate::report::camera_from_part;
use linkage_skill::object::{Appearance, Joint, JointGeometry};
use linkage_skill::recognise::Recognised;
use linkage_skill::{ObjectModel, Pose};
use nalgebra::{Point3, Vector3};

/// How far beside its axis a joint's way is drawn where its part's surface is not known, metres.
const BESIDE_M: f64 = 0.2;

/// An object in one frame.
pub struct Shown {
    /// The object itself, by its name.
    pub name: String,
    /// The frame of its base; those of its parts and the names of its joints begin with it.
    pub frame: String,
    /// Where each part is, where that is known; the base's is that of the object frame.
    pub camera_from_part: Vec<Option<Pose>>,
    pub joints: Vec<ShownJoint>,
    /// How far each joint is, where that is known.
    pub configurations: Vec<Option<Configuration>>,
}

/// A joint of one.
pub struct ShownJoint {
    pub name: String,
    pub parent: usize,
    pub child: usize,
    /// In the object frame at configuration 0, as the parent carries it.
    pub line: JointGeometry,
    pub range: [f64; 2],
    /// A place of the part that it moves, in the object frame at configuration 0.
    pub anchor: Point3<f64>,
}

/// How far a joint is.
pub struct Configuration {
    pub q: f64,
    /// Standard deviation.
    pub deviation: Option<f64>,
}

impl Shown {
    /// A model whose parts are where they were tracked; no configuration is known yet.
    pub fn learned(
        model: &ObjectModel,
        camera_from_part: Vec<Option<Pose>>,
        appearance: Option<&Appearance>,
    ) -> Self {
        Self {
            name: model.object.clone(),
            frame: frame_names::of_object(&model.object),
            camera_from_part,
            joints: model.joints.iter().map(|j| ShownJoint::new(j, model, appearance)).collect(),
            configurations: model.joints.iter().map(|_| None).collect(),
        }
    }

    /// An object as it was recognised.
    pub fn recognised(
        model: &ObjectModel,
        found: &Recognised,
        appearance: Option<&Appearance>,
    ) -> Self {
        let known = |name: &str| {
            let state = found.joints.iter().find(|j| j.name == name)?;
            Some(Configuration { q: state.configuration?, deviation: state.deviation })
        };
        Self {
            configurations: model.joints.iter().map(|j| known(&j.name)).collect(),
            ..Self::learned(model, camera_from_part(model, found), appearance)
        }
    }
}

/// Objects that are shown together: each has frames of its own, those of one make too.
pub fn with_frames_of_their_own(mut shown: Vec<Shown>) -> Vec<Shown> {
    let frames = frame_names::of_objects(shown.iter().map(|s| s.name.as_str()));
    shown.iter_mut().zip(frames).for_each(|(shown, frame)| shown.frame = frame);
    shown
}

impl ShownJoint {
    fn new(joint: &Joint, model: &ObjectModel, appearance: Option<&Appearance>) -> Self {
        let line = joint.geometry();
        let grasp = model.parts.get(joint.child).and_then(|p| p.grasp).map(Point3::from);
        let anchor =
            grasp.or_else(|| middle_of(appearance?, joint.child)).unwrap_or_else(|| beside(&line));
        let Joint { name, parent, child, range, .. } = joint;
        let (name, parent, child, range) = (name.clone(), *parent, *child, *range);
        Self { name, parent, child, line, range, anchor }
    }
}

/// The middle of a part's surface, object frame.
fn middle_of(appearance: &Appearance, part: usize) -> Option<Point3<f64>> {
    let own = appearance.surfels.iter().filter(|s| usize::from(s.part) == part);
    let (count, sum) = own.fold((0_usize, Vector3::zeros()), |(n, sum), s| {
        (n + 1, sum + Vector3::from(s.point.map(f64::from)))
    });
    (count > 0).then(|| Point3::from(sum / count as f64))
}

/// A place beside a line.
fn beside(line: &JointGeometry) -> Point3<f64> {
    let (across, _) = linkage_skill::internals::orthonormal_basis(&line.axis);
    line.origin + across * BESIDE_M
}
