//! Learning from a demonstration: the paper's training phase (its Fig. 3), as one type that
//! takes frames as they come and one function that finishes.

pub mod appearance;
mod background_search;
pub mod demonstration;
pub mod ego_motion;
pub mod free_space;
pub mod grasp_point;
pub mod joint_search;
pub mod katz;
pub mod keyframes;
pub mod learned_joint;
pub mod paper;
pub mod plane_hinges;
pub mod stage_times;
pub mod tracking;

use crate::config::{Method, SkillConfig};
use crate::learn::demonstration::{Demonstration, assemble};
use crate::object::model::{Joint, MODEL_SCHEMA, ObjectModel, Part, ReferenceFrame};
use background_search::{BackgroundSearch, Snapshot};
use ego_motion::EgoMotionEstimator;
use joint_search::Watched;
use keyframes::Keyframes;
use linkage_driver::RgbdFrame;
use stage_times::StageTimes;
use tracking::{Tracker, telling_frames};

/// A demonstration that nothing can be learned from.
#[derive(Debug, thiserror::Error)]
pub enum LearnError {
    /// Too few frames.
    #[error("the demonstration has {found} frames, at least {needed} are needed")]
    TooShort {
        /// Frames given.
        found: usize,
        /// Frames needed.
        needed: usize,
    },
    /// Time stands still or runs backwards.
    #[error("frame {frame} is not later than the one before it ({before} us, then {now} us)")]
    TimeRunsBackwards {
        /// Number of the frame.
        frame: usize,
        /// Time of the frame before.
        before: i64,
        /// Its time.
        now: i64,
    },
    /// No depth at all.
    #[error(
        "no frame has depth at any feature: is the depth camera covered or depth_units_per_metre wrong?"
    )]
    NoDepth,
    /// The vision library failed.
    #[error("vision: {0}")]
    Vision(#[from] opencv::Error),
}

/// Fewest frames of a demonstration.
const MIN_FRAMES: usize = 10;

/// Takes the frames of a demonstration, one after the other.
pub struct Learner {
    config: SkillConfig,
    tracker: Tracker,
    base: EgoMotionEstimator,
    keyframes: Keyframes,
    ahead: BackgroundSearch,
    first_utime: i64,
    last_utime: Option<i64>,
    times: StageTimes,
}

impl Learner {
    /// A learner that has seen nothing.
    pub fn new(config: &SkillConfig) -> Self {
        Self::telling(config, false)
    }

    /// A learner that can tell its best guess while the demonstration runs, for a twentieth more
    /// work.
    pub fn live(config: &SkillConfig) -> Self {
        Self::telling(config, true)
    }

    fn telling(config: &SkillConfig, tells: bool) -> Self {
        let every = match config.learn.way {
            Method::DirectJoints => config.learn.search_every,
            Method::Paper | Method::Katz => 0,
        };
        Self {
            tracker: Tracker::new(config.track.clone()),
            base: EgoMotionEstimator::new(&config.base, config.seed),
            keyframes: Keyframes::new(config.learn.keyframes),
            ahead: BackgroundSearch::new(every, tells),
            config: config.clone(),
            first_utime: 0,
            last_utime: None,
            times: StageTimes::default(),
        }
    }

    /// Takes the next frame.
    ///
    /// # Errors
    /// [`LearnError::TimeRunsBackwards`]; the learner stays usable.
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
        self.times.measure("track", || self.tracker.push(frame))?;
        self.times.measure("camera", || self.base.push(&self.tracker.lifted()));
        self.keyframes.offer(index, frame);
        let Self { tracker, base, keyframes, config, ahead, times, .. } = self;
        let snapshot = || Snapshot {
            set: tracker.snapshot(),
            camera_from_base: base.camera_from_base().to_vec(),
            keyframes: keyframes.clone(),
        };
        times.measure("ahead", || ahead.offer(index + 1, config, snapshot));
        Ok(())
    }

    /// Forgets frames that tell little when there are as many as memory is kept for, so that a
    /// demonstration may last as long as it likes.
    fn make_room(&mut self) {
        let room = self.config.track.max_frames.max(4 * MIN_FRAMES);
        if self.tracker.frames() < room {
            return;
        }
        let mut marks = telling_frames(self.tracker.seen(), room / 2);
        // Whole frames that were kept are kept on: their pictures cannot be had again.
        self.keyframes.iter().for_each(|(index, _)| marks[index] = true);
        let numbers = self.tracker.keep_frames(&marks);
        self.base.keep_frames(&marks, &numbers);
        self.keyframes.keep_frames(&marks);
        self.ahead.start_over();
        tracing::debug!(of = marks.len(), kept = self.tracker.frames(), "frames forgotten");
    }

    /// The tracker, for drawing what it follows.
    pub fn tracker(&self) -> &Tracker {
        &self.tracker
    }

    /// The best guess of a [`Self::live`] learner: joints that a search over the first part of the
    /// demonstration believes in. How long that part is depends on how fast this machine is.
    pub fn current_estimate(&self, object: &str) -> ObjectModel {
        let joints = self.ahead.current_estimate();
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
            profile: self.config.profile.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        }
    }

    /// Learns from what was seen.
    ///
    /// # Errors
    /// [`LearnError::TooShort`], [`LearnError::NoDepth`]. A demonstration in which nothing
    /// articulated moves is no error: its model has no joints.
    pub fn finish(self, object: &str) -> Result<Demonstration, LearnError> {
        let Self { config, tracker, base, keyframes, ahead, mut times, .. } = self;
        if tracker.frames() < MIN_FRAMES {
            return Err(LearnError::TooShort { found: tracker.frames(), needed: MIN_FRAMES });
        }
        let set = tracker.finish();
        if set.tracks.is_empty() {
            return Err(LearnError::NoDepth);
        }
        let poses = base.camera_from_base().to_vec();
        let earlier = ahead.settle();
        let base = times.measure("base", || earlier.base.extended(&set, poses, &config.base));
        let joints = match config.learn.way {
            Method::Paper => paper::from_clusters(&set, &base, &keyframes, &config, &mut times),
            Method::Katz => {
                times.measure("katz", || crate::learn::katz::learn(&set, &base, &config.katz))
            }
            Method::DirectJoints => {
                let watched =
                    Watched { set: &set, base: &base, keyframes: &keyframes, config: &config };
                let joints = times.measure("joints", || watched.joints(&earlier.memory));
                if config.planes.enabled {
                    times.measure("planes", || {
                        plane_hinges::complete(joints, &set, &base, &keyframes, &config)
                    })
                } else {
                    joints
                }
            }
        };
        Ok(assemble(object, &config, set, &base, joints, keyframes, times))
    }
}
