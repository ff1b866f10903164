//! Configuration of the articulation stage.

use serde::{Deserialize, Serialize};

/// Values of the articulation stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ArticulateConfig {
    /// Standard deviation of an observed position about an ideal joint, metres: marker noise
    /// together with the play and bend of real hinges and slides. Ours.
    pub position_sigma_m: f64,
    /// Standard deviation of an observed orientation, radians.
    pub orientation_sigma_rad: f64,
    /// Median distance between a hinge and what it carries, metres: hinges that nobody
    /// builds are unlikely. Ours: in real logs 0.25-0.68 m.
    pub hinge_radius_m: f64,
    /// Standard deviation of its logarithm; larger radii are penalised, smaller ones not.
    pub hinge_radius_log_sigma: f64,
    /// EM iterations that separate outliers.
    pub iterations: usize,
}

impl Default for ArticulateConfig {
    fn default() -> Self {
        Self {
            position_sigma_m: 0.008,
            orientation_sigma_rad: 0.08,
            hinge_radius_m: 0.45,
            hinge_radius_log_sigma: 0.5,
            iterations: 12,
        }
    }
}
