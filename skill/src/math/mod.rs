//! Rigid motions, robust estimation and small numerical helpers.

pub(crate) mod extremes;
pub(crate) mod grid;
pub(crate) mod normal_equations;
pub(crate) mod ransac;
pub(crate) mod rigid;
pub(crate) mod robust;
