//! The core of Linkage: learns how articulated things move, recognises them, predicts their motion.
//! Frames and configuration in, values out; no camera, socket or clock.
//!
//! Metres, radians, microseconds. Camera frame: x right, y down, z forward. A joint's configuration is
//! 0 where its demonstration began.
//!
//! # Features
//! Both are on by default. `paper`: the paper's way of learning and its baseline's, with which the
//! profiles `paper` and `katz` can be loaded. `store`: objects in a SQLite file, and a library of many.
//!
//! # Learn
//! A [`Learner`] takes the frames of one demonstration and tells the joints that it shows.
//!
//! ```
//! use linkage_skill::object::JointKind;
//! use linkage_skill::{Learner, SkillConfig};
//! # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/panel.rs"));
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//!
//! let mut learner = Learner::new(&SkillConfig::default());
//! // Frames of a camera or of a recording; here a panel that slides by 0.3 m is made up.
//! for frame in panel_that_opens() {
//!     learner.push(&frame)?;
//! }
//! let panel = learner.finish("panel")?;
//!
//! let joint = &panel.model.joints[0];
//! assert_eq!(joint.kind, JointKind::Prismatic);
//! assert!(joint.axis[0] > 0.99, "it slides to the right");
//! let travel_m = joint.range[1] - joint.range[0];
//! assert!((travel_m - 0.3).abs() < 0.02);
//! println!("{} opens by {travel_m:.2} {}", joint.name, joint.kind.unit());
//! # Ok(())
//! # }
//! ```
//!
//! Motion that something else has tracked, such as markers, is fitted by
//! [`articulation::fit_models`]:
//!
//! ```
//! use linkage_skill::Pose;
//! use linkage_skill::articulation::{FitError, PoseSample, fit_models};
//! use linkage_skill::object::JointKind;
//!
//! // A drawer that is pulled by 8 mm a frame.
//! let poses = (0..40).map(|i| (f64::from(i) / 30.0, Pose::translation(0.0, 0.0, 1.5 - 0.008 * f64::from(i))));
//! let samples: Vec<PoseSample> = poses.map(|(t, pose)| PoseSample::from_pose(t, &pose)).collect();
//! let best = &fit_models(&samples)?[0];
//! assert_eq!(best.geometry.kind, JointKind::Prismatic);
//! # Ok::<(), FitError>(())
//! ```
//!
//! # Recognise
//! [`recognise::recognise`] looks for known objects in a [`recognise::Scene`], which is one frame.
//!
//! ```
//! use linkage_skill::recognise::{KnownObject, Scene, recognise};
//! use linkage_skill::remember::to_stored;
//! use linkage_skill::object::Provenance;
//! # use linkage_skill::{Learner, SkillConfig};
//! # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/panel.rs"));
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let config = SkillConfig::default();
//! # let mut learner = Learner::new(&config);
//! # for frame in panel_that_opens() {
//! #     learner.push(&frame)?;
//! # }
//! # let learned = learner.finish("panel")?;
//! # let later = frame(0, 0.12, &Arc::new(camera()));
//!
//! let provenance = Provenance { source: "kitchen".to_owned(), learned_utime: 0 };
//! let stored = to_stored(&learned, provenance)?;
//! let known = Arc::new(KnownObject::new(stored.model, &stored.appearance));
//!
//! let found = recognise(&Scene::new(&later)?, &[known], &config.recognise, config.seed);
//! let panel = &found.matches[0];
//! assert!(panel.score > config.recognise.min_score);
//! let open_m = panel.joints[0].configuration.expect("both sides of the joint are seen");
//! assert!((open_m - 0.12).abs() < 0.01);
//! # Ok(())
//! # }
//! ```
//!
//! # Predict
//! A [`predict::PredictionContext`] tells how a recognised object will move.
//!
//! ```
//! use linkage_skill::predict::{PredictionContext, Target};
//! # use linkage_skill::object::Provenance;
//! # use linkage_skill::recognise::{KnownObject, Scene, find};
//! # use linkage_skill::remember::to_stored;
//! # use linkage_skill::{Learner, SkillConfig};
//! # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/panel.rs"));
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let config = SkillConfig::default();
//! # let mut learner = Learner::new(&config);
//! # for frame in panel_that_opens() {
//! #     learner.push(&frame)?;
//! # }
//! # let learned = learner.finish("panel")?;
//! # let provenance = Provenance { source: "kitchen".to_owned(), learned_utime: 0 };
//! # let stored = to_stored(&learned, provenance)?;
//! # let known = KnownObject::new(stored.model, &stored.appearance);
//! # let scene = Scene::new(&frame(0, 0.12, &Arc::new(camera())))?;
//! # let recognised = find(&scene, &known, &config.recognise, config.seed).expect("it is there");
//!
//! let object = PredictionContext::new(&known.model, &recognised)?;
//! let motion = &object.motions(None, Target::Open)?[0];
//! assert!((motion.to - motion.from - 0.18).abs() < 0.02, "the rest of its way, metres");
//!
//! // Where each part will be half way, as poses in the camera frame.
//! let half_way = 0.5 * (motion.from + motion.to);
//! let camera_from_part = object.part_poses(&[(motion.joint, half_way)]);
//! assert_eq!(camera_from_part.len(), 2, "the base and the panel");
//! # Ok(())
//! # }
//! ```
#![forbid(unsafe_code)]

pub mod articulation;
pub mod config;
mod explained_config;
mod features;
mod image;
#[doc(hidden)]
pub mod internals;
pub mod learn;
mod math;
pub mod object;
pub mod predict;
pub mod recognise;
pub mod remember;
#[cfg(feature = "store")]
pub mod store;
#[cfg(test)]
mod test_data;
mod vision_error;

pub use config::SkillConfig;
pub use learn::{Demonstration, LearnError, Learner};
/// Frames, cameras and depth: what the skill takes in.
pub use linkage_frames as frames;
pub use math::rigid::{Pose, pose_from_array, pose_to_array};
pub use object::{Joint, ObjectModel, Part};
pub use vision_error::VisionError;
