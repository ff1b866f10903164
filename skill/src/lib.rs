//! The science of Linkage: learns how articulated things move, recognises them, predicts
//! their motion. Frames and configuration in, values out; no camera, socket or clock.
#![forbid(unsafe_code)]

pub mod articulate;
pub mod base;
pub mod geometry;
pub mod pose;
pub mod segment;
pub mod track;
pub mod vision;
