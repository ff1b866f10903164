//! Fits a slide and a hinge to the short window of time in which a rigid motion was seen.
//!
//! In: a motion hypothesis and tracks in the frame of a part, metres.
//! Out: joints in that frame, known in the window only, with their mean cost of an observation.
//! From: the mean translation and the screw axis of the motion (Chasles' theorem) as initial
//! estimates, then bundle adjustment.

use super::bundle_adjustment::{OUTLIER_CUT, refine};
use super::configuration_vote::{Voters, vote};
use super::estimate::JointEstimate;
use super::motion_hypotheses::Hypothesis;
use super::screw_joint::ScrewJoint;
use super::tracks_in_part_frame::TracksInFrame;
use crate::math::rigid::{distance_to_line, screw_of};
use nalgebra::{Point3, Vector3};

/// Smallest turn of the window's motion from which a hinge is fitted, radians.
const MIN_SCREW_ANGLE: f64 = 0.03;
/// Largest distance of a hinge from the centre of the tracks that it moves, metres.
const MAX_LEVER: f64 = 2.0;
/// Number of bundle adjustment steps of a window's fit.
const STEPS: usize = 6;

/// Fits a slide and a hinge to the window alone, each with its mean cost of an observation. The
/// slide is omitted where the hinge explains the window clearly better, and the hinge where it does
/// not explain the window better than the slide.
pub fn window_fits(view: &TracksInFrame, h: &Hypothesis) -> Vec<(JointEstimate, f64)> {
    let at = |t: usize, f: usize| view.at(t, f).map(|s| s.point.coords);
    let n = h.tracks.len() as f64;
    let start: Vector3<f64> =
        h.tracks.iter().filter_map(|&t| at(t, h.from)).sum::<Vector3<f64>>() / n;
    let end: Vector3<f64> = h.tracks.iter().filter_map(|&t| at(t, h.to)).sum::<Vector3<f64>>() / n;
    let centre = Point3::from(start);
    let mut fits = Vec::new();
    if let Some(axis) = (end - start).try_normalize(1e-6) {
        fits.push(window_fit(view, ScrewJoint::slide(axis, centre), h, STEPS));
    }
    if let Some(screw) = screw_of(&h.motion)
        && screw.angle > MIN_SCREW_ANGLE
        && distance_to_line(&screw.origin, &screw.axis, &centre) < MAX_LEVER
    {
        let dof = ScrewJoint::hinge(screw.axis.into_inner(), screw.origin);
        let hinge = window_fit(view, dof, h, STEPS);
        let slide_cost = fits.first().map_or(f64::INFINITY, |(_, c)| *c);
        if slide_cost > 1.3 * hinge.1 + 0.2 {
            fits.clear();
        }
        if hinge.1 < 0.95 * slide_cost {
            fits.push(hinge);
        }
    }
    fits
}

/// Fits the configurations of a joint whose line is known to the window, with its mean cost of an observation.
pub fn window_fit_about(
    view: &TracksInFrame,
    dof: ScrewJoint,
    h: &Hypothesis,
) -> (JointEstimate, f64) {
    window_fit(view, dof, h, 0)
}

/// Fits a joint to the window, in so many `steps` of bundle adjustment.
fn window_fit(
    view: &TracksInFrame,
    dof: ScrewJoint,
    h: &Hypothesis,
    steps: usize,
) -> (JointEstimate, f64) {
    let mut joint = JointEstimate::new(dof, view, h.from);
    for &t in &h.tracks {
        if let Some(s) = view.at(t, h.from) {
            joint.points[t] = s.point;
        }
    }
    let mut q = 0.0;
    for f in h.from..=h.to {
        let alive: Vec<usize> =
            h.tracks.iter().copied().filter(|&t| view.at(t, f).is_some()).collect();
        if alive.len() < 3 || !view.usable[f] {
            continue;
        }
        let weights = vec![1.0; alive.len()];
        let voters = Voters { view, tracks: &alive, weights: &weights };
        let outcome = vote(&joint, &voters, f, Some(q), 2.0 * OUTLIER_CUT);
        q = outcome.q;
        if outcome.agreeing >= 3 {
            joint.q[f] = q;
            joint.known[f] = true;
        }
    }
    joint.members = h.tracks.clone();
    refine(&mut joint, view, &h.tracks, OUTLIER_CUT, steps);
    let (mut sum, mut observations) = (0.0, 0);
    let motions = joint.motions();
    for &t in &h.tracks {
        let cost = joint.cost_of(&motions, view, t, OUTLIER_CUT);
        sum += cost.sum;
        observations += cost.observations;
    }
    (joint, sum / observations.max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::test_data::seen_moving;

    /// Kinds of the fits to twelve points that a joint moves in a window of twelve frames.
    fn hinges_fitted(truth: &ScrewJoint, step: f64) -> Vec<bool> {
        let q: Vec<f64> = (0..13).map(|f| step * f64::from(f)).collect();
        let places: Vec<Point3<f64>> = (0..12)
            .map(f64::from)
            .map(|i| Point3::new(0.2 + 0.03 * i, 0.2 * (1.3 * i).sin(), 1.5))
            .collect();
        let view = seen_moving(truth, &places, &q);
        let motion = truth.geometry().motion(q[12]);
        let h = Hypothesis { from: 0, to: 12, motion, tracks: (0..12).collect(), rank: 1.0 };
        let fits = window_fits(&view, &h);
        fits.iter().map(|(joint, _)| joint.dof.hinge).collect()
    }

    #[test]
    fn a_window_of_a_turning_door_shows_a_hinge_and_one_of_a_drawer_a_slide() {
        let door = ScrewJoint::hinge(Vector3::y(), Point3::new(0.0, 0.0, 1.5));
        assert_eq!(hinges_fitted(&door, 0.05), [true]);
        assert_eq!(
            hinges_fitted(&ScrewJoint::slide(Vector3::z(), Point3::origin()), 0.02),
            [false]
        );
    }
}
