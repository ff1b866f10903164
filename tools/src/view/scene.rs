//! Joints as lines in space: the axis, the path of the part over its range, and where on it the
//! part is.

use super::convert::{colour, place, pose, timestamp, translation_and_rotation};
use super::frame_names::{self, CAMERA};
use super::shown::{Configuration, Shown, ShownJoint};
use crate::report::{amount, part_colour};
use foxglove::messages::line_primitive::Type;
use foxglove::messages::{
    Duration, FrameTransform, LinePrimitive, Pose as Placed, SceneEntity, SceneUpdate,
    SpherePrimitive, TextPrimitive, Vector3,
};
use linkage_skill::Pose;
use nalgebra::Point3;

/// Half of a drawn axis, metres.
const AXIS_HALF_M: f64 = 0.25;
/// Pieces of the way over a range.
const STEPS: usize = 32;
/// Thickness of lines, metres.
const LINE_M: f64 = 0.006;
/// Diameter of the mark at the present configuration, metres.
const MARK_M: f64 = 0.04;
/// Height of letters, metres.
const LETTERS_M: f64 = 0.04;
/// Time after which what is no longer updated vanishes.
const LIFETIME_S: i32 = 2;

/// The frames of an object's parts in the camera.
pub fn transforms(utime: i64, shown: &Shown) -> Vec<FrameTransform> {
    let of = |(part, pose): (usize, &Option<Pose>)| {
        let (translation, rotation) = translation_and_rotation(pose.as_ref()?);
        Some(FrameTransform {
            timestamp: Some(timestamp(utime)),
            parent_frame_id: CAMERA.to_owned(),
            child_frame_id: frame_names::of_part(&shown.frame, part),
            translation: Some(translation),
            rotation: Some(rotation),
        })
    };
    shown.camera_from_part.iter().enumerate().filter_map(of).collect()
}

/// The joints of objects.
pub fn joints<'s>(utime: i64, all: impl IntoIterator<Item = &'s Shown>) -> SceneUpdate {
    let of = |shown: &'s Shown| {
        let known = shown.joints.iter().zip(&shown.configurations);
        known.map(|(joint, configuration)| entity(utime, shown, joint, configuration.as_ref()))
    };
    SceneUpdate { deletions: Vec::new(), entities: all.into_iter().flat_map(of).collect() }
}

/// One joint, in the frame of the part that carries it.
fn entity(
    utime: i64,
    shown: &Shown,
    joint: &ShownJoint,
    configuration: Option<&Configuration>,
) -> SceneEntity {
    let rgb = part_colour(joint.child);
    let half = joint.line.axis.into_inner() * AXIS_HALF_M;
    let axis = [joint.line.origin - half, joint.line.origin + half];
    let [low, high] = joint.range;
    let at = |q: f64| joint.line.motion(q) * joint.anchor;
    let way: Vec<Point3<f64>> =
        (0..=STEPS).map(|i| at(low + (high - low) * i as f64 / STEPS as f64)).collect();
    let marks = configuration.map(|c| SpherePrimitive {
        pose: Some(placed(&at(c.q))),
        size: Some(Vector3 { x: MARK_M, y: MARK_M, z: MARK_M }),
        color: Some(colour(rgb, 1.0)),
    });
    let label = TextPrimitive {
        pose: Some(placed(&at(configuration.map_or(high, |c| c.q)))),
        billboard: true,
        font_size: LETTERS_M,
        scale_invariant: false,
        color: Some(colour(rgb, 1.0)),
        text: label(joint, configuration),
    };
    SceneEntity {
        timestamp: Some(timestamp(utime)),
        frame_id: frame_names::of_part(&shown.frame, joint.parent),
        id: format!("{}/{}", shown.frame, joint.name),
        lifetime: Some(Duration::new(LIFETIME_S, 0)),
        frame_locked: true,
        lines: vec![line(&axis, rgb, 1.0), line(&way, rgb, 0.7)],
        spheres: marks.into_iter().collect(),
        texts: vec![label],
        ..SceneEntity::default()
    }
}

/// "joint1 34° ± 1.0°".
fn label(joint: &ShownJoint, configuration: Option<&Configuration>) -> String {
    let name = &joint.name;
    let of = |q: f64| amount(joint.line.kind, q);
    match configuration {
        Some(Configuration { q, deviation: Some(d) }) => format!("{name} {} ± {}", of(*q), of(*d)),
        Some(Configuration { q, deviation: None }) => format!("{name} {}", of(*q)),
        None => format!("{name} {} to {}", of(joint.range[0]), of(joint.range[1])),
    }
}

fn line(places: &[Point3<f64>], rgb: [u8; 3], opacity: f64) -> LinePrimitive {
    LinePrimitive {
        r#type: Type::LineStrip.into(),
        pose: Some(pose(&Pose::identity())),
        thickness: LINE_M,
        scale_invariant: false,
        points: places.iter().map(place).collect(),
        color: Some(colour(rgb, opacity)),
        ..LinePrimitive::default()
    }
}

fn placed(at: &Point3<f64>) -> Placed {
    pose(&Pose::from_parts(at.coords.into(), Default::default()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_skill::object::JointGeometry;
    use nalgebra::Vector3 as V;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn the_way_of_a_door_is_the_arc_of_its_handle_and_the_mark_is_on_it() {
        let door = ShownJoint {
            name: "joint1".to_owned(),
            parent: 0,
            child: 1,
            line: JointGeometry::hinge(V::y_axis(), Point3::origin()),
            range: [0.0, FRAC_PI_2],
            anchor: Point3::new(0.5, 0.0, 0.0),
        };
        let shown = Shown {
            name: "door".into(),
            frame: "door".into(),
            camera_from_part: vec![Some(Pose::identity())],
            joints: vec![door],
            configurations: vec![Some(Configuration { q: FRAC_PI_2, deviation: Some(0.0175) })],
        };
        let update = joints(0, [&shown]);
        let entity = &update.entities[0];
        assert_eq!((entity.id.as_str(), entity.frame_id.as_str()), ("door/joint1", "door"));
        let arc = &entity.lines[1].points;
        assert!(arc.iter().all(|p| (p.x.hypot(p.z) - 0.5).abs() < 1e-9), "{arc:?}");
        let mark = entity.spheres[0].pose.as_ref().and_then(|p| p.position).unwrap();
        assert!((mark.z + 0.5).abs() < 1e-9 && mark.x.abs() < 1e-9, "{mark:?}");
        assert_eq!(entity.texts[0].text, "joint1 90° ± 1.0°");
    }
}
