//! Configuration of the search for plain parts.

use serde::{Deserialize, Serialize};

/// Values of the search for plain parts. All ours.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlanesConfig {
    /// Plain parts are sought beside the joints that tracks show, and joints are followed by their
    /// planes where their tracks are lost.
    pub enabled: bool,
    /// Gain up to which a joint of tracks gives way to a plain part that moves together with it.
    pub meagre_gain: f64,
    /// Fewest keyframes that show the part.
    pub min_keyframes: usize,
    /// Least turn, radians.
    pub min_turn_rad: f64,
    /// Largest root mean square distance of the planes from where the hinge puts them, metres.
    pub max_rmse_m: f64,
    /// Largest share of the part's points that may be seen through.
    pub max_through: f64,
    /// Least share of them that must be seen through if the part were turned aside by half its range.
    pub min_tells: f64,
}

impl Default for PlanesConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            meagre_gain: 1000.0,
            min_keyframes: 8,
            min_turn_rad: 0.35,
            max_rmse_m: 0.008,
            max_through: 0.1,
            min_tells: 0.5,
        }
    }
}
