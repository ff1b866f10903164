//! Refinement of a hypothesis: configurations without votes are scanned in depth, features
//! and surface are brought to agreement in one articulated least-squares problem.

use super::articulated::{Articulated, State};
use super::hypothesis::{Hypothesis, agrees, unique_inliers};
use super::matching::Match;
use super::scene::Scene;
use super::verify::{Cloud, verify, visible};
use linkage_driver::depth::depth_sigma;
use nalgebra::{DMatrix, DVector, Vector3};

/// Inliers on either side of a joint below which its configuration is scanned.
const WEAK: usize = 6;
/// Surfels that a matched feature is worth.
const FEATURE_WORTH: f64 = 8.0;
/// How much better a scanned configuration must fit to replace a refined one.
const SCAN_ADVANTAGE: f64 = 1.02;

/// From a hypothesis to the state that fits best.
pub fn settle(
    scene: &Scene,
    articulated: &Articulated,
    cloud: &Cloud,
    matches: &[Match],
    hypothesis: &Hypothesis,
) -> State {
    let part = hypothesis.part;
    let weak = weak_joints(articulated, matches, &hypothesis.state);
    let mut state = hypothesis.state.clone();
    if weak.is_empty() {
        state = fit_features(articulated, matches, state);
    } else {
        state = scan(scene, articulated, cloud, matches, part, state, &weak, 17);
    }
    state = align(scene, articulated, cloud, matches, state);
    if weak.is_empty() {
        return state;
    }
    let scanned = scan(scene, articulated, cloud, matches, part, state, &weak, 25);
    let aligned = align(scene, articulated, cloud, matches, scanned);
    // Alignment may pull a small part into the surface behind it: look once more.
    let again = scan(scene, articulated, cloud, matches, part, aligned.clone(), &weak, 41);
    let fit = |s: &State| fit(scene, articulated, cloud, matches, s);
    if fit(&again) > SCAN_ADVANTAGE * fit(&aligned) { again } else { aligned }
}

/// Agreement of surface and features; a feature weighs as much as some surface.
fn fit(
    scene: &Scene,
    articulated: &Articulated,
    cloud: &Cloud,
    matches: &[Match],
    state: &State,
) -> f64 {
    let features = unique_inliers(articulated, matches, state, None) as f64;
    verify(scene, articulated, cloud, state).fit() + FEATURE_WORTH * features
}

fn weak_joints(articulated: &Articulated, matches: &[Match], state: &State) -> Vec<usize> {
    let by_part: Vec<usize> = (0..articulated.parts)
        .map(|p| unique_inliers(articulated, matches, state, Some(p)))
        .collect();
    let total: usize = by_part.iter().sum();
    (0..articulated.joints.len())
        .filter(|&j| {
            let moved: usize = articulated.moved_by(j).into_iter().map(|p| by_part[p]).sum();
            moved.min(total - moved) < WEAK
        })
        .collect()
}

/// Scans joints for the configuration that fits depth best, while the part that the
/// hypothesis started from stays where it is.
fn scan(
    scene: &Scene,
    articulated: &Articulated,
    cloud: &Cloud,
    matches: &[Match],
    part: usize,
    mut state: State,
    joints: &[usize],
    steps: usize,
) -> State {
    for &joint in joints {
        let camera_from_part = articulated.poses(&state)[part];
        state = candidates(articulated, joint, state.q[joint], steps)
            .map(|q| {
                let mut moved = state.q.clone();
                moved[joint] = q;
                articulated.state_with(part, &camera_from_part, moved)
            })
            .map(|s| (fit(scene, articulated, cloud, matches, &s), s))
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .map_or(state.clone(), |(_, s)| s);
    }
    state
}

fn candidates(
    articulated: &Articulated,
    joint: usize,
    present: f64,
    steps: usize,
) -> impl Iterator<Item = f64> + use<> {
    let (low, high) = (articulated.joints[joint].low, articulated.joints[joint].high);
    (0..steps)
        .map(move |i| low + (high - low) * i as f64 / (steps - 1) as f64)
        .chain(std::iter::once(present))
}

/// Normal equations over pose and configurations.
struct System {
    hessian: DMatrix<f64>,
    gradient: DVector<f64>,
}

impl System {
    fn new(unknowns: usize) -> Self {
        Self { hessian: DMatrix::zeros(unknowns, unknowns), gradient: DVector::zeros(unknowns) }
    }

    fn add(&mut self, jacobian: &[f64], residual: f64, weight: f64) {
        for (a, ja) in jacobian.iter().enumerate() {
            self.gradient[a] += weight * ja * residual;
            for (b, jb) in jacobian.iter().enumerate() {
                self.hessian[(a, b)] += weight * ja * jb;
            }
        }
    }

    fn add_point(&mut self, velocities: &[Vector3<f64>], residual: &Vector3<f64>, weight: f64) {
        for k in 0..3 {
            let row: Vec<f64> = velocities.iter().map(|v| v[k]).collect();
            self.add(&row, residual[k], weight);
        }
    }

    fn solve(mut self, damping: f64) -> Option<DVector<f64>> {
        for k in 0..self.hessian.nrows() {
            self.hessian[(k, k)] += damping;
        }
        Some(self.hessian.cholesky()?.solve(&(-self.gradient)))
    }
}

/// Matches alone, robustly.
fn fit_features(articulated: &Articulated, matches: &[Match], mut state: State) -> State {
    for i in 0..6 {
        let slack = if i < 2 { 1.5 } else { 1.0 };
        let mut system = System::new(6 + articulated.joints.len());
        if add_features(&mut system, articulated, matches, &state, slack, 1.0) < 3 {
            break;
        }
        let Some(step) = system.solve(1.0) else { break };
        state = articulated.stepped(&state, &step);
    }
    state
}

fn add_features(
    system: &mut System,
    articulated: &Articulated,
    matches: &[Match],
    state: &State,
    slack: f64,
    share: f64,
) -> usize {
    let poses = articulated.poses(state);
    let mut used = 0;
    for m in matches {
        let Some(seen) = m.seen_point else { continue };
        if !agrees(m, &poses[m.part], slack) {
            continue;
        }
        let moved = poses[m.part] * m.model_point;
        let residual = moved - seen;
        let sigma = m.tolerance / 3.0;
        let weight = share / sigma.powi(2) / (residual.norm() / sigma / 1.5).max(1.0);
        system.add_point(&articulated.velocities(&poses, m.part, &moved), &residual, weight);
        used += 1;
    }
    used
}

/// Articulated point-to-plane alignment of the surface, with the matches.
fn align(
    scene: &Scene,
    articulated: &Articulated,
    cloud: &Cloud,
    matches: &[Match],
    mut state: State,
) -> State {
    const STEPS: usize = 10;
    for i in 0..STEPS {
        let closing = (i as f64 / (0.6 * STEPS as f64)).min(1.0);
        let gate = 0.04 + (0.012 - 0.04) * closing;
        let poses = articulated.poses(&state);
        let mut planes = Vec::new();
        for p in visible(scene, cloud, &poses) {
            let Some(surface) = scene.surface(p.pixel.0, p.pixel.1) else { continue };
            let (u, v) = (p.pixel.0 as f64, p.pixel.1 as f64);
            let seen = scene.frame.camera.back_project(u, v, surface.z);
            let residual = (p.point - seen).dot(&surface.normal);
            let near = residual.abs() < gate + 2.0 * depth_sigma(p.point.z)
                && (seen.z - p.point.z).abs() < 2.0 * gate + 0.02
                && surface.normal.dot(&p.normal) > 0.8;
            if near {
                planes.push((p, surface.normal, residual));
            }
        }
        if planes.len() < 30 {
            break;
        }
        let mut system = System::new(6 + articulated.joints.len());
        let share = (300.0 / planes.len() as f64).min(1.0);
        for (p, normal, residual) in &planes {
            let sigma = depth_sigma(p.point.z) + 0.002;
            let weight = share / sigma.powi(2) / (residual.abs() / sigma / 2.0).max(1.0);
            let row: Vec<f64> = articulated
                .velocities(&poses, p.part, &p.point)
                .iter()
                .map(|v| normal.dot(v))
                .collect();
            system.add(&row, *residual, weight);
        }
        add_features(&mut system, articulated, matches, &state, 1.2, 0.5);
        let Some(step) = system.solve(10.0) else { break };
        let done = step.amax() < 2e-4;
        state = articulated.stepped(&state, &step);
        if done {
            break;
        }
    }
    state
}
