//! The science of Linkage: learns how articulated things move, recognises them, predicts
//! their motion. Frames and configuration in, values out; no camera, socket or clock.
#![forbid(unsafe_code)]

pub mod articulation;
pub mod config;
mod explained_config;
pub mod features;
pub mod image;
pub mod learn;
pub mod math;
pub mod object;
pub mod predict;
pub mod recognise;
pub mod remember;
pub mod store;
#[cfg(test)]
mod test_data;

pub use config::SkillConfig;
pub use learn::demonstration::Demonstration;
pub use learn::{LearnError, Learner};
pub use object::model::{Joint, ObjectModel, Part};
