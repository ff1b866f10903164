//! What of a joint's motion a recording does not show, in words: the motion had begun before the recording or went on
//! after it, or the part was hidden while it moved.
//!
//! In: configurations of a joint over time (seconds, radians or metres), and the times of the frames that may show it.
//! Out: sentences that say what to do.

use super::units::{amount, turns};
use linkage_skill::object::Joint;

/// Shortest time at each end of a recording over which the speed is measured, seconds.
const END_S: f64 = 0.35;
/// Fewest intervals between frames over which the speed is measured.
const END_INTERVALS: f64 = 2.0;
/// Speed above which a joint that turns moves, radians a second.
const MOVES_RAD_S: f64 = 0.2;
/// Speed above which any other joint moves, metres a second.
const MOVES_M_S: f64 = 0.05;
/// Shortest time without a configuration that is reported, seconds.
const HIDDEN_S: f64 = 0.5;
/// Fewest frames without a configuration that are reported.
const HIDDEN_FRAMES: usize = 2;
/// Share of the range by which a joint must have moved while it was hidden.
const HIDDEN_SHARE: f64 = 0.2;

/// Sentences on what the recording does not show; `frames`: times of the frames that may show the joint, seconds.
pub fn motion_warnings(joint: &Joint, frames: &[f64]) -> Vec<String> {
    let (Some(&begin), Some(&end)) = (frames.first(), frames.last()) else { return Vec::new() };
    let interval = (end - begin) / (frames.len() - 1).max(1) as f64;
    let near_end = END_S.max(1.1 * END_INTERVALS * interval);
    let mut said = Vec::new();
    let first = joint.configuration.first().map_or(begin, |[t, _]| *t);
    if first - begin > HIDDEN_S.max(END_INTERVALS * interval) {
        said.push(format!(
            "Its configuration is not known in the first {:.1} s: 0 is where it was first seen, which may not be where \
             it was shut.",
            first - begin
        ));
    }
    if moves_within(joint, [begin, begin + near_end]) {
        said.push(
            "It moves when the recording begins: begin to record before you touch it.".to_owned(),
        );
    }
    if moves_within(joint, [end - near_end, end]) {
        said.push(
            "It moves when the recording ends: let it rest for a second before you stop."
                .to_owned(),
        );
    }
    said.extend(hidden_motion(joint, frames));
    said
}

/// True if the joint moves in a span of time.
fn moves_within(joint: &Joint, [from, to]: [f64; 2]) -> bool {
    let fastest = if turns(joint.kind) { MOVES_RAD_S } else { MOVES_M_S };
    let mut within = joint.configuration.iter().filter(|[t, _]| (from..=to).contains(t));
    let (Some([t0, q0]), Some([t1, q1])) = (within.next(), within.next_back()) else {
        return false;
    };
    // Over a shorter time, noise looks like motion.
    t1 - t0 > 0.5 * (to - from) && ((q1 - q0) / (t1 - t0)).abs() > fastest
}

/// The first motion that no frame shows, in words.
fn hidden_motion(joint: &Joint, frames: &[f64]) -> Option<String> {
    let travel = joint.range[1] - joint.range[0];
    let is_hidden = |[before, after]: [[f64; 2]; 2]| {
        let between = frames.iter().filter(|t| before[0] < **t && **t < after[0]).count();
        after[0] - before[0] > HIDDEN_S
            && between >= HIDDEN_FRAMES
            && (after[1] - before[1]).abs() > HIDDEN_SHARE * travel
    };
    let mut pairs = joint.configuration.windows(2).map(|pair| [pair[0], pair[1]]);
    let [before, after] = pairs.find(|pair| is_hidden(*pair))?;
    Some(format!(
        "Its configuration is not known for {:.1} s, in which it went from {} to {}: keep it in view, and keep your \
         hands out of the way.",
        after[0] - before[0],
        amount(joint.kind, before[1]),
        amount(joint.kind, after[1]),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_skill::object::JointGeometry;
    use nalgebra::{Point3, Vector3};

    const RATE_HZ: f64 = 30.0;

    /// Warnings for a joint that is seen at this configuration so many seconds after the beginning of four seconds.
    fn warned_of(
        line: &JointGeometry,
        rate_hz: f64,
        q: impl Fn(f64) -> Option<f64>,
    ) -> Vec<String> {
        let frames: Vec<f64> =
            (0..).map(|i| f64::from(i) / rate_hz).take_while(|t| *t <= 4.0).collect();
        let configuration = frames.iter().filter_map(|t| Some([*t, q(*t)?])).collect();
        motion_warnings(&Joint { range: [0.0, 1.0], configuration, ..Joint::of(line) }, &frames)
    }

    fn warned(turn: impl Fn(f64) -> Option<f64>) -> Vec<String> {
        let hinge = JointGeometry::hinge(Vector3::y_axis(), Point3::origin());
        warned_of(&hinge, RATE_HZ, turn)
    }

    /// A motion that rests for a second before it and after it.
    fn rests(t: f64) -> f64 {
        ((t - 1.0) / 2.0).clamp(0.0, 1.0)
    }

    #[test]
    fn a_motion_that_begins_and_ends_at_rest_in_sight_is_warned_of_nothing() {
        assert_eq!(warned(|t| Some(rests(t))), Vec::<String>::new());
        assert_eq!(warned(|_| None), Vec::<String>::new());
        // Only some keyframes of a long recording may show a plain part.
        let hinge = JointGeometry::hinge(Vector3::y_axis(), Point3::origin());
        assert_eq!(warned_of(&hinge, 1.9, |t| Some(rests(t))), Vec::<String>::new());
    }

    #[test]
    fn a_recording_that_is_cut_short_is_told_with_what_to_do() {
        assert!(
            warned(|t| Some(rests(t + 1.0)))[0].starts_with("It moves when the recording begins")
        );
        assert!(
            warned(|t| Some(rests(t - 1.0)))[0].starts_with("It moves when the recording ends")
        );
        let slide = JointGeometry::slide(Vector3::z_axis(), Point3::origin());
        let slowly = |speed: f64| warned_of(&slide, RATE_HZ, move |t| Some(speed * t)).len();
        assert_eq!((slowly(0.04), slowly(0.06)), (0, 2));
    }

    #[test]
    fn what_was_hidden_while_it_moved_is_told_with_where_it_went() {
        let hidden = |from: f64, to: f64| warned(|t| (!(from..to).contains(&t)).then(|| rests(t)));
        let said = hidden(1.55, 2.45);
        assert_eq!(said.len(), 1);
        let begins = "Its configuration is not known for 0.9 s, in which it went from 15° to 42°:";
        assert!(said[0].starts_with(begins), "{said:?}");
        assert!(hidden(3.05, 3.6).is_empty(), "at rest, nothing is missed");
    }

    #[test]
    fn a_part_that_is_first_seen_late_counts_from_there_and_that_is_told() {
        let said = warned(|t| (t > 1.9).then(|| rests(t)));
        assert!(
            said[0].starts_with("Its configuration is not known in the first 1.9 s:"),
            "{said:?}"
        );
        assert!(warned(|t| (t > 0.4).then(|| rests(t))).is_empty());
    }
}
