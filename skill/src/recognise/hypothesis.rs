//! Hypotheses: poses of one part from matches that agree geometrically; the other parts follow through the joints,
//! whose configurations are voted by the matches of those parts.
//!
//! In: matches (model side in the object frame at configuration 0, seen side in the camera frame, metres).
//! Out: states, each with the number of matches that support it.
//! From: standard methods: pairwise geometric consistency of matches (distance and normals), sampling of triples,
//! score by a truncated quadratic (MSAC).

use super::kinematics::{Articulated, State};
use super::matching::Match;
use crate::math::rigid::{Pose, matrix_pose, rigid_fit};
use crate::math::robust::median;
use crate::object::joint_geometry::{JointGeometry, JointKind};
use nalgebra::{IsometryMatrix3, Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::borrow::Cow;
use std::collections::HashSet;
use std::f64::consts::TAU;

/// A pose of one part with the configurations that follow.
#[derive(Debug, Clone)]
pub struct Hypothesis {
    /// Part whose pose was estimated first.
    pub part: usize,
    /// Pose of the part [`Self::part`].
    pub camera_from_part: Pose,
    /// Pose and configurations of the whole object.
    pub state: State,
    /// Number of places whose matches (or contour points) agree with the state.
    pub support: usize,
}

/// Largest number of matches of a part that are used.
const MAX_MATCHES: usize = 250;
/// Number of triples drawn for a part; each seed gets at least four.
const TRIPLES: usize = 600;
/// Largest number of matches that start a triple: those with the most consistent partners.
const SEEDS: usize = 80;
/// Largest number of poses kept of a part.
const KEEP: usize = 6;
/// Largest difference between an angle on the model and the same angle in the scene, radians.
const MAX_ANGLE: f64 = 0.49;
/// Distance from a matched point to the point on its normal that is fitted as well, metres.
const NORMAL_ARM: f64 = 0.04;
/// Above this number, matches far from the hypothesis are dropped before refinement.
const FEW: usize = 800;
/// Factor on the tolerance of a match within which refinement may turn it into an inlier.
const REACH: f64 = 4.0;
/// Smallest cosine between the normal of the model and the seen normal of an inlier.
const MIN_COSINE: f64 = 0.82;

/// Hypotheses of all parts, most support first.
pub fn all(articulated: &Articulated, matches: &[Match], seed: u64) -> Vec<Hypothesis> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut found = Vec::new();
    for part in 0..articulated.parts {
        let own: Vec<&Match> = matches
            .iter()
            .filter(|m| m.part == part && m.seen_point.is_some())
            .take(MAX_MATCHES)
            .collect();
        for camera_from_part in part_poses(&own, &mut rng) {
            let q = configurations(articulated, matches, part, &camera_from_part);
            let state = articulated.state_with(part, &camera_from_part, q);
            let support = unique_inliers(articulated, matches, &state, None);
            found.push(Hypothesis { part, camera_from_part, state, support });
        }
    }
    found.sort_by_key(|h| std::cmp::Reverse(h.support));
    found
}

/// Matches that may become inliers of a state by refinement; all of them if there are at most [`FEW`].
pub fn within_reach<'m>(
    articulated: &Articulated,
    matches: &'m [Match],
    state: &State,
) -> Cow<'m, [Match]> {
    if matches.len() <= FEW {
        return Cow::Borrowed(matches);
    }
    let poses = articulated.matrices(state);
    matches.iter().filter(|m| agrees(m, &poses[m.part], REACH)).cloned().collect()
}

/// Number of inliers of a state, on one part or on all (`None`), counted by [`places`].
pub fn unique_inliers(
    articulated: &Articulated,
    matches: &[Match],
    state: &State,
    part: Option<usize>,
) -> usize {
    let poses = articulated.matrices(state);
    let own = matches.iter().filter(|m| part.is_none_or(|p| p == m.part));
    places(own.filter(|m| agrees(m, &poses[m.part], 1.0)))
}

/// Inliers of a state on one part, counted by [`places`] and weighted by how well they fit: 1 for residual 0, 0 for
/// a residual equal to the tolerance.
pub fn fit_of_inliers(
    articulated: &Articulated,
    matches: &[Match],
    state: &State,
    part: usize,
) -> f64 {
    let pose = &articulated.matrices(state)[part];
    let closeness = |m: &Match| {
        let squared = Pair::of(m)?.residual_squared(pose, 1.0)?;
        Some(1.0 - squared)
    };
    let close: Vec<(f64, &Match)> = matches
        .iter()
        .filter(|m| m.part == part)
        .filter_map(|m| Some((closeness(m)?, m)))
        .collect();
    let mean = close.iter().map(|(c, _)| c).sum::<f64>() / close.len().max(1) as f64;
    mean * places(close.into_iter().map(|(_, m)| m)) as f64
}

/// Number of distinct places of matches: the smaller of the number of cells on the object (12 mm wide) and in the
/// image (4 pixels wide).
pub fn places<'m>(matches: impl Iterator<Item = &'m Match>) -> usize {
    let (mut on_object, mut in_picture) = (HashSet::new(), HashSet::new());
    for m in matches {
        on_object.insert((m.part, [0, 1, 2].map(|k| (m.model_point[k] / 0.012).floor() as i32)));
        in_picture.insert(m.pixel.map(|x| (x / 4.0).floor() as i32));
    }
    on_object.len().min(in_picture.len())
}

/// True if a match agrees with the pose of its part in place and normal; `slack` is a factor on its tolerance.
pub fn agrees(m: &Match, camera_from_part: &IsometryMatrix3<f64>, slack: f64) -> bool {
    Pair::of(m).is_some_and(|pair| pair.residual_squared(camera_from_part, slack).is_some())
}

/// True if both sides of a match have a normal.
fn has_normals(m: &Match) -> bool {
    m.model_normal.norm_squared() > 0.5 && m.seen_normal.norm_squared() > 0.5
}

/// A match with depth, reduced to what the inner loops need.
struct Pair {
    model_point: Point3<f64>,
    model_normal: Vector3<f64>,
    seen_point: Point3<f64>,
    seen_normal: Vector3<f64>,
    tolerance: f64,
    has_normals: bool,
}

impl Pair {
    fn of(m: &Match) -> Option<Self> {
        Some(Self {
            model_point: m.model_point,
            model_normal: m.model_normal,
            seen_point: m.seen_point?,
            seen_normal: m.seen_normal,
            tolerance: m.tolerance,
            has_normals: has_normals(m),
        })
    }

    /// Squared distance of the pair in a pose, divided by the squared tolerance; `None` if the pair does not agree
    /// with the pose in place and normal.
    #[inline(always)]
    fn residual_squared(&self, pose: &IsometryMatrix3<f64>, slack: f64) -> Option<f64> {
        let apart = pose * self.model_point - self.seen_point;
        let squared = apart.norm_squared() / self.tolerance.powi(2);
        let is_turned_alike = || (pose * self.model_normal).dot(&self.seen_normal) > MIN_COSINE;
        (squared < slack * slack && (!self.has_normals || is_turned_alike())).then_some(squared)
    }
}

/// A subset of a part's matches, one bit per match.
#[derive(Clone, Copy, Default)]
struct Chosen([u64; MAX_MATCHES.div_ceil(64)]);

impl Chosen {
    fn add(&mut self, i: usize) {
        self.0[i / 64] |= 1 << (i % 64);
    }

    fn count(&self) -> usize {
        self.0.iter().map(|word| word.count_ones() as usize).sum()
    }

    fn and(&self, other: &Self) -> Self {
        Self(std::array::from_fn(|k| self.0[k] & other.0[k]))
    }

    fn iter(&self) -> impl Iterator<Item = usize> {
        let of_word = |(k, word): (usize, u64)| {
            let next = |left: &u64| Some(left & (left - 1)).filter(|left| *left != 0);
            let from = Some(word).filter(|word| *word != 0);
            std::iter::successors(from, next)
                .map(move |left| 64 * k + left.trailing_zeros() as usize)
        };
        self.0.into_iter().enumerate().flat_map(of_word)
    }

    /// Random member of the subset; `None` if it is empty.
    fn any(&self, rng: &mut ChaCha8Rng) -> Option<usize> {
        let count = self.count();
        (count > 0).then(|| self.iter().nth(rng.random_range(0..count)))?
    }
}

/// Poses of one part from its matches, best first.
fn part_poses(matches: &[&Match], rng: &mut ChaCha8Rng) -> Vec<Pose> {
    let pairs: Vec<Pair> = matches.iter().filter_map(|m| Pair::of(m)).collect();
    let neighbours = compatibility(&pairs);
    let mut seeds: Vec<usize> = (0..pairs.len()).filter(|&i| neighbours[i].count() > 0).collect();
    seeds.sort_by_key(|&i| std::cmp::Reverse(neighbours[i].count()));
    seeds.truncate(SEEDS);
    if seeds.is_empty() {
        return Vec::new();
    }
    let mut triples = HashSet::new();
    let per_seed = (TRIPLES / seeds.len()).max(4);
    for &i in &seeds {
        for _ in 0..per_seed {
            let Some(j) = neighbours[i].any(rng) else { break };
            let k = neighbours[i].and(&neighbours[j]).any(rng).unwrap_or(j);
            let mut triple = [i, j, k];
            triple.sort_unstable();
            triples.insert(triple);
        }
    }
    let mut triples: Vec<[usize; 3]> = triples.into_iter().collect();
    triples.sort_unstable();
    let mut scored: Vec<Scored> =
        triples.par_iter().filter_map(|t| Some(Scored::new(&pairs, fit(&pairs, *t)?))).collect();
    scored.sort_by(|a, b| b.score.total_cmp(&a.score));
    distinct(&pairs, &scored)
}

/// For each pair, the other pairs that are geometrically consistent with it.
fn compatibility(pairs: &[Pair]) -> Vec<Chosen> {
    let of = |i: usize| {
        let mut compatible_with = Chosen::default();
        let others = (0..pairs.len()).filter(|&j| j != i && compatible(&pairs[i], &pairs[j]));
        others.for_each(|j| compatible_with.add(j));
        compatible_with
    };
    (0..pairs.len()).into_par_iter().map(of).collect()
}

/// True if two matches may belong to one rigid motion: distance and angles are alike on both sides.
fn compatible(a: &Pair, b: &Pair) -> bool {
    let on_model = b.model_point - a.model_point;
    let in_scene = b.seen_point - a.seen_point;
    let (dm, ds) = (on_model.norm(), in_scene.norm());
    if dm < 0.025 || ds < 0.025 || (dm - ds).abs() > 0.6 * (a.tolerance + b.tolerance) {
        return false;
    }
    let between_normals = || {
        let model = a.model_normal.dot(&b.model_normal);
        is_same_angle(model, a.seen_normal.dot(&b.seen_normal))
    };
    let to_the_other = |p: &Pair, sign: f64| {
        let model = sign * p.model_normal.dot(&on_model) / dm;
        is_same_angle(model, sign * p.seen_normal.dot(&in_scene) / ds)
    };
    (!(a.has_normals && b.has_normals) || between_normals())
        && (!a.has_normals || to_the_other(a, 1.0))
        && (!b.has_normals || to_the_other(b, -1.0))
}

/// True if two angles, given by their cosines, differ by less than [`MAX_ANGLE`]. Cosines differ by no more than
/// their angles, so most pairs are rejected without an arc cosine.
fn is_same_angle(cosine: f64, other: f64) -> bool {
    let angle = |x: f64| x.clamp(-1.0, 1.0).acos();
    (cosine - other).abs() < MAX_ANGLE && (angle(cosine) - angle(other)).abs() < MAX_ANGLE
}

/// Weighted rigid fit of the matched points and of points on their normals.
fn fit(pairs: &[Pair], of: impl IntoIterator<Item = usize>) -> Option<Pose> {
    let (mut from, mut to, mut weights) = (Vec::new(), Vec::new(), Vec::new());
    for i in of {
        let p = &pairs[i];
        from.push(p.model_point);
        to.push(p.seen_point);
        weights.push(1.0);
        if p.has_normals {
            from.push(p.model_point + NORMAL_ARM * p.model_normal);
            to.push(p.seen_point + NORMAL_ARM * p.seen_normal);
            weights.push(0.5);
        }
    }
    rigid_fit(&from, &to, &weights)
}

/// A pose with the pairs that agree with it and its score.
struct Scored {
    pose: Pose,
    inliers: Chosen,
    score: f64,
}

impl Scored {
    fn new(pairs: &[Pair], pose: Pose) -> Self {
        let matrix = matrix_pose(&pose);
        let (mut inliers, mut score) = (Chosen::default(), 0.0);
        for (i, pair) in pairs.iter().enumerate() {
            if let Some(squared) = pair.residual_squared(&matrix, 1.0) {
                inliers.add(i);
                score += 1.0 - 0.5 * squared;
            }
        }
        Self { pose, inliers, score }
    }
}

/// Best poses that share at most half of their inliers with each better one, refitted to their inliers.
fn distinct(pairs: &[Pair], scored: &[Scored]) -> Vec<Pose> {
    let mut kept = Vec::new();
    let mut used: Vec<Chosen> = Vec::new();
    for Scored { pose, inliers, .. } in scored {
        if inliers.count() < 3 {
            break;
        }
        if used.iter().any(|u| 2 * u.and(inliers).count() > inliers.count()) {
            continue;
        }
        used.push(*inliers);
        let (mut best, mut own) = (*pose, *inliers);
        for _ in 0..2 {
            let Some(refitted) = fit(pairs, own.iter()) else { break };
            let now = Scored::new(pairs, refitted);
            if now.inliers.count() >= own.count() {
                (best, own) = (refitted, now.inliers);
            }
        }
        kept.push(best);
        if kept.len() == KEEP {
            break;
        }
    }
    kept
}

/// Configurations by votes, propagated through the tree from the part with the known pose. A joint without votes
/// keeps its rest configuration.
fn configurations(
    articulated: &Articulated,
    matches: &[Match],
    part: usize,
    camera_from_part: &Pose,
) -> Vec<f64> {
    let mut q = articulated.rest();
    let mut pose_of: Vec<Option<Pose>> = vec![None; articulated.parts];
    pose_of[part] = Some(*camera_from_part);
    loop {
        let next = articulated
            .joints
            .iter()
            .position(|j| pose_of[j.parent].is_some() != pose_of[j.child].is_some());
        let Some(i) = next else { return q };
        let joint = &articulated.joints[i];
        let forward = pose_of[joint.parent].is_some();
        let (known, other) =
            if forward { (joint.parent, joint.child) } else { (joint.child, joint.parent) };
        let Some(pose) = pose_of[known] else { return q };
        if let Some(voted) = vote(articulated, matches, i, other, &pose, forward) {
            q[i] = voted;
        }
        // At configuration 0 the frames of all parts coincide, so that only the motion of the joint lies between two
        // poses.
        let motion = joint.geometry.motion(q[i]);
        pose_of[other] = Some(if forward { pose * motion } else { pose * motion.inverse() });
    }
}

/// Configuration that most matches of `other` vote for, given the pose of the part on the known side; `forward` if
/// that is the parent.
fn vote(
    articulated: &Articulated,
    matches: &[Match],
    joint: usize,
    other: usize,
    camera_from_known: &Pose,
    forward: bool,
) -> Option<f64> {
    let j = &articulated.joints[joint];
    let votes: Vec<(f64, f64)> = matches
        .iter()
        .filter(|m| m.part == other)
        .filter_map(|m| {
            let seen = camera_from_known.inverse_transform_point(&m.seen_point?);
            // Forward, motion(q) takes the model point to the seen point; backward, it takes the seen point to the
            // model point.
            let (from, to) = if forward { (m.model_point, seen) } else { (seen, m.model_point) };
            let (q, residual, lever) = vote_of(&j.geometry, &from, &to);
            (residual < 1.3 * m.tolerance && q > j.low && q < j.high)
                .then_some((q, m.tolerance / lever.max(0.03)))
        })
        .collect();
    let (best, width) = votes
        .iter()
        .max_by_key(|(q, width)| {
            votes.iter().filter(|(other, _)| (other - q).abs() < *width).count()
        })
        .copied()?;
    let mut near: Vec<f64> =
        votes.iter().map(|v| v.0).filter(|q| (q - best).abs() < width).collect();
    median(&mut near)
}

/// Configuration that moves `from` closest to `to`, the remaining distance (metres), and the lever arm (metres; 1
/// for a slide).
fn vote_of(line: &JointGeometry, from: &Point3<f64>, to: &Point3<f64>) -> (f64, f64, f64) {
    let axis = line.axis.into_inner();
    if line.kind == JointKind::Prismatic {
        let d = to - from;
        let q = axis.dot(&d);
        return (q, (d - axis * q).norm(), 1.0);
    }
    let (x, y) = (from - line.origin, to - line.origin);
    let (hx, hy) = (axis.dot(&x), axis.dot(&y));
    let (px, py) = (x - axis * hx, y - axis * hy);
    let q = axis.dot(&px.cross(&py)).atan2(px.dot(&py));
    let advance = line.pitch * q / TAU;
    let residual = (px.norm() - py.norm()).hypot(hy - hx - advance);
    (q, residual, 0.5 * (px.norm() + py.norm()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recognise::kinematics::ChainJoint;

    #[test]
    fn one_match_votes_for_the_configuration_that_takes_it_there() {
        let hinge = JointGeometry::hinge(Vector3::y_axis(), Point3::new(0.3, 0.0, 1.0));
        let from = Point3::new(-0.1, 0.2, 1.1);
        let (q, residual, lever) = vote_of(&hinge, &from, &(hinge.motion(0.6) * from));
        assert!((q - 0.6).abs() < 1e-9 && residual < 1e-9 && (lever - 0.41231).abs() < 1e-4);
        let slide = JointGeometry::slide(Vector3::x_axis(), Point3::origin());
        let (q, residual, _) = vote_of(&slide, &from, &(from + Vector3::new(0.2, 0.03, 0.0)));
        assert!((q - 0.2).abs() < 1e-9 && (residual - 0.03).abs() < 1e-9);
    }

    #[test]
    fn angles_are_compared_by_their_cosines_as_by_themselves() {
        assert!(is_same_angle(1.0_f64.cos(), 1.4_f64.cos()));
        assert!(!is_same_angle(1.0_f64.cos(), 1.6_f64.cos()));
        assert!(!is_same_angle(0.0_f64.cos(), 0.6_f64.cos()));
    }

    #[test]
    fn matches_of_a_door_tell_its_pose_and_how_far_it_is_open() {
        let hinge = JointGeometry::hinge(Vector3::y_axis(), Point3::new(0.3, 0.0, 1.0));
        let joints = vec![ChainJoint::new(hinge, [0, 1], [0.0, 1.5])];
        let articulated = Articulated { parts: 2, joints };
        let truth = State { camera_from_object: Pose::translation(0.1, 0.0, 0.5), q: vec![0.8] };
        let poses = articulated.poses(&truth);
        let matches: Vec<Match> = (0..24_u16)
            .map(|i| {
                let part = usize::from(i % 2);
                let (x, y) = (0.07 * f64::from(i / 2 % 4), 0.09 * f64::from(i / 8));
                let model_point = Point3::new(x - 0.2, y - 0.1, 1.0 + 0.02 * f64::from(i % 3));
                let seen = poses[part] * model_point;
                Match {
                    part,
                    model_point,
                    model_normal: Vector3::zeros(),
                    pixel: [10.0 * f32::from(i), 5.0 * f32::from(i)],
                    seen_point: Some(seen),
                    seen_normal: Vector3::zeros(),
                    tolerance: 0.02,
                    distance: 0.1,
                    ratio: 0.5,
                }
            })
            .collect();
        let best = &all(&articulated, &matches, 1)[0];
        assert_eq!(best.support, 24);
        let off = best.state.camera_from_object.inverse() * truth.camera_from_object;
        assert!(off.translation.vector.norm() < 0.01 && (best.state.q[0] - 0.8).abs() < 0.05);
    }
}
