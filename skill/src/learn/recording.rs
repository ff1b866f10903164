//! What the camera stages (tracking, ego-motion and keyframes) hand to a method that learns joints.
//! All three methods take the same [`Recording`].
//!
//! Frames are counted from 0. Points are in metres; `ego_motion` gives tracks in the frame of the
//! static background (the base), which is the camera frame of frame 0.

use super::ego_motion::EgoMotion;
use super::keyframes::Keyframes;
use super::tracking::TrackSet;

/// A demonstration, or the part of it that was recorded so far.
#[derive(Debug, Clone)]
pub struct Recording {
    /// Tracks in the camera frame, with the time of each frame.
    pub tracks: TrackSet,
    /// Motion of the camera, and all tracks in the base frame.
    pub ego_motion: EgoMotion,
    /// Frames that were kept whole, for free-space tests.
    pub keyframes: Keyframes,
}
