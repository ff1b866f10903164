//! Is it a joint of an object? The depth pictures are asked, and limits are kept.

use super::config::JointSearchConfig;
use super::estimate::JointEstimate;
use super::estimate::base_from_part;
use super::tracks_in_part_frame::TracksInFrame;
use crate::learn::ego_motion::EgoMotion;
use crate::learn::free_space::{FreeSpaceCounts, count_free_space};
use crate::learn::keyframes::Keyframes;
use crate::math::rigid::Pose;
use crate::math::robust::{Moments, median};
use linkage_driver::RgbdFrame;
use nalgebra::{DMatrix, DVector, Point3};
use rayon::prelude::*;
use std::ops::RangeInclusive;

/// Keyframes and limits.
pub struct FreeSpaceCheck<'w> {
    /// Camera motion.
    pub base: &'w EgoMotion,
    /// Whole frames.
    pub keyframes: &'w Keyframes,
    /// Limits.
    pub config: &'w JointSearchConfig,
}

/// Largest share of a child's configuration that may be a function of its parent's.
pub const MAX_CORRELATION: f64 = 0.85;
/// What a coupling may be: below, the parent rests whenever the child is known.
pub const ALLOWED_CORRELATION: RangeInclusive<f64> = 0.0..=MAX_CORRELATION;
/// Share of points that tells for sure where they are.
const WELL_TOLD: f64 = 0.6;
/// Share of points below which the pictures tell nothing of where they are.
const SILENT: f64 = 0.1;
/// Of the least gain, what must be earned by a joint that the pictures alone would tell,
const TOLD_GAIN: f64 = 0.4;
/// by a slide of which they tell nothing,
const UNTOLD_SLIDE_GAIN: f64 = 10.0;
/// and by a hinge of which they tell nothing that is known for a short while:
const UNTOLD_BRIEF_GAIN: f64 = 3.0;
/// in less than this share of the frames.
const BRIEF: f64 = 0.5;
/// Share of its points in all pictures that may be missing from what costs more than a joint on
/// which nothing hangs, where less tells.
const MAX_MISSING: f64 = 0.05;
/// Members that are looked for in the pictures.
const MAX_POINTS: usize = 120;
/// Configurations that are tried where none is known.
const SCAN: usize = 33;
/// How far beyond the range known so far a hinge may have gone, radians,
const BEYOND_TURN: f64 = 1.6;
/// and a slide, metres.
const BEYOND_SLIDE: f64 = 0.4;

/// What a picture tells of a joint.
struct FrameEvidence {
    frame: usize,
    /// The configuration, or the one at which most is found where it is not known.
    q: f64,
    found: FreeSpaceCounts,
    /// What is found half the range aside; `None` where the configuration is not known.
    aside: Option<FreeSpaceCounts>,
}

impl FreeSpaceCheck<'_> {
    /// Fills `through`, `hidden`, `tells`, `scanned` and `contradicted` from the keyframes.
    pub fn examine(&self, joint: &mut JointEstimate, joints: &[JointEstimate]) {
        let stride = joint.members.len().div_ceil(MAX_POINTS).max(1);
        let points: Vec<Point3<f64>> =
            joint.members.iter().step_by(stride).map(|&t| joint.points[t]).collect();
        if points.is_empty() {
            joint.through = 1.0;
            return;
        }
        let testimonies = self.testimonies(joint, &points, joints);
        joint.contradicted.clear();
        let (mut there, mut aside, mut blind) =
            (FreeSpaceCounts::default(), FreeSpaceCounts::default(), 0);
        let mut blind_agrees = 0;
        for testimony in &testimonies {
            let FrameEvidence { frame, q, found, .. } = *testimony;
            joint.scanned[frame] = q;
            there.add(found);
            if let Some(elsewhere) = testimony.aside {
                aside.add(elsewhere);
                if 5 * found.count() >= points.len() && found.through > found.agrees {
                    let around = frame.saturating_sub(2)..(frame + 3).min(joint.known.len());
                    joint.contradicted.extend(around);
                }
            } else {
                blind += 1;
                blind_agrees += found.agrees;
            }
        }
        joint.through = there.share_through();
        joint.tells = aside.share_through();
        joint.hidden =
            if blind > 0 { 1.0 - blind_agrees as f64 / (blind * points.len()) as f64 } else { 0.0 };
    }

    /// What each picture tells of a joint's points.
    fn testimonies(
        &self,
        joint: &JointEstimate,
        points: &[Point3<f64>],
        joints: &[JointEstimate],
    ) -> Vec<FrameEvidence> {
        let (near, far) = (near_scan(joint), far_scan(joint));
        let aside = 0.5 * joint.span();
        let pictures: Vec<(usize, &RgbdFrame)> = self.keyframes.iter().collect();
        pictures
            .par_iter()
            .map(|&(frame, picture)| {
                let camera_from_parent =
                    self.base.camera_from_base[frame] * parent_motion(joint, joints, frame);
                let probe = |q: f64| {
                    let camera_from_part = camera_from_parent * joint.dof.geometry().motion(q);
                    count_free_space(picture, points, &camera_from_part)
                };
                let known = joint.q[frame];
                if joint.known[frame] {
                    let [low, high] = [-aside, aside].map(|d| probe(known + d));
                    let aside = Some(if high.through > low.through { high } else { low });
                    return FrameEvidence { frame, q: known, found: probe(known), aside };
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
            })
            .collect()
    }

    /// Takes out members that the pictures contradict one by one, where most of the joint
    /// stands: a hand moves with what it holds, but comes and leaves.
    pub fn dismiss_strangers(&self, joint: &mut JointEstimate, joints: &[JointEstimate]) {
        let pictures: Vec<(Pose, &RgbdFrame)> = self
            .keyframes
            .iter()
            .filter(|(f, _)| joint.known[*f])
            .map(|(f, picture)| {
                let camera_from_parent =
                    self.base.camera_from_base[f] * parent_motion(joint, joints, f);
                (camera_from_parent * joint.dof.geometry().motion(joint.q[f]), picture)
            })
            .collect();
        let stands = |t: &usize| {
            let mut all = FreeSpaceCounts::default();
            for (camera_from_part, picture) in &pictures {
                all.add(count_free_space(picture, &[joint.points[*t]], camera_from_part));
            }
            all.mostly_agrees()
        };
        let kept: Vec<usize> = joint.members.par_iter().copied().filter(stands).collect();
        if 2 * kept.len() > joint.members.len() {
            joint.members = kept;
        }
    }

    /// The depth pictures could still make a joint of it, or a stretch of one.
    pub fn is_worth_asking(&self, joint: &JointEstimate) -> bool {
        joint.members.len() >= 5
            && joint.gain > self.config.min_gain / 3.0
            && joint.cost <= 1.2 * most_tolerated(self.config)
            && joint.coupling <= MAX_CORRELATION
    }

    /// All limits are kept.
    pub fn accepts(&self, joint: &JointEstimate) -> bool {
        let config = self.config;
        let known = joint.known_frames().len();
        let coverage = known as f64 / joint.known.len() as f64;
        let solid = joint.through <= 0.12 && joint.members.len() >= 50;
        let found_everywhere = is_found_everywhere(joint);
        // Parts that hang on it raise a joint's cost while they move; a hand is not there from
        // beginning to end, and along an arm the pictures hardly tell where it is.
        let comes_and_leaves = joint.tells < WELL_TOLD && missing(joint) > MAX_MISSING;
        let max_cost = config.max_cost
            + match coverage {
                _ if comes_and_leaves => 0.0,
                c if c >= 0.9 && solid && (found_everywhere || is_there_throughout(joint)) => 1.8,
                c if c >= 0.6 && solid => 1.0,
                _ if found_everywhere => 0.6,
                _ => 0.0,
            };
        joint.members.len() >= 5
            && joint.gain >= self.least_gain(joint)
            && joint.cost <= max_cost
            && known >= 15
            && ALLOWED_CORRELATION.contains(&joint.coupling)
            && travels_enough(joint)
            && joint.through <= config.max_through
            && joint.hidden <= config.max_hidden
            && joint.unruly <= config.max_unruly
    }

    /// What its tracks must earn: less where the pictures alone would tell it, more where they
    /// are silent and it was seen for a short while; most for a slide along a wall, as corners
    /// seem to that somebody's outline makes with it.
    pub fn least_gain(&self, joint: &JointEstimate) -> f64 {
        let least = self.config.min_gain;
        let coverage = joint.known_frames().len() as f64 / joint.known.len() as f64;
        match joint.tells {
            t if t >= WELL_TOLD && is_found_everywhere(joint) => TOLD_GAIN * least,
            t if t < SILENT && !joint.dof.hinge => UNTOLD_SLIDE_GAIN * least,
            t if t < SILENT && coverage < BRIEF => UNTOLD_BRIEF_GAIN * least,
            _ => least,
        }
    }

    /// The pictures show its points where another joint would put them: a hand that rests on a
    /// part is no part. Where they are silent they do not tell that either.
    pub fn is_on(&self, joint: &JointEstimate, index: usize, joints: &[JointEstimate]) -> bool {
        if joint.tells < SILENT {
            return false;
        }
        let other = &joints[index];
        let both = |f: usize| joint.known[f] && other.known[f];
        let Some(start) = (0..joint.known.len()).find(|&f| both(f)) else { return false };
        let base_from_joint =
            |f: usize| parent_motion(joint, joints, f) * joint.dof.geometry().motion(joint.q[f]);
        let other_from_joint =
            base_from_part(joints, index, start).inverse() * base_from_joint(start);
        let points: Vec<Point3<f64>> = joint.members.iter().map(|&t| joint.points[t]).collect();
        let (mut own, mut others) = (FreeSpaceCounts::default(), FreeSpaceCounts::default());
        for (frame, picture) in self.keyframes.iter().filter(|(f, _)| both(*f)) {
            let camera_from_base = self.base.camera_from_base[frame];
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

    /// Good enough to be a stretch of a joint that is accepted.
    pub fn tolerates(&self, joint: &JointEstimate) -> bool {
        joint.members.len() >= 5
            && joint.gain > self.config.min_gain / 3.0
            && joint.cost < most_tolerated(self.config)
            && joint.through < self.config.max_through + 0.03
            && joint.hidden < self.config.max_hidden + 0.05
            && joint.known_frames().len() >= 10
            && joint.coupling < MAX_CORRELATION
    }
}

/// Cost from which a joint is not even a stretch of another.
pub fn most_tolerated(config: &JointSearchConfig) -> f64 {
    config.max_cost + 1.8
}

/// In all pictures the part is where the joint puts it, and would not be elsewhere.
pub fn is_found_everywhere(joint: &JointEstimate) -> bool {
    joint.through <= 0.1 && joint.hidden <= 0.3 && joint.tells >= 0.3
}

/// Of two ways to hang one part, the pictures miss more of it where the other puts it.
pub fn is_missed_less(joint: &JointEstimate, other: &JointEstimate) -> bool {
    missing(other) > MAX_MISSING && 3.0 * missing(joint) < 2.0 * missing(other)
}

/// Share of its points in all pictures that are not found.
fn missing(joint: &JointEstimate) -> f64 {
    let known = joint.known_frames().len() as f64;
    joint.hidden * (1.0 - known / joint.known.len() as f64)
}

/// It explains all that its tracks do and is never seen through: round things look the same
/// wherever they are turned to.
fn is_there_throughout(joint: &JointEstimate) -> bool {
    joint.through <= 0.05 && joint.hidden <= 0.05 && joint.unruly <= 0.05
}

/// Configurations in and about the range known so far.
fn near_scan(joint: &JointEstimate) -> Vec<f64> {
    let pad = (0.5 * joint.span()).max(if joint.dof.hinge { 0.2 } else { 0.05 });
    let (low, high) = (joint.range[0] - pad, joint.range[1] + pad);
    (0..SCAN).map(|i| low + (high - low) * i as f64 / (SCAN - 1) as f64).collect()
}

/// Configurations beyond: while a part is not tracked it may have gone anywhere.
fn far_scan(joint: &JointEstimate) -> Vec<f64> {
    let beyond = if joint.dof.hinge { BEYOND_TURN } else { BEYOND_SLIDE };
    let step = beyond / SCAN as f64;
    (1..=SCAN)
        .map(|i| step * i as f64)
        .flat_map(|d| [joint.range[0] - d, joint.range[1] + d])
        .collect()
}

/// 6 cm for a slide; 0.12 rad and 3 cm of arc for a hinge.
fn travels_enough(joint: &JointEstimate) -> bool {
    if !joint.dof.hinge {
        return joint.span() >= 0.06;
    }
    let mut levers: Vec<f64> =
        joint.members.iter().map(|&t| joint.dof.lever(&joint.points[t])).collect();
    levers.sort_by(f64::total_cmp);
    let lever = levers.get(levers.len() * 3 / 4).copied().unwrap_or(0.0);
    joint.span() >= 0.12 && joint.span() * lever >= 0.03
}

fn parent_motion(joint: &JointEstimate, joints: &[JointEstimate], frame: usize) -> Pose {
    joint.parent.map_or_else(Pose::identity, |p| base_from_part(joints, p, frame))
}

/// Share of a child's configuration that is a function of its parent's: in a moving part's
/// frame, what stands still makes a perfect mirror of the part's own joint.
pub fn coupling(joint: &JointEstimate, parent: &JointEstimate) -> f64 {
    let common: Vec<usize> =
        joint.known_frames().into_iter().filter(|&f| parent.known[f]).collect();
    if common.len() < 5 {
        return 1.0;
    }
    let pairs: Vec<(f64, f64)> = common.iter().map(|&f| (parent.filled[f], joint.q[f])).collect();
    let moments = Moments::of(&pairs);
    if moments.xx.sqrt() < resting(parent) {
        return -1.0;
    }
    let overall = moments.correlation_sq().unwrap_or(1.0);
    overall.max(mirrored(joint, parent, &common))
}

/// Spread of a configuration that counts as rest.
fn resting(joint: &JointEstimate) -> f64 {
    if joint.dof.hinge { 0.04 } else { 0.02 }
}

/// Whether a parent moves while some of its view's tracks live.
pub fn moves_beside(parent: &JointEstimate, view: &TracksInFrame, tracks: &[usize]) -> bool {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for (f, _) in tracks.iter().flat_map(|&t| view.life(t)) {
        low = low.min(parent.filled[f]);
        high = high.max(parent.filled[f]);
    }
    high - low > resting(parent)
}

/// Frames in which a part is away from where it mostly is while a joint's configuration is known.
pub fn away(part: &JointEstimate, joint: &JointEstimate) -> Vec<bool> {
    let mut beside: Vec<f64> = joint.known_frames().iter().map(|&f| part.filled[f]).collect();
    let usual = median(&mut beside).unwrap_or(0.0);
    part.filled.iter().map(|q| (q - usual).abs() > resting(part)).collect()
}

/// Share of a joint's configuration that is a smooth function of another's, while nearly all
/// that it does happens beside the other: a hand follows what it holds.
pub fn follows(joint: &JointEstimate, other: &JointEstimate) -> f64 {
    let known = joint.known_frames();
    let common: Vec<usize> = known.iter().copied().filter(|&f| other.known[f]).collect();
    if common.len() < 10 || 5 * common.len() < 4 * known.len() {
        return 0.0;
    }
    let design = DMatrix::from_fn(common.len(), 3, |i, k| other.q[common[i]].powi(k as i32));
    let q = DVector::from_fn(common.len(), |i, _| joint.q[common[i]]);
    let Ok(fitted) = design.clone().svd(true, true).solve(&q, 1e-9) else { return 0.0 };
    let spread = q.add_scalar(-q.mean()).norm_squared();
    1.0 - (design * fitted - &q).norm_squared() / spread.max(f64::EPSILON)
}

/// The same while the parent moves: a part that hangs on it goes along and rests in its
/// frame; one that hangs on the base moves back as fast as the parent goes transform.
fn mirrored(joint: &JointEstimate, parent: &JointEstimate, common: &[usize]) -> f64 {
    const LAG: usize = 5;
    const CHILD_NOISE: f64 = 0.01;
    let (mut pp, mut cc, mut pc) = (0.0, 0.0, 0.0);
    for pair in common.windows(LAG + 1) {
        let (a, b) = (pair[0], pair[LAG]);
        let dp = parent.filled[b] - parent.filled[a];
        if b - a > 2 * LAG || dp.abs() < 0.1 * parent.span() {
            continue;
        }
        let dc = joint.q[b] - joint.q[a];
        pp += dp * dp;
        cc += dc * dc + CHILD_NOISE * CHILD_NOISE;
        pc += dp * dc;
    }
    if pp <= 0.0 { 0.0 } else { pc * pc / (pp * cc) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::screw_joint::ScrewJoint;
    use crate::learn::joint_search::test_data::seen_moving;
    use crate::test_data::{board, seen};
    use nalgebra::Vector3;

    const FRAMES: usize = 100;

    fn is_accepted(joint: &JointEstimate) -> bool {
        let base =
            EgoMotion { camera_from_base: vec![Pose::identity(); FRAMES], ..EgoMotion::default() };
        let (keyframes, config) = (Keyframes::new(2), JointSearchConfig::default());
        FreeSpaceCheck { base: &base, keyframes: &keyframes, config: &config }.accepts(joint)
    }

    /// A drawer that was followed for a share of the recording, and whose tracks cost more than
    /// its own motion explains; the pictures show it wherever it is.
    fn drawer(coverage: f64, hidden: f64) -> JointEstimate {
        let front = Point3::new(0.0, 0.0, 1.5);
        let slide = ScrewJoint::slide(Vector3::z(), front);
        let view = seen_moving(&slide, &[front; 60], &[0.0; FRAMES]);
        let mut joint = JointEstimate::new(slide, &view, 0);
        joint.known = (0..FRAMES).map(|f| (f as f64) < coverage * FRAMES as f64).collect();
        joint.members = (0..60).collect();
        joint.range = [0.0, 0.2];
        (joint.gain, joint.cost) = (2000.0, 2.7);
        (joint.through, joint.tells, joint.hidden) = (0.02, 0.5, hidden);
        joint
    }

    #[test]
    fn a_joint_with_noisy_tracks_is_accepted_where_all_pictures_show_its_part() {
        assert!(is_accepted(&drawer(0.5, 0.0)));
        assert!(is_accepted(&drawer(0.7, 0.0)));
        assert!(is_accepted(&drawer(0.95, 0.3)));
        let told_well = JointEstimate { tells: 0.9, ..drawer(0.5, 0.2) };
        assert!(is_accepted(&told_well));
    }

    #[test]
    fn corners_along_a_wall_need_more_tracks_than_a_drawer() {
        let along_a_wall = JointEstimate { tells: 0.02, ..drawer(0.8, 0.0) };
        assert!(!is_accepted(&along_a_wall));
        assert!(
            is_accepted(&JointEstimate { gain: 16_000.0, ..along_a_wall.clone() }),
            "a sliding door"
        );
        let wheel = ScrewJoint::hinge(Vector3::z(), Point3::new(0.2, 0.0, 1.5));
        assert!(is_accepted(&JointEstimate { dof: wheel, range: [0.0, 0.6], ..along_a_wall }));
    }

    #[test]
    fn an_arm_that_comes_and_leaves_is_no_joint() {
        assert!(!is_accepted(&drawer(0.5, 0.2)));
        assert!(!is_accepted(&drawer(0.7, 0.25)));
    }

    /// Whether what goes along with a drawer is on its part, where pictures tell so much of it.
    fn is_on_the_drawer(tells: f64) -> bool {
        let front = |f: usize| 1.5 - 0.002 * f as f64;
        let mut keyframes = Keyframes::new(FRAMES);
        for f in (0..FRAMES).step_by(10) {
            keyframes.offer(f, &seen(f as i64, board(0.2, front(f), 2.5)));
        }
        let mut opened = drawer(1.0, 0.0);
        opened.q = (0..FRAMES).map(|f| front(f) - front(0)).collect();
        opened.filled = opened.q.clone();
        opened.points = vec![Point3::new(0.0, 0.0, front(0)); 60];
        let along = JointEstimate { tells, ..opened.clone() };
        let base =
            EgoMotion { camera_from_base: vec![Pose::identity(); FRAMES], ..EgoMotion::default() };
        let config = JointSearchConfig::default();
        FreeSpaceCheck { base: &base, keyframes: &keyframes, config: &config }.is_on(
            &along,
            0,
            &[opened],
        )
    }

    #[test]
    fn what_pictures_show_on_a_part_wherever_that_goes_is_on_it() {
        assert!(is_on_the_drawer(0.5));
    }

    #[test]
    fn what_pictures_do_not_tell_is_on_nothing() {
        assert!(!is_on_the_drawer(0.02));
    }
}
