//! Learning from a demonstration: the training phase of the paper (its Fig. 3). [`Learner`] takes
//! the frames one by one; [`Learner::finish`] returns what was learned.
//!
//! In: RGB-D frames in the order of time, and the configuration.
//! Out: a [`Demonstration`]: the joints in the object frame, and the pose of each part in each
//! camera frame; metres, radians.
//! From: paper, section III. The configuration names the method: the paper's, the baseline of Katz
//! et al., or ours (`joint_search`, then `plane_hinges` and `vacated`).

pub(crate) mod appearance;
pub(crate) mod attachment;
mod background_search;
mod best_path;
pub(crate) mod config;
pub(crate) mod demonstration;
mod edge_on;
pub(crate) mod ego_motion;
mod episodes;
mod followed_surface;
pub(crate) mod free_space;
pub(crate) mod grasp_point;
pub(crate) mod joint_search;
#[cfg(feature = "paper")]
pub(crate) mod katz;
pub(crate) mod keyframes;
pub(crate) mod learned_joint;
mod line_step;
mod one_surface;
#[cfg(feature = "paper")]
pub(crate) mod paper;
pub(crate) mod plane_hinges;
pub(crate) mod recording;
pub(crate) mod stage_times;
pub(crate) mod tracking;
mod vacated;

use crate::math::rigid::Pose;
use crate::object::model::{Joint, MODEL_SCHEMA, ObjectModel, Part, ReferenceFrame};
use crate::vision_error::VisionError;
use background_search::{BackgroundSearch, Snapshot};
pub use config::LearnSettings;
use config::Method;
use demonstration::assemble;
use ego_motion::EgoMotionEstimator;
use joint_search::WarmStart;
pub use keyframes::Keyframes;
use learned_joint::LearnedJoints;
use linkage_frames::RgbdFrame;
use recording::Recording;
pub use stage_times::StageTimes;
use tracking::{Tracker, informative_frames};

pub use demonstration::Demonstration;
pub use learned_joint::RejectedCandidate;

/// Reason why nothing can be learned from a demonstration, or why a frame is refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LearnError {
    /// The demonstration has too few frames.
    #[error("the demonstration has {found} frames, at least {needed} are needed")]
    TooShort {
        /// Number of frames that were given.
        found: usize,
        /// Number of frames that are needed.
        needed: usize,
    },
    /// A frame is not later than the frame before it.
    #[error("frame {frame} is not later than the one before it ({before} us, then {now} us)")]
    TimeRunsBackwards {
        /// Number of the refused frame, counted from 0 over the frames that are kept.
        frame: usize,
        /// Time of the frame before, microseconds.
        before: i64,
        /// Time of the refused frame, microseconds.
        now: i64,
    },
    /// No feature has depth in enough frames to be a track.
    #[error(
        "no frame has depth at any feature: is the depth camera covered or depth_units_per_metre wrong?"
    )]
    NoDepth,
    /// The vision library failed.
    #[error("vision: {0}")]
    Vision(#[from] VisionError),
}

/// Largest number of frames that are kept whole, for appearance and free-space tests; it bounds the
/// memory.
const KEYFRAMES: usize = 48;
/// Frames from the start of one background search to the start of the next. A live estimate is less
/// than twice as many frames old, unless frames were removed since.
const SEARCH_EVERY: usize = 15;
/// Smallest number of frames of a demonstration.
const MIN_FRAMES: usize = 10;

/// Learns from a demonstration whose frames arrive one after the other.
pub struct Learner {
    settings: LearnSettings,
    tracker: Tracker,
    base: EgoMotionEstimator,
    keyframes: Keyframes,
    background: BackgroundSearch,
    first_utime: i64,
    last_utime: Option<i64>,
    times: StageTimes,
}

impl Learner {
    /// Creates a learner without a live estimate.
    pub fn new(settings: impl Into<LearnSettings>) -> Self {
        Self::with_progress(settings.into(), false)
    }

    /// Creates a learner that has a [`Self::current_estimate`] while the demonstration runs, for a
    /// twentieth more work.
    pub fn live(settings: impl Into<LearnSettings>) -> Self {
        Self::with_progress(settings.into(), true)
    }

    fn with_progress(settings: LearnSettings, reports_progress: bool) -> Self {
        let every = match settings.method {
            Method::DirectJoints => SEARCH_EVERY,
            #[cfg(feature = "paper")]
            Method::Paper | Method::Katz => 0,
        };
        Self {
            tracker: Tracker::new(settings.track.clone()),
            base: EgoMotionEstimator::new(settings.seed),
            keyframes: Keyframes::new(KEYFRAMES),
            background: BackgroundSearch::new(every, reports_progress),
            settings,
            first_utime: 0,
            last_utime: None,
            times: StageTimes::default(),
        }
    }

    /// Takes the next frame: tracks its features, estimates the motion of the camera, and starts a
    /// background search if one is due.
    ///
    /// # Errors
    /// [`LearnError::TimeRunsBackwards`], after which the learner stays usable;
    /// [`LearnError::Vision`].
    pub fn push(&mut self, frame: &RgbdFrame) -> Result<(), LearnError> {
        self.make_room();
        let index = self.tracker.frames();
        if let Some(before) = self.last_utime
            && frame.utime <= before
        {
            return Err(LearnError::TimeRunsBackwards { frame: index, before, now: frame.utime });
        }
        if self.last_utime.is_none() {
            self.first_utime = frame.utime;
        }
        self.last_utime = Some(frame.utime);
        self.times.measure("track", || self.tracker.push(frame)).map_err(VisionError::new)?;
        self.times.measure("camera", || self.base.push(&self.tracker.lifted(), frame));
        self.keyframes.offer(index, frame);
        let Self { tracker, base, keyframes, settings, background, times, .. } = self;
        let snapshot = || Snapshot {
            tracks: tracker.snapshot(),
            camera_from_base: base.camera_from_base().to_vec(),
            keyframes: keyframes.clone(),
        };
        times.measure("ahead", || background.offer(index + 1, settings, snapshot));
        Ok(())
    }

    /// Removes frames in which little moves when the largest number of frames is reached, so that a
    /// demonstration may last for any time.
    fn make_room(&mut self) {
        let room = self.settings.track.max_frames.max(4 * MIN_FRAMES);
        if self.tracker.frames() < room {
            return;
        }
        let mut marks = informative_frames(self.tracker.seen(), room / 2);
        // The frames of keyframes are kept: their images cannot be read again.
        self.keyframes.iter().for_each(|(index, _)| marks[index] = true);
        let numbers = self.tracker.keep_frames(&marks);
        self.base.keep_frames(&marks, &numbers);
        self.keyframes.keep_frames(&marks);
        self.background.start_over();
        tracing::debug!(of = marks.len(), kept = self.tracker.frames(), "frames forgotten");
    }

    /// The tracker, to draw the features that it follows.
    #[doc(hidden)]
    pub fn tracker(&self) -> &Tracker {
        &self.tracker
    }

    /// Pose of the object frame (the camera frame of the first frame) in the camera frame of the
    /// newest frame; `None` before the first frame.
    pub fn camera_from_object(&self) -> Option<Pose> {
        self.base.camera_from_base().last().copied()
    }

    /// The present model of a [`Self::live`] learner, with the joints that a search over the first
    /// part of the demonstration has accepted. How many frames that part has depends on the speed
    /// of this machine.
    #[must_use]
    pub fn current_estimate(&self, object: &str) -> ObjectModel {
        let joints = self.background.current_estimate();
        let part = |(i, _): (usize, &Joint)| Part::new(i + 1, format!("part{}", i + 1), 0);
        let base = Part::new(0, "base", self.tracker.live_count());
        let parts = std::iter::once(base).chain(joints.iter().enumerate().map(part)).collect();
        ObjectModel {
            schema: MODEL_SCHEMA.to_owned(),
            object: object.to_owned(),
            reference_frame: ReferenceFrame::at_camera(self.first_utime as f64 * 1e-6),
            parts,
            joints,
            demonstrations: 0,
            profile: self.settings.profile.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        }
    }

    /// Learns from all frames that were pushed.
    ///
    /// # Errors
    /// [`LearnError::TooShort`], [`LearnError::NoDepth`]. A demonstration in which nothing
    /// articulated moves is no error: its model has no joints.
    pub fn finish(self, object: &str) -> Result<Demonstration, LearnError> {
        let Self { settings, tracker, base, keyframes, background, mut times, .. } = self;
        if tracker.frames() < MIN_FRAMES {
            return Err(LearnError::TooShort { found: tracker.frames(), needed: MIN_FRAMES });
        }
        let tracks = tracker.finish();
        if tracks.tracks.is_empty() {
            return Err(LearnError::NoDepth);
        }
        let earlier = background.settle();
        let poses = base.camera_from_base().to_vec();
        let sensor = keyframes.depth_sensor();
        let ego_motion =
            times.measure("base", || earlier.ego_motion.extended(&tracks, poses, sensor));
        let recording = Recording { tracks, ego_motion, keyframes };
        let learned = learn_joints(&recording, &earlier.warm_start, &settings, &mut times);
        Ok(assemble(object, settings.profile, recording, learned, times))
    }
}

/// The joints of a recording, by the method that the configuration names.
fn learn_joints(
    recording: &Recording,
    earlier: &WarmStart,
    settings: &LearnSettings,
    times: &mut StageTimes,
) -> LearnedJoints {
    match settings.method {
        #[cfg(feature = "paper")]
        Method::Paper => paper::learn(recording, settings.seed, times),
        #[cfg(feature = "paper")]
        Method::Katz => times.measure("katz", || katz::learn(recording)),
        Method::DirectJoints => {
            let search = settings.search();
            let found =
                times.measure("joints", || joint_search::learn(recording, earlier, &search));
            let found = match settings.planes.enabled {
                true => times.measure("planes", || plane_hinges::complete(found, recording)),
                false => found,
            };
            let found = match settings.planes.vacated {
                true => times.measure("vacated", || vacated::complete(found, recording)),
                false => found,
            };
            match settings.planes.enabled {
                true => times.measure("edge on", || edge_on::complete(found, recording)),
                false => found,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::{painted, patches};

    /// Time from a frame to the next, microseconds.
    const INTERVAL_US: i64 = 33_333;

    /// A painted wall at this depth, metres, which rests.
    fn wall(utime: i64, depth: f64) -> RgbdFrame {
        painted(utime, |_, _| depth, |x, y| patches(1, 1.5 * x, 1.5 * y))
    }

    /// A learner that has seen so many frames of the wall.
    fn after(frames: i64, depth: f64, settings: LearnSettings) -> Learner {
        let mut learner = Learner::new(settings);
        for frame in 0..frames {
            learner.push(&wall(7_000_000 + INTERVAL_US * frame, depth)).unwrap();
        }
        learner
    }

    #[test]
    fn a_few_frames_are_too_short_a_demonstration() {
        let learner = after(MIN_FRAMES as i64 - 1, 1.5, LearnSettings::default());
        let refused = learner.finish("wall").err();
        assert!(matches!(refused, Some(LearnError::TooShort { found: 9, needed: 10 })));
    }

    #[test]
    fn frames_without_depth_teach_nothing() {
        let refused = after(12, f64::NAN, LearnSettings::default()).finish("wall").err();
        assert!(matches!(refused, Some(LearnError::NoDepth)));
    }

    #[test]
    fn what_rests_is_learned_without_a_joint_and_the_camera_stays_where_it_is() {
        let learner = after(20, 1.5, LearnSettings::default());
        let camera = learner.camera_from_object().unwrap();
        assert!(camera.translation.vector.norm() < 1e-3 && camera.rotation.angle() < 1e-3);
        let learned = learner.finish("wall").unwrap();
        assert!(learned.model.joints.is_empty() && learned.rejections.is_empty());
        assert_eq!((learned.model.object.as_str(), learned.model.parts.len()), ("wall", 1));
        assert_eq!(learned.frame_utimes.len(), 20);
        assert!(learned.why_nothing().starts_with("nothing articulated moves"));
    }

    #[test]
    fn a_frame_that_is_not_later_is_refused_and_the_next_one_is_taken() {
        let mut learner = Learner::new(LearnSettings::default());
        learner.push(&wall(500, 1.5)).unwrap();
        for now in [500, 499, i64::MIN] {
            let refused = learner.push(&wall(now, 1.5)).err();
            let Some(LearnError::TimeRunsBackwards { frame: 1, before: 500, now: told }) = refused
            else {
                panic!("{refused:?}")
            };
            assert_eq!(told, now);
        }
        learner.push(&wall(501, 1.5)).unwrap();
        assert_eq!(learner.tracker().frames(), 2);
    }

    #[test]
    fn memory_holds_no_more_frames_than_are_asked_for_or_are_kept_whole() {
        for (asked, held) in [(60, 60), (0, KEYFRAMES + 1)] {
            let mut settings = LearnSettings::default();
            settings.track.max_frames = asked;
            let mut learner = after(0, 1.5, settings);
            for frame in 0..100 {
                learner.push(&wall(INTERVAL_US * frame, 1.5)).unwrap();
                let frames = learner.tracker().frames();
                assert!(frames <= held, "{frames} frames, {asked} are asked for");
                let keyframes = learner.keyframes.iter().map(|(frame, _)| frame);
                assert!(keyframes.max().is_some_and(|last| last < frames));
                assert_eq!(learner.base.camera_from_base().len(), frames);
            }
        }
    }

    #[test]
    fn before_anything_is_found_the_estimate_is_a_base_in_the_frame_of_the_first_camera() {
        let nothing = Learner::live(LearnSettings::default());
        assert!(nothing.camera_from_object().is_none());
        assert!(nothing.current_estimate("wall").joints.is_empty());
        let model = after(3, 1.5, LearnSettings::default()).current_estimate("wall");
        assert_eq!((model.object.as_str(), model.schema.as_str()), ("wall", MODEL_SCHEMA));
        assert!(model.joints.is_empty());
        assert_eq!((model.parts.len(), model.parts[0].name.as_str()), (1, "base"));
        assert!(model.parts[0].features > 0);
        assert!((model.reference_frame.t - 7.0).abs() < 1e-9, "seconds of the first frame");
    }
}
