//! Free-space check of a joint: depth images must show the part where the joint puts it. Points
//! that an image sees through contradict the joint; points that would also be found at another
//! configuration do not discriminate it.
//!
//! In: a joint with points in the frame of its parent (metres), its parents, and the keyframes.
//! Out: [`FreeSpaceEvidence`]: shares from 0 to 1, configurations in radians or metres.

use super::estimate::{JointEstimate, base_from_part};
use crate::learn::attachment::unattached_ratio;
use crate::learn::free_space::{FreeSpaceCounts, count_free_space};
use crate::learn::recording::Recording;
use crate::math::rigid::Pose;
use linkage_frames::RgbdFrame;
use nalgebra::Point3;
use rayon::prelude::*;

/// Discriminability below which depth images do not discriminate a configuration.
pub const SILENT: f64 = 0.1;
/// Share of the members that must be inliers for the others to be removed; of a sibling of another joint.
const LEAST_INLIERS: f64 = 0.5;
const LEAST_OF_SIBLING: f64 = 0.25;
/// Largest number of members whose points are tested in the depth images.
const MAX_POINTS: usize = 120;
/// Number of configurations that are tried within the known range, and on each side beyond it, in
/// frames of unknown configuration.
const SCAN: usize = 33;
/// Largest turn of a hinge beyond the known range that is tried, radians.
const BEYOND_TURN: f64 = 1.6;
/// Largest travel of a slide beyond the known range that is tried, metres.
const BEYOND_SLIDE: f64 = 0.4;

/// Free-space check of joints against the keyframes of a recording.
#[derive(Clone, Copy)]
pub struct FreeSpaceCheck<'r> {
    /// Recording with the keyframes and the camera motion.
    pub recording: &'r Recording,
}

/// Result of the free-space check over all keyframes.
pub struct FreeSpaceEvidence {
    /// Share of the observed points that are seen through, 0 to 1.
    pub violation: f64,
    /// Share of the observed points that would be seen through half the range aside, 0 to 1.
    pub discriminability: f64,
    /// Share of the points that are not found in frames of unknown configuration, 0 to 1.
    pub unobserved_ratio: f64,
    /// Share of a hinge's line that no visible surface holds, 0 to 1; 0 for a slide.
    pub unattached_ratio: f64,
    /// Frame number and configuration of each keyframe, radians or metres; from depth where tracks
    /// do not give it.
    pub configurations: Vec<(usize, f64)>,
    /// Frames in which depth images contradict the joint.
    pub contradicted_frames: Vec<usize>,
}

/// Result of the free-space check in one keyframe.
struct FrameEvidence {
    frame: usize,
    /// Configuration from the tracks; where they give none, the one at which the surplus of points
    /// found over points seen through is largest. Radians or metres.
    q: f64,
    found: FreeSpaceCounts,
    /// Counts half the range aside, on the side where more is seen through; `None` where the tracks
    /// give no configuration.
    aside: Option<FreeSpaceCounts>,
}

impl FreeSpaceCheck<'_> {
    /// Checks a joint against all keyframes; `None` if no track follows the joint. `joints` holds
    /// its parents.
    pub fn evidence(
        &self,
        joint: &JointEstimate,
        joints: &[JointEstimate],
    ) -> Option<FreeSpaceEvidence> {
        let stride = joint.members.len().div_ceil(MAX_POINTS).max(1);
        let points: Vec<Point3<f64>> =
            joint.members.iter().step_by(stride).map(|&t| joint.points[t]).collect();
        if points.is_empty() {
            return None;
        }
        let frames = self.by_frame(joint, &points, joints);
        let mut evidence = summed_up(&frames, points.len(), joint.known.len());
        if joint.dof.hinge {
            let camera_from_parent = |frame| self.camera_from_parent(joint, joints, frame);
            let line = joint.dof.geometry();
            evidence.unattached_ratio =
                unattached_ratio(&line, &points, self.recording, camera_from_parent);
        }
        Some(evidence)
    }

    /// Checks a joint's points against each keyframe.
    fn by_frame(
        &self,
        joint: &JointEstimate,
        points: &[Point3<f64>],
        joints: &[JointEstimate],
    ) -> Vec<FrameEvidence> {
        let (near, far) = (near_scan(joint), far_scan(joint));
        let aside = 0.5 * joint.span();
        let in_frame = |&(frame, picture): &(usize, &RgbdFrame)| {
            let camera_from_parent = self.camera_from_parent(joint, joints, frame);
            let probe = |q: f64| {
                let camera_from_part = camera_from_parent * joint.dof.geometry().motion(q);
                count_free_space(picture, points, &camera_from_part)
            };
            if joint.known[frame] {
                let q = joint.q[frame];
                let [low, high] = [-aside, aside].map(|d| probe(q + d));
                let aside = Some(if high.through > low.through { high } else { low });
                return FrameEvidence { frame, q, found: probe(q), aside };
            }
            let best_of = |scan: &[f64]| {
                scan.iter()
                    .map(|&q| (q, probe(q)))
                    .max_by_key(|(_, found)| found.margin())
                    .expect("a scan is not empty")
            };
            let (mut q, mut found) = best_of(&near);
            if 2 * found.agrees < points.len() {
                let beyond = best_of(&far);
                if beyond.1.margin() > found.margin() {
                    (q, found) = beyond;
                }
            }
            FrameEvidence { frame, q, found, aside: None }
        };
        let pictures: Vec<(usize, &RgbdFrame)> = self.recording.keyframes.iter().collect();
        pictures.par_iter().map(in_frame).collect()
    }

    /// Members that depth images do not contradict. An outlier is a track whose point is often seen
    /// through while the rest of the part is found: a hand moves with what it holds, but comes and
    /// leaves. All members are kept where at least half of them would be outliers, or, of a sibling of another joint,
    /// three quarters: the arm that opens a plain door has more tracks than the door.
    pub fn inlier_members(&self, joint: &JointEstimate, joints: &[JointEstimate]) -> Vec<usize> {
        let pictures: Vec<(Pose, &RgbdFrame)> = self
            .recording
            .keyframes
            .iter()
            .filter(|(f, _)| joint.known[*f])
            .map(|(f, picture)| {
                let camera_from_parent = self.camera_from_parent(joint, joints, f);
                (camera_from_parent * joint.dof.geometry().motion(joint.q[f]), picture)
            })
            .collect();
        let is_inlier = |t: &usize| {
            let mut all = FreeSpaceCounts::default();
            for (camera_from_part, picture) in &pictures {
                all.add(count_free_space(picture, &[joint.points[*t]], camera_from_part));
            }
            all.mostly_agrees()
        };
        let kept: Vec<usize> = joint.members.par_iter().copied().filter(is_inlier).collect();
        let least =
            if joint.evidence.is_parallel_sibling { LEAST_OF_SIBLING } else { LEAST_INLIERS };
        if kept.len() as f64 > least * joint.members.len() as f64 {
            kept
        } else {
            joint.members.clone()
        }
    }

    /// True if depth images show a joint's points where the part of joint number `index` would
    /// carry them too: a hand that rests on a part is no part itself. False where depth images do
    /// not discriminate the joint.
    pub fn is_on(&self, joint: &JointEstimate, index: usize, joints: &[JointEstimate]) -> bool {
        if joint.evidence.discriminability < SILENT {
            return false;
        }
        let other = &joints[index];
        let both = |f: usize| joint.known[f] && other.known[f];
        let Some(start) = (0..joint.known.len()).find(|&f| both(f)) else { return false };
        let base_from_joint =
            |f: usize| base_from_parent(joint, joints, f) * joint.dof.geometry().motion(joint.q[f]);
        let other_from_joint =
            base_from_part(joints, index, start).inverse() * base_from_joint(start);
        let points: Vec<Point3<f64>> = joint.members.iter().map(|&t| joint.points[t]).collect();
        let (mut own, mut others) = (FreeSpaceCounts::default(), FreeSpaceCounts::default());
        for (frame, picture) in self.recording.keyframes.iter().filter(|(f, _)| both(*f)) {
            let camera_from_base = self.recording.ego_motion.camera_from_base[frame];
            let ask = |base_from_points: Pose| {
                count_free_space(picture, &points, &(camera_from_base * base_from_points))
            };
            own.add(ask(base_from_joint(frame)));
            others.add(ask(base_from_part(joints, index, frame) * other_from_joint));
        }
        own.agrees > 0
            && 10 * others.agrees >= 9 * own.agrees
            && others.through <= own.through + own.agrees / 20
    }

    /// Pose of the frame of a joint's parent in the camera, at a frame of the recording.
    pub fn camera_from_parent(
        &self,
        joint: &JointEstimate,
        joints: &[JointEstimate],
        frame: usize,
    ) -> Pose {
        let camera_from_base = self.recording.ego_motion.camera_from_base[frame];
        camera_from_base * base_from_parent(joint, joints, frame)
    }
}

/// Sums the results of all keyframes for a joint of `points` points in a recording of `frames`
/// frames.
fn summed_up(pictures: &[FrameEvidence], points: usize, frames: usize) -> FreeSpaceEvidence {
    let (mut there, mut aside) = (FreeSpaceCounts::default(), FreeSpaceCounts::default());
    let (mut unknown, mut found_in_unknown) = (0, 0);
    let mut contradicted_frames = Vec::new();
    for FrameEvidence { frame, found, aside: elsewhere, .. } in pictures {
        there.add(*found);
        if let Some(elsewhere) = elsewhere {
            aside.add(*elsewhere);
            if 5 * found.count() >= points && found.through > found.agrees {
                contradicted_frames.extend(frame.saturating_sub(2)..(frame + 3).min(frames));
            }
        } else {
            unknown += 1;
            found_in_unknown += found.agrees;
        }
    }
    FreeSpaceEvidence {
        violation: there.share_through(),
        discriminability: aside.share_through(),
        unobserved_ratio: match unknown {
            0 => 0.0,
            _ => 1.0 - found_in_unknown as f64 / (unknown * points) as f64,
        },
        unattached_ratio: 0.0,
        configurations: pictures.iter().map(|p| (p.frame, p.q)).collect(),
        contradicted_frames,
    }
}

/// Configurations within and near the known range.
fn near_scan(joint: &JointEstimate) -> Vec<f64> {
    let pad = (0.5 * joint.span()).max(if joint.dof.hinge { 0.2 } else { 0.05 });
    let (low, high) = (joint.range[0] - pad, joint.range[1] + pad);
    (0..SCAN).map(|i| low + (high - low) * i as f64 / (SCAN - 1) as f64).collect()
}

/// Configurations beyond the known range, on both sides: a part that is not tracked may have moved
/// anywhere.
fn far_scan(joint: &JointEstimate) -> Vec<f64> {
    let beyond = if joint.dof.hinge { BEYOND_TURN } else { BEYOND_SLIDE };
    let step = beyond / SCAN as f64;
    (1..=SCAN)
        .map(|i| step * i as f64)
        .flat_map(|d| [joint.range[0] - d, joint.range[1] + d])
        .collect()
}

fn base_from_parent(joint: &JointEstimate, joints: &[JointEstimate], frame: usize) -> Pose {
    joint.parent.map_or_else(Pose::identity, |p| base_from_part(joints, p, frame))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::ego_motion::EgoMotion;
    use crate::learn::joint_search::evidence::Evidence;
    use crate::learn::joint_search::screw_joint::ScrewJoint;
    use crate::learn::joint_search::test_data::seen_moving;
    use crate::learn::keyframes::Keyframes;
    use crate::learn::tracking::TrackSet;
    use crate::test_data::{board, seen};
    use nalgebra::Vector3;

    const FRAMES: usize = 100;

    fn front(f: usize) -> f64 {
        1.5 - 0.002 * f as f64
    }

    /// A drawer that opens by 2 mm a frame, and pictures of it.
    fn opened_drawer() -> (Recording, JointEstimate) {
        let mut keyframes = Keyframes::new(FRAMES);
        for f in (0..FRAMES).step_by(10) {
            keyframes.offer(f, &seen(f as i64, board(0.2, front(f), 2.5)));
        }
        let ego_motion =
            EgoMotion { camera_from_base: vec![Pose::identity(); FRAMES], ..EgoMotion::default() };
        let middle = Point3::new(0.0, 0.0, front(0));
        let slide = ScrewJoint::slide(Vector3::z(), middle);
        let view = seen_moving(&slide, &[middle; 60], &[0.0; FRAMES]);
        let mut drawer = JointEstimate::new(slide, &view, 0);
        drawer.q = (0..FRAMES).map(|f| front(f) - front(0)).collect();
        drawer.known = vec![true; FRAMES];
        drawer.points = vec![middle; 60];
        drawer.members = (0..60).collect();
        drawer.gain = 2000.0;
        drawer.summarise();
        (Recording { tracks: TrackSet::default(), ego_motion, keyframes }, drawer)
    }

    /// True if a second joint that moves exactly as the drawer is found to be on the drawer's part.
    fn is_on_the_drawer(discriminability: f64) -> bool {
        let (recording, drawer) = opened_drawer();
        let evidence = Evidence { discriminability, ..drawer.evidence.clone() };
        let along = JointEstimate { evidence, ..drawer.clone() };
        FreeSpaceCheck { recording: &recording }.is_on(&along, 0, &[drawer])
    }

    #[test]
    fn of_a_sibling_a_third_of_the_tracks_may_be_the_part() {
        // Two thirds of the tracks are on an arm that is not there in the pictures.
        let (recording, mut drawer) = opened_drawer();
        drawer.points[20..].iter_mut().for_each(|p| p.z -= 0.4);
        let check = FreeSpaceCheck { recording: &recording };
        assert_eq!(check.inlier_members(&drawer, &[]).len(), 60);
        drawer.evidence.is_parallel_sibling = true;
        assert_eq!(check.inlier_members(&drawer, &[]), (0..20).collect::<Vec<_>>());
        drawer.points[10..].iter_mut().for_each(|p| p.z = 1.0);
        assert_eq!(check.inlier_members(&drawer, &[]).len(), 60, "ten are too few");
    }

    #[test]
    fn what_pictures_show_on_a_part_wherever_that_goes_is_on_it() {
        assert!(is_on_the_drawer(0.5));
    }

    #[test]
    fn what_pictures_do_not_discriminate_is_on_nothing() {
        assert!(!is_on_the_drawer(0.02));
    }

    #[test]
    fn a_drawer_is_found_where_its_joint_puts_it_and_seen_through_where_it_is_not() {
        let (recording, drawer) = opened_drawer();
        let check = FreeSpaceCheck { recording: &recording };
        let found = check.evidence(&drawer, &[]).unwrap();
        assert_eq!((found.violation, found.contradicted_frames.len()), (0.0, 0));
        assert!(found.discriminability > 0.4, "{}", found.discriminability);
        // The joint puts the front half a metre nearer than it is.
        let mut wrong = drawer;
        wrong.q.iter_mut().for_each(|q| *q -= 0.5);
        let found = check.evidence(&wrong, &[]).unwrap();
        assert_eq!(found.violation, 1.0);
        assert_eq!(found.contradicted_frames.len(), 3 + 9 * 5);
    }
}
