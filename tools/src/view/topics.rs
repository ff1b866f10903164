//! The topics, each with its schema.

use super::readings::JointReadings;
use foxglove::messages::{
    CameraCalibration, CompressedImage, FrameTransforms, JointStates, Log, PointCloud, PoseInFrame,
    RawImage, SceneUpdate,
};
use foxglove::{Channel, Context};
use std::sync::Arc;

/// What is written and sent.
pub struct Topics {
    pub color: Channel<CompressedImage>,
    pub depth: Channel<RawImage>,
    pub calibration: Channel<CameraCalibration>,
    /// How the camera stands upright.
    pub upright: Channel<FrameTransforms>,
    /// Parts in the camera.
    pub transforms: Channel<FrameTransforms>,
    /// Followed places by part.
    pub tracks: Channel<PointCloud>,
    /// The learned surface where it was recognised.
    pub surface: Channel<PointCloud>,
    /// Axes, and the paths of parts over their ranges.
    pub joints: Channel<SceneUpdate>,
    pub states: Channel<JointStates>,
    pub readings: Channel<JointReadings>,
    /// Moving parts at the target.
    pub ghost: Channel<PointCloud>,
    /// The object that was recognised best.
    pub pose: Channel<PoseInFrame>,
    pub log: Channel<Log>,
}

impl Topics {
    /// All topics of a context.
    pub fn new(context: &Arc<Context>) -> Self {
        let of = |topic: &str| context.channel_builder(topic);
        Self {
            color: of("/camera/color").build(),
            depth: of("/camera/depth").build(),
            calibration: of("/camera/calibration").build(),
            upright: of("/tf_static").build(),
            transforms: of("/tf").build(),
            tracks: of("/tracks").build(),
            surface: of("/surface").build(),
            joints: of("/joints").build(),
            states: of("/joint_states").build(),
            readings: of("/joint_readings").build(),
            ghost: of("/ghost").build(),
            pose: of("/object_pose").build(),
            log: of("/log").build(),
        }
    }
}
