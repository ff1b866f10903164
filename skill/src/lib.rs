//! The science of Linkage: learns how articulated things move, recognises them, predicts
//! their motion. Frames and configuration in, values out; no camera, socket or clock.
#![forbid(unsafe_code)]

pub mod appearance;
pub mod articulate;
pub mod base;
pub mod config;
pub mod encounter;
mod extremes;
pub mod geometry;
pub mod grasp;
pub mod joints;
pub mod katz;
pub mod keyframes;
mod lab;
pub mod learn;
pub mod model;
pub mod planes;
pub mod pose;
pub mod predict;
pub mod recognise;
pub mod segment;
#[cfg(test)]
mod specimen;
pub mod store;
pub mod structure;
pub mod timing;
pub mod track;
pub mod vision;

pub use config::SkillConfig;
pub use learn::{Demonstration, LearnError, Learner};
pub use model::{Joint, ObjectModel, Part};
