//! Slide, hinge or screw? The same tracks are explained each way; what separates the costs is
//! the evidence. A motion too short bends too little to tell.

use super::JointsConfig;
use super::adjust::{locate_points, refine};
use super::dof::Dof;
use super::grown::Grown;
use super::view::View;
use crate::articulate::JointKind;
use crate::geometry::orthonormal_basis;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Tracks that are explained each way.
const TRACKS: usize = 150;
/// Distances of hinges that may imitate a slide, metres.
const FAR_HINGES_M: [f64; 2] = [0.5, 2.0];
/// Refinement steps of the other kinds.
const STEPS: usize = 10;
/// Factor on the cut within which observations count while a screw's pitch is sought: a hinge tells
/// where its tracks are only as long as they have not advanced.
pub const FAR: f64 = 16.0;
/// Least that a screw advances over what is seen of it, metres: what advances less is a hinge.
const MIN_ADVANCE_M: f64 = 0.01;
/// Least turn that can tell a screw, radians.
const MIN_SCREW_TURN: f64 = 0.5;
/// By how much the BIC must speak for a screw: hinges drawn from few frames reach 20, screws
/// that advance 1.5 cm begin at 350.
const MIN_EVIDENCE: f64 = 40.0;

/// Probability of each kind by the BIC of all (Kass & Raftery 1995).
pub fn type_probabilities(
    joint: &Grown,
    view: &View,
    config: &JointsConfig,
) -> BTreeMap<JointKind, f64> {
    let sample = Sample::of(joint, view, config);
    let mut criteria = BTreeMap::from([(kind(joint), sample.criterion(joint))]);
    for start in others(joint, &sample.tracks) {
        let other = sample.refined(start);
        if other.dof.pitch.is_none() || advance(&other) >= MIN_ADVANCE_M {
            let least = criteria.entry(kind(&other)).or_insert(f64::INFINITY);
            *least = least.min(sample.criterion(&other));
        }
    }
    let best = criteria.values().copied().fold(f64::INFINITY, f64::min);
    let mut likely: BTreeMap<JointKind, f64> =
        criteria.into_iter().map(|(kind, b)| (kind, (-0.5 * (b - best)).exp())).collect();
    let total: f64 = likely.values().sum();
    likely.values_mut().for_each(|p| *p /= total);
    likely
}

/// It turned far enough to tell a hinge from a screw.
pub fn may_be_screw(joint: &Grown, config: &JointsConfig) -> bool {
    let is_hinge = joint.dof.hinge && joint.dof.pitch.is_none();
    config.screws && is_hinge && joint.members.len() >= 5 && joint.span() >= MIN_SCREW_TURN
}

/// The screw that a hinge is, where its tracks clearly advance as they turn.
pub fn as_screw(joint: &Grown, view: &View, config: &JointsConfig) -> Option<Grown> {
    let start = screw_from(joint)?;
    let sample = Sample::of(joint, view, config);
    let screw = sample.refined_from_afar(start);
    let evidence = sample.criterion(joint) - sample.criterion(&screw);
    tracing::debug!(
        advance_cm = 100.0 * advance(&screw),
        span = joint.span(),
        evidence,
        "as a screw"
    );
    (advance(&screw) >= MIN_ADVANCE_M && evidence >= MIN_EVIDENCE).then_some(screw)
}

fn kind(joint: &Grown) -> JointKind {
    joint.dof.geometry().kind
}

/// What a joint advances over its range, metres.
fn advance(joint: &Grown) -> f64 {
    joint.dof.advance(joint.span()).norm()
}

/// Some of a joint's tracks, which all kinds are to explain.
struct Sample<'s> {
    view: &'s View,
    config: &'s JointsConfig,
    tracks: Vec<usize>,
    /// Observations that are independent.
    independent: f64,
}

impl<'s> Sample<'s> {
    fn of(joint: &Grown, view: &'s View, config: &'s JointsConfig) -> Self {
        let stride = joint.members.len().div_ceil(TRACKS).max(1);
        let tracks: Vec<usize> = joint.members.iter().copied().step_by(stride).collect();
        let known = |t: usize| view.life(t).filter(|(f, _)| joint.known[*f]).count();
        let observations: usize = tracks.iter().map(|&t| known(t)).sum();
        let independent = (observations as f64 / config.correlated_observations).max(1.0);
        Self { view, config, tracks, independent }
    }

    fn refined(&self, mut joint: Grown) -> Grown {
        locate_points(&mut joint, self.view, &self.tracks, 4.0 * self.config.cut);
        refine(&mut joint, self.view, &self.tracks, self.config.cut, STEPS);
        joint
    }

    /// The same where most observations are far from where the joint starts.
    fn refined_from_afar(&self, mut joint: Grown) -> Grown {
        let cut = FAR * self.config.cut;
        locate_points(&mut joint, self.view, &self.tracks, cut);
        refine(&mut joint, self.view, &self.tracks, cut, STEPS);
        self.refined(joint)
    }

    /// Bayesian information criterion, less what all kinds share.
    fn criterion(&self, joint: &Grown) -> f64 {
        let motions = joint.motions();
        let cost = |&t: &usize| joint.cost_of(&motions, self.view, t, self.config.cut).sum;
        let cost: f64 = self.tracks.par_iter().map(cost).sum();
        let more_parameters = match kind(joint) {
            JointKind::Helical => 3.0,
            JointKind::Revolute => 2.0,
            _ => 0.0,
        };
        cost / self.config.correlated_observations + more_parameters * self.independent.ln()
    }
}

/// Where the search for a hinge's screw starts.
fn screw_from(joint: &Grown) -> Option<Grown> {
    (joint.dof.hinge && joint.dof.pitch.is_none()).then(|| {
        let mut screw = joint.clone();
        screw.dof.pitch = Some(0.0);
        screw
    })
}

/// Where the search for the best joints of the other kinds starts.
fn others(joint: &Grown, tracks: &[usize]) -> Vec<Grown> {
    let n = tracks.len().max(1) as f64;
    let middle = 0.5 * (joint.range[0] + joint.range[1]);
    let sum: Vector3<f64> =
        tracks.iter().map(|&t| joint.dof.move_point(middle, &joint.points[t]).coords).sum();
    let centre = Point3::from(sum / n);
    let with = |dof: Dof, scale: f64| {
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
        let slide = with(Dof::slide(velocity / lever, centre), lever);
        let other = screw_from(joint).unwrap_or_else(|| with(Dof { pitch: None, ..joint.dof }, 1.0));
        return vec![slide, other];
    }
    let (u, v) = orthonormal_basis(&joint.dof.axis);
    let mut starts = Vec::new();
    for side in [u, -u, v, -v] {
        for lever in FAR_HINGES_M {
            // The hinge's axis x arm is the slide's direction.
            let axis = side.cross(&joint.dof.axis);
            starts.push(with(Dof::hinge(axis, centre - side * lever), 1.0 / lever));
        }
    }
    starts
}

#[cfg(test)]
mod tests {
    use super::super::specimen::seen_moving;
    use super::*;

    /// Twelve points that turn by `angle` in thirty frames, seen with 2 mm of noise.
    fn seen_turning(line: &Dof, angle: f64) -> (View, Grown) {
        let q: Vec<f64> = (0..30).map(|f| angle * f64::from(f) / 29.0).collect();
        let places: Vec<Point3<f64>> = (0..12)
            .map(f64::from)
            .map(|i| Point3::new(0.1 + 0.04 * i, 0.2 * (1.3 * i).sin(), 1.5))
            .collect();
        let view = seen_moving(line, &places, &q);
        let mut joint = Grown::new(*line, &view, 0);
        joint.q = q;
        joint.known = vec![true; 30];
        joint.members = (0..12).collect();
        joint.points = places;
        joint.summarise();
        (view, joint)
    }

    const DOOR: Dof = Dof {
        hinge: true,
        axis: Vector3::new(0.0, 1.0, 0.0),
        origin: Point3::new(0.0, 0.0, 1.5),
        pitch: None,
    };

    fn probability_of_a_hinge(angle: f64) -> f64 {
        let (view, joint) = seen_turning(&DOOR, angle);
        type_probabilities(&joint, &view, &JointsConfig::default())[&JointKind::Revolute]
    }

    #[test]
    fn a_door_that_opens_wide_is_a_hinge() {
        assert!(probability_of_a_hinge(0.8) > 0.99);
        let (view, door) = seen_turning(&DOOR, 0.8);
        assert!(as_screw(&door, &view, &JointsConfig::default()).is_none());
    }

    #[test]
    fn a_door_that_hardly_opens_may_be_either() {
        let short = probability_of_a_hinge(0.01);
        assert!(short < 0.9, "{short}");
    }

    #[test]
    fn what_advances_as_it_turns_is_a_screw() {
        let lift = Dof { pitch: Some(-0.02), ..DOOR };
        let (view, mut joint) = seen_turning(&lift, 1.2);
        let config = JointsConfig::default();
        assert!(type_probabilities(&joint, &view, &config)[&JointKind::Helical] > 0.99);
        joint.dof.pitch = None;
        let screw = as_screw(&joint, &view, &config).unwrap();
        assert!((screw.dof.pitch.unwrap() + 0.02).abs() < 0.001);
        assert!(type_probabilities(&joint, &view, &config)[&JointKind::Helical] > 0.99);
    }
}
