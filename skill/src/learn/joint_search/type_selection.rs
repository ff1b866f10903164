//! Selects the type of a joint (slide, hinge or screw): a joint of each type is fitted to the same
//! tracks, and the types are compared by BIC. A short motion bends too little to discriminate them.
//! A joint without a pitch is not compared with screws.
//!
//! In: a joint and its tracks in the frame of its parent, metres. Out: probability of each type.
//! From: paper, section III-D (BIC); Kass & Raftery 1995.

use super::association::{ADJUSTED_FRAMES, thinned};
use super::bundle_adjustment::{OUTLIER_CUT, locate_points, refine};
use super::estimate::JointEstimate;
use super::screw_joint::ScrewJoint;
use super::tracks_in_part_frame::TracksInFrame;
use crate::math::rigid::orthonormal_basis;
use crate::object::joint_geometry::JointKind;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Largest number of tracks to which each type is fitted.
const TRACKS: usize = 150;
/// Distances of far hinges that may imitate a slide, metres.
const FAR_HINGES_M: [f64; 2] = [0.5, 2.0];
/// Number of observations of a track that count as one independent observation, because the noise
/// of neighbouring frames is correlated.
const CORRELATED_OBSERVATIONS: f64 = 10.0;
/// Number of tracks of a frame that count as independent observations: they share the errors of the
/// frame's pose, which has six parameters, and of its depth. Where all tracks counted, a drawer that
/// moved by 5 cm before a camera in the hand was a hinge with probability 1.
const INDEPENDENT_IN_FRAME: f64 = 6.0;
/// Number of refinement steps for each of the other types.
const STEPS: usize = 10;

/// Probability of each type, by the BIC of all types (Kass & Raftery 1995). The costs are divided by
/// the cost of an observation in the best type where that is above 1, because the noise is then
/// larger than the sensor's model says (the variance inflation factor of Burnham & Anderson 2002).
pub fn type_probabilities(joint: &JointEstimate, view: &TracksInFrame) -> BTreeMap<JointKind, f64> {
    let mut sampled = joint.clone();
    sampled.known = thinned(&joint.known, joint.anchor, ADJUSTED_FRAMES);
    let sample = Sample::of(joint, &sampled, view);
    let mut costs = BTreeMap::from([(kind(joint), sample.cost(&sampled))]);
    let explained = |start: JointEstimate| {
        let other = sample.refined(start);
        (kind(&other), sample.cost(&other))
    };
    let others: Vec<(JointKind, f64)> =
        others(&sampled, &sample.tracks).into_par_iter().map(explained).collect();
    for (kind, cost) in others {
        let least = costs.entry(kind).or_insert(f64::INFINITY);
        *least = least.min(cost);
    }
    tracing::debug!(?costs, "mean cost of an observation by type");
    probabilities(&costs, sample.independent, sample.effective)
}

/// Probability of each type by the mean cost of an observation, the number of independent observations, and the number of
/// those that count: the tracks of a frame share errors, so at most six of them do. More parameters are penalised by
/// all of them, because the shared errors must not make the simpler type less likely.
fn probabilities(
    costs: &BTreeMap<JointKind, f64>,
    independent: f64,
    effective: f64,
) -> BTreeMap<JointKind, f64> {
    let inflation = costs.values().copied().fold(f64::INFINITY, f64::min).max(1.0);
    let criterion = |(&kind, cost): (&JointKind, &f64)| {
        let more_parameters = match kind {
            JointKind::Helical => 3.0,
            JointKind::Revolute => 2.0,
            _ => 0.0,
        };
        (kind, effective * cost / inflation + more_parameters * independent.ln())
    };
    let criteria: Vec<(JointKind, f64)> = costs.iter().map(criterion).collect();
    let best = criteria.iter().map(|(_, b)| *b).fold(f64::INFINITY, f64::min);
    let mut likely: BTreeMap<JointKind, f64> =
        criteria.into_iter().map(|(kind, b)| (kind, (-0.5 * (b - best)).exp())).collect();
    let total: f64 = likely.values().sum();
    likely.values_mut().for_each(|p| *p /= total);
    likely
}

fn kind(joint: &JointEstimate) -> JointKind {
    joint.dof.geometry().kind
}

/// Sample of a joint's tracks and frames to which joints of all types are fitted.
struct Sample<'s> {
    view: &'s TracksInFrame,
    tracks: Vec<usize>,
    /// Number of observations in the sampled frames.
    observations: f64,
    /// Number of independent observations in all frames.
    independent: f64,
    /// Number of these that count, at most [`INDEPENDENT_IN_FRAME`] in a frame.
    effective: f64,
}

impl<'s> Sample<'s> {
    fn of(joint: &JointEstimate, sampled: &JointEstimate, view: &'s TracksInFrame) -> Self {
        let stride = joint.members.len().div_ceil(TRACKS).max(1);
        let tracks: Vec<usize> = joint.members.iter().copied().step_by(stride).collect();
        let observed =
            |joint: &JointEstimate, t: usize| view.life(t).filter(|(f, _)| joint.known[*f]).count();
        let observations = |joint| tracks.iter().map(|&t| observed(joint, t)).sum::<usize>() as f64;
        let independent = (observations(joint) / CORRELATED_OBSERVATIONS).max(1.0);
        let mut in_frame = vec![0.0_f64; joint.known.len()];
        for (frame, _) in tracks.iter().flat_map(|&t| view.life(t)).filter(|(f, _)| joint.known[*f])
        {
            in_frame[frame] += 1.0;
        }
        let counted: f64 = in_frame.iter().map(|n| n.min(INDEPENDENT_IN_FRAME)).sum();
        Self {
            view,
            observations: observations(sampled).max(1.0),
            independent,
            effective: counted / CORRELATED_OBSERVATIONS,
            tracks,
        }
    }

    fn refined(&self, mut joint: JointEstimate) -> JointEstimate {
        locate_points(&mut joint, self.view, &self.tracks, 4.0 * OUTLIER_CUT);
        refine(&mut joint, self.view, &self.tracks, OUTLIER_CUT, STEPS);
        joint
    }

    /// Mean cost of an observation.
    fn cost(&self, joint: &JointEstimate) -> f64 {
        let motions = joint.motions();
        let cost = |&t: &usize| joint.cost_of(&motions, self.view, t, OUTLIER_CUT).sum;
        self.tracks.par_iter().map(cost).sum::<f64>() / self.observations
    }
}

/// Initial estimates for the joints of the other types.
fn others(joint: &JointEstimate, tracks: &[usize]) -> Vec<JointEstimate> {
    let n = tracks.len().max(1) as f64;
    let middle = 0.5 * (joint.range[0] + joint.range[1]);
    let sum: Vector3<f64> =
        tracks.iter().map(|&t| joint.dof.move_point(middle, &joint.points[t]).coords).sum();
    let centre = Point3::from(sum / n);
    let with = |dof: ScrewJoint, scale: f64| {
        let mut other = joint.clone();
        other.dof = dof;
        for q in &mut other.q {
            *q *= scale;
        }
        other
    };
    if joint.dof.hinge {
        let velocity = joint.dof.velocity(&centre);
        let lever = velocity.norm().max(1e-6);
        let slide = with(ScrewJoint::slide(velocity / lever, centre), lever);
        let hinge = joint.dof.pitch.map(|_| with(ScrewJoint { pitch: None, ..joint.dof }, 1.0));
        return std::iter::once(slide).chain(hinge).collect();
    }
    let (u, v) = orthonormal_basis(&joint.dof.axis);
    let mut starts = Vec::new();
    for side in [u, -u, v, -v] {
        for lever in FAR_HINGES_M {
            // The hinge's axis x arm is the slide's direction.
            let axis = side.cross(&joint.dof.axis);
            starts.push(with(ScrewJoint::hinge(axis, centre - side * lever), 1.0 / lever));
        }
    }
    starts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::test_data::seen_moving;

    /// Twelve points that turn by `angle` in thirty frames, seen with 2 mm of noise.
    fn seen_turning(line: &ScrewJoint, angle: f64) -> (TracksInFrame, JointEstimate) {
        let q: Vec<f64> = (0..30).map(|f| angle * f64::from(f) / 29.0).collect();
        let places: Vec<Point3<f64>> = (0..12)
            .map(f64::from)
            .map(|i| Point3::new(0.1 + 0.04 * i, 0.2 * (1.3 * i).sin(), 1.5))
            .collect();
        let view = seen_moving(line, &places, &q);
        let mut joint = JointEstimate::new(*line, &view, 0);
        joint.q = q;
        joint.known = vec![true; 30];
        joint.members = (0..12).collect();
        joint.points = places;
        joint.summarise();
        (view, joint)
    }

    const DOOR: ScrewJoint = ScrewJoint {
        hinge: true,
        axis: Vector3::new(0.0, 1.0, 0.0),
        origin: Point3::new(0.0, 0.0, 1.5),
        pitch: None,
    };

    fn probability_of_a_hinge(angle: f64) -> f64 {
        let (view, joint) = seen_turning(&DOOR, angle);
        type_probabilities(&joint, &view)[&JointKind::Revolute]
    }

    #[test]
    fn a_door_that_opens_wide_is_a_hinge() {
        assert!(probability_of_a_hinge(0.8) > 0.99);
    }

    #[test]
    fn a_door_that_hardly_opens_may_be_either() {
        let short = probability_of_a_hinge(0.01);
        assert!(short < 0.9, "{short}");
    }

    #[test]
    fn a_hinge_that_fits_little_better_under_errors_that_tracks_share_is_not_told() {
        let hinge = |slide: f64, hinge: f64, effective: f64| {
            let costs = [(JointKind::Prismatic, slide), (JointKind::Revolute, hinge)].into();
            probabilities(&costs, 540.0, effective)[&JointKind::Revolute]
        };
        assert!(hinge(4.5, 4.0, 540.0) > 0.99, "if all observations were independent");
        assert!(hinge(4.5, 4.0, 54.0) < 0.1);
        assert!(hinge(20.0, 4.0, 54.0) > 0.99);
    }

    #[test]
    fn what_advances_as_it_turns_is_a_screw() {
        let lift = ScrewJoint { pitch: Some(-0.02), ..DOOR };
        let (view, joint) = seen_turning(&lift, 1.2);
        let of_types = type_probabilities(&joint, &view);
        assert!(of_types[&JointKind::Helical] > 0.99);
    }
}
