//! How frames of coordinates stand to each other: `/tf_static`, and the extrinsics that RealSense's
//! own recordings hold.

use super::messages::header;
use super::wire::{WireError, WireFormat, WireReader};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use std::collections::BTreeMap;

/// Most transforms that are kept: a robot has some hundred.
pub const MAX_TRANSFORMS: usize = 10_000;
/// Most steps from a frame to its root.
const MAX_STEPS: usize = 100;

/// How a frame stands in another one.
#[derive(Debug, Clone, PartialEq)]
pub struct Transform {
    /// The frame that carries it.
    pub parent: String,
    /// The frame itself.
    pub child: String,
    /// Maps coordinates of the child into the parent.
    pub parent_from_child: Isometry3<f64>,
}

/// Frames that stand fixed to each other.
#[derive(Debug, Default)]
pub struct FrameTree {
    /// Each frame's parent and `parent_from_child`.
    parents: BTreeMap<String, (String, Isometry3<f64>)>,
}

impl FrameTree {
    /// Takes transforms; a later one of the same child takes the place of an earlier one.
    pub fn add(&mut self, transforms: Vec<Transform>) {
        for Transform { parent, child, parent_from_child } in transforms {
            if self.parents.len() < MAX_TRANSFORMS {
                self.parents.insert(child, (parent, parent_from_child));
            }
        }
    }

    /// Maps coordinates of the frame `from` into the frame `to`; `None` where nothing joins them.
    pub fn between(&self, to: &str, from: &str) -> Option<Isometry3<f64>> {
        let (to_root, root_from_to) = self.root(to);
        let (from_root, root_from_from) = self.root(from);
        (to_root == from_root).then(|| root_from_to.inverse() * root_from_from)
    }

    /// The root of a frame, and `root_from_frame`.
    fn root<'t>(&'t self, frame: &'t str) -> (&'t str, Isometry3<f64>) {
        let (mut root, mut root_from_frame) = (frame, Isometry3::identity());
        for _ in 0..MAX_STEPS {
            let Some((parent, parent_from_root)) = self.parents.get(root) else { break };
            root_from_frame = parent_from_root * root_from_frame;
            root = parent;
        }
        (root, root_from_frame)
    }
}

/// The transforms of a `tf2_msgs/TFMessage`.
///
/// # Errors
/// [`WireError`].
pub fn parse_transforms(bytes: &[u8], format: WireFormat) -> Result<Vec<Transform>, WireError> {
    let mut reader = WireReader::new(bytes, format)?;
    let mut transforms = Vec::new();
    for _ in 0..reader.u32("transforms")? {
        let parent = header(&mut reader, format)?.frame.to_owned();
        let child = reader.text("child_frame_id")?.to_owned();
        transforms.push(Transform { parent, child, parent_from_child: transform(&mut reader)? });
    }
    Ok(transforms)
}

/// A `geometry_msgs/Transform` that is a message of its own.
///
/// # Errors
/// [`WireError`].
pub fn parse_transform(bytes: &[u8], format: WireFormat) -> Result<Isometry3<f64>, WireError> {
    transform(&mut WireReader::new(bytes, format)?)
}

fn transform(reader: &mut WireReader<'_>) -> Result<Isometry3<f64>, WireError> {
    pose_of(reader.f64s("translation")?, reader.f64s("rotation")?)
}

/// A pose of a translation and a quaternion, whose `w` is last.
///
/// # Errors
/// [`WireError::Value`] for what is not finite, and for a quaternion of nothing.
pub fn pose_of(
    [x, y, z]: [f64; 3],
    [qx, qy, qz, qw]: [f64; 4],
) -> Result<Isometry3<f64>, WireError> {
    let rotation = UnitQuaternion::try_new(Quaternion::new(qw, qx, qy, qz), 1e-6);
    let is_finite = [x, y, z, qx, qy, qz, qw].iter().all(|v| v.is_finite());
    match rotation {
        Some(rotation) if is_finite => {
            Ok(Isometry3::from_parts(Translation3::new(x, y, z), rotation))
        }
        _ => Err(WireError::Value {
            field: "transform",
            value: format!("{:?}", [x, y, z, qx, qy, qz, qw]),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bag::messages::tests::text;

    fn message(parent: &str, child: &str, xyz: [f64; 3], q: [f64; 4]) -> Vec<u8> {
        let mut bytes = 1_u32.to_le_bytes().to_vec();
        bytes.extend([0; 12]);
        bytes.extend(text(parent));
        bytes.extend(text(child));
        bytes.extend(xyz.iter().chain(&q).flat_map(|v| v.to_le_bytes()));
        bytes
    }

    fn read(bytes: &[u8]) -> Result<Vec<Transform>, WireError> {
        parse_transforms(bytes, WireFormat::Ros1)
    }

    #[test]
    fn frames_are_joined_through_their_root() {
        let mut tree = FrameTree::default();
        let half = 0.5_f64.sqrt();
        let turned = [0.0, 0.0, half, half];
        for (child, xyz, q) in
            [("color", [1.0, 0.0, 0.0], turned), ("depth", [0.0, 2.0, 0.0], [0.0, 0.0, 0.0, 1.0])]
        {
            tree.add(read(&message("base", child, xyz, q)).unwrap());
        }
        // The origin of depth lies at (0, 2, 0) of the base, (-1, 2, 0) from colour's origin, and
        // colour's x axis is the base's y axis.
        let origin = tree.between("color", "depth").unwrap().translation.vector;
        assert!((origin - nalgebra::Vector3::new(2.0, 1.0, 0.0)).norm() < 1e-12, "{origin}");
        assert!(tree.between("color", "elsewhere").is_none());
    }

    #[test]
    fn a_circle_of_frames_ends() {
        let mut tree = FrameTree::default();
        for (parent, child) in [("a", "b"), ("b", "a")] {
            let bytes = message(parent, child, [0.0; 3], [0.0, 0.0, 0.0, 1.0]);
            tree.add(read(&bytes).unwrap());
        }
        assert!(tree.between("a", "c").is_none());
    }

    #[test]
    fn a_rotation_of_nothing_and_a_cut_message_are_errors() {
        let bytes = message("a", "b", [0.0; 3], [0.0; 4]);
        assert!(read(&bytes).is_err());
        assert!(read(&bytes[..40]).is_err());
    }
}
