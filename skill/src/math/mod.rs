//! Rigid motions, robust estimation and small numerical helpers.

pub(crate) mod extremes;
pub mod ransac;
pub mod rigid;
pub mod robust;
