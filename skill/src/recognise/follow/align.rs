//! Alignment of an object's surface with a frame by depth and lightness, base pose and configurations together.
//!
//! In: a frame, and a state near the right one (camera frame, metres and radians).
//! Out: the aligned state, and the standard deviation of each configuration there (rad or m).
//! From: Gauss-Newton over point-to-plane and photometric residuals.

use super::lightness::{LightnessWindow, add_lightness};
use crate::recognise::evidence::configuration_deviations;
use crate::recognise::kinematics::{Articulated, State};
use crate::recognise::known_object::KnownObject;
use crate::recognise::normal_equations::{System, add_surface};
use crate::recognise::render_cloud::Cloud;
use crate::recognise::scene::Scene;

/// Smallest number of surfels with which a state is aligned.
const LEAST_SURFACE: usize = 20;
/// Windows of the first and of the last step.
const WINDOWS: [LightnessWindow; 2] = [
    LightnessWindow { gate_m: 0.05, reach_px: 5.0 },
    LightnessWindow { gate_m: 0.012, reach_px: 1.5 },
];
/// Share of the steps from which the whole surface is used instead of the thinned one.
const ALL_FROM: f64 = 0.7;
/// Information added to each unknown, so that an unknown without evidence keeps its value.
const DAMPING: f64 = 30.0;
/// Largest step of every unknown, metres or radians, at which the alignment has converged.
const CONVERGED: f64 = 1e-4;
/// Information that holds the pose to some tenths of a millimetre or milliradian. If the base is not seen, motion is
/// attributed to a joint, not to the base.
const HOLD: f64 = 1e7;

/// Alignment of one object with one frame.
pub struct Aligner<'a> {
    /// Prepared frame.
    pub scene: &'a Scene,
    /// Kinematic tree of the object.
    pub articulated: &'a Articulated,
    /// Surface of the object.
    pub object: &'a KnownObject,
    /// True if the base was seen in the last frame; else its pose is held.
    pub base_seen: bool,
}

impl Aligner<'_> {
    /// State after at most this many steps.
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

    /// Standard deviation of each configuration, rad or m. If the base is not seen, `base_deviations`, from when it
    /// was last seen, are added as variances.
    pub fn deviations(&self, state: &State, base_deviations: &[Option<f64>]) -> Vec<Option<f64>> {
        let (mut system, _) = self.system(&self.object.cloud, state, WINDOWS[1]);
        if self.base_seen {
            return configuration_deviations(self.articulated, &system);
        }
        // The pose of the base is no better known than when the base was last seen.
        system.hold_pose(HOLD);
        let with_base = |(held, base): (Option<f64>, &Option<f64>)| Some(held?.hypot((*base)?));
        let held = configuration_deviations(self.articulated, &system);
        held.into_iter().zip(base_deviations).map(with_base).collect()
    }

    /// Normal equations at a state, and the number of surfels that gave rows of depth.
    fn system(&self, cloud: &Cloud, state: &State, window: LightnessWindow) -> (System, usize) {
        let Self { scene, articulated, .. } = *self;
        let mut system = System::new(6 + articulated.joints.len());
        let planes = add_surface(&mut system, scene, articulated, cloud, state, window.gate_m);
        add_lightness(&mut system, scene, articulated, cloud, state, window);
        system.draw_into_range(articulated, state);
        (system, planes)
    }
}

/// Window between the first and the last one; `done` is the share of the steps, 0 to 1.
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
