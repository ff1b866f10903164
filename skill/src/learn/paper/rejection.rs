//! Which candidates are no part of an object, and why.

use super::candidate::{Candidate, correlation};
use super::part_evidence::{resting_share, seen_through_share};
use crate::learn::learned_joint::span_of;
use crate::learn::recording::Recording;
use crate::math::robust::extent;
use crate::object::joint_geometry::JointKind;

/// Fewest frames in which a joint is observed.
pub const MIN_FRAMES: usize = 15;
/// Least motion of a slide, metres.
const MIN_SLIDE_M: f64 = 0.06;
/// Least motion of a hinge, radians.
const MIN_TURN_RAD: f64 = 0.15;
/// Largest root mean square distance to the joint's model, metres, of a part that hardly moves.
const MAX_POSITION_RMSE_M: f64 = 0.0025;
/// Share of the way that the part makes that this distance may grow by. Hands roughly follow many
/// models.
const MAX_RMSE_SHARE: f64 = 0.01;
/// Largest share of samples that the joint does not explain.
const MAX_OUTLIER_RATIO: f64 = 0.35;
/// Frames for which a track of an object's part rests at the start or end of its life.
const REST_FRAMES: usize = 8;
/// Least share of a part's tracks that rest: object parts rest, hands do not.
const MIN_REST_SHARE: f64 = 0.12;
/// Largest share of a part's points seen *through*: where the model says that there is a surface,
/// the camera saw something behind it.
const MAX_SEEN_THROUGH: f64 = 0.28;
/// Squared correlation with a better joint's configuration from which a joint is taken for a
/// consequence of it.
const MAX_CORRELATION: f64 = 0.85;

/// Why a moving thing is no part of an object, if it is not.
pub(super) fn doubt(
    recording: &Recording,
    candidate: &Candidate,
    believed: &[Candidate],
) -> Option<String> {
    let fit = &candidate.fit;
    let span = span_of(&fit.configuration);
    let least = match fit.geometry.kind {
        JointKind::Fixed => return Some("it does not move".to_owned()),
        JointKind::Prismatic => MIN_SLIDE_M,
        _ => MIN_TURN_RAD,
    };
    if span < least {
        return Some(format!("it moves by {span:.3} only"));
    }
    if candidate.frames.len() < MIN_FRAMES {
        return Some(format!("it is seen in {} frames only", candidate.frames.len()));
    }
    let way =
        extent(candidate.motion.base_from_part.iter().flatten().map(|p| p.translation.vector));
    if fit.position_rmse > MAX_POSITION_RMSE_M + MAX_RMSE_SHARE * way {
        return Some(format!("it departs from any joint by {:.3} m", fit.position_rmse));
    }
    if fit.outlier_ratio > MAX_OUTLIER_RATIO {
        return Some(format!("no joint explains {:.0} % of it", 100.0 * fit.outlier_ratio));
    }
    let rest = resting_share(&recording.ego_motion, &candidate.motion.tracks, REST_FRAMES);
    if rest < MIN_REST_SHARE {
        return Some(format!("only {:.0} % of it ever rests", 100.0 * rest));
    }
    let through = seen_through_share(recording, candidate);
    if through > MAX_SEEN_THROUGH {
        return Some(format!("{:.0} % of it is seen through", 100.0 * through));
    }
    if believed.iter().any(|b| correlation(candidate, b) > MAX_CORRELATION) {
        return Some("it moves as a part does that more tracks vouch for".to_owned());
    }
    None
}
