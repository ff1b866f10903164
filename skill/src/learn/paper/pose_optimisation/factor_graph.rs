//! The factor graph of one part: relative motions with a robust loss, and constant velocity.
//!
//! In: relative motions between frames, with their standard deviations, radians and metres.
//! Out: the motion of the part since its reference frame, in each frame.
//! From: paper, section III-C, which uses iSAM; here Gauss-Newton with the Geman-McClure loss.

use super::relative_motion::RelativeMotion;
use crate::math::rigid::Pose;
use factrs::core::{
    BetweenResidual, GaussNewton, GaussianNoise, GemanMcClure, Graph, PriorResidual, SE3, SO3,
    Values,
};
use factrs::linalg::{Const, ForwardProp, Numeric, VectorX};
use factrs::optimizers::OptError;
use factrs::residuals::Residual3;
use factrs::traits::*;
use factrs::{assign_symbols, fac};
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};

assign_symbols!(X: SE3);

/// Standard deviation of the change of velocity between two frames: rotation, radians. Ours.
const VELOCITY_SIGMA_RAD: f64 = 0.03;
/// Standard deviation of the change of velocity between two frames: translation, metres. Ours.
const VELOCITY_SIGMA_M: f64 = 0.01;
/// Width of the Geman-McClure loss of a relative motion, in standard deviations.
const ROBUST_WIDTH: f64 = 3.0;

/// Residual of constant velocity: the motion from a to b equals that from b to c.
#[derive(Clone, Debug)]
struct ConstantVelocity;

#[factrs::mark]
impl Residual3 for ConstantVelocity {
    type DimIn = Const<18>;
    type DimOut = Const<6>;
    type V1 = SE3;
    type V2 = SE3;
    type V3 = SE3;
    type Differ = ForwardProp<Const<18>>;

    fn residual3<T: Numeric>(&self, a: SE3<T>, b: SE3<T>, c: SE3<T>) -> VectorX<T> {
        a.inverse().compose(&b).ominus(&b.inverse().compose(&c))
    }
}

/// Poses of `frames`, as motions since `reference`; `None` if the optimisation fails or ends
/// without finite poses.
///
/// The graph's variables are the inverse motions W(t): with points moving as `p(to) = M p(from)`,
/// W(from)⁻¹ W(to) = M⁻¹, whatever the reference is.
pub fn optimise(
    motions: &[RelativeMotion],
    frames: &[usize],
    reference: usize,
) -> Option<Vec<Pose>> {
    let slot: BTreeMap<usize, usize> = frames.iter().enumerate().map(|(i, &f)| (f, i)).collect();
    let initial = chain(motions, &slot, reference);
    let mut values = Values::new();
    for (i, pose) in initial.iter().enumerate() {
        values.insert(X(i as u32), to_factrs(&pose.inverse()));
    }
    let mut graph = build(motions, frames, &slot, reference);
    add_weak_priors(&mut graph, &initial);
    let mut optimiser: GaussNewton = GaussNewton::new_default(graph);
    // The solver panics if a system cannot be solved: that part then has no trajectory.
    let solved = match catch_unwind(AssertUnwindSafe(|| optimiser.optimize(values))).ok()? {
        // With a robust loss the last steps may oscillate about the minimum.
        Ok(solved) | Err(OptError::MaxIterations(solved)) => solved,
        Err(OptError::InvalidSystem | OptError::FailedToStep) => return None,
    };
    let to_reference = from_factrs(solved.get(X(slot[&reference] as u32))?);
    let poses: Vec<Pose> = (0..frames.len())
        .map(|i| {
            let w = from_factrs(solved.get(X(i as u32)).expect("every slot was inserted"));
            w.inverse() * to_reference
        })
        .collect();
    poses.iter().all(|p| p.translation.vector.iter().all(|x| x.is_finite())).then_some(poses)
}

/// Adds a weak prior on every pose: where the robust losses reject all measurements of a pose, the
/// pose stays at its initial guess, and the system can be solved.
fn add_weak_priors(graph: &mut Graph, initial: &[Pose]) {
    for (i, pose) in initial.iter().enumerate() {
        let loose = GaussianNoise::<6>::from_scalar_sigma(WEAK_PRIOR_SIGMA);
        let guess = to_factrs(&pose.inverse());
        graph.add_factor(fac![PriorResidual::new(guess), X(i as u32), loose]);
    }
}

/// Standard deviation of the weak prior on every pose, radians and metres.
const WEAK_PRIOR_SIGMA: f64 = 0.5;

fn build(
    motions: &[RelativeMotion],
    frames: &[usize],
    slot: &BTreeMap<usize, usize>,
    reference: usize,
) -> Graph {
    let mut graph = Graph::new();
    let anchor = GaussianNoise::<6>::from_scalar_sigma(1e-4);
    graph.add_factor(fac![PriorResidual::new(SE3::identity()), X(slot[&reference] as u32), anchor]);
    for m in motions {
        let (Some(&a), Some(&b)) = (slot.get(&m.from), slot.get(&m.to)) else { continue };
        let residual = BetweenResidual::new(to_factrs(&m.motion.inverse()));
        let noise = GaussianNoise::<6>::from_split_sigma(m.sigma_rad, m.sigma_m);
        let (a, b) = (X(a as u32), X(b as u32));
        graph.add_factor(fac![residual, (a, b), noise, GemanMcClure::new(ROBUST_WIDTH)]);
    }
    let smooth = GaussianNoise::<6>::from_split_sigma(VELOCITY_SIGMA_RAD, VELOCITY_SIGMA_M);
    for i in 2..frames.len() {
        if frames[i] == frames[i - 2] + 2 {
            let (a, b, c) = (X(i as u32 - 2), X(i as u32 - 1), X(i as u32));
            graph.add_factor(fac![ConstantVelocity, (a, b, c), smooth.clone()]);
        }
    }
    graph
}

/// Initial guess of the poses: relative motions chained outwards from the reference, the shortest
/// gaps between frames first.
fn chain(motions: &[RelativeMotion], slot: &BTreeMap<usize, usize>, reference: usize) -> Vec<Pose> {
    let mut poses: Vec<Option<Pose>> = vec![None; slot.len()];
    poses[slot[&reference]] = Some(Pose::identity());
    let mut ordered: Vec<&RelativeMotion> =
        motions.iter().filter(|m| slot.contains_key(&m.from) && slot.contains_key(&m.to)).collect();
    ordered.sort_by_key(|m| m.to - m.from);
    let mut queue = std::collections::VecDeque::from([slot[&reference]]);
    let mut links: Vec<Vec<(usize, Pose)>> = vec![Vec::new(); slot.len()];
    for m in ordered {
        let (a, b) = (slot[&m.from], slot[&m.to]);
        links[a].push((b, m.motion));
        links[b].push((a, m.motion.inverse()));
    }
    while let Some(i) = queue.pop_front() {
        let pose = poses[i].expect("only slots with a pose are queued");
        for (j, motion) in &links[i] {
            if poses[*j].is_none() {
                poses[*j] = Some(motion * pose);
                queue.push_back(*j);
            }
        }
    }
    poses.into_iter().map(Option::unwrap_or_default).collect()
}

fn to_factrs(pose: &Pose) -> SE3 {
    let q = pose.rotation.quaternion();
    SE3::from_rot_trans(SO3::from_xyzw(q.i, q.j, q.k, q.w), pose.translation.vector)
}

fn from_factrs(pose: &SE3) -> Pose {
    let r = pose.rot();
    let q = nalgebra::Quaternion::new(r.w(), r.x(), r.y(), r.z());
    Pose::from_parts(
        nalgebra::Translation3::from(pose.xyz().into_owned()),
        nalgebra::UnitQuaternion::from_quaternion(q),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn a_turning_part_is_recovered_although_one_motion_is_wrong() {
        let truth: Vec<Pose> = (0..30)
            .map(|t| {
                Pose::new(
                    Vector3::new(0.01 * f64::from(t), 0.0, 0.0),
                    Vector3::y() * 0.03 * f64::from(t),
                )
            })
            .collect();
        let mut motions = Vec::new();
        for to in 1..30_usize {
            for gap in [1, 10] {
                let Some(from) = to.checked_sub(gap) else { continue };
                let motion = truth[to] * truth[from].inverse();
                motions.push(RelativeMotion { from, to, motion, sigma_rad: 0.003, sigma_m: 0.001 });
            }
        }
        motions[20].motion = Pose::translation(0.3, 0.0, 0.0) * motions[20].motion;
        let frames: Vec<usize> = (0..30).collect();
        let poses = optimise(&motions, &frames, 0).unwrap();
        for (found, expected) in poses.iter().zip(&truth) {
            let error = found.inverse() * expected;
            assert!(error.translation.vector.norm() < 0.005 && error.rotation.angle() < 0.01);
        }
    }
}
