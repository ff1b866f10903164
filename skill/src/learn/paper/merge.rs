//! Merges candidates that are one part, or one joint seen in two segments of time.
//!
//! In: candidates, each with the joint that was fitted to it in the base frame; metres, radians.
//! Out: the candidates that are left; merged ones are fitted again.

use super::candidate::{Candidate, fit_to_base, relative_samples};
use super::pose_optimisation;
use super::rejection::MIN_FRAMES;
use super::segmentation::Cluster;
use crate::articulation::{POSITION_SIGMA_M, fit_models};
use crate::learn::ego_motion::EgoMotion;
use crate::math::rigid::{Pose, distance_to_line, line_angle};
use crate::object::joint_geometry::JointKind;

/// Largest angle between the axes of two segments of one joint, radians.
const MERGE_ANGLE_RAD: f64 = 0.26;
/// Largest distance between the lines of two segments of one hinge, metres.
const MERGE_DISTANCE_M: f64 = 0.06;

/// Merges clusters that do not move relative to one another: they are one part.
pub(super) fn merge_rigid(base: &EgoMotion, parts: &mut Vec<Candidate>, seed: u64) {
    let mut i = 0;
    while i < parts.len() {
        let mut j = i + 1;
        while j < parts.len() {
            let rigid = relative_samples(&parts[i].motion, &parts[j].motion)
                .filter(|(_, s)| s.len() >= MIN_FRAMES)
                .and_then(|(_, s)| fit_models(&s).ok())
                .and_then(|fits| fits.into_iter().next())
                .is_some_and(|f| {
                    f.geometry.kind == JointKind::Fixed
                        && f.position_rmse < POSITION_SIGMA_M * 2.0
                        && f.outlier_ratio < 0.2
                });
            match rigid.then(|| merged_cluster(base, &parts[i], &parts[j], seed)).flatten() {
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

/// One candidate with the tracks of both; `None` if it is known in fewer frames than the longer of
/// the two, or does not move.
fn merged_cluster(base: &EgoMotion, a: &Candidate, b: &Candidate, seed: u64) -> Option<Candidate> {
    let mut tracks = [a.motion.tracks.clone(), b.motion.tracks.clone()].concat();
    tracks.sort_unstable();
    let motion = pose_optimisation::estimate(base, &Cluster { tracks }, seed)?;
    let merged = fit_to_base(motion)?;
    let longest = a.frames.len().max(b.frames.len());
    (merged.frames.len() >= longest && merged.fit.geometry.kind != JointKind::Fixed)
        .then_some(merged)
}

/// Merges two segments of time with one line into one joint, continuous in between. Opening and
/// closing may be seen as two parts with hardly a common frame, because surfaces turn away.
pub(super) fn merge_segments(parts: &mut Vec<Candidate>) {
    let mut i = 0;
    while i < parts.len() {
        let mut j = i + 1;
        while j < parts.len() {
            if same_line(&parts[i], &parts[j])
                && let Some(merged) = joined_in_time(&parts[i], &parts[j])
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

/// True if both candidates are joints of one type about near lines and are hardly seen at the same
/// time.
fn same_line(a: &Candidate, b: &Candidate) -> bool {
    let (ga, gb) = (&a.fit.geometry, &b.fit.geometry);
    if ga.kind != gb.kind || ga.kind == JointKind::Fixed {
        return false;
    }
    if line_angle(&ga.axis, &gb.axis) > MERGE_ANGLE_RAD {
        return false;
    }
    let common = a.frames.iter().filter(|f| b.frames.contains(f)).count();
    let near = match ga.kind {
        JointKind::Prismatic => distance_to_line(&ga.origin, &ga.axis, &gb.origin) < 0.3,
        _ => distance_to_line(&ga.origin, &ga.axis, &gb.origin) < MERGE_DISTANCE_M,
    };
    near && common * 4 < a.frames.len().min(b.frames.len())
}

/// One candidate of two segments of time: the later one is moved along the joint so that it starts
/// where the earlier one ends.
fn joined_in_time(a: &Candidate, b: &Candidate) -> Option<Candidate> {
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
    fit_to_base(motion)
}

#[cfg(test)]
mod tests {
    use super::super::pose_optimisation::PartMotion;
    use super::*;
    use crate::object::joint_geometry::JointGeometry;
    use nalgebra::{Point3, Vector3};
    use std::ops::Range;

    const FRAMES: usize = 80;

    fn hinge() -> JointGeometry {
        JointGeometry::hinge(Vector3::y_axis(), Point3::new(0.2, 0.0, 1.5))
    }

    fn slide() -> JointGeometry {
        JointGeometry::slide(Vector3::x_axis(), Point3::new(0.0, 0.0, 1.0))
    }

    /// A part of a joint that is opened all the time, seen in some frames by one track.
    fn seen(joint: &JointGeometry, frames: Range<usize>, track: usize) -> Candidate {
        let rest = Pose::translation(0.6, 0.1 * track as f64, 1.5);
        let pose = |f: usize| frames.contains(&f).then(|| joint.motion(0.015 * f as f64) * rest);
        let motion =
            PartMotion { base_from_part: (0..FRAMES).map(pose).collect(), tracks: vec![track] };
        fit_to_base(motion).unwrap()
    }

    /// The candidates that are left of some segments of time.
    fn merged(mut parts: Vec<Candidate>) -> Vec<Candidate> {
        merge_segments(&mut parts);
        parts
    }

    #[test]
    fn two_segments_of_one_hinge_become_one_joint_in_all_their_frames() {
        for early_first in [true, false] {
            let mut parts = vec![seen(&hinge(), 0..38, 1), seen(&hinge(), 42..FRAMES, 2)];
            if !early_first {
                parts.reverse();
            }
            let [whole] = &merged(parts)[..] else { panic!("one joint") };
            assert_eq!(whole.motion.tracks, [1, 2]);
            assert_eq!(whole.frames.len(), 76);
            assert_eq!(whole.fit.geometry.kind, JointKind::Revolute);
            let line = &whole.fit.geometry;
            assert!(distance_to_line(&hinge().origin, &line.axis, &line.origin) < 0.01);
        }
    }

    #[test]
    fn the_later_segment_goes_on_where_the_earlier_one_ended() {
        // What happened in the frames between is not known: no motion is taken for it.
        let whole = &merged(vec![seen(&slide(), 0..40, 1), seen(&slide(), 60..FRAMES, 2)])[0];
        let q = &whole.fit.configuration;
        assert_eq!(whole.frames[39..41], [39, 60]);
        assert!((q[40] - q[39]).abs() < 1e-3, "{} then {}", q[39], q[40]);
    }

    #[test]
    fn joints_that_are_seen_together_are_two() {
        let together = vec![seen(&hinge(), 0..60, 1), seen(&hinge(), 20..FRAMES, 2)];
        assert_eq!(merged(together).len(), 2);
    }

    #[test]
    fn joints_of_other_types_or_on_other_lines_are_two() {
        let (early, late) = (0..38, 42..FRAMES);
        let mut beside = hinge();
        beside.origin.x += 0.12;
        let tilted = JointGeometry::hinge(Vector3::x_axis(), hinge().origin);
        for other in [slide(), beside, tilted] {
            let parts = vec![seen(&hinge(), early.clone(), 1), seen(&other, late.clone(), 2)];
            assert_eq!(merged(parts).len(), 2, "{other:?}");
        }
    }

    #[test]
    fn what_rests_is_no_joint_to_merge_and_nothing_stays_nothing() {
        let still = |frames: Range<usize>, track| {
            let pose = |f: usize| frames.contains(&f).then(|| Pose::translation(0.0, 0.0, 1.0));
            let base_from_part = (0..FRAMES).map(pose).collect();
            fit_to_base(PartMotion { base_from_part, tracks: vec![track] }).unwrap()
        };
        assert_eq!(merged(vec![still(0..38, 1), still(42..FRAMES, 2)]).len(), 2);
        assert!(merged(Vec::new()).is_empty());
    }
}
