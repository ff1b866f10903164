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
use super::shape::{Contours, add_contour};
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
/// The same at first, where features tell the pose.
const FIRST_GATE_M: f64 = 0.04;
/// The same where the room tells it: what stands there may be turned or moved a little.
const ROOM_GATE_M: f64 = 0.12;
/// Standard deviation of where the object stands in its room, metres: things are pushed a little.
const ROOM_SIGMA_M: f64 = 0.03;

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
    /// Its contour, where states are aligned by that too.
    pub shape: Option<Contours<'r>>,
    /// Matches of the room that agree with the hypothesis: they hold the base about where it is, as far as
    /// its own surface does not tell better.
    pub room: &'r [Match],
    /// What is done.
    pub config: &'r RecogniseConfig,
}

impl Refiner<'_> {
    /// From a hypothesis to the state that fits best. Depth alone may hold for several states, and
    /// plain boards slide as they are aligned: what the matches say by themselves competes too.
    /// `None` where another thing is seen in the place of the hypothesis' part.
    pub fn settle(&self, hypothesis: &Hypothesis) -> Option<State> {
        let part = hypothesis.part;
        let matched = match self.room {
            [] => self.fit_features(hypothesis.state.clone()),
            _ => hypothesis.state.clone(),
        };
        let aligned = self.align(matched.clone());
        let mut states = vec![matched, aligned];
        let may_dismiss = self.config.dismiss_early && self.room.is_empty();
        if may_dismiss && states.iter().all(|s| self.shows_another(part, s)) {
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
        let tuned = weak.iter().fold(settled, |state, joint| self.tune(part, state, *joint));
        // Where ends are known they tell more exactly than what may be tried.
        Some(if self.shape.is_some() { self.align(tuned) } else { tuned })
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
        let verdict = verify(self.scene, self.articulated, cloud, state);
        let surface = if self.shape.is_some() { verdict.fit_of_shape() } else { verdict.fit() };
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

    /// The room draws the base to about where it stood, as much as one place would that is known to
    /// [`ROOM_SIGMA_M`], however many matches say so: they err together where the object was moved.
    fn add_room(&self, system: &mut System, state: &State) {
        let poses = self.articulated.poses(state);
        let velocities = self.articulated.velocities(&poses);
        let weight = 1.0 / (self.room.len() as f64 * ROOM_SIGMA_M.powi(2));
        for m in self.room {
            let Some(seen) = m.seen_point else { continue };
            let moved = poses[m.part] * m.model_point;
            let residual = moved - seen;
            for k in 0..3 {
                system.add(velocities.of(m.part, &moved).map(|v| v[k]), residual[k], weight);
            }
        }
    }

    /// Normal equations of surface and matches at a state.
    pub fn system(&self, state: &State) -> System {
        let mut system = System::new(6 + self.articulated.joints.len());
        add_surface(&mut system, self.scene, self.articulated, self.cloud, state, FINAL_GATE_M);
        self.add_features(&mut system, state, 1.2, 0.5);
        self.add_room(&mut system, state);
        self.add_ends(&mut system, state);
        system.draw_into_range(self.articulated, state);
        system
    }

    /// Contour that is known at a state, where states are aligned by contour.
    fn add_ends(&self, system: &mut System, state: &State) {
        let Some(Contours { shape, seen }) = self.shape else { return };
        let known = shape.known_at(self.articulated, state);
        add_contour(system, self.scene, seen, known, self.articulated, state);
    }

    /// Articulated point-to-plane alignment of the surface, with the matches.
    fn align(&self, mut state: State) -> State {
        const STEPS: usize = 10;
        if !self.config.align_surface {
            return state;
        }
        let first_gate = if self.room.is_empty() { FIRST_GATE_M } else { ROOM_GATE_M };
        for i in 0..STEPS {
            let closing = (i as f64 / (0.6 * STEPS as f64)).min(1.0);
            let cloud = if closing < 1.0 { self.coarse } else { self.cloud };
            let gate = first_gate + (FINAL_GATE_M - first_gate) * closing;
            let mut system = System::new(6 + self.articulated.joints.len());
            if add_surface(&mut system, self.scene, self.articulated, cloud, &state, gate)
                < LEAST_SURFACE
            {
                break;
            }
            self.add_features(&mut system, &state, 1.2, 0.5);
            self.add_room(&mut system, &state);
            self.add_ends(&mut system, &state);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::Pose;
    use crate::object::joint_geometry::JointGeometry;
    use crate::recognise::kinematics::ChainJoint;
    use crate::recognise::test_data::{BOARD_M, PLATE_M, on_board, on_plate, slider_surface};
    use crate::test_data::seen;
    use nalgebra::{Point3, Vector3};

    /// A board that slides in x before a plate.
    fn slider() -> Articulated {
        let slide = JointGeometry::slide(Vector3::x_axis(), Point3::origin());
        Articulated { parts: 2, joints: vec![ChainJoint::new(slide, [0, 1], [0.0, 0.4])] }
    }

    /// The board slid by so much, and the wall behind both.
    fn scene(slid: f64) -> Scene {
        let shift = slid / BOARD_M;
        let frame = seen(0, |x, y| match (on_board(x - shift, y), on_plate(x, y)) {
            (true, _) => BOARD_M,
            (false, true) => PLATE_M,
            (false, false) => 2.5,
        });
        Scene::plain(&frame).unwrap()
    }

    fn state(q: f64) -> State {
        State { camera_from_object: Pose::identity(), q: vec![q] }
    }

    /// Looks at a refiner of the slider in a scene where it is slid by so much.
    fn with_refiner<T>(slid: f64, config: &RecogniseConfig, look: impl FnOnce(&Refiner) -> T) -> T {
        let (scene, articulated) = (scene(slid), slider());
        let cloud = slider_surface(|_| 50.0);
        let refiner = Refiner {
            scene: &scene,
            articulated: &articulated,
            cloud: &cloud,
            coarse: &cloud,
            matches: &[],
            shape: None,
            min_inliers: 0,
            room: &[],
            config,
        };
        look(&refiner)
    }

    #[test]
    fn the_state_that_is_seen_fits_better_than_those_beside_it() {
        with_refiner(0.15, &RecogniseConfig::default(), |refiner| {
            let fit = |q| refiner.fit(refiner.cloud, &state(q));
            assert!(fit(0.15) > fit(0.05) && fit(0.15) > fit(0.25));
            let states = [0.05, 0.15, 0.25].map(state);
            let best = refiner.best_of(states.to_vec().into_par_iter()).unwrap();
            assert_eq!(best.q, [0.15]);
            assert!(refiner.best_of(Vec::new().into_par_iter()).is_none());
        });
    }

    #[test]
    fn a_scan_finds_the_configuration_while_the_plate_stays_where_it_is() {
        with_refiner(0.2, &RecogniseConfig::default(), |refiner| {
            let found = refiner.scan(0, &state(0.0), &[0], COARSE_STEPS, FOLLOWED);
            assert!((found[0].q[0] - 0.2).abs() < 0.02, "{:?}", found[0].q);
            assert_eq!(found[0].camera_from_object, Pose::identity());
            assert!(found.len() <= FOLLOWED && !found.is_empty());
            for (i, a) in found.iter().enumerate() {
                assert!(found[..i].iter().all(|b| (a.q[0] - b.q[0]).abs() > 0.04), "apart");
            }
        });
    }

    #[test]
    fn without_joints_to_scan_the_state_stays_as_it_is() {
        with_refiner(0.2, &RecogniseConfig::default(), |refiner| {
            let kept = refiner.scan(0, &state(0.1), &[], COARSE_STEPS, FOLLOWED);
            assert_eq!((kept.len(), kept[0].q[0]), (1, 0.1));
        });
    }

    #[test]
    fn joints_without_matches_on_both_sides_are_weak() {
        with_refiner(0.2, &RecogniseConfig::default(), |refiner| {
            assert_eq!(refiner.weak_joints(&state(0.2)), [0]);
        });
    }

    #[test]
    fn alignment_draws_an_object_to_the_surface_that_is_seen() {
        with_refiner(0.2, &RecogniseConfig::default(), |refiner| {
            let mut near = state(0.2);
            near.camera_from_object = Pose::translation(0.0, 0.0, 0.02);
            let aligned = refiner.align(near);
            assert!(aligned.camera_from_object.translation.z.abs() < 1e-3);
        });
    }

    #[test]
    fn an_alignment_that_is_switched_off_or_has_no_surface_moves_nothing() {
        let off = RecogniseConfig { align_surface: false, ..RecogniseConfig::default() };
        let mut beside = state(0.2);
        beside.camera_from_object = Pose::translation(0.0, 0.0, 0.02);
        with_refiner(0.2, &off, |refiner| {
            assert_eq!(refiner.align(beside.clone()).camera_from_object, beside.camera_from_object);
        });
        let mut away = state(0.2);
        away.camera_from_object = Pose::translation(0.0, 0.0, -0.5);
        with_refiner(0.2, &RecogniseConfig::default(), |refiner| {
            assert_eq!(refiner.align(away.clone()).camera_from_object, away.camera_from_object);
            assert_eq!(
                refiner.fit_features(away.clone()).camera_from_object,
                away.camera_from_object
            );
        });
    }

    #[test]
    fn what_is_hidden_makes_a_state_explain_less_and_nothing_explains_nothing() {
        let nothing = Verdict::default();
        assert_eq!(explained(&nothing, 0), 0.0);
        let hidden = Verdict { hidden: 80, ..Verdict::default() };
        assert!((explained(&nothing, 10) - 10.0 * FEATURE_WORTH).abs() < 1e-9);
        assert!((explained(&hidden, 10) - 5.0 * FEATURE_WORTH).abs() < 1e-9);
    }
}
