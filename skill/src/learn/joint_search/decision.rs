//! Decides whether a candidate is a joint of an object: its support by tracks and the [`Evidence`] of its last
//! verification are compared with limits.
//!
//! In: a candidate with its evidence; metres, radians, shares from 0 to 1.
//! Out: accepted, or a [`Rejection`], which names the first limit that is broken and not outweighed by other evidence.
//! From: measurements, given at each limit that has one.
//!
//! The largest cost of an observation depends on the other evidence, because parts that are carried by a joint
//! raise its cost while they move. A hand raises it too, but it is not there from beginning to end, and depth
//! hardly discriminates shifts along an arm.

use super::config::JointSearchConfig;
use super::correlation::{ALLOWED_CORRELATION, MAX_CORRELATION};
use super::estimate::JointEstimate;
use super::evidence::Evidence;
use super::free_space_check::SILENT;
use super::weighed_evidence::{self, is_sure};
use crate::learn::attachment::MAX_UNATTACHED;

/// Smallest number of tracks of a joint.
const MIN_TRACKS: usize = 5;
/// Smallest number of frames in which the configuration of a joint is known.
const MIN_FRAMES: usize = 15;
/// Smallest share of the frames, 0 to 1, in which the configuration of a joint of few tracks is known. A forearm of 18
/// tracks slid by 17 cm in 0.24 of the frames; a shop till's display of 16 tracks, known in 0.25 of them, was 10 cm
/// beside its place. All right joints from tracks in 58 demonstrations were known in more than 0.4.
const MIN_COVERAGE: f64 = 0.3;
/// Number of tracks from which any share of the frames will do.
const MANY_TRACKS: usize = 25;
/// Smallest number of frames in either half of a joint's range. Where a passer-by occludes a thing at rest,
/// features of it seem to move with the person for one to three frames.
const MIN_FRAMES_OF_HALF: usize = 4;
/// Smallest number of known frames of a segment, which is an interval of time in which a joint was seen.
const MIN_SEGMENT_FRAMES: usize = 10;
/// Largest cost of an observation, as a mean over a joint's tracks (squared standard deviations). Measured:
/// hands cost 2.5 to 3.9, real joints 0.9 to 2.9.
pub const MAX_COST: f64 = 2.2;
/// Smallest gain of a joint: how much better it explains its tracks than rest does.
const MIN_GAIN: f64 = 300.0;
/// Divisor of [`MIN_GAIN`] that gives the smallest gain of a segment.
const SEGMENT_GAIN_DIVISOR: f64 = 3.0;

/// Allowance above [`MAX_COST`] for a solid joint that is known in nearly all frames and that depth images, or
/// rest before and after its motion, confirm.
const ALLOWANCE_ALWAYS: f64 = 1.8;
/// Allowance above [`MAX_COST`] for a solid joint that is known in most frames and rests when it is first or
/// last known. A person who stands beside the part never rests.
const ALLOWANCE_MOSTLY: f64 = 1.0;
/// Allowance above [`MAX_COST`] for a joint that depth images show everywhere and that rests when it is first
/// or last known. Depth images show an arm that opens a lid too, because it hangs beside the person at both
/// ends of a recording; but the arm's joint is known only while it moves.
const ALLOWANCE_FOUND: f64 = 0.6;
/// Allowance above [`MAX_COST`] for a solid joint that depth images reliably discriminate, that moves far, rests when
/// it is first or last known, and covers nearly all observations of its tracks. On 112 recordings the wing of a
/// jewellery box, known in a quarter of the frames, cost 2.5 to 3.0; what was no part, moved as far and was covered
/// cost 4.2.
const ALLOWANCE_COVERED: f64 = 1.0;
/// Allowance above [`MAX_COST`] for a joint that moves far and is known in nearly all frames: a slide between two rests
/// that is there throughout, or a hinge that turns by more than [`LARGE_TURN_RAD`] and covers its tracks. On 112
/// recordings all such candidates, of four things, were true, at a cost of up to 4.6; a tube that was folded before a
/// real sensor cost 4.9.
const ALLOWANCE_FAR: f64 = 3.0;
/// Turn of a hinge that no swaying person makes, radians: candidates that were no joints and were known in nearly all
/// frames turned by up to 0.4.
const LARGE_TURN_RAD: f64 = 0.8;
/// Smallest number of tracks of such a hinge.
const LARGE_TURN_TRACKS: usize = 25;
/// Largest share of the tracks' observations that a covered joint leaves unexplained. Persons and their arms, whose
/// cost was low enough, left 0.3 to 0.7.
const COVERED: f64 = 0.15;
/// Smallest turn of a hinge that moves far, radians.
const FAR_RAD: f64 = 0.5;
/// Further allowance for a solid sibling of an adopted joint that depth images reliably discriminate. Measured: the
/// lower drawer of a white pedestal, 0.6 degrees from parallel with the upper one, cost 4.6.
const ALLOWANCE_SIBLING: f64 = 1.0;
/// Share of the frames from which a joint counts as known in nearly all frames.
const ALWAYS: f64 = 0.9;
/// Share of the frames from which a joint counts as known in most frames.
const MOSTLY: f64 = 0.6;
/// Smallest number of tracks of a solid joint.
const SOLID_TRACKS: usize = 50;
/// Largest share of a solid joint's points that are seen through.
const SOLID_VIOLATION: f64 = 0.12;
/// Factor on the largest cost of a segment; a candidate that costs more is not verified by depth images.
pub const HOPELESS_COST: f64 = 1.2;

/// Discriminability from which depth images reliably discriminate the configuration.
const WELL_DISCRIMINATED: f64 = 0.6;
/// Factor on [`MIN_GAIN`] for a joint that depth images show everywhere and reliably discriminate.
const SHOWN_GAIN: f64 = 0.4;
/// Factor on [`MIN_GAIN`] for a slide that depth images do not discriminate. Corners between a person's outline
/// and a wall seem to slide along the wall.
const SILENT_SLIDE_GAIN: f64 = 40.0;
/// Factor on [`MIN_GAIN`] for a hinge that depth images do not discriminate. On 80 recordings all such hinges
/// were false: a few features on a person who sways, with 1.2 to 2.4 times the smallest gain.
const SILENT_HINGE_GAIN: f64 = 3.0;
/// Largest share of a joint's points, over all frames, that may be missing if the joint gets an allowance on
/// its cost although depth images do not reliably discriminate it. The share is also the limit for the
/// comparison of two parents.
const MAX_MISSING: f64 = 0.05;

/// Smallest travel of a slide, metres.
const MIN_SLIDE_M: f64 = 0.06;
/// Smallest travel of a slide that rests before and after it moves, metres. A person's trunk sways by as much,
/// but never rests.
const SMALL_SLIDE_M: f64 = 0.03;
/// Smallest number of frames for which a part must rest before or after it moves.
const REST_FRAMES: usize = 10;
/// Divisor of the number of known frames: a part that is known in few frames must rest for this share of them
/// only. A roll that was put onto its holder while 20 frames were taken rested in 7 of them.
const REST_OF_KNOWN: usize = 4;
/// Largest travel of a slide that counts as rest, metres.
const REST_M: f64 = 0.008;
/// Largest turn of a hinge that counts as rest, radians.
const REST_RAD: f64 = 0.02;
/// Largest share of the points seen through for a joint that stands between rests.
const REST_VIOLATION: f64 = 0.05;
/// Smallest discriminability of a joint that stands between rests. The limit is low because half of a short
/// travel is hardly discriminated.
const REST_DISCRIMINABILITY: f64 = 0.2;
/// Smallest discriminability of a joint that stands between rests and moves far. A trunk that followed a door by
/// 0.3 m and came back had 0.21.
const FAR_REST_DISCRIMINABILITY: f64 = 0.3;
/// Travel of a slide from which it moves far, metres.
const FAR_M: f64 = 0.15;
/// Smallest turn of a hinge, radians.
const MIN_TURN_RAD: f64 = 0.12;
/// Turn below which a hinge whose tracks cost more than [`MAX_COST`] must rest before and after it moves, and be
/// reliably discriminated by depth images, radians. Trunks that swayed turned by 0.12 to 0.19 rad at a cost of 3.0 to
/// 3.8; one of them stood between two rests, with a discriminability of 0.25. The hinges of things that were found at
/// such a cost on 60 recordings turned by 0.6 rad and more.
const SMALL_TURN_RAD: f64 = 0.25;
/// Smallest arc of a hinge's part, metres: its turn times the 75th percentile of its tracks' distances from the
/// axis.
const MIN_ARC_M: f64 = 0.03;

/// Largest share of the comparisons of images in which the texture of a joint's tracks is still at its former place
/// (see `former_place`).
pub const MAX_STILL_THERE: f64 = 0.3;

/// Allowance for a segment above the largest share of points that are seen through.
pub const SEGMENT_VIOLATION_SLACK: f64 = 0.03;
/// Allowance for a segment above the largest share of points that are missing.
const SEGMENT_UNOBSERVED_SLACK: f64 = 0.05;

/// Reason why a candidate is not accepted as a joint.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Rejection {
    /// Too few tracks follow the candidate.
    #[error("{found} tracks follow it; at least {MIN_TRACKS} are needed")]
    TooFewTracks {
        /// Number of tracks that follow the candidate.
        found: usize,
    },
    /// The configuration is known in too few frames.
    #[error("its configuration is known in {found} frames; at least {MIN_FRAMES} are needed")]
    TooFewFrames {
        /// Number of frames with a known configuration.
        found: usize,
    },
    /// Few tracks show the candidate, and in few of the frames.
    #[error(
        "{tracks} tracks show it in {:.0} % of the frames; {:.0} % are needed, or {MANY_TRACKS} tracks",
        100.0 * share,
        100.0 * MIN_COVERAGE
    )]
    Brief {
        /// Number of tracks.
        tracks: usize,
        /// Share of the frames, 0 to 1, in which the configuration is known.
        share: f64,
    },
    /// The candidate is in one half of its range for a moment only.
    #[error(
        "half of its range was seen in {found} frames; at least {MIN_FRAMES_OF_HALF} are needed"
    )]
    Moment {
        /// Number of frames in the half that was seen less.
        found: usize,
    },
    /// The candidate explains its tracks hardly better than rest does.
    #[error(
        "it explains its tracks by {gain:.0} better than rest does; at least {needed:.0} is needed"
    )]
    LowGain {
        /// Gain of the candidate.
        gain: f64,
        /// Smallest gain that is accepted.
        needed: f64,
    },
    /// The tracks deviate too much from the joint's motion.
    #[error("its tracks cost {cost:.2} an observation; at most {allowed:.2} is allowed")]
    HighCost {
        /// Mean cost of an observation.
        cost: f64,
        /// Largest mean cost that is accepted.
        allowed: f64,
    },
    /// The parent rests in all frames in which the candidate is known, so that the base may as well be the
    /// parent.
    #[error("its parent rests whenever it is seen")]
    ParentRests,
    /// The configuration is mostly a function of the parent's configuration.
    #[error(
        "{:.0} % of its motion follows from its parent's; at most {:.0} % is allowed",
        100.0 * share,
        100.0 * MAX_CORRELATION
    )]
    FollowsParent {
        /// Share of the configuration that follows from the parent's, 0 to 1.
        share: f64,
    },
    /// A slide whose travel is too short.
    #[error("it slides by {travel_m:.3} m; at least {needed_m} m is needed")]
    ShortSlide {
        /// Length of the range, metres.
        travel_m: f64,
        /// Smallest travel that is accepted for this slide, metres.
        needed_m: f64,
    },
    /// A hinge whose turn, or whose part's arc, is too short.
    #[error(
        "it turns by {turn_rad:.2} rad, and three quarters of its points by {arc_m:.3} m at most; \
         at least {MIN_TURN_RAD} rad and {MIN_ARC_M} m are needed"
    )]
    ShortTurn {
        /// Length of the range, radians.
        turn_rad: f64,
        /// Arc that three quarters of the tracks' points do not exceed, metres.
        arc_m: f64,
    },
    /// Depth images show something behind too many of the candidate's points.
    #[error(
        "it was seen through at {:.0} % of its points; at most {:.0} % are allowed",
        100.0 * share,
        100.0 * allowed
    )]
    SeenThrough {
        /// Share of the points that are seen through, 0 to 1.
        share: f64,
        /// Largest share that is accepted, 0 to 1.
        allowed: f64,
    },
    /// Depth images do not show the part in frames of unknown configuration.
    #[error(
        "{:.0} % of its points were missing while its configuration was unknown; \
         at most {:.0} % are allowed",
        100.0 * share,
        100.0 * allowed
    )]
    Unobserved {
        /// Share of the points that are missing, 0 to 1.
        share: f64,
        /// Largest share that is accepted, 0 to 1.
        allowed: f64,
    },
    /// Too many observations of the tracks are in frames of unknown configuration.
    #[error(
        "{:.0} % of its tracks' observations are in frames that it does not explain; \
         at most {:.0} % are allowed",
        100.0 * share,
        100.0 * allowed
    )]
    Uncovered {
        /// Share of the tracks' observations, 0 to 1.
        share: f64,
        /// Largest share that is accepted, 0 to 1.
        allowed: f64,
    },
    /// No visible surface holds the line of the hinge.
    #[error(
        "{:.0} % of the line that it turns about is in the air or outside the pictures, as it is of a \
         person who leans; at most {:.0} % are allowed",
        100.0 * share,
        100.0 * MAX_UNATTACHED
    )]
    Unattached {
        /// Share of the line beside the part that is in the air or outside the images, 0 to 1.
        share: f64,
    },
    /// Images show the texture of the tracks at its former place while the joint has moved it away.
    #[error(
        "what moves is still seen at its former place in {:.0} % of the comparisons; at most {:.0} % are allowed",
        100.0 * share,
        100.0 * MAX_STILL_THERE
    )]
    StillThere {
        /// Share of the decisive comparisons, 0 to 1.
        share: f64,
    },
    /// An accepted candidate explains the same tracks and is preferred: one is a joint of the base and the
    /// other of a part. A joint of the base needs 0.8 times the frames, a joint of a part 1.25 times.
    #[error("a candidate with another parent explains the same tracks and is preferred")]
    ExplainedWithAnotherParent,
    /// The configuration is a function of an adopted joint's configuration, and the candidate is not shown
    /// everywhere by depth images or has little gain.
    #[error(
        "{:.0} % of its motion follows from an accepted joint; at most {:.0} % is allowed",
        100.0 * share,
        100.0 * allowed
    )]
    FollowsAcceptedJoint {
        /// Share of the configuration that follows from the adopted joint's, 0 to 1.
        share: f64,
        /// Largest share that is accepted, 0 to 1.
        allowed: f64,
    },
    /// A slide whose tracks cost more than [`MAX_COST`] moves along with an adopted slide, as a person does who pulls
    /// it.
    #[error(
        "it moves along during {:.0} % of the motion of an accepted joint, as a person who pulls does, and its tracks \
         are noisy; at most {:.0} % are allowed",
        100.0 * share,
        100.0 * allowed
    )]
    GoesAlong {
        /// Share of the adopted joint's motion during which the candidate moves the same way, 0 to 1.
        share: f64,
        /// Largest share that is accepted, 0 to 1.
        allowed: f64,
    },
    /// The candidate turns about the line of an adopted joint and has little of that joint's gain.
    #[error("it turns about the line of an accepted joint and has little of that joint's gain")]
    OnLineOfAcceptedJoint,
    /// Depth images show the candidate on the part of an adopted joint wherever that part goes, as they show a
    /// hand that rests on the part.
    #[error("pictures show it on the part of an accepted joint wherever that part goes")]
    OnPartOfAcceptedJoint,
}

/// Compares a candidate with all limits; the error names the first limit that is broken and, for a joint of the base,
/// not outweighed by all evidence together.
pub fn decide(
    joint: &JointEstimate,
    evidence: &Evidence,
    config: &JointSearchConfig,
) -> Result<(), Rejection> {
    compare(joint, evidence, config, joint.parent.is_none())
}

/// Compares a candidate with all limits, as [`decide`]. `may_be_outweighed`: all evidence together may outweigh a
/// limit.
fn compare(
    joint: &JointEstimate,
    evidence: &Evidence,
    config: &JointSearchConfig,
    may_be_outweighed: bool,
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
        (
            joint.coverage() >= MIN_COVERAGE || tracks >= MANY_TRACKS,
            Rejection::Brief { tracks, share: joint.coverage() },
        ),
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
            evidence.unobserved_ratio <= config.max_unobserved,
            Rejection::Unobserved {
                share: evidence.unobserved_ratio,
                allowed: config.max_unobserved,
            },
        ),
        (
            evidence.uncovered_ratio <= config.max_uncovered,
            Rejection::Uncovered { share: evidence.uncovered_ratio, allowed: config.max_uncovered },
        ),
        (
            evidence.unattached_ratio <= MAX_UNATTACHED,
            Rejection::Unattached { share: evidence.unattached_ratio },
        ),
        (
            evidence.still_there_ratio <= MAX_STILL_THERE,
            Rejection::StillThere { share: evidence.still_there_ratio },
        ),
    ];
    let mut broken = table.into_iter().filter(|(is_kept, _)| !is_kept).map(|(_, broken)| broken);
    let holds = |broken: &Rejection| !(may_be_outweighed && is_outweighed(broken, joint, evidence));
    broken.find(holds).map_or(Ok(()), Err)
}

/// True if all evidence together makes it sure that a candidate is a joint, though it breaks a limit that is useful
/// only where there is little other evidence.
fn is_outweighed(broken: &Rejection, joint: &JointEstimate, evidence: &Evidence) -> bool {
    let may_be = match broken {
        // The cost distinguishes an arm that turns at the shoulder from a part.
        Rejection::HighCost { .. } => !(joint.dof.hinge && comes_and_leaves(joint, evidence)),
        Rejection::Unobserved { .. } | Rejection::Uncovered { .. } => true,
        _ => false,
    };
    may_be && is_sure(joint, evidence, longest_rest(joint))
}

/// Logarithm of the odds that a candidate is a joint, by all evidence together.
pub fn log_odds(joint: &JointEstimate, evidence: &Evidence) -> f64 {
    weighed_evidence::log_odds(joint, evidence, longest_rest(joint))
}

/// True if a joint with the evidence of its last verification keeps all limits.
pub fn accepts(joint: &JointEstimate, config: &JointSearchConfig) -> bool {
    decide(joint, &joint.evidence, config).is_ok()
}

/// True if a candidate keeps all limits or outweighs them, whatever its parent. On a moving part this suffices for a
/// joint that was accepted on the base.
pub fn may_be_accepted(
    joint: &JointEstimate,
    evidence: &Evidence,
    config: &JointSearchConfig,
) -> bool {
    compare(joint, evidence, config, true).is_ok()
}

/// True if a candidate is good enough to be merged into an accepted joint as a segment.
pub fn is_segment(joint: &JointEstimate, config: &JointSearchConfig) -> bool {
    let evidence = &joint.evidence;
    joint.members.len() >= MIN_TRACKS
        && joint.gain > MIN_GAIN / SEGMENT_GAIN_DIVISOR
        && joint.cost < max_segment_cost()
        && evidence.free_space_violation < config.max_through + SEGMENT_VIOLATION_SLACK
        && evidence.unobserved_ratio < config.max_unobserved + SEGMENT_UNOBSERVED_SLACK
        && joint.known_frames().len() >= MIN_SEGMENT_FRAMES
        && evidence.parent_correlation < MAX_CORRELATION
}

/// True if depth images could still confirm a candidate as a joint or as a segment of one.
pub fn is_worth_verifying(joint: &JointEstimate, parent_correlation: f64) -> bool {
    joint.members.len() >= MIN_TRACKS
        && joint.gain > MIN_GAIN / SEGMENT_GAIN_DIVISOR
        && (joint.cost <= HOPELESS_COST * max_segment_cost()
            || makes_large_turn(joint) && joint.cost <= MAX_COST + ALLOWANCE_FAR)
        && parent_correlation <= MAX_CORRELATION
}

/// Mean cost of an observation from which a candidate is not even a segment of a joint.
pub fn max_segment_cost() -> f64 {
    MAX_COST + ALLOWANCE_ALWAYS
}

/// Largest mean cost of an observation that is accepted for a joint: [`MAX_COST`] and an allowance that depends
/// on its evidence.
fn max_cost(joint: &JointEstimate, evidence: &Evidence) -> f64 {
    let coverage = joint.coverage();
    let solid =
        evidence.free_space_violation <= SOLID_VIOLATION && joint.members.len() >= SOLID_TRACKS;
    let found_everywhere = evidence.is_found_everywhere();
    let may_sway = joint.dof.hinge
        && joint.span() < SMALL_TURN_RAD
        && !(stands_between_rests(joint, evidence)
            && evidence.discriminability >= WELL_DISCRIMINATED);
    let nothing_against =
        found_everywhere || evidence.is_there_throughout() || stands_between_rests(joint, evidence);
    let is_covered = solid && evidence.uncovered_ratio <= COVERED && moves_far(joint);
    let allowance = match coverage {
        _ if turns_over(joint, evidence) => ALLOWANCE_FAR,
        _ if comes_and_leaves(joint, evidence) || may_sway => 0.0,
        _ if is_covered
            && !joint.dof.hinge
            && evidence.is_there_throughout()
            && stands_between_rests(joint, evidence) =>
        {
            ALLOWANCE_FAR
        }
        c if c >= ALWAYS && solid && nothing_against => ALLOWANCE_ALWAYS,
        c if c >= MOSTLY && solid && rests_for_a_while(joint) => ALLOWANCE_MOSTLY,
        _ if is_covered
            && evidence.discriminability >= WELL_DISCRIMINATED
            && rests_at_an_end(joint) =>
        {
            ALLOWANCE_COVERED
        }
        _ if found_everywhere && rests_at_an_end(joint) => ALLOWANCE_FOUND,
        _ => 0.0,
    };
    let is_sure_sibling = evidence.is_parallel_sibling
        && evidence.discriminability >= WELL_DISCRIMINATED
        && solid
        && !may_sway;
    MAX_COST + allowance + if is_sure_sibling { ALLOWANCE_SIBLING } else { 0.0 }
}

/// Smallest gain that is accepted for a joint: less where depth images alone would show it, more where they do
/// not discriminate it, most for a slide that they do not discriminate.
pub fn min_gain(joint: &JointEstimate, evidence: &Evidence) -> f64 {
    let least = MIN_GAIN;
    match evidence.discriminability {
        d if d >= WELL_DISCRIMINATED && evidence.is_found_everywhere() => SHOWN_GAIN * least,
        d if d < SILENT && !joint.dof.hinge => SILENT_SLIDE_GAIN * least,
        d if d < SILENT => SILENT_HINGE_GAIN * least,
        _ => least,
    }
}

/// True if depth images miss clearly less of a part with `joint` than with `other`, which is the same part with
/// another parent.
pub fn is_missed_less(joint: &JointEstimate, other: &JointEstimate) -> bool {
    let missed = |joint: &JointEstimate| joint.missing_share(&joint.evidence);
    missed(other) > MAX_MISSING && 3.0 * missed(joint) < 2.0 * missed(other)
}

/// True if depth images miss a part now and then and do not reliably discriminate it, as they miss an arm.
fn comes_and_leaves(joint: &JointEstimate, evidence: &Evidence) -> bool {
    evidence.discriminability < WELL_DISCRIMINATED && joint.missing_share(evidence) > MAX_MISSING
}

/// True if a joint is known in nearly all frames, rests before and after it moves, and depth images confirm it.
/// A person's trunk sways all the time, and a hand comes and leaves.
fn stands_between_rests(joint: &JointEstimate, evidence: &Evidence) -> bool {
    let [before, after] = rests(joint);
    let is_far_slide = !joint.dof.hinge && moves_far(joint);
    let discriminability =
        if is_far_slide { FAR_REST_DISCRIMINABILITY } else { REST_DISCRIMINABILITY };
    joint.coverage() >= ALWAYS
        && before.min(after) >= REST_FRAMES
        && evidence.free_space_violation <= REST_VIOLATION
        && evidence.discriminability >= discriminability
}

/// True if a hinge makes a large turn, is known in nearly all frames, is hardly seen through, covers its tracks and
/// rests at an end. Such a part does not come and leave, whatever the depth images discriminate.
fn turns_over(joint: &JointEstimate, evidence: &Evidence) -> bool {
    makes_large_turn(joint)
        && evidence.free_space_violation <= SOLID_VIOLATION
        && evidence.uncovered_ratio <= COVERED
        && rests_at_an_end(joint)
}

/// True if many tracks show a large turn of a hinge that is known in nearly all frames.
fn makes_large_turn(joint: &JointEstimate) -> bool {
    joint.dof.hinge
        && joint.span() > LARGE_TURN_RAD
        && joint.members.len() >= LARGE_TURN_TRACKS
        && joint.coverage() >= ALWAYS
}

/// True if a hinge turns, or a slide travels, far.
fn moves_far(joint: &JointEstimate) -> bool {
    joint.span() > if joint.dof.hinge { FAR_RAD } else { FAR_M }
}

/// True if a joint rests for [`REST_FRAMES`] when it is first or last known.
fn rests_at_an_end(joint: &JointEstimate) -> bool {
    longest_rest(joint) >= REST_FRAMES
}

/// True if a joint rests when it is first or last known: for [`REST_FRAMES`], or for one in [`REST_OF_KNOWN`]
/// of its known frames if that is less.
fn rests_for_a_while(joint: &JointEstimate) -> bool {
    longest_rest(joint) >= REST_FRAMES.min(joint.known_frames().len() / REST_OF_KNOWN)
}

/// Number of known frames in which a joint rests, when it is first or when it is last known, whichever is more.
fn longest_rest(joint: &JointEstimate) -> usize {
    let [before, after] = rests(joint);
    before.max(after)
}

/// Number of known frames in which a joint rests, from the first known frame on and from the last one back.
fn rests(joint: &JointEstimate) -> [usize; 2] {
    let q: Vec<f64> = joint.known_frames().into_iter().map(|f| joint.q[f]).collect();
    let way = if joint.dof.hinge { REST_RAD } else { REST_M };
    [resting(q.iter(), way), resting(q.iter().rev(), way)]
}

/// Number of known frames in that half of a joint's range which is seen less.
fn frames_of_less_seen_half(joint: &JointEstimate) -> usize {
    let middle = 0.5 * (joint.range[0] + joint.range[1]);
    let known = joint.known_frames();
    let upper = known.iter().filter(|&&f| joint.q[f] > middle).count();
    upper.min(known.len() - upper)
}

/// Number of configurations, from the first on, that stay within a span of `way` (radians or metres). The first
/// may be at either end of the span, because with a moving camera a part at rest seems to drift by millimetres.
fn resting<'q>(configurations: impl Iterator<Item = &'q f64>, way: f64) -> usize {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    configurations
        .take_while(|&&q| {
            (low, high) = (low.min(q), high.max(q));
            high - low < way
        })
        .count()
}

/// True if a joint moves enough, with the rejection that applies if it does not.
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

    /// True if the cost is allowed whatever all evidence together says.
    fn is_cheap_enough(joint: &JointEstimate) -> bool {
        joint.cost <= max_cost(joint, &joint.evidence)
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
        let seen = [drawer(0.5, 0.0), drawer(0.7, 0.0), drawer(0.95, 0.3)];
        assert!(seen.iter().all(|joint| is_cheap_enough(joint) && is_accepted(joint)));
        assert!(is_cheap_enough(&discriminated(drawer(0.5, 0.2), 0.9)));
    }

    #[test]
    fn all_evidence_outweighs_noisy_tracks_on_a_part_only_if_the_parent_does_not_count() {
        let sure = discriminated(drawer(0.7, 0.0), 0.5);
        let attached = JointEstimate { parent: Some(0), cost: 3.6, ..sure };
        let config = JointSearchConfig::default();
        let may_be = |joint: &JointEstimate| may_be_accepted(joint, &joint.evidence, &config);
        assert!(!accepts(&attached, &config) && may_be(&attached));
        assert!(!may_be(&discriminated(attached, 0.2)));
    }

    #[test]
    fn a_sibling_may_have_noisier_tracks_where_pictures_discriminate_it() {
        let noisy = |is_parallel_sibling, discriminability| {
            let joint = discriminated(drawer(0.95, 0.3), discriminability);
            let evidence = Evidence { is_parallel_sibling, ..joint.evidence.clone() };
            is_cheap_enough(&JointEstimate { evidence, cost: 4.6, ..joint })
        };
        assert!(noisy(true, 0.68));
        assert!(!noisy(false, 0.68) && !noisy(true, 0.4));
    }

    #[test]
    fn a_slide_that_is_there_throughout_may_have_noisy_tracks_if_it_moves_far_between_rests() {
        let noisy = |unobserved: f64, share: f64| {
            let joint = drawer(0.95, unobserved);
            let q = joint.q.iter().map(|q| q * share).collect();
            is_cheap_enough(&JointEstimate { q, range: [0.0, 0.2 * share], cost: 4.6, ..joint })
        };
        assert!(noisy(0.0, 1.0));
        assert!(!noisy(0.3, 1.0), "missing in some pictures");
        assert!(!noisy(0.0, 0.5), "it hardly moves");
    }

    #[test]
    fn a_wing_that_is_known_late_may_have_noisy_tracks_if_it_covers_them_and_rests() {
        let wing = |uncovered_ratio: f64, discriminability: f64, travel: f64| {
            let joint = drawer(0.3, 0.78);
            let late = |f: usize| if f < 75 { 0.0 } else { travel };
            let evidence = Evidence { uncovered_ratio, discriminability, ..joint.evidence.clone() };
            JointEstimate {
                dof: ScrewJoint::hinge(Vector3::z(), Point3::new(0.5, 0.0, 1.5)),
                known: (0..FRAMES).map(|f| f >= 70).collect(),
                q: (0..FRAMES).map(late).collect(),
                range: [0.0, travel],
                cost: 3.0,
                evidence,
                ..joint
            }
        };
        let is_cheap_enough = |wing: JointEstimate| decided(&wing) != Err(high_cost(&wing));
        assert!(is_cheap_enough(wing(0.1, 0.8, 0.7)));
        assert!(
            !is_cheap_enough(wing(0.4, 0.8, 0.7)),
            "an arm goes on where the joint does not explain it"
        );
        assert!(!is_cheap_enough(wing(0.1, 0.5, 0.7)), "its pictures hardly discriminate it");
        assert!(!is_cheap_enough(wing(0.1, 0.8, 0.3)), "it hardly turns");
    }

    #[test]
    fn a_hinge_that_makes_a_large_turn_in_nearly_all_frames_may_have_noisy_tracks() {
        let turned = |turn: f64, coverage: f64, tracks: usize, uncovered_ratio: f64| {
            let joint = drawer(coverage, 0.0);
            let evidence = Evidence { uncovered_ratio, ..joint.evidence.clone() };
            let hinge = JointEstimate {
                dof: ScrewJoint::hinge(Vector3::z(), Point3::new(0.5, 0.0, 1.5)),
                q: joint.q.iter().map(|q| q / 0.2 * turn).collect(),
                range: [0.0, turn],
                members: (0..tracks).collect(),
                cost: 5.0,
                evidence,
                ..joint
            };
            is_worth_verifying(&hinge, 0.0) && decided(&hinge) != Err(high_cost(&hinge))
        };
        assert!(turned(2.1, 0.95, 60, 0.0));
        assert!(!turned(0.6, 0.95, 60, 0.0), "a limb turns so far");
        assert!(!turned(2.1, 0.8, 60, 0.0), "it is not known in all frames");
        assert!(!turned(2.1, 0.95, 20, 0.0), "few tracks");
        assert!(!turned(2.1, 0.95, 60, 0.4), "its tracks go elsewhere");
    }

    fn high_cost(joint: &JointEstimate) -> Rejection {
        Rejection::HighCost { cost: joint.cost, allowed: max_cost(joint, &joint.evidence) }
    }

    #[test]
    fn a_trunk_that_goes_along_and_comes_back_is_no_drawer() {
        let moved = |travel: f64| {
            let joint = discriminated(drawer(0.95, 0.16), 0.21);
            let q = joint.q.iter().map(|q| q * travel / 0.2).collect();
            is_accepted(&JointEstimate { q, range: [0.0, travel], cost: 3.7, ..joint })
        };
        assert!(moved(0.1), "half of a short travel is hardly discriminated");
        assert!(!moved(0.3));
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
        let leans_once = hinge(&opens, 0.25);
        assert!(matches!(decided(&leans_once), Err(Rejection::HighCost { .. })));
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
        let arm = |coverage: f64, unobserved: f64| {
            let joint = drawer(coverage, unobserved);
            let evidence = Evidence { uncovered_ratio: 0.4, ..joint.evidence.clone() };
            JointEstimate { evidence, ..joint }
        };
        for arm in [arm(0.5, 0.2), arm(0.7, 0.25)] {
            assert!(!is_cheap_enough(&arm) && !is_accepted(&arm));
        }
    }

    #[test]
    fn much_evidence_for_a_joint_of_the_base_outweighs_noisy_tracks() {
        let tank = JointEstimate { members: (0..22).collect(), cost: 3.0, ..drawer(0.97, 0.14) };
        assert!(!is_cheap_enough(&tank) && is_accepted(&tank));
        let of_a_part = JointEstimate { parent: Some(0), ..tank.clone() };
        assert!(matches!(decided(&of_a_part), Err(Rejection::HighCost { .. })));
        let little = JointEstimate { range: [0.0, 0.07], ..tank };
        assert!(matches!(decided(&little), Err(Rejection::HighCost { .. })), "it hardly moves");
    }

    #[test]
    fn much_evidence_outweighs_that_a_part_is_missing_now_and_then() {
        let joint = discriminated(drawer(0.6, 0.66), 0.9);
        let evidence = Evidence { uncovered_ratio: 0.32, ..joint.evidence.clone() };
        let locker = JointEstimate { evidence, cost: 1.5, ..joint };
        assert_eq!(decided(&locker), Ok(()));
        let of_a_part = JointEstimate { parent: Some(0), ..locker };
        assert!(matches!(decided(&of_a_part), Err(Rejection::Unobserved { .. })));
    }

    #[test]
    fn no_evidence_outweighs_the_other_limits_and_these_are_named() {
        let tank = JointEstimate { members: (0..22).collect(), cost: 3.0, ..drawer(0.97, 0.14) };
        let evidence = Evidence { still_there_ratio: 0.41, ..tank.evidence.clone() };
        let still_there = JointEstimate { evidence, ..tank.clone() };
        assert!(matches!(decided(&still_there), Err(Rejection::StillThere { .. })));
        let no_gain = JointEstimate { gain: 110.0, ..tank };
        assert!(matches!(decided(&no_gain), Err(Rejection::LowGain { .. })));
    }

    #[test]
    fn the_cost_of_a_hinge_that_comes_and_leaves_is_not_outweighed() {
        let hinge = |unobserved_ratio: f64| {
            let joint = discriminated(drawer(0.6, unobserved_ratio), 0.55);
            let dof = ScrewJoint::hinge(Vector3::z(), Point3::new(0.5, 0.0, 1.5));
            let q = joint.q.iter().map(|q| 5.0 * q).collect();
            JointEstimate { dof, q, range: [0.0, 1.0], cost: 3.4, ..joint }
        };
        assert!(is_accepted(&hinge(0.05)), "a door");
        assert!(matches!(decided(&hinge(0.3)), Err(Rejection::HighCost { .. })), "an arm");
    }

    #[test]
    fn few_tracks_must_show_a_joint_for_a_while() {
        let seen_in = |share: f64, tracks: usize| {
            let q = (0..FRAMES).map(|f| if f < 8 { 0.2 } else { 0.0 }).collect();
            JointEstimate { members: (0..tracks).collect(), q, ..drawer(share, 0.0) }
        };
        let is_brief =
            |joint: &JointEstimate| matches!(decided(joint), Err(Rejection::Brief { .. }));
        assert!(is_brief(&seen_in(0.25, 18)), "a forearm");
        assert_eq!(
            decided(&seen_in(0.25, 18)).unwrap_err().to_string(),
            "18 tracks show it in 25 % of the frames; 30 % are needed, or 25 tracks"
        );
        assert!(!is_brief(&seen_in(0.25, 60)) && !is_brief(&seen_in(0.45, 18)));
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
    fn what_is_still_at_its_former_place_is_no_joint() {
        let decided_with = |still_there_ratio| {
            let joint = drawer(0.95, 0.3);
            let evidence = Evidence { still_there_ratio, ..joint.evidence.clone() };
            decided(&JointEstimate { evidence, ..joint })
        };
        assert!(decided_with(0.2).is_ok());
        assert!(matches!(decided_with(0.41), Err(Rejection::StillThere { .. })));
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
