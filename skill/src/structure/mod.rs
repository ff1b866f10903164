//! From clusters to a kinematic tree: the paper's sections III-B to III-D in a row, and the
//! tests that decide which of the moving things is a part of an object at all (an arm is
//! not).

mod evidence;

use crate::articulate::{
    FittedJoint, JointGeometry, JointKind, Link, PoseSample, fit_models, spanning_tree,
};
use crate::base::BaseMotion;
use crate::config::SkillConfig;
use crate::geometry::{Moments, Pose, distance_to_line, extent, line_angle, median_point};
use crate::keyframes::Keyframes;
use crate::model::{Joint, covariance_rows};
use crate::pose::{self, PartMotion};
use crate::segment::{Cluster, segment};
use crate::timing::StageTimes;
use crate::track::{TrackSet, Trajectory};
use nalgebra::{Point3, UnitVector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

pub use evidence::{Probed, probe_points, rests, seen_through};

/// Which parts and joints are believed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StructureConfig {
    /// Fewest frames in which a joint is observed.
    pub min_frames: usize,
    /// Least motion of a slide, metres.
    pub min_slide_m: f64,
    /// Least motion of a hinge, radians.
    pub min_turn_rad: f64,
    /// Largest root mean square distance to the joint's model, metres,
    pub max_position_rmse_m: f64,
    /// plus this share of the way that the part makes: hands roughly follow many a model.
    pub max_rmse_share: f64,
    /// Largest share of samples that the joint does not explain.
    pub max_outlier_ratio: f64,
    /// Frames for which a track of an object's part rests at the start or end of its life.
    pub rest_frames: usize,
    /// Least share of a part's tracks that rest: object parts rest, hands do not.
    pub min_rest_share: f64,
    /// Largest share of a part's points seen *through*: where the model says that there is
    /// a surface, the camera saw something behind it.
    pub max_seen_through: f64,
    /// Squared correlation with a better joint's configuration from which a joint is taken for
    /// a consequence of it.
    pub max_coupling: f64,
    /// Two stretches of one joint agree within this angle, radians.
    pub merge_angle_rad: f64,
    /// and this distance, metres.
    pub merge_distance_m: f64,
}

impl Default for StructureConfig {
    fn default() -> Self {
        Self {
            min_frames: 15,
            min_slide_m: 0.06,
            min_turn_rad: 0.15,
            max_position_rmse_m: 0.0025,
            max_rmse_share: 0.01,
            max_outlier_ratio: 0.35,
            rest_frames: 8,
            min_rest_share: 0.12,
            max_seen_through: 0.28,
            max_coupling: 0.85,
            merge_angle_rad: 0.26,
            merge_distance_m: 0.06,
        }
    }
}

/// A joint with the part that it moves.
#[derive(Debug, Clone)]
pub struct LearnedJoint {
    /// The joint.
    pub joint: Joint,
    /// Takes the part's points of the reference frame to where they are in the base frame.
    pub base_from_part: Trajectory,
    /// Tracks on the part.
    pub tracks: Vec<usize>,
    /// Places on a plain part, which no track tells of, in its coordinates.
    pub plain_surface: Vec<Point3<f64>>,
}

/// A part while the tree is built.
struct Candidate {
    motion: PartMotion,
    fit: FittedJoint,
    /// Frames of the fit's samples.
    frames: Vec<usize>,
}

/// Sections III-B to III-D of the paper.
pub fn from_clusters(
    set: &TrackSet,
    base: &BaseMotion,
    keyframes: &Keyframes,
    config: &SkillConfig,
    times: &mut StageTimes,
) -> Vec<LearnedJoint> {
    let clusters = times.measure("segment", || segment(set, base, &config.segment));
    let motions: Vec<PartMotion> = times.measure("pose", || {
        clusters.par_iter().flat_map_iter(|c| motions_of(base, keyframes, c, config)).collect()
    });
    times.measure("articulate", || {
        let candidates = candidates(base, keyframes, motions, config);
        build_tree(set, base, candidates, config)
    })
}

fn candidates(
    base: &BaseMotion,
    keyframes: &Keyframes,
    motions: Vec<PartMotion>,
    config: &SkillConfig,
) -> Vec<Candidate> {
    let mut fitted: Vec<Candidate> =
        motions.into_iter().filter_map(|m| fit_to_base(m, config)).collect();
    merge_rigid(base, &mut fitted, config);
    merge_stretches(&mut fitted, config);
    fitted.sort_by_key(|c| std::cmp::Reverse(c.motion.tracks.len()));
    let mut believed: Vec<Candidate> = Vec::new();
    for candidate in fitted {
        let reason = doubt(base, keyframes, &candidate, &believed, config);
        tracing::debug!(
            tracks = candidate.motion.tracks.len(),
            kind = candidate.fit.geometry.kind.name(),
            frames = candidate.frames.len(),
            rmse_m = candidate.fit.position_rmse,
            outliers = candidate.fit.outlier_ratio,
            refused = reason.as_deref().unwrap_or("no"),
            "part"
        );
        if reason.is_none() {
            believed.push(candidate);
        }
    }
    believed
}

/// The motions in a cluster, the clearest first. A hand and what it holds move as one for a
/// while, so a cluster may chain several things: what departs from its motion, or is
/// contradicted by the pictures, is looked at again by itself.
fn motions_of(
    base: &BaseMotion,
    keyframes: &Keyframes,
    cluster: &Cluster,
    config: &SkillConfig,
) -> Vec<PartMotion> {
    let mut motions = Vec::new();
    let mut rest = cluster.tracks.clone();
    for round in 0..MOTIONS_OF_A_CLUSTER {
        let seed = config.seed + round;
        let Some(motion) =
            pose::estimate(base, &Cluster { tracks: rest.clone() }, &config.pose, seed)
        else {
            break;
        };
        let motion = without_strangers(base, keyframes, motion, config);
        let before = rest.len();
        rest.retain(|t| !motion.tracks.contains(t));
        motions.push(motion);
        if rest.len() < config.segment.min_cluster || rest.len() == before {
            break;
        }
    }
    motions
}

/// Most motions sought in one cluster.
const MOTIONS_OF_A_CLUSTER: u64 = 5;

/// Takes out tracks that depart from the motion and tracks that the pictures contradict one by
/// one (a hand moves with what it holds, but comes and leaves), and estimates the motion anew
/// from the rest.
fn without_strangers(
    base: &BaseMotion,
    keyframes: &Keyframes,
    mut motion: PartMotion,
    config: &SkillConfig,
) -> PartMotion {
    for round in 0..STRANGER_ROUNDS {
        let all = motion.tracks.len();
        let mut kept = pose::followers(base, &motion, &config.pose);
        kept = uncontradicted(base, keyframes, &motion, &kept);
        if kept.len() == all || kept.len() < config.segment.min_cluster {
            break;
        }
        let seed = config.seed + round;
        match pose::estimate(base, &Cluster { tracks: kept }, &config.pose, seed) {
            Some(again) => motion = again,
            None => break,
        }
    }
    motion
}

/// Rounds of dismissing strangers: the motion is clearer after each.
const STRANGER_ROUNDS: u64 = 3;

/// Tracks whose place on the part is not seen through in a third of the keyframes that tell.
fn uncontradicted(
    base: &BaseMotion,
    keyframes: &Keyframes,
    motion: &PartMotion,
    tracks: &[usize],
) -> Vec<usize> {
    let on_part = |id: usize| {
        let places: Vec<Point3<f64>> = base.tracks[id]
            .seen()
            .filter_map(|(t, p)| Some(motion.base_from_part[t]?.inverse_transform_point(&p.point)))
            .collect();
        median_point(&places)
    };
    let stands = |id: usize| {
        let Some(place) = on_part(id) else { return false };
        let mut all = Probed::default();
        for (frame, picture) in keyframes.iter() {
            if let Some(pose) = motion.base_from_part[frame] {
                let camera_from_part = base.camera_from_base[frame] * pose;
                all.add(probe_points(picture, &[place], &camera_from_part));
            }
        }
        all.mostly_agrees()
    };
    tracks.iter().copied().filter(|&id| stands(id)).collect()
}

fn fit_to_base(motion: PartMotion, config: &SkillConfig) -> Option<Candidate> {
    let (frames, samples): (Vec<usize>, Vec<PoseSample>) = motion
        .base_from_part
        .iter()
        .enumerate()
        .filter_map(|(t, pose)| Some((t, PoseSample::from_pose(t as f64, pose.as_ref()?))))
        .unzip();
    let fit = fit_models(&samples, &config.articulate).ok()?.into_iter().next()?;
    tracing::debug!(
        tracks = motion.tracks.len(),
        kind = fit.geometry.kind.name(),
        frames = ?frames.first().zip(frames.last()),
        span = span_of(&fit.configuration),
        rmse_m = fit.position_rmse,
        "cluster"
    );
    Some(Candidate { motion, fit, frames })
}

/// Clusters that keep still relative to one another are one part.
fn merge_rigid(base: &BaseMotion, parts: &mut Vec<Candidate>, config: &SkillConfig) {
    let mut i = 0;
    while i < parts.len() {
        let mut j = i + 1;
        while j < parts.len() {
            let rigid = relative_samples(&parts[i].motion, &parts[j].motion)
                .filter(|(_, s)| s.len() >= config.structure.min_frames)
                .and_then(|(_, s)| fit_models(&s, &config.articulate).ok())
                .and_then(|fits| fits.into_iter().next())
                .is_some_and(|f| {
                    f.geometry.kind == JointKind::Fixed
                        && f.position_rmse < config.articulate.position_sigma_m * 2.0
                        && f.outlier_ratio < 0.2
                });
            match rigid.then(|| joined(base, &parts[i], &parts[j], config)).flatten() {
                Some(merged) => {
                    parts[i] = merged;
                    parts.remove(j);
                    j = i + 1;
                }
                None => j += 1,
            }
        }
        i += 1;
    }
}

fn joined(
    base: &BaseMotion,
    a: &Candidate,
    b: &Candidate,
    config: &SkillConfig,
) -> Option<Candidate> {
    let mut tracks = [a.motion.tracks.clone(), b.motion.tracks.clone()].concat();
    tracks.sort_unstable();
    let motion = pose::estimate(base, &Cluster { tracks }, &config.pose, config.seed)?;
    let merged = fit_to_base(motion, config)?;
    let longest = a.frames.len().max(b.frames.len());
    (merged.frames.len() >= longest && merged.fit.geometry.kind != JointKind::Fixed)
        .then_some(merged)
}

/// Opening and closing may be seen as two parts with hardly a common frame, since surfaces
/// turn away: two stretches with one line are one joint, continuous in between.
fn merge_stretches(parts: &mut Vec<Candidate>, config: &SkillConfig) {
    let mut i = 0;
    while i < parts.len() {
        let mut j = i + 1;
        while j < parts.len() {
            if same_line(&parts[i], &parts[j], &config.structure)
                && let Some(merged) = concatenated(&parts[i], &parts[j], config)
            {
                parts[i] = merged;
                parts.remove(j);
                j = i + 1;
            } else {
                j += 1;
            }
        }
        i += 1;
    }
}

fn same_line(a: &Candidate, b: &Candidate, config: &StructureConfig) -> bool {
    let (ga, gb) = (&a.fit.geometry, &b.fit.geometry);
    if ga.kind != gb.kind || ga.kind == JointKind::Fixed {
        return false;
    }
    if line_angle(&ga.axis, &gb.axis) > config.merge_angle_rad {
        return false;
    }
    let common = a.frames.iter().filter(|f| b.frames.contains(f)).count();
    let near = match ga.kind {
        JointKind::Prismatic => distance_to_line(&ga.origin, &ga.axis, &gb.origin) < 0.3,
        _ => distance_to_line(&ga.origin, &ga.axis, &gb.origin) < config.merge_distance_m,
    };
    near && common * 4 < a.frames.len().min(b.frames.len())
}

/// The later stretch is moved along the joint so that it starts where the earlier one ends.
fn concatenated(a: &Candidate, b: &Candidate, config: &SkillConfig) -> Option<Candidate> {
    let (early, late) = if a.frames.first()? <= b.frames.first()? { (a, b) } else { (b, a) };
    let mut motion = early.motion.clone();
    let geometry = early.fit.geometry;
    let q_end = *early.fit.configuration.last()?;
    let sign = geometry.axis.dot(&late.fit.geometry.axis).signum();
    let q_start = sign * late.fit.configuration.first()?;
    let rest = Pose::from_parts(early.fit.rest_position.coords.into(), early.fit.rest_orientation);
    for (frame, q) in late.frames.iter().zip(&late.fit.configuration) {
        if motion.base_from_part[*frame].is_none() {
            let q = sign * q - q_start + q_end;
            motion.base_from_part[*frame] = Some(geometry.motion(q) * rest);
        }
    }
    motion.tracks.extend(&late.motion.tracks);
    motion.tracks.sort_unstable();
    motion.tracks.dedup();
    fit_to_base(motion, config)
}

fn relative_samples(a: &PartMotion, b: &PartMotion) -> Option<(Vec<usize>, Vec<PoseSample>)> {
    let pairs: Vec<(usize, PoseSample)> = a
        .base_from_part
        .iter()
        .zip(&b.base_from_part)
        .enumerate()
        .filter_map(|(t, (a, b))| {
            Some((t, PoseSample::from_pose(t as f64, &(a.as_ref()?.inverse() * b.as_ref()?))))
        })
        .collect();
    (!pairs.is_empty()).then(|| pairs.into_iter().unzip())
}

/// Why a moving thing is no part of an object, if it is not.
fn doubt(
    base: &BaseMotion,
    keyframes: &Keyframes,
    candidate: &Candidate,
    believed: &[Candidate],
    config: &SkillConfig,
) -> Option<String> {
    let limits = &config.structure;
    let fit = &candidate.fit;
    let span = span_of(&fit.configuration);
    let least = match fit.geometry.kind {
        JointKind::Fixed => return Some("it does not move".to_owned()),
        JointKind::Prismatic => limits.min_slide_m,
        _ => limits.min_turn_rad,
    };
    if span < least {
        return Some(format!("it moves by {span:.3} only"));
    }
    if candidate.frames.len() < limits.min_frames {
        return Some(format!("it is seen in {} frames only", candidate.frames.len()));
    }
    let way =
        extent(candidate.motion.base_from_part.iter().flatten().map(|p| p.translation.vector));
    if fit.position_rmse > limits.max_position_rmse_m + limits.max_rmse_share * way {
        return Some(format!("it departs from any joint by {:.3} m", fit.position_rmse));
    }
    if fit.outlier_ratio > limits.max_outlier_ratio {
        return Some(format!("no joint explains {:.0} % of it", 100.0 * fit.outlier_ratio));
    }
    let rest = rests(base, &candidate.motion.tracks, limits.rest_frames);
    if rest < limits.min_rest_share {
        return Some(format!("only {:.0} % of it ever rests", 100.0 * rest));
    }
    let through = seen_through(
        base,
        keyframes,
        &candidate.motion,
        &fit.geometry,
        &candidate.frames,
        &fit.configuration,
    );
    if through > limits.max_seen_through {
        return Some(format!("{:.0} % of it is seen through", 100.0 * through));
    }
    if believed.iter().any(|b| coupling(candidate, b) > limits.max_coupling) {
        return Some("it moves as a part does that more tracks vouch for".to_owned());
    }
    None
}

/// Squared correlation of two configurations, 0 to 1: a hand, or an edge that is dragged along,
/// moves with the part that it holds.
fn coupling(a: &Candidate, b: &Candidate) -> f64 {
    let common: Vec<(f64, f64)> = a
        .frames
        .iter()
        .zip(&a.fit.configuration)
        .filter_map(|(f, &q)| Some((q, b.fit.configuration[b.frames.binary_search(f).ok()?])))
        .collect();
    if 2 * common.len() < a.frames.len() {
        return 0.0;
    }
    Moments::of(&common).correlation_sq().unwrap_or(0.0)
}

fn span_of(configuration: &[f64]) -> f64 {
    let low = configuration.iter().copied().fold(f64::INFINITY, f64::min);
    let high = configuration.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if high >= low { high - low } else { 0.0 }
}

/// The minimum spanning tree over base and parts (paper, Eq. 7).
fn build_tree(
    set: &TrackSet,
    base: &BaseMotion,
    parts: Vec<Candidate>,
    config: &SkillConfig,
) -> Vec<LearnedJoint> {
    let mut links = Vec::new();
    let mut fits: Vec<(FittedJoint, Vec<usize>)> = Vec::new();
    for (i, part) in parts.iter().enumerate() {
        links.push(Link { a: 0, b: i + 1, cost: per_frame(&part.fit, part.frames.len()) });
        fits.push((part.fit.clone(), part.frames.clone()));
    }
    for i in 0..parts.len() {
        for j in i + 1..parts.len() {
            let Some((frames, samples)) = relative_samples(&parts[i].motion, &parts[j].motion)
            else {
                continue;
            };
            // A link that was seen for a small part of the time explains little.
            if 2 * frames.len() < parts[i].frames.len().max(parts[j].frames.len()) {
                continue;
            }
            let Some(fit) = fit_models(&samples, &config.articulate)
                .ok()
                .and_then(|f| f.into_iter().find(|f| f.geometry.kind != JointKind::Fixed))
            else {
                continue;
            };
            // The base explains as well as a moving part: prefer it (two sliders beside one
            // another are joined by one degree of freedom, too).
            let cost = per_frame(&fit, frames.len()) + PREFER_BASE;
            links.push(Link { a: i + 1, b: j + 1, cost });
            fits.push((fit, frames));
        }
    }
    let mut learned: Vec<LearnedJoint> = Vec::new();
    let mut number_of_part = vec![0; parts.len() + 1];
    for (parent, child, link) in spanning_tree(parts.len() + 1, &links) {
        let (fit, frames) = &fits[link];
        let number = learned.len() + 1;
        number_of_part[child] = number;
        // Links between parts were fitted as a -> b with a < b.
        let reversed = links[link].a != parent;
        if reversed && parent != 0 {
            continue;
        }
        let in_parent = fit.geometry;
        let parent_motion = (parent > 0).then(|| &parts[parent - 1].motion);
        learned.push(to_learned(
            set,
            number,
            number_of_part[parent],
            in_parent,
            fit,
            frames,
            &parts[child - 1],
            parent_motion,
            base.camera_from_base.len(),
        ));
    }
    learned
}

/// BIC a frame by which a moving parent must be better than the base.
const PREFER_BASE: f64 = 2.0;

fn per_frame(fit: &FittedJoint, frames: usize) -> f64 {
    fit.bic / frames.max(1) as f64
}

#[allow(clippy::too_many_arguments)]
fn to_learned(
    set: &TrackSet,
    number: usize,
    parent: usize,
    in_parent: JointGeometry,
    fit: &FittedJoint,
    frames: &[usize],
    part: &Candidate,
    parent_motion: Option<&PartMotion>,
    frame_count: usize,
) -> LearnedJoint {
    // Object frame: the base at the first frame. A moving parent's line is carried there by
    // the parent's pose in the first frame that it was seen in.
    let base_from_parent = parent_motion
        .and_then(|m| m.base_from_part.iter().flatten().next().copied())
        .unwrap_or_default();
    let mut geometry = in_parent.transformed(&base_from_parent);
    let mut configuration: Vec<f64> = fit.configuration.clone();
    orient(&mut geometry, &mut configuration);
    let mut base_from_part: Trajectory = vec![None; frame_count];
    let rest = part.motion.base_from_part[part.frames[0]].unwrap_or_default();
    for (&frame, pose) in
        part.frames.iter().zip(part.frames.iter().map(|f| part.motion.base_from_part[*f]))
    {
        base_from_part[frame] = pose.map(|p| p * rest.inverse());
    }
    LearnedJoint {
        joint: Joint {
            name: format!("joint{number}"),
            parent,
            child: number,
            range: range_of(&configuration),
            covariance: covariance_rows(&fit.covariance),
            observations: frames.len(),
            bic: fit.bic,
            log_likelihood: fit.log_likelihood,
            position_rmse: fit.position_rmse,
            orientation_rmse: fit.orientation_rmse,
            configuration: set.timed(frames, &configuration),
            ..Joint::of(&geometry)
        },
        base_from_part,
        tracks: part.motion.tracks.clone(),
        plain_surface: Vec::new(),
    }
}

/// Configuration 0 at the first frame, growing with the first clear motion.
pub fn orient(geometry: &mut JointGeometry, configuration: &mut [f64]) {
    let Some(&first) = configuration.first() else { return };
    let span = span_of(configuration);
    let clear = configuration.iter().find(|q| (*q - first).abs() > 0.25 * span);
    let sign = if clear.is_some_and(|q| *q < first) { -1.0 } else { 1.0 };
    for q in configuration.iter_mut() {
        *q = sign * (*q - first);
    }
    if sign < 0.0 {
        geometry.axis = UnitVector3::new_unchecked(-geometry.axis.into_inner());
    }
}

/// Least and greatest configuration, single strays left out.
pub fn range_of(configuration: &[f64]) -> [f64; 2] {
    let mut sorted = configuration.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len();
    if n == 0 {
        return [0.0, 0.0];
    }
    let stray = n / 100;
    [sorted[stray].min(0.0), sorted[n - 1 - stray].max(0.0)]
}
