//! Which candidates are no part of an object, and why.

use super::candidate::{Candidate, correlation};
use super::config::PaperSettings;
use super::part_evidence::{resting_share, seen_through_share};
use crate::learn::learned_joint::span_of;
use crate::learn::recording::Recording;
use crate::math::robust::extent;
use crate::object::joint_geometry::JointKind;

/// Why a moving thing is no part of an object, if it is not.
pub(super) fn doubt(
    recording: &Recording,
    candidate: &Candidate,
    believed: &[Candidate],
    settings: &PaperSettings,
) -> Option<String> {
    let limits = settings.structure;
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
    let rest = resting_share(&recording.ego_motion, &candidate.motion.tracks, limits.rest_frames);
    if rest < limits.min_rest_share {
        return Some(format!("only {:.0} % of it ever rests", 100.0 * rest));
    }
    let through = seen_through_share(recording, candidate);
    if through > limits.max_seen_through {
        return Some(format!("{:.0} % of it is seen through", 100.0 * through));
    }
    if believed.iter().any(|b| correlation(candidate, b) > limits.max_coupling) {
        return Some("it moves as a part does that more tracks vouch for".to_owned());
    }
    None
}
