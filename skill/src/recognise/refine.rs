//! Refinement of a hypothesis: configurations without votes are scanned in depth, features
//! and surface are brought to agreement in one articulated least-squares problem.
//!
//! In: a hypothesis. Out: the state nearby that explains the picture best (camera frame, metres and
//! radians), or none where another thing is seen in its place.

use super::config::RecogniseConfig;
use super::hypothesis::{Hypothesis, agrees, unique_inliers};
use super::kinematics::{Articulated, State};
use super::matching::Match;
use super::normal_equations::{System, add_surface};
use super::render_cloud::Cloud;
use super::scene::Scene;
use super::verdict::Verdict;
use super::verify::verify;
use crate::math::rigid::matrix_pose;
use rayon::prelude::*;

/// Inliers on either side of a joint below which its configuration is scanned.
const WEAK: usize = 6;
/// Surfels that a matched feature is worth.
pub const FEATURE_WORTH: f64 = 8.0;
/// Scanned configurations that are followed to their end.
const FOLLOWED: usize = 3;
/// Configurations that are tried of a joint's range.
const COARSE_STEPS: usize = 25;
/// Surfels below which a surface aligns nothing.
const LEAST_SURFACE: usize = 20;
/// How much better a scanned configuration must fit to replace a refined one.
const SCAN_ADVANTAGE: f64 = 1.02;

/// How much of the picture a state explains, in surfels: less where much of what it claims
/// stands behind something else.
pub fn explained(verdict: &Verdict, inliers: usize) -> f64 {
    let shown = verdict.fit().max(0.0) + FEATURE_WORTH * inliers as f64;
    shown * shown / (shown + verdict.hidden as f64).max(1.0)
}

/// Distance of a surfel from the surface seen at its pixel up to which it counts in the end.
const FINAL_GATE_M: f64 = 0.012;

/// One object against one scene.
pub struct Refiner<'r> {
    /// The encounter.
    pub scene: &'r Scene,
    /// The object's tree.
    pub articulated: &'r Articulated,
    /// Its surface.
    pub cloud: &'r Cloud,
    /// Some of it, to compare configurations by.
    pub coarse: &'r Cloud,
    /// Its matches.
    pub matches: &'r [Match],
    /// Fewest of them that must agree with a state.
    pub min_inliers: usize,
    /// What is done.
    pub config: &'r RecogniseConfig,
}

impl Refiner<'_> {
    /// From a hypothesis to the state that fits best. Depth alone may hold for several states, and
    /// plain boards slide as they are aligned: what the matches say by themselves competes too.
    /// `None` where another thing is seen in the place of the hypothesis' part.
    pub fn settle(&self, hypothesis: &Hypothesis) -> Option<State> {
        let part = hypothesis.part;
        let matched = self.fit_features(hypothesis.state.clone());
        let aligned = self.align(matched.clone());
        let mut states = vec![matched, aligned];
        if self.config.dismiss_early && states.iter().all(|s| self.shows_another(part, s)) {
            return None;
        }
        let weak = self.weak_joints(&hypothesis.state);
        if self.config.search_configurations && !weak.is_empty() {
            let scanned = self.scan(part, &hypothesis.state, &weak, COARSE_STEPS, FOLLOWED);
            states.par_extend(scanned.into_par_iter().map(|s| self.follow(part, s, &weak)));
        }
        let settled = self.best_of(states.into_par_iter());
        let settled = settled.unwrap_or_else(|| hypothesis.state.clone());
        if !self.config.search_configurations {
            return Some(settled);
        }
        Some(weak.iter().fold(settled, |state, joint| self.tune(part, state, *joint)))
    }

    /// Another thing is seen where a state puts a part.
    fn shows_another(&self, part: usize, state: &State) -> bool {
        let seen = verify(self.scene, self.articulated, self.cloud, state).parts[part];
        (self.config.check_free_space && seen.is_missing())
            || (self.config.compare_looks && seen.has_other_texture())
    }

    /// A scanned state, followed to its end. Alignment may pull a small part into the surface
    /// behind it: its configuration is looked for again.
    fn follow(&self, part: usize, scanned: State, weak: &[usize]) -> State {
        let aligned = self.align(scanned);
        let again = self.scan(part, &aligned, weak, 41, 1).swap_remove(0);
        let better = self.fit(self.cloud, &again) > SCAN_ADVANTAGE * self.fit(self.cloud, &aligned);
        if better { again } else { aligned }
    }

    /// Moves a joint to where its parts look most alike, from the nearest scanned configuration:
    /// depth says nothing of what turns in its own shape, as the foot of a chair does.
    fn tune(&self, part: usize, state: State, joint: usize) -> State {
        const HALF: i32 = 8;
        let j = &self.articulated.joints[joint];
        let reach = (j.high - j.low) / (COARSE_STEPS - 1) as f64;
        let camera_from_part = self.articulated.poses(&state)[part];
        let about = (-HALF..=HALF).into_par_iter().map(|i| {
            let mut q = state.q.clone();
            q[joint] += reach * f64::from(i) / f64::from(HALF);
            self.articulated.state_with(part, &camera_from_part, q)
        });
        self.best_of(about).unwrap_or(state)
    }

    /// The state that fits best; of equal ones the last, whichever thread is first.
    fn best_of(&self, states: impl ParallelIterator<Item = State>) -> Option<State> {
        let fitted: Vec<(f64, State)> = states.map(|s| (self.fit(self.cloud, &s), s)).collect();
        fitted.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, best)| best)
    }

    /// Agreement of surface and features; a feature weighs as much as some surface.
    fn fit(&self, cloud: &Cloud, state: &State) -> f64 {
        let features = unique_inliers(self.articulated, self.matches, state, None) as f64;
        let surface = verify(self.scene, self.articulated, cloud, state).fit();
        surface * self.cloud.surfels.len() as f64 / cloud.surfels.len().max(1) as f64
            + FEATURE_WORTH * features
            - self.articulated.range_penalty(state)
    }

    /// Joints with few inliers on one of their sides.
    fn weak_joints(&self, state: &State) -> Vec<usize> {
        let by_part: Vec<usize> = (0..self.articulated.parts)
            .map(|p| unique_inliers(self.articulated, self.matches, state, Some(p)))
            .collect();
        let total: usize = by_part.iter().sum();
        (0..self.articulated.joints.len())
            .filter(|&j| {
                let moved: usize =
                    self.articulated.moved_by(j).into_iter().map(|p| by_part[p]).sum();
                moved.min(total - moved) < WEAK
            })
            .collect()
    }

    /// Scans joints for the configurations that fit best, best first, while `part` stays
    /// where it is; of all but the last joint only the best is kept. Never empty.
    fn scan(
        &self,
        part: usize,
        state: &State,
        joints: &[usize],
        steps: usize,
        keep: usize,
    ) -> Vec<State> {
        let mut best = vec![state.clone()];
        for &joint in joints {
            let state = best.swap_remove(0);
            let camera_from_part = self.articulated.poses(&state)[part];
            let j = &self.articulated.joints[joint];
            let step = (j.high - j.low) / (steps - 1) as f64;
            let tried: Vec<f64> = (0..steps)
                .map(|i| j.low + step * i as f64)
                .chain(std::iter::once(state.q[joint]))
                .collect();
            let mut tried: Vec<(f64, State)> = tried
                .into_par_iter()
                .map(|q| {
                    let mut moved = state.q.clone();
                    moved[joint] = q;
                    self.articulated.state_with(part, &camera_from_part, moved)
                })
                .map(|s| (self.fit(self.coarse, &s), s))
                .collect();
            tried.sort_by(|a, b| b.0.total_cmp(&a.0));
            best = Vec::new();
            for (_, s) in tried {
                let apart = |other: &State| (other.q[joint] - s.q[joint]).abs() > 2.5 * step;
                if best.len() < keep && best.iter().all(apart) {
                    best.push(s);
                }
            }
        }
        best
    }

    /// Matches alone, robustly.
    fn fit_features(&self, mut state: State) -> State {
        for i in 0..6 {
            let slack = if i < 2 { 1.5 } else { 1.0 };
            let mut system = System::new(6 + self.articulated.joints.len());
            if self.add_features(&mut system, &state, slack, 1.0) < 3 {
                break;
            }
            let Some(step) = system.solve(1.0) else { break };
            state = self.articulated.stepped(&state, &step);
        }
        state
    }

    fn add_features(&self, system: &mut System, state: &State, slack: f64, share: f64) -> usize {
        let poses = self.articulated.poses(state);
        let velocities = self.articulated.velocities(&poses);
        let poses: Vec<_> = poses.iter().map(matrix_pose).collect();
        let mut used = 0;
        for m in self.matches {
            let Some(seen) = m.seen_point else { continue };
            if !agrees(m, &poses[m.part], slack) {
                continue;
            }
            let moved = poses[m.part] * m.model_point;
            let residual = moved - seen;
            let sigma = m.tolerance / 3.0;
            let weight = share / sigma.powi(2) / (residual.norm() / sigma / 1.5).max(1.0);
            for k in 0..3 {
                system.add(velocities.of(m.part, &moved).map(|v| v[k]), residual[k], weight);
            }
            used += 1;
        }
        used
    }

    /// Normal equations of surface and matches at a state.
    pub fn system(&self, state: &State) -> System {
        let mut system = System::new(6 + self.articulated.joints.len());
        add_surface(&mut system, self.scene, self.articulated, self.cloud, state, FINAL_GATE_M);
        self.add_features(&mut system, state, 1.2, 0.5);
        system.draw_into_range(self.articulated, state);
        system
    }

    /// Articulated point-to-plane alignment of the surface, with the matches.
    fn align(&self, mut state: State) -> State {
        const STEPS: usize = 10;
        if !self.config.align_surface {
            return state;
        }
        for i in 0..STEPS {
            let closing = (i as f64 / (0.6 * STEPS as f64)).min(1.0);
            let cloud = if closing < 1.0 { self.coarse } else { self.cloud };
            let gate = 0.04 + (FINAL_GATE_M - 0.04) * closing;
            let mut system = System::new(6 + self.articulated.joints.len());
            if add_surface(&mut system, self.scene, self.articulated, cloud, &state, gate)
                < LEAST_SURFACE
            {
                break;
            }
            self.add_features(&mut system, &state, 1.2, 0.5);
            system.draw_into_range(self.articulated, &state);
            let Some(step) = system.solve(10.0) else { break };
            let done = step.amax() < 2e-4;
            state = self.articulated.stepped(&state, &step);
            if done && closing >= 1.0 {
                break;
            }
        }
        state
    }
}
