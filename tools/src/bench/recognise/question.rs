//! What the suite asks, and how right an answer is: stills of learned things, and a report against
//! the truth.

use super::stills::Still;
use crate::bench::dir::{ConfigurationScore, configuration_scores};
use crate::truth::Truth;
use linkage_driver::RgbdFrame;
use linkage_skill::internals::{DescribedFeature, distance_to_line};
use linkage_skill::object::{JointKind, StoredObject};
use linkage_skill::pose_from_array;
use linkage_skill::recognise::Recognised;
use nalgebra::{Point3, Vector3};
use serde::Serialize;

/// A still as it is asked about.
pub struct Question {
    pub still: Still,
    pub truth: Truth,
    pub frame: RgbdFrame,
    pub features: Vec<DescribedFeature>,
    /// Which learned thing it shows; `None`: none.
    pub number: Option<usize>,
}

/// A learned thing.
pub struct Learned {
    pub stored: StoredObject,
    pub truth: Truth,
}

/// How far the right object's report is from the truth.
#[derive(Serialize)]
pub struct Precision {
    /// False: a moving part is seen alone, and the report says so.
    pub base_known: bool,
    pub base_deg: f64,
    /// Where the base is, not where its frame begins: that is at the demonstration's camera.
    pub base_cm: f64,
    pub joints: Vec<ConfigurationScore>,
    /// Error of the axis' position, of hinges only.
    pub axis_cm: Vec<f64>,
}

impl Precision {
    /// The base where it is; where it is not known, an axis. That of a slide has no place.
    pub fn is_right(&self) -> bool {
        if self.base_known {
            return self.base_deg < 5.0 && self.base_cm < 5.0;
        }
        let has_no_place = self.axis_cm.is_empty();
        self.joints.iter().any(|j| j.axis_deg < 3.0)
            && (has_no_place || self.axis_cm.iter().any(|cm| *cm < 2.0))
    }
}

/// Things stand where they were demonstrated: the demonstration's first camera is the object
/// frame.
pub fn precision(found: &Recognised, truth: &Truth, demonstrated: &Truth) -> Option<Precision> {
    let world_from_camera = pose_from_array(truth.world_from_camera.last()?)?;
    let world_from_object = pose_from_array(demonstrated.world_from_camera.first()?)?;
    let camera_from_object = world_from_camera.inverse() * world_from_object;
    let off = camera_from_object.inverse() * pose_from_array(&found.camera_from_object)?;
    let base = truth.parts.first()?;
    let base_at = camera_from_object.inverse()
        * pose_from_array(base.camera_from_part.last()?)?
        * Point3::from(base.centroid);
    let axis_cm = found
        .joints
        .iter()
        .filter(|j| j.kind == JointKind::Revolute)
        .filter_map(|j| {
            let place = Point3::from(j.origin);
            truth
                .joints
                .iter()
                .map(|t| {
                    let (o, a) = (Point3::from(t.origin_last), Vector3::from(t.axis_last));
                    100.0 * distance_to_line(&o, &a, &place)
                })
                .min_by(f64::total_cmp)
        })
        .collect();
    Some(Precision {
        base_deg: off.rotation.angle().to_degrees(),
        base_known: found.base_known,
        base_cm: 100.0 * (off * base_at - base_at).norm(),
        joints: configuration_scores(found, truth, demonstrated),
        axis_cm,
    })
}
