//! A joint in words: what it is, how far it moves, how sure that is, and what is to be done where it
//! is not sure.
//!
//! In: a joint in a frame whose x points right, y down and z away from who looks: the object frame,
//! which is the camera's of the first frame, or the camera frame. Out: sentences.

use super::units::{amount, angle, length, probability};
use linkage_planner_bridge::Rig;
use linkage_planner_bridge::joint_deviation::{axis_deviation_rad, hinge_deviation_m};
use linkage_skill::object::{Joint, JointKind};
use nalgebra::{Point3, Vector3};

/// Turn below which a demonstration is short, radians.
const SHORT_TURN_RAD: f64 = 0.52;
/// Slide below which it is short, metres.
const SHORT_SLIDE_M: f64 = 0.10;
/// Share of the frames below which few show the joint.
const FEW_FRAMES: f64 = 0.5;
/// Part of a unit direction along a coordinate axis from which it counts as that axis: 40 degrees.
const ALONG: f64 = 0.766;
/// Share of the range on the other side of the beginning from which it is told.
const OTHER_SIDE: f64 = 0.1;

/// What a sentence needs beside the joint.
#[derive(Debug, Clone, Copy, Default)]
pub struct Seen<'s> {
    /// Middle of the part's surface at configuration 0, in the joint's frame.
    pub middle: Option<Point3<f64>>,
    /// Name of the part that carries it, unless that is the base.
    pub carrier: Option<&'s str>,
    /// Frames of the recording; 0 where they are not known.
    pub frames: usize,
}

/// "A door, hinged on the right, opens 72°."
pub fn sentence(joint: &Joint, seen: &Seen) -> String {
    let [low, high] = joint.range;
    let (travel, kind) = (high - low, joint.kind);
    let what = if joint.undecided { undecided(joint) } else { thing(joint, seen.middle) };
    let carried = seen.carrier.map_or_else(String::new, |c| format!(" carried by {c},"));
    let moves = match kind {
        _ if joint.undecided => format!("moves {}", amount(kind, travel)),
        JointKind::Prismatic => format!("slides {}{}", length(travel), towards(joint)),
        JointKind::Helical => {
            let turns = travel / std::f64::consts::TAU;
            format!("turns {} and advances {}", angle(travel), length((joint.pitch * turns).abs()))
        }
        JointKind::Revolute if is_opening(joint, seen.middle) => format!("opens {}", angle(travel)),
        JointKind::Revolute => format!("turns {}", angle(travel)),
        JointKind::Fixed => "does not move".to_owned(),
        JointKind::Nonparametric => format!("moves {} along no simple path", length(travel)),
    };
    let other_side = low.abs().min(high.abs());
    let ends = if other_side > OTHER_SIDE * travel {
        let (low, high) = (amount(kind, low), amount(kind, high));
        format!(" It was seen from {low} to {high}, where 0 is the beginning of the recording.")
    } else {
        String::new()
    };
    format!("{what}{carried} {moves}.{ends}")
}

/// "Sure of the type: > 99 %. Direction ± 0.2°, hinge ± 3 mm."
pub fn certainty(joint: &Joint) -> String {
    let sure = match joint.type_probabilities.get(&joint.kind) {
        Some(p) => format!("Sure of the type: {}.", probability(*p)),
        None => "How sure the type is was not computed.".to_owned(),
    };
    let direction = match axis_deviation_rad(joint) {
        Some(rad) => format!("Direction ± {}", angle(rad)),
        None => return format!("{sure} How far the axis may be off is not known."),
    };
    if joint.kind == JointKind::Prismatic {
        return format!("{sure} {direction}.");
    }
    match hinge_deviation_m(joint) {
        Some(m) => format!("{sure} {direction}, hinge ± {}.", length(m)),
        None => format!("{sure} {direction}; how far the hinge's place may be off is not known."),
    }
}

/// What a person should know before the joint is used, and what helps.
pub fn warnings(joint: &Joint, seen: &Seen) -> Vec<String> {
    let mut said = Vec::new();
    let travel = joint.range[1] - joint.range[0];
    let (short, verb) = match joint.kind {
        JointKind::Revolute | JointKind::Helical => (SHORT_TURN_RAD, "open"),
        _ => (SHORT_SLIDE_M, "move"),
    };
    if joint.undecided {
        said.push(format!("The type is not sure: {}.", kinds_with_probability(joint)));
    }
    if travel < short {
        let shown = amount(joint.kind, travel);
        said.push(format!("Only {shown} were shown; {verb} it further."));
    }
    let known = joint.configuration.len();
    if seen.frames > 0 && (known as f64) < FEW_FRAMES * seen.frames as f64 {
        let share = 100.0 * known as f64 / seen.frames as f64;
        said.push(format!(
            "Few pictures show it: its configuration is known in {share:.0} % of them; \
             keep it in view, and keep your hands out of the way."
        ));
    }
    said.extend(too_uncertain(joint));
    said
}

/// A warning where the axis deviates by more than a rig allows that sets no limits of its own.
fn too_uncertain(joint: &Joint) -> Option<String> {
    let safety = Rig::default().safety;
    let demonstrate = "demonstrate it again, over more of its way";
    match (axis_deviation_rad(joint), hinge_deviation_m(joint)) {
        (None, _) => Some(format!(
            "How far its axis may be off is not known, so no motion is planned; {demonstrate}."
        )),
        (Some(rad), _) if rad > safety.axis_deviation => Some(format!(
            "The direction of its axis may be off by {}; {} are allowed where a motion is planned; \
             {demonstrate}.",
            angle(rad),
            angle(safety.axis_deviation)
        )),
        (_, Some(m)) if m > safety.hinge_deviation => Some(format!(
            "Its hinge may be off by {}; {} are allowed where a motion is planned; {demonstrate}.",
            length(m),
            length(safety.hinge_deviation)
        )),
        _ => None,
    }
}

/// A kind as a person calls it.
pub fn kind_in_words(kind: JointKind) -> &'static str {
    match kind {
        JointKind::Fixed => "fixed",
        JointKind::Prismatic => "a slide",
        JointKind::Revolute => "a hinge",
        JointKind::Helical => "a screw",
        JointKind::Nonparametric => "no simple joint",
    }
}

/// "A part of which the type is not sure (a hinge 62 %, a slide 38 %)".
fn undecided(joint: &Joint) -> String {
    format!("A part of which the type is not sure ({})", kinds_with_probability(joint))
}

/// "a hinge 62 %, a slide 38 %": the kinds that are likely, and the one that the joint has.
fn kinds_with_probability(joint: &Joint) -> String {
    let is_likely_or_own = |(kind, p): &(&JointKind, &f64)| **p >= 0.01 || **kind == joint.kind;
    let mut kinds: Vec<_> = joint.type_probabilities.iter().filter(is_likely_or_own).collect();
    kinds.sort_by(|a, b| b.1.total_cmp(a.1));
    let told: Vec<String> =
        kinds.iter().map(|(k, p)| format!("{} {}", kind_in_words(**k), probability(**p))).collect();
    if told.is_empty() { format!("perhaps {}", kind_in_words(joint.kind)) } else { told.join(", ") }
}

/// The kind of thing that it is, with the side of its hinge.
fn thing(joint: &Joint, middle: Option<Point3<f64>>) -> String {
    let axis = Vector3::from(joint.axis);
    let [x, y, z] = [axis.x.abs(), axis.y.abs(), axis.z.abs()];
    match joint.kind {
        JointKind::Prismatic if z > ALONG => "A drawer".to_owned(),
        JointKind::Prismatic if x > ALONG => "A sliding door".to_owned(),
        JointKind::Prismatic => "A part".to_owned(),
        JointKind::Helical => "A screw".to_owned(),
        JointKind::Revolute => {
            let side = middle.map(|m| side_of_hinge(joint, &m));
            match side {
                Some(side) if y > ALONG => format!("A door, hinged {side},"),
                Some(side) if x > ALONG => format!("A lid or flap, hinged {side},"),
                None if y > ALONG => "A door".to_owned(),
                None if x > ALONG => "A lid or flap".to_owned(),
                _ if z > ALONG => "A part, turning in the plane of the picture,".to_owned(),
                _ => "A part, hinged about a slanted axis,".to_owned(),
            }
        }
        JointKind::Fixed | JointKind::Nonparametric => "A part".to_owned(),
    }
}

/// The side of the part on which its hinge is.
fn side_of_hinge(joint: &Joint, middle: &Point3<f64>) -> &'static str {
    let axis = Vector3::from(joint.axis);
    let way = Point3::from(joint.origin) - middle;
    let across = way - axis * axis.dot(&way);
    let upright = axis.y.abs() > ALONG;
    // Across an upright axis a side is right or left, across a level one top or bottom; a part that
    // is seen along its surface has its hinge in front or behind.
    let (sideways, names) = if upright {
        (across.x, ["on the left", "on the right"])
    } else {
        (across.y, ["at the top", "at the bottom"])
    };
    if sideways.abs() >= across.z.abs() {
        names[usize::from(sideways > 0.0)]
    } else {
        ["at the front", "at the back"][usize::from(across.z > 0.0)]
    }
}

/// True where a hinge opens something: it lies at a side, upright or level.
fn is_opening(joint: &Joint, middle: Option<Point3<f64>>) -> bool {
    let [x, y, _] = joint.axis.map(f64::abs);
    middle.is_some() && (x > ALONG || y > ALONG)
}

/// The direction in which a slide opens, as a person sees it.
fn towards(joint: &Joint) -> &'static str {
    let [low, high] = joint.range;
    let sign = if high.abs() >= low.abs() { 1.0 } else { -1.0 };
    let [x, y, z] = joint.axis.map(|a| sign * a);
    match () {
        () if z < -ALONG => " towards the camera",
        () if z > ALONG => " away from the camera",
        () if x > ALONG => " to the right",
        () if x < -ALONG => " to the left",
        () if y > ALONG => " down",
        () if y < -ALONG => " up",
        () => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_skill::object::JointGeometry;
    use std::collections::BTreeMap;

    /// A door of 60 cm whose hinge is on the right, 1 m away, opened by 72 degrees.
    fn door() -> Joint {
        let line = JointGeometry::hinge(-Vector3::y_axis(), Point3::new(0.3, 0.0, 1.0));
        let mut covariance = vec![[0.0; 6]; 6];
        for (i, row) in covariance.iter_mut().enumerate() {
            row[i] = if i < 3 { 0.0035_f64.powi(2) } else { 0.003_f64.powi(2) };
        }
        Joint {
            range: [0.0, 72.0_f64.to_radians()],
            covariance,
            configuration: vec![[0.0, 0.0]; 90],
            type_probabilities: BTreeMap::from([(JointKind::Revolute, 0.9999)]),
            ..Joint::of(&line)
        }
    }

    fn seen() -> Seen<'static> {
        Seen { middle: Some(Point3::new(0.0, 0.0, 1.0)), carrier: None, frames: 100 }
    }

    fn slide(axis: Vector3<f64>, range: [f64; 2]) -> Joint {
        let axis = nalgebra::UnitVector3::new_normalize(axis);
        Joint { range, ..Joint::of(&JointGeometry::slide(axis, Point3::new(0.0, 0.0, 1.0))) }
    }

    #[test]
    fn a_door_is_told_in_one_sentence_with_the_side_of_its_hinge() {
        assert_eq!(sentence(&door(), &seen()), "A door, hinged on the right, opens 72°.");
        let left = Seen { middle: Some(Point3::new(0.6, 0.0, 1.0)), ..seen() };
        assert_eq!(sentence(&door(), &left), "A door, hinged on the left, opens 72°.");
        // One that is seen along its surface.
        let deep = Seen { middle: Some(Point3::new(0.28, 0.0, 0.7)), ..seen() };
        assert_eq!(sentence(&door(), &deep), "A door, hinged at the back, opens 72°.");
        assert_eq!(sentence(&door(), &Seen::default()), "A door turns 72°.");
    }

    #[test]
    fn a_well_learned_door_is_sure_and_warns_of_nothing() {
        let said = "Sure of the type: > 99 %. Direction ± 0.2°, hinge ± 3 mm.";
        assert_eq!(certainty(&door()), said);
        assert_eq!(warnings(&door(), &seen()), Vec::<String>::new());
    }

    #[test]
    fn a_lid_is_hinged_at_the_top_and_may_be_carried() {
        let line = JointGeometry::hinge(Vector3::x_axis(), Point3::new(0.0, -0.2, 1.0));
        let lid = Joint { range: [0.0, 1.5], ..Joint::of(&line) };
        let seen = Seen { carrier: Some("part1"), ..seen() };
        let said = "A lid or flap, hinged at the top, carried by part1, opens 86°.";
        assert_eq!(sentence(&lid, &seen), said);
    }

    #[test]
    fn slides_are_told_by_where_they_go() {
        let said = |axis: [f64; 3], range| sentence(&slide(axis.into(), range), &seen());
        let drawer = "A drawer slides 32 cm towards the camera.";
        assert_eq!(said([0.0, 0.0, -1.0], [0.0, 0.32]), drawer);
        assert_eq!(said([0.0, 0.0, 1.0], [-0.32, 0.0]), drawer);
        let door = "A sliding door slides 50 cm to the left.";
        assert_eq!(said([-1.0, 0.1, 0.0], [0.0, 0.5]), door);
        assert_eq!(said([0.0, -1.0, 0.0], [0.0, 0.5]), "A part slides 50 cm up.");
        assert_eq!(said([1.0, 1.0, 0.0], [0.0, 0.5]), "A part slides 50 cm.");
    }

    #[test]
    fn a_screw_turns_and_advances() {
        let line = JointGeometry::screw(Vector3::y_axis(), Point3::origin(), 0.02);
        let screw = Joint { range: [0.0, std::f64::consts::PI], ..Joint::of(&line) };
        assert_eq!(sentence(&screw, &seen()), "A screw turns 180° and advances 1.0 cm.");
    }

    #[test]
    fn both_ways_from_the_beginning_are_told() {
        let said = sentence(&slide(-Vector3::z(), [-0.1, 0.2]), &seen());
        let expected = "A drawer slides 30 cm towards the camera. It was seen from −10 cm to \
                        20 cm, where 0 is the beginning of the recording.";
        assert_eq!(said, expected);
    }

    #[test]
    fn what_is_not_sure_is_said_with_what_helps() {
        let kinds = [(JointKind::Revolute, 0.62), (JointKind::Prismatic, 0.38)];
        let short = Joint {
            range: [0.0, 12.0_f64.to_radians()],
            undecided: true,
            type_probabilities: BTreeMap::from(kinds),
            configuration: vec![[0.0, 0.0]; 20],
            ..door()
        };
        let said = sentence(&short, &seen());
        assert_eq!(
            said,
            "A part of which the type is not sure (a hinge 62 %, a slide 38 %) moves 12°."
        );
        let warned = warnings(&short, &seen());
        assert_eq!(warned[0], "The type is not sure: a hinge 62 %, a slide 38 %.");
        assert_eq!(warned[1], "Only 12° were shown; open it further.");
        assert!(warned[2].starts_with("Few pictures show it: its configuration is known in 20 %"));
        assert_eq!(warned.len(), 3);
    }

    #[test]
    fn an_axis_that_no_plan_is_made_for_is_warned_of() {
        let mut loose = door();
        loose.covariance[3][3] = 0.5_f64.powi(2);
        loose.covariance[5][5] = 0.5_f64.powi(2);
        let warned = warnings(&loose, &seen());
        assert!(warned[0].starts_with("Its hinge may be off by 50 cm;"), "{warned:?}");
        let unknown = Joint { covariance: Vec::new(), ..door() };
        assert!(certainty(&unknown).ends_with("How far the axis may be off is not known."));
        assert!(warnings(&unknown, &seen())[0].contains("no motion is planned"));
    }
}
