//! Refinement of a hypothesis: configurations with few inliers are scanned by depth, then features and surface are
//! aligned in one articulated least-squares problem.
//!
//! In: a hypothesis.
//! Out: the nearby state that explains the image best (camera frame, metres and radians), or `None` if another
//! object is seen in its place.
//! From: Gauss-Newton over point-to-point residuals of matches and point-to-plane residuals of surface.

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

/// Number of inliers on one side of a joint below which its configuration is scanned.
const WEAK: usize = 6;
/// Weight of a matched feature, in surfels.
pub const FEATURE_WORTH: f64 = 8.0;
/// Largest number of scanned configurations that are refined.
const FOLLOWED: usize = 3;
/// Number of configurations tried over a joint's range.
const COARSE_STEPS: usize = 25;
/// Smallest number of surfels with which a surface is aligned.
const LEAST_SURFACE: usize = 20;
/// Smallest ratio of their fits at which a scanned configuration replaces a refined one.
const SCAN_ADVANTAGE: f64 = 1.02;

/// How much of the image a state explains, in surfels; less if much of the claimed surface is occluded.
pub fn explained(verdict: &Verdict, inliers: usize) -> f64 {
    let shown = verdict.fit().max(0.0) + FEATURE_WORTH * inliers as f64;
    shown * shown / (shown + verdict.hidden as f64).max(1.0)
}

/// Largest distance of a surfel from the surface seen at its pixel in the last steps, metres.
const FINAL_GATE_M: f64 = 0.012;
/// Largest distance of a surfel from the surface seen at its pixel in the first step, metres, if features give the
/// pose.
const FIRST_GATE_M: f64 = 0.04;
/// Largest distance of a surfel from the surface seen at its pixel in the first step, metres, if the room gives the
/// pose: the object may have been turned or moved a little.
const ROOM_GATE_M: f64 = 0.12;
/// Standard deviation of the object's place in its room, metres: objects are pushed a little.
const ROOM_SIGMA_M: f64 = 0.03;

/// Refinement of one object in one scene.
pub struct Refiner<'r> {
    /// Scene of the encounter.
    pub scene: &'r Scene,
    /// Kinematic tree of the object.
    pub articulated: &'r Articulated,
    /// Surface of the object.
    pub cloud: &'r Cloud,
    /// Thinned surface of the object, for comparing configurations.
    pub coarse: &'r Cloud,
    /// Matches of the object.
    pub matches: &'r [Match],
    /// Smallest number of matches, each place counted once, that must agree with a state.
    pub min_inliers: usize,
    /// Contour of the object and of the image, if states are aligned by contour too.
    pub shape: Option<Contours<'r>>,
    /// Matches of the room that agree with the hypothesis: a weak prior on the pose of the base.
    pub room: &'r [Match],
    /// Configuration of recognition.
    pub config: &'r RecogniseConfig,
}

#[cfg(test)]
impl<'r> Refiner<'r> {
    /// Refinement by surface alone: without matches, room and contour.
    pub fn by_surface(
        scene: &'r Scene,
        articulated: &'r Articulated,
        cloud: &'r Cloud,
        config: &'r RecogniseConfig,
    ) -> Self {
        let (matches, room): (&[Match], &[Match]) = (&[], &[]);
        let (coarse, shape, min_inliers) = (cloud, None, 0);
        Self { scene, articulated, cloud, coarse, matches, min_inliers, shape, room, config }
    }
}

impl Refiner<'_> {
    /// State with the best fit near a hypothesis: of the fit to the matches alone, the aligned state, and scanned
    /// configurations. The matches alone compete, since depth may fit several states, and a plain board slides
    /// during alignment. `None` if another object is seen in the place of the hypothesis' part.
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
        // Contours determine the state more precisely than the tried configurations.
        Some(if self.shape.is_some() { self.align(tuned) } else { tuned })
    }

    /// True if another object is seen where a state puts a part.
    fn shows_another(&self, part: usize, state: &State) -> bool {
        let seen = verify(self.scene, self.articulated, self.cloud, state).parts[part];
        (self.config.check_free_space && seen.is_missing())
            || (self.config.compare_colour && seen.has_other_texture())
    }

    /// Aligns a scanned state, then scans it once more: alignment may pull a small part into the surface behind it.
    fn follow(&self, part: usize, scanned: State, weak: &[usize]) -> State {
        let aligned = self.align(scanned);
        let again = self.scan(part, &aligned, weak, 41, 1).swap_remove(0);
        let better = self.fit(self.cloud, &again) > SCAN_ADVANTAGE * self.fit(self.cloud, &aligned);
        if better { again } else { aligned }
    }

    /// Moves a joint to the best fit within one scanned step. Depth does not determine the rotation of a part that
    /// turns in its own shape, as the foot of a chair does; its colour does.
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

    /// State with the best fit; of equal ones the last, so that the order of threads does not matter.
    fn best_of(&self, states: impl ParallelIterator<Item = State>) -> Option<State> {
        let fitted: Vec<(f64, State)> = states.map(|s| (self.fit(self.cloud, &s), s)).collect();
        fitted.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, best)| best)
    }

    /// Agreement of surface and features, in surfels, less the cost of joints outside their range.
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

    /// Scans joints for the configurations with the best fit, best first, while `part` keeps its pose; of all joints
    /// but the last only the best configuration is kept. Never empty.
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

    /// State fitted to the matches alone, with robust weights.
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

    /// Adds the matches of the room as a prior on the pose of the base. Together they weigh as much as one place
    /// known to [`ROOM_SIGMA_M`], however many they are: if the object was moved, their errors are equal.
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

    /// Normal equations of surface, matches, room and contour at a state.
    pub fn system(&self, state: &State) -> System {
        let mut system = System::new(6 + self.articulated.joints.len());
        add_surface(&mut system, self.scene, self.articulated, self.cloud, state, FINAL_GATE_M);
        self.add_features(&mut system, state, 1.2, 0.5);
        self.add_room(&mut system, state);
        self.add_ends(&mut system, state);
        system.draw_into_range(self.articulated, state);
        system
    }

    /// Adds the contour that is known at a state, if states are aligned by contour.
    fn add_ends(&self, system: &mut System, state: &State) {
        let Some(Contours { shape, seen }) = self.shape else { return };
        let known = shape.known_at(self.articulated, state);
        add_contour(system, self.scene, seen, known, self.articulated, state);
    }

    /// Articulated point-to-plane alignment of the surface, together with matches, room and contour.
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
        let refiner = Refiner::by_surface(&scene, &articulated, &cloud, config);
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
