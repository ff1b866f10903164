//! One joint seen in two stretches, opening and closing say: its surfaces turned away or an
//! arm came between. The stretches share the line; their configurations are tied by common
//! frames or by what the depth pictures say.

use super::bundle_adjustment::refine;
use super::config::JointSearchConfig;
use super::estimate::JointEstimate;
use super::grow::finish;
use super::tracks_in_part_frame::TracksInFrame;
use crate::math::rigid::{distance_to_line, line_angle, nearest_on_line};
use crate::math::robust::median;
use crate::math::robust::overlap;
use nalgebra::Point3;

/// Largest angle between the axes of one joint, radians.
const MAX_ANGLE: f64 = 0.175;
/// Largest distance between its lines, metres.
const MAX_DISTANCE: f64 = 0.05;
/// Frames that two stretches must share for their configurations to be compared.
const COMMON_FRAMES: usize = 8;
/// Frames that a stretch must add.
const LEAST_MORE: usize = 5;
/// Tracks of each stretch that the merged joint is refined on.
const TRACKS_EACH: usize = 75;

/// How near two joints' lines are to be those of one joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LineMatch {
    /// Same line within what a joint is usually known to.
    Same,
    /// Short stretches or grazing views may have drawn the lines apart: they are one joint if
    /// one line explains what both do.
    Possible,
}

impl LineMatch {
    fn slack(self) -> f64 {
        match self {
            Self::Same => 1.0,
            Self::Possible => 2.0,
        }
    }

    /// Share of the lesser gain that the merged joint must add to the greater.
    pub fn required_gain(self) -> f64 {
        match self {
            Self::Same => 0.0,
            Self::Possible => 0.5,
        }
    }
}

/// How two joints are akin: same kind, near lines, and configurations that run alike over
/// common frames.
pub fn line_match(a: &JointEstimate, b: &JointEstimate) -> Option<LineMatch> {
    [LineMatch::Same, LineMatch::Possible].into_iter().find(|k| lines_match(a, b, k.slack()))
}

/// The other joint is known where this one is not: its tracks this one would have gathered
/// itself.
pub fn adds_frames(joint: &JointEstimate, other: &JointEstimate) -> bool {
    let beyond = joint.known.iter().zip(&other.known).filter(|(here, there)| !**here && **there);
    beyond.count() >= LEAST_MORE
}

/// Same kind and near lines.
pub fn shares_line(a: &JointEstimate, b: &JointEstimate, slack: f64) -> bool {
    if a.dof.hinge != b.dof.hinge || line_angle(&a.dof.axis, &b.dof.axis) > slack * MAX_ANGLE {
        return false;
    }
    if !a.dof.hinge {
        return true;
    }
    let n = b.members.len().max(1) as f64;
    let centre: nalgebra::Vector3<f64> =
        b.members.iter().map(|&t| b.points[t].coords).sum::<nalgebra::Vector3<f64>>() / n;
    let on_b = nearest_on_line(&b.dof.origin, &b.dof.axis, &Point3::from(centre));
    distance_to_line(&a.dof.origin, &a.dof.axis, &on_b) <= slack * MAX_DISTANCE
}

fn lines_match(a: &JointEstimate, b: &JointEstimate, slack: f64) -> bool {
    if !shares_line(a, b, slack) {
        return false;
    }
    let differences = differences(a, b);
    if differences.len() < COMMON_FRAMES {
        // Any two slides beside one another share their line: they must share tracks, too,
        // and more than those of the arm that moves both.
        let shared = overlap(&a.members, &b.members).max(overlap(&b.members, &a.members));
        return a.dof.hinge || shared > 0.3;
    }
    let mut sorted = differences.clone();
    let middle = median(&mut sorted).unwrap_or(0.0);
    let mut strays: Vec<f64> = differences.iter().map(|d| (d - middle).abs()).collect();
    strays.sort_by(f64::total_cmp);
    strays[strays.len() * 9 / 10] < 0.25 * a.span().max(b.span())
}

fn sign(a: &JointEstimate, b: &JointEstimate) -> f64 {
    if a.dof.axis.dot(&b.dof.axis) > 0.0 { 1.0 } else { -1.0 }
}

/// a's configuration less b's (its sign following the axis) over common frames.
fn differences(a: &JointEstimate, b: &JointEstimate) -> Vec<f64> {
    let s = sign(a, b);
    (0..a.q.len()).filter(|&f| a.known[f] && b.known[f]).map(|f| a.q[f] - s * b.q[f]).collect()
}

/// The joint of both stretches; `None` when nothing remains of it.
pub fn merged(
    view: &TracksInFrame,
    a: &JointEstimate,
    b: &JointEstimate,
    candidates: &[usize],
    config: &JointSearchConfig,
) -> Option<JointEstimate> {
    let s = sign(a, b);
    let mut common = differences(a, b);
    let offset = if common.len() >= 3 {
        median(&mut common)?
    } else {
        let mut by_depth: Vec<f64> = (0..b.q.len())
            .filter(|&f| b.known[f] && a.scanned[f].is_finite())
            .map(|f| a.scanned[f] - s * b.q[f])
            .collect();
        median(&mut by_depth).unwrap_or(0.0)
    };
    let mut joint = a.clone();
    for f in 0..joint.q.len() {
        if !joint.known[f] && b.known[f] {
            joint.q[f] = s * b.q[f] + offset;
            joint.known[f] = true;
        }
    }
    let mut some: Vec<usize> = spread(&a.members).chain(spread(&b.members)).collect();
    some.sort_unstable();
    some.dedup();
    refine(&mut joint, view, &some, config.cut, config.finish_steps + 1);
    finish(view, &mut joint, candidates, config, 3);
    (joint.members.len() >= 5).then_some(joint)
}

fn spread(members: &[usize]) -> impl Iterator<Item = usize> + '_ {
    members.iter().copied().step_by(members.len().div_ceil(TRACKS_EACH).max(1))
}
