//! Slide or hinge? The same tracks are explained both ways; what separates the two costs is
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

/// Tracks that are explained both ways.
const TRACKS: usize = 150;
/// Distances of hinges that may imitate a slide, metres.
const FAR_HINGES_M: [f64; 2] = [0.5, 2.0];
/// Refinement steps of the other kind.
const STEPS: usize = 10;
/// Parameters that a hinge has beyond a slide.
const MORE_PARAMETERS: f64 = 2.0;

/// Probability of each kind by the BIC of both (Kass & Raftery 1995), over as many
/// observations as are independent.
pub fn type_probabilities(
    joint: &Grown,
    view: &View,
    config: &JointsConfig,
) -> BTreeMap<JointKind, f64> {
    let stride = joint.members.len().div_ceil(TRACKS).max(1);
    let tracks: Vec<usize> = joint.members.iter().copied().step_by(stride).collect();
    let total = |j: &Grown| -> f64 {
        let motions = j.motions();
        tracks.par_iter().map(|&t| j.cost_of(&motions, view, t, config.cut).sum).sum()
    };
    let known = |t: usize| view.life(t).filter(|(f, _)| joint.known[*f]).count();
    let observations: usize = tracks.iter().map(|&t| known(t)).sum();
    let other = others(joint, &tracks)
        .into_iter()
        .map(|mut other| {
            locate_points(&mut other, view, &tracks, 4.0 * config.cut);
            refine(&mut other, view, &tracks, config.cut, STEPS);
            total(&other)
        })
        .fold(f64::INFINITY, f64::min);
    let independent = config.correlated_observations;
    let own = total(joint) / independent;
    let other = other / independent;
    let penalty = MORE_PARAMETERS * (observations as f64 / independent).max(1.0).ln();
    let (slide, hinge) = if joint.dof.hinge { (other, own) } else { (own, other) };
    let hinge_probability = 1.0 / (1.0 + (0.5 * (hinge + penalty - slide)).exp());
    BTreeMap::from([
        (JointKind::Prismatic, 1.0 - hinge_probability),
        (JointKind::Revolute, hinge_probability),
    ])
}

/// Where the search for the best joint of the other kind starts.
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
        return vec![with(Dof { hinge: false, axis: velocity / lever, origin: centre }, lever)];
    }
    let (u, v) = orthonormal_basis(&joint.dof.axis);
    let mut starts = Vec::new();
    for side in [u, -u, v, -v] {
        for lever in FAR_HINGES_M {
            // The hinge's axis x arm is the slide's direction.
            let axis = side.cross(&joint.dof.axis);
            let dof = Dof { hinge: true, axis, origin: centre - side * lever };
            starts.push(with(dof, 1.0 / lever));
        }
    }
    starts
}

#[cfg(test)]
mod tests {
    use super::super::specimen::seen_moving;
    use super::*;

    /// A door of twelve points that opens by `angle` in thirty frames, seen with 2 mm of noise.
    fn door(angle: f64) -> (View, Grown) {
        let hinge = Dof { hinge: true, axis: Vector3::y(), origin: Point3::new(0.0, 0.0, 1.5) };
        let q: Vec<f64> = (0..30).map(|f| angle * f64::from(f) / 29.0).collect();
        let places: Vec<Point3<f64>> = (0..12)
            .map(f64::from)
            .map(|i| Point3::new(0.1 + 0.04 * i, 0.2 * (1.3 * i).sin(), 1.5))
            .collect();
        let view = seen_moving(&hinge, &places, &q);
        let mut joint = Grown::new(hinge, &view, 0);
        joint.q = q;
        joint.known = vec![true; 30];
        joint.members = (0..12).collect();
        joint.points = places;
        joint.summarise();
        (view, joint)
    }

    fn probability_of_a_hinge(angle: f64) -> f64 {
        let (view, joint) = door(angle);
        type_probabilities(&joint, &view, &JointsConfig::default())[&JointKind::Revolute]
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
}
