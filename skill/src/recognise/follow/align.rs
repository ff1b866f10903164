//! Alignment of an object's surface with a frame, by depth and lightness, base pose and configurations
//! together (Gauss-Newton over point-to-plane and photometric residuals).
//!
//! In: a state near the right one. Out: the aligned state, and the standard deviation of each
//! configuration there (rad or m).

use super::lightness::{LightnessWindow, add_lightness};
use crate::recognise::evidence::configuration_deviations;
use crate::recognise::kinematics::{Articulated, State};
use crate::recognise::known_object::KnownObject;
use crate::recognise::normal_equations::{System, add_surface};
use crate::recognise::render_cloud::Cloud;
use crate::recognise::scene::Scene;

/// Surfels below which nothing is aligned.
const LEAST_SURFACE: usize = 20;
/// Windows of the first and of the last step.
const WINDOWS: [LightnessWindow; 2] = [
    LightnessWindow { gate_m: 0.05, reach_px: 5.0 },
    LightnessWindow { gate_m: 0.012, reach_px: 1.5 },
];
/// Share of the steps from which all of the surface is used.
const ALL_FROM: f64 = 0.7;
/// Least evidence that fixes an unknown which nothing seen tells of.
const DAMPING: f64 = 30.0;
/// Step of every unknown, metres or radians, below which the alignment has converged.
const CONVERGED: f64 = 1e-4;
/// Information that holds the pose, some tenths of a millimetre. Where the base is not seen, what
/// moves is taken for a joint's motion, not for the base's.
const HOLD: f64 = 1e7;

/// One object against one frame.
pub struct Aligner<'a> {
    /// The frame.
    pub scene: &'a Scene,
    /// The object's tree.
    pub articulated: &'a Articulated,
    /// The object.
    pub object: &'a KnownObject,
    /// The base was seen in the last frame; else its pose is held.
    pub base_seen: bool,
}

impl Aligner<'_> {
    /// The state after at most so many steps.
    pub fn align(&self, mut state: State, steps: usize) -> State {
        let last = (steps - 1).max(1) as f64;
        for i in 0..steps {
            let done = i as f64 / last;
            let cloud = if done < ALL_FROM { &self.object.coarse } else { &self.object.cloud };
            let (mut system, planes) = self.system(cloud, &state, window_at(done));
            if planes < LEAST_SURFACE {
                break;
            }
            if !self.base_seen {
                system.hold_pose(HOLD);
            }
            let Some(step) = system.solve(DAMPING) else { break };
            state = self.articulated.stepped(&state, &step);
            if step.amax() < CONVERGED && done >= ALL_FROM {
                break;
            }
        }
        state
    }

    /// Standard deviation of each configuration; of the base's those are `base_deviations`, from
    /// when it was seen.
    pub fn deviations(&self, state: &State, base_deviations: &[Option<f64>]) -> Vec<Option<f64>> {
        let (mut system, _) = self.system(&self.object.cloud, state, WINDOWS[1]);
        if self.base_seen {
            return configuration_deviations(self.articulated, &system);
        }
        // The joints turn about a base that is no better known than when it was seen.
        system.hold_pose(HOLD);
        let with_base = |(held, base): (Option<f64>, &Option<f64>)| Some(held?.hypot((*base)?));
        let held = configuration_deviations(self.articulated, &system);
        held.into_iter().zip(base_deviations).map(with_base).collect()
    }

    /// Normal equations at a state, and how many surfels gave rows of depth.
    fn system(&self, cloud: &Cloud, state: &State, window: LightnessWindow) -> (System, usize) {
        let Self { scene, articulated, .. } = *self;
        let mut system = System::new(6 + articulated.joints.len());
        let planes = add_surface(&mut system, scene, articulated, cloud, state, window.gate_m);
        add_lightness(&mut system, scene, articulated, cloud, state, window);
        system.draw_into_range(articulated, state);
        (system, planes)
    }
}

/// The window between that of the first and that of the last step.
fn window_at(done: f64) -> LightnessWindow {
    let between = |first: f64, last: f64| first + (last - first) * done;
    let [first, last] = WINDOWS;
    LightnessWindow {
        gate_m: between(first.gate_m, last.gate_m),
        reach_px: between(first.reach_px, last.reach_px),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_become_narrower_from_step_to_step() {
        let at = |done| window_at(done);
        assert_eq!((at(0.0).gate_m, at(0.0).reach_px), (0.05, 5.0));
        assert!((at(1.0).gate_m - 0.012).abs() < 1e-12 && at(1.0).reach_px == 1.5);
        assert!(at(0.3).gate_m > at(0.6).gate_m && at(0.3).reach_px > at(0.6).reach_px);
    }
}
