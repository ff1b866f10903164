//! Is a candidate a joint of an object? Its support by tracks and the [`Evidence`] of its last
//! verification are compared with limits; the first limit that is broken is the reason to reject it.
//!
//! The largest cost of an observation depends on what else speaks for the joint: parts that hang on
//! it raise its cost while they move. A hand is not there from beginning to end, and along an arm the
//! pictures hardly discriminate where it is.

use super::config::JointSearchConfig;
use super::correlation::{ALLOWED_CORRELATION, MAX_CORRELATION};
use super::estimate::JointEstimate;
use super::evidence::Evidence;
use super::free_space_check::SILENT;
use crate::learn::attachment::MAX_UNATTACHED;

/// Fewest tracks of a joint.
const MIN_TRACKS: usize = 5;
/// Fewest frames in which the configuration of a joint is known.
const MIN_FRAMES: usize = 15;
/// Fewest frames in which it is in either half of its range. Where a passer-by covers a thing at rest, that
/// seems to run with him for a frame or three.
const MIN_FRAMES_OF_HALF: usize = 4;
/// Fewest frames of a segment of time in which a joint was seen.
const MIN_SEGMENT_FRAMES: usize = 10;
/// Largest cost of an observation, as a mean over a joint's tracks. Measured: hands cost 2.5 to 3.9,
/// real joints 0.9 to 2.9.
pub const MAX_COST: f64 = 2.2;
/// Least gain of a joint: how much better it explains its tracks than standing still does.
const MIN_GAIN: f64 = 300.0;
/// A segment needs the least gain of a joint divided by this.
const SEGMENT_GAIN_DIVISOR: f64 = 3.0;

/// Allowed above [`MAX_COST`] for a joint that is known nearly always and that nothing speaks against.
const ALLOWANCE_ALWAYS: f64 = 1.8;
/// Allowed above [`MAX_COST`] for a solid joint that is known most of the time and that rests when it is first or
/// last known: a person who stands beside the part never does.
const ALLOWANCE_MOSTLY: f64 = 1.0;
/// Allowed above [`MAX_COST`] for a joint that is found in all pictures and that rests when it is first or last
/// known. An arm that opens a lid hangs beside the person at both ends of a recording, where pictures find it
/// too; but what is known of its joint begins and ends while it moves.
const ALLOWANCE_FOUND: f64 = 0.6;
/// Share of the frames from which a joint is known nearly always.
const ALWAYS: f64 = 0.9;
/// Share of the frames from which a joint is known most of the time.
const MOSTLY: f64 = 0.6;
/// Fewest tracks of a solid joint.
const SOLID_TRACKS: usize = 50;
/// Largest share of a solid joint's points that are seen through.
const SOLID_VIOLATION: f64 = 0.12;
/// Factor on the largest cost of a segment up to which pictures are asked about a candidate.
pub const HOPELESS_COST: f64 = 1.2;

/// Share of points, half the range aside, from which pictures discriminate for sure.
const WELL_DISCRIMINATED: f64 = 0.6;
/// Factor on the least gain of a joint that the pictures alone would show.
const SHOWN_GAIN: f64 = 0.4;
/// Factor on the least gain of a slide of which pictures say nothing. Corners that somebody's outline
/// makes with a wall seem to slide along it.
const SILENT_SLIDE_GAIN: f64 = 40.0;
/// Factor on the least gain of a hinge of which pictures say nothing. On 80 recordings the hinges of which they say
/// nothing were none: a few features on a person who sways, with 1.2 to 2.4 times the least gain.
const SILENT_HINGE_GAIN: f64 = 3.0;
/// Share of its points in all pictures that may be missing from a joint that gets an allowance on its
/// cost although pictures do not discriminate for sure. The same share tells two parents apart.
const MAX_MISSING: f64 = 0.05;

/// Least travel of a slide, metres.
const MIN_SLIDE_M: f64 = 0.06;
/// Least travel of a slide that rests before and after it moves, metres. A person's trunk sways by as
/// much, but never rests.
const SMALL_SLIDE_M: f64 = 0.03;
/// Fewest frames for which a part rests before and after it moves.
const REST_FRAMES: usize = 10;
/// One in so many of the frames in which a joint is known, for which a part rests that is known in few frames: a roll
/// that was put onto its holder while 20 frames were taken rested in 7 of them.
const REST_OF_KNOWN: usize = 4;
/// Largest way of a slide that rests, metres.
const REST_M: f64 = 0.008;
/// Largest turn of a hinge that rests, radians.
const REST_RAD: f64 = 0.02;
/// Largest share of such a part's points that are seen through.
const REST_VIOLATION: f64 = 0.05;
/// Least share of such a part's points that would be seen through half the range aside. It is small,
/// for half of a short way is hardly discriminated.
const REST_DISCRIMINABILITY: f64 = 0.2;
/// Least turn of a hinge, radians.
const MIN_TURN_RAD: f64 = 0.12;
/// A hinge that turns by less than this and whose tracks cost more than [`MAX_COST`] must rest before and after it
/// moves, radians. Two trunks that swayed turned by 0.14 and 0.19 rad at a cost of 3.5 and 3.0; the hinges of things that
/// were found at such a cost on 60 recordings turned by 0.6 rad and more.
const SMALL_TURN_RAD: f64 = 0.25;
/// Least way that most points of a hinge's part make, metres.
const MIN_ARC_M: f64 = 0.03;

/// How far a segment may exceed the largest share of points that are seen through.
pub const SEGMENT_VIOLATION_SLACK: f64 = 0.03;
/// How far a segment may exceed the largest share of points that are missing.
const SEGMENT_UNOBSERVED_SLACK: f64 = 0.05;

/// Why a candidate is no joint.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Rejection {
    /// Too few tracks.
    #[error("{found} tracks follow it; at least {MIN_TRACKS} are needed")]
    TooFewTracks {
        /// Tracks that follow it.
        found: usize,
    },
    /// Known in too few frames.
    #[error("its configuration is known in {found} frames; at least {MIN_FRAMES} are needed")]
    TooFewFrames {
        /// Frames with a configuration.
        found: usize,
    },
    /// It is away from its rest, or at it, for a moment only.
    #[error(
        "half of its range was seen in {found} frames; at least {MIN_FRAMES_OF_HALF} are needed"
    )]
    Moment {
        /// Frames in the half that was seen less.
        found: usize,
    },
    /// It explains little that standing still does not explain.
    #[error(
        "it explains its tracks by {gain:.0} better than rest does; at least {needed:.0} is needed"
    )]
    LowGain {
        /// Its gain.
        gain: f64,
        /// The gain that is needed.
        needed: f64,
    },
    /// Its tracks depart from it.
    #[error("its tracks cost {cost:.2} an observation; at most {allowed:.2} is allowed")]
    HighCost {
        /// Mean cost of an observation.
        cost: f64,
        /// The largest one.
        allowed: f64,
    },
    /// Its parent rests, so that it may as well hang on the base.
    #[error("its parent rests whenever it is seen")]
    ParentRests,
    /// Its configuration is a function of its parent's.
    #[error(
        "{:.0} % of its motion follows from its parent's; at most {:.0} % is allowed",
        100.0 * share,
        100.0 * MAX_CORRELATION
    )]
    FollowsParent {
        /// Share of its configuration.
        share: f64,
    },
    /// A slide that hardly moves.
    #[error("it slides by {travel_m:.3} m; at least {needed_m} m is needed")]
    ShortSlide {
        /// Its range, metres.
        travel_m: f64,
        /// The least range of such a slide, metres.
        needed_m: f64,
    },
    /// A hinge that hardly turns.
    #[error(
        "it turns by {turn_rad:.2} rad, and most of its points by {arc_m:.3} m; \
         at least {MIN_TURN_RAD} rad and {MIN_ARC_M} m are needed"
    )]
    ShortTurn {
        /// Its range, radians.
        turn_rad: f64,
        /// Way of three quarters of its points at most, metres.
        arc_m: f64,
    },
    /// Pictures show something behind it.
    #[error(
        "it was seen through at {:.0} % of its points; at most {:.0} % are allowed",
        100.0 * share,
        100.0 * allowed
    )]
    SeenThrough {
        /// Share of its points.
        share: f64,
        /// The largest share.
        allowed: f64,
    },
    /// Pictures do not show it while its configuration is unknown.
    #[error(
        "{:.0} % of its points were missing while its configuration was unknown; \
         at most {:.0} % are allowed",
        100.0 * share,
        100.0 * allowed
    )]
    Unobserved {
        /// Share of its points.
        share: f64,
        /// The largest share.
        allowed: f64,
    },
    /// Its tracks go on where it does not explain them.
    #[error(
        "{:.0} % of its tracks' observations are in frames that it does not explain; \
         at most {:.0} % are allowed",
        100.0 * share,
        100.0 * allowed
    )]
    Uncovered {
        /// Share of the observations.
        share: f64,
        /// The largest share.
        allowed: f64,
    },
    /// It turns about a line that nothing is seen to hold.
    #[error(
        "{:.0} % of the line that it turns about is in the air or outside the pictures, as it is of a \
         person who leans; at most {:.0} % are allowed",
        100.0 * share,
        100.0 * MAX_UNATTACHED
    )]
    Unattached {
        /// Share of the line beside the part.
        share: f64,
    },
    /// Another candidate explains the same tracks in more frames, with another parent.
    #[error("a candidate with another parent explains the same tracks in more frames")]
    ExplainedWithAnotherParent,
    /// It does what an accepted joint does.
    #[error(
        "{:.0} % of its motion follows from an accepted joint; at most {:.0} % is allowed",
        100.0 * share,
        100.0 * allowed
    )]
    FollowsAcceptedJoint {
        /// Share of its configuration.
        share: f64,
        /// The largest share.
        allowed: f64,
    },
    /// Next to nothing beside an accepted joint about the same line.
    #[error("it turns about the line of an accepted joint and has little of that joint's gain")]
    OnLineOfAcceptedJoint,
    /// A hand that rests on a part.
    #[error("pictures show it on the part of an accepted joint wherever that part goes")]
    OnPartOfAcceptedJoint,
}

/// All limits are kept, or the first that is broken.
pub fn decide(
    joint: &JointEstimate,
    evidence: &Evidence,
    config: &JointSearchConfig,
) -> Result<(), Rejection> {
    let (tracks, frames) = (joint.members.len(), joint.known_frames().len());
    let moment = frames_of_less_seen_half(joint);
    let (gain, needed) = (joint.gain, min_gain(joint, evidence));
    let (cost, allowed_cost) = (joint.cost, max_cost(joint, evidence));
    let share = evidence.parent_correlation;
    let correlation = if share < *ALLOWED_CORRELATION.start() {
        Rejection::ParentRests
    } else {
        Rejection::FollowsParent { share }
    };
    let table = [
        (tracks >= MIN_TRACKS, Rejection::TooFewTracks { found: tracks }),
        (frames >= MIN_FRAMES, Rejection::TooFewFrames { found: frames }),
        (moment >= MIN_FRAMES_OF_HALF, Rejection::Moment { found: moment }),
        (gain >= needed, Rejection::LowGain { gain, needed }),
        (cost <= allowed_cost, Rejection::HighCost { cost, allowed: allowed_cost }),
        (ALLOWED_CORRELATION.contains(&share), correlation),
        travel(joint, evidence),
        (
            evidence.free_space_violation <= config.max_through,
            Rejection::SeenThrough {
                share: evidence.free_space_violation,
                allowed: config.max_through,
            },
        ),
        (
            evidence.unobserved_ratio <= config.max_hidden,
            Rejection::Unobserved { share: evidence.unobserved_ratio, allowed: config.max_hidden },
        ),
        (
            evidence.uncovered_ratio <= config.max_unruly,
            Rejection::Uncovered { share: evidence.uncovered_ratio, allowed: config.max_unruly },
        ),
        (
            evidence.unattached_ratio <= MAX_UNATTACHED,
            Rejection::Unattached { share: evidence.unattached_ratio },
        ),
    ];
    table.into_iter().find(|(is_kept, _)| !is_kept).map_or(Ok(()), |(_, rejection)| Err(rejection))
}

/// A joint keeps all limits.
pub fn accepts(joint: &JointEstimate, config: &JointSearchConfig) -> bool {
    decide(joint, &joint.evidence, config).is_ok()
}

/// A candidate is good enough to be a segment of a joint that is accepted.
pub fn is_segment(joint: &JointEstimate, config: &JointSearchConfig) -> bool {
    let evidence = &joint.evidence;
    joint.members.len() >= MIN_TRACKS
        && joint.gain > MIN_GAIN / SEGMENT_GAIN_DIVISOR
        && joint.cost < max_segment_cost()
        && evidence.free_space_violation < config.max_through + SEGMENT_VIOLATION_SLACK
        && evidence.unobserved_ratio < config.max_hidden + SEGMENT_UNOBSERVED_SLACK
        && joint.known_frames().len() >= MIN_SEGMENT_FRAMES
        && evidence.parent_correlation < MAX_CORRELATION
}

/// The depth pictures could still make a joint of a candidate, or a segment of one.
pub fn is_worth_verifying(joint: &JointEstimate, parent_correlation: f64) -> bool {
    joint.members.len() >= MIN_TRACKS
        && joint.gain > MIN_GAIN / SEGMENT_GAIN_DIVISOR
        && joint.cost <= HOPELESS_COST * max_segment_cost()
        && parent_correlation <= MAX_CORRELATION
}

/// Cost of an observation from which a candidate is not even a segment of a joint.
pub fn max_segment_cost() -> f64 {
    MAX_COST + ALLOWANCE_ALWAYS
}

/// Largest cost of an observation of a joint.
fn max_cost(joint: &JointEstimate, evidence: &Evidence) -> f64 {
    let coverage = joint.coverage();
    let solid =
        evidence.free_space_violation <= SOLID_VIOLATION && joint.members.len() >= SOLID_TRACKS;
    let found_everywhere = evidence.is_found_everywhere();
    let comes_and_leaves = evidence.discriminability < WELL_DISCRIMINATED
        && missing_share(joint, evidence) > MAX_MISSING;
    let may_sway =
        joint.dof.hinge && joint.span() < SMALL_TURN_RAD && !stands_between_rests(joint, evidence);
    let nothing_against =
        found_everywhere || evidence.is_there_throughout() || stands_between_rests(joint, evidence);
    let allowance = match coverage {
        _ if comes_and_leaves || may_sway => 0.0,
        c if c >= ALWAYS && solid && nothing_against => ALLOWANCE_ALWAYS,
        c if c >= MOSTLY && solid && rests_for_a_while(joint) => ALLOWANCE_MOSTLY,
        _ if found_everywhere && rests_at_an_end(joint) => ALLOWANCE_FOUND,
        _ => 0.0,
    };
    MAX_COST + allowance
}

/// Least gain of a joint: less where the pictures alone would show it, more where they discriminate
/// nothing, most for a slide of which they discriminate nothing.
pub fn min_gain(joint: &JointEstimate, evidence: &Evidence) -> f64 {
    let least = MIN_GAIN;
    match evidence.discriminability {
        d if d >= WELL_DISCRIMINATED && evidence.is_found_everywhere() => SHOWN_GAIN * least,
        d if d < SILENT && !joint.dof.hinge => SILENT_SLIDE_GAIN * least,
        d if d < SILENT => SILENT_HINGE_GAIN * least,
        _ => least,
    }
}

/// Of two parents of one part, pictures miss more of it where `other` puts it.
pub fn is_missed_less(joint: &JointEstimate, other: &JointEstimate) -> bool {
    let missed = |joint: &JointEstimate| missing_share(joint, &joint.evidence);
    missed(other) > MAX_MISSING && 3.0 * missed(joint) < 2.0 * missed(other)
}

/// Share of its points, in all pictures, that are not found.
fn missing_share(joint: &JointEstimate, evidence: &Evidence) -> f64 {
    evidence.unobserved_ratio * (1.0 - joint.coverage())
}

/// A joint is known nearly always, rests before and after it moves, and pictures bear it out. A
/// person's trunk sways all the time, and a hand comes and leaves.
fn stands_between_rests(joint: &JointEstimate, evidence: &Evidence) -> bool {
    let [before, after] = rests(joint);
    joint.coverage() >= ALWAYS
        && before.min(after) >= REST_FRAMES
        && evidence.free_space_violation <= REST_VIOLATION
        && evidence.discriminability >= REST_DISCRIMINABILITY
}

/// A joint rests in the first frames in which it is known, or in the last ones.
fn rests_at_an_end(joint: &JointEstimate) -> bool {
    let [before, after] = rests(joint);
    before.max(after) >= REST_FRAMES
}

/// A joint rests in the first frames in which it is known, or in the last ones: for [`REST_FRAMES`], or for a share of
/// the frames in which it is known, where these are few.
fn rests_for_a_while(joint: &JointEstimate) -> bool {
    let [before, after] = rests(joint);
    before.max(after) >= REST_FRAMES.min(joint.known_frames().len() / REST_OF_KNOWN)
}

/// In how many frames a joint rests from the first one in which it is known, and from the last one back.
fn rests(joint: &JointEstimate) -> [usize; 2] {
    let q: Vec<f64> = joint.known_frames().into_iter().map(|f| joint.q[f]).collect();
    let way = if joint.dof.hinge { REST_RAD } else { REST_M };
    [resting(q.iter(), way), resting(q.iter().rev(), way)]
}

/// In how many frames the joint is in that half of its range which is seen less.
fn frames_of_less_seen_half(joint: &JointEstimate) -> usize {
    let middle = 0.5 * (joint.range[0] + joint.range[1]);
    let known = joint.known_frames();
    let upper = known.iter().filter(|&&f| joint.q[f] > middle).count();
    upper.min(known.len() - upper)
}

/// Over how many configurations from the first on a joint stays within a way. The first may be at either end of
/// that: with a moving camera a thing that rests seems to drift by millimetres.
fn resting<'q>(configurations: impl Iterator<Item = &'q f64>, way: f64) -> usize {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    configurations
        .take_while(|&&q| {
            (low, high) = (low.min(q), high.max(q));
            high - low < way
        })
        .count()
}

/// Whether a joint moves enough, and the rejection where it does not.
fn travel(joint: &JointEstimate, evidence: &Evidence) -> (bool, Rejection) {
    let span = joint.span();
    if !joint.dof.hinge {
        let needed_m =
            if stands_between_rests(joint, evidence) { SMALL_SLIDE_M } else { MIN_SLIDE_M };
        return (span >= needed_m, Rejection::ShortSlide { travel_m: span, needed_m });
    }
    let mut levers: Vec<f64> =
        joint.members.iter().map(|&t| joint.dof.lever(&joint.points[t])).collect();
    levers.sort_by(f64::total_cmp);
    let lever = levers.get(levers.len() * 3 / 4).copied().unwrap_or(0.0);
    let arc_m = span * lever;
    let is_enough = span >= MIN_TURN_RAD && arc_m >= MIN_ARC_M;
    (is_enough, Rejection::ShortTurn { turn_rad: span, arc_m })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::joint_search::screw_joint::ScrewJoint;
    use crate::learn::joint_search::test_data::seen_moving;
    use nalgebra::{Point3, Vector3};

    const FRAMES: usize = 100;

    fn decided(joint: &JointEstimate) -> Result<(), Rejection> {
        decide(joint, &joint.evidence, &JointSearchConfig::default())
    }

    fn is_accepted(joint: &JointEstimate) -> bool {
        decided(joint).is_ok()
    }

    /// A drawer that was followed for a share of the recording, and whose tracks cost more than its
    /// own motion explains; the pictures show it wherever it is.
    fn drawer(coverage: f64, unobserved_ratio: f64) -> JointEstimate {
        let front = Point3::new(0.0, 0.0, 1.5);
        let slide = ScrewJoint::slide(Vector3::z(), front);
        let view = seen_moving(&slide, &[front; 60], &[0.0; FRAMES]);
        let mut joint = JointEstimate::new(slide, &view, 0);
        joint.known = (0..FRAMES).map(|f| (f as f64) < coverage * FRAMES as f64).collect();
        joint.members = (0..60).collect();
        joint.q = (0..FRAMES).map(|f| if (40..60).contains(&f) { 0.2 } else { 0.0 }).collect();
        joint.range = [0.0, 0.2];
        (joint.gain, joint.cost) = (2000.0, 2.7);
        joint.evidence = Evidence {
            free_space_violation: 0.02,
            discriminability: 0.5,
            unobserved_ratio,
            ..joint.evidence
        };
        joint
    }

    fn discriminated(joint: JointEstimate, discriminability: f64) -> JointEstimate {
        let evidence = Evidence { discriminability, ..joint.evidence.clone() };
        JointEstimate { evidence, ..joint }
    }

    #[test]
    fn a_joint_with_noisy_tracks_is_accepted_where_all_pictures_show_its_part() {
        assert!(is_accepted(&drawer(0.5, 0.0)));
        assert!(is_accepted(&drawer(0.7, 0.0)));
        assert!(is_accepted(&drawer(0.95, 0.3)));
        assert!(is_accepted(&discriminated(drawer(0.5, 0.2), 0.9)));
    }

    #[test]
    fn an_arm_that_is_known_only_while_it_moves_is_no_joint() {
        // It goes to what it opens, holds it for a while, and comes back.
        let way = |f: usize| 0.2 * (0.08 * f as f64).sin();
        let goes = JointEstimate {
            q: (0..FRAMES).map(|f| if (15..25).contains(&f) { 0.2 } else { way(f) }).collect(),
            ..drawer(0.4, 0.1)
        };
        let arm = discriminated(goes, 0.64);
        assert!(matches!(decided(&arm), Err(Rejection::HighCost { .. })), "{:?}", decided(&arm));
        let rests = |f: usize| if f < 12 { 0.0 } else { way(f) };
        assert!(is_accepted(&JointEstimate { q: (0..FRAMES).map(rests).collect(), ..arm }));
    }

    #[test]
    fn a_person_who_sways_most_of_the_time_is_no_joint() {
        let sways = |f: usize| 0.1 + 0.1 * (0.3 * f as f64).sin();
        let person = JointEstimate {
            q: (0..FRAMES).map(sways).collect(),
            ..discriminated(drawer(0.7, 0.1), 0.9)
        };
        assert!(matches!(decided(&person), Err(Rejection::HighCost { .. })));
        assert!(is_accepted(&discriminated(drawer(0.7, 0.1), 0.9)), "it rests at first");
        let mut short = discriminated(drawer(0.7, 0.1), 0.9);
        short.known = (0..FRAMES).map(|f| f < 20).collect();
        short.q = (0..FRAMES).map(|f| if f < 6 { 0.0 } else { 0.01 * (f - 5) as f64 }).collect();
        assert!(rests_for_a_while(&short) && !rests_at_an_end(&short));
    }

    #[test]
    fn a_trunk_that_turns_a_little_all_the_time_is_no_hinge_and_a_small_lid_is_one() {
        let hinge = |q: &dyn Fn(usize) -> f64, discriminability: f64| JointEstimate {
            dof: ScrewJoint::hinge(Vector3::z(), Point3::new(0.5, 0.0, 1.5)),
            q: (0..FRAMES).map(q).collect(),
            range: [0.0, 0.15],
            gain: 20_000.0,
            ..discriminated(drawer(1.0, 0.0), discriminability)
        };
        let sways = |f: usize| 0.075 + 0.075 * (0.08 * f as f64).sin();
        for told in [0.01, 0.65] {
            let trunk = hinge(&sways, told);
            assert!(matches!(decided(&trunk), Err(Rejection::HighCost { .. })), "{told}");
        }
        let opens = |f: usize| if (40..60).contains(&f) { 0.15 } else { 0.0 };
        assert!(is_accepted(&hinge(&opens, 0.65)));
    }

    #[test]
    fn what_moves_for_a_moment_is_no_joint() {
        let moment = |frames: usize| JointEstimate {
            q: (0..FRAMES).map(|f| if f < frames { 0.2 } else { 0.0 }).collect(),
            ..drawer(0.95, 0.0)
        };
        assert_eq!(decided(&moment(3)), Err(Rejection::Moment { found: 3 }));
        assert!(is_accepted(&moment(4)));
        assert_eq!(decided(&moment(93)), Err(Rejection::Moment { found: 2 }));
    }

    #[test]
    fn corners_along_a_wall_need_more_tracks_than_a_drawer() {
        let along_a_wall = discriminated(drawer(0.8, 0.0), 0.02);
        assert!(!is_accepted(&along_a_wall));
        assert!(
            is_accepted(&JointEstimate { gain: 16_000.0, ..along_a_wall.clone() }),
            "a sliding door"
        );
        let wheel = ScrewJoint::hinge(Vector3::z(), Point3::new(0.2, 0.0, 1.5));
        let q = along_a_wall.q.iter().map(|q| 3.0 * q).collect();
        assert!(is_accepted(&JointEstimate { dof: wheel, q, range: [0.0, 0.6], ..along_a_wall }));
    }

    #[test]
    fn a_few_features_on_a_person_who_turns_to_and_fro_are_no_hinge() {
        let wheel = ScrewJoint::hinge(Vector3::z(), Point3::new(0.2, 0.0, 1.5));
        let turned = JointEstimate {
            dof: wheel,
            q: drawer(0.9, 0.0).q.iter().map(|q| 3.0 * q).collect(),
            range: [0.0, 0.6],
            cost: 2.0,
            ..discriminated(drawer(0.9, 0.0), 0.0)
        };
        assert!(is_accepted(&turned), "a wheel with a pattern");
        let few = JointEstimate { gain: 390.0, ..turned };
        assert!(matches!(decided(&few), Err(Rejection::LowGain { .. })));
        assert!(is_accepted(&discriminated(few, 0.3)), "pictures show that it moves");
    }

    #[test]
    fn an_arm_that_comes_and_leaves_is_no_joint() {
        assert!(!is_accepted(&drawer(0.5, 0.2)));
        assert!(!is_accepted(&drawer(0.7, 0.25)));
    }

    #[test]
    fn a_short_slide_is_a_joint_where_it_rests_before_and_after() {
        let slide = |q: fn(usize) -> f64| JointEstimate {
            q: (0..FRAMES).map(q).collect(),
            range: [0.0, 0.05],
            ..drawer(1.0, 0.0)
        };
        assert!(is_accepted(&slide(|f| if f.abs_diff(50) < 25 { 0.05 } else { 0.0 })));
        let drifts = |f: usize| 0.0003 * f.min(20) as f64;
        let moves = |f: usize| if f.abs_diff(50) < 25 { 0.05 } else { 0.0 };
        let with_drift = JointEstimate {
            q: (0..FRAMES).map(|f| drifts(f) + moves(f)).collect(),
            ..slide(|_| 0.0)
        };
        assert!(is_accepted(&with_drift), "with a camera that moves, rest drifts");
        assert!(!is_accepted(&slide(|f| 0.025 + 0.025 * (0.3 * f as f64).sin())), "a trunk");
    }

    #[test]
    fn a_rejection_tells_what_was_found_and_what_is_allowed() {
        let said = |joint: &JointEstimate| decided(joint).unwrap_err().to_string();
        let with = |evidence: Evidence| JointEstimate { evidence, ..drawer(0.95, 0.0) };
        let seen = drawer(0.95, 0.0).evidence;
        assert_eq!(
            said(&with(Evidence { free_space_violation: 0.41, ..seen.clone() })),
            "its tracks cost 2.70 an observation; at most 2.20 is allowed"
        );
        let cheap = JointEstimate {
            cost: 1.0,
            ..with(Evidence { free_space_violation: 0.41, ..seen.clone() })
        };
        assert_eq!(
            said(&cheap),
            "it was seen through at 41 % of its points; at most 22 % are allowed"
        );
        let rests = with(Evidence { parent_correlation: -1.0, ..seen.clone() });
        assert_eq!(said(&rests), "its parent rests whenever it is seen");
        let follows = with(Evidence { parent_correlation: 0.97, ..seen });
        assert_eq!(
            said(&follows),
            "97 % of its motion follows from its parent's; at most 85 % is allowed"
        );
        let sways = |f: usize| if f.is_multiple_of(2) { 0.01 } else { 0.0 };
        let mut short = JointEstimate { range: [0.0, 0.01], ..drawer(0.95, 0.0) };
        short.q = (0..FRAMES).map(sways).collect();
        assert_eq!(said(&short), "it slides by 0.010 m; at least 0.06 m is needed");
        let few = JointEstimate { members: vec![1, 2], ..drawer(0.95, 0.0) };
        assert_eq!(said(&few), "2 tracks follow it; at least 5 are needed");
    }
}
