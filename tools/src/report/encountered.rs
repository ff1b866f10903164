//! The page about a recognition: what was recognised and how far each joint is, in words; the learned
//! surface laid over the picture; why a configuration is not told; what was refused; the numbers.

use super::draw::{Canvas, part_colour};
use super::layout::{self, facts, keys, part_style, vector};
use super::overlay;
use super::units::{amount, probability};
use super::words::kind_in_words;
use linkage_driver::{ColorImage, RgbdFrame};
use linkage_skill::learn::StageTimes;
use linkage_skill::object::{ObjectModel, StoredObject};
use linkage_skill::recognise::{JointState, PartEvidence, Recognised, Recognition};
use linkage_skill::{Pose, pose_from_array};
use maud::{Markup, html};

/// What was asked of recognition.
#[derive(Debug, Clone, Copy)]
pub struct Asked<'a> {
    /// Objects that were looked for.
    pub known: usize,
    /// Score from which one is reported.
    pub min_score: f64,
    /// Those that were recognised, as they were learned; one that is missing is not drawn.
    pub objects: &'a [StoredObject],
    /// How long each step took.
    pub times: &'a StageTimes,
}

impl Asked<'_> {
    /// An object as it was learned.
    fn object(&self, name: &str) -> Option<&StoredObject> {
        self.objects.iter().find(|o| o.model.object == name)
    }
}

/// A page about a recognition.
pub fn recognition_page(
    frame: &RgbdFrame,
    recognition: &Recognition,
    asked: &Asked,
) -> anyhow::Result<String> {
    let found = &recognition.matches;
    let body = html! {
        h1 { "Recognition" }
        @if found.is_empty() {
            p.lead { "Nothing is recognised." }
            p { (asked.known) " known objects were looked for." }
        }
        @for m in found { (in_words(m)) }
        p.note { (runner_up(recognition, asked)) }
        @if found.is_empty() {
            (layout::picture(&Canvas::new(frame)?.finish()?, "What the camera saw")?)
        }
        @for m in found {
            @let object = asked.object(&m.object);
            (layout::picture(&overlaid(frame, m, object)?, &format!("{} as recognised", m.object))?)
            @if let Some(object) = object {
                p.note { "Lines are axes; dots are the learned surface where it was recognised." }
                (keys(object.model.parts.iter().map(|p| (p.id, p.name.as_str()))))
            }
        }
        @if found.iter().any(|m| !m.evidence.is_empty()) {
            h2 { "What was seen of each part" }
            @for m in found { (evidence(m)) }
        }
        @if !found.is_empty() {
            h2 { "Numbers" }
            @for m in found { (numbers(m)) }
            p.note { "Axes and origins are in the camera frame: x right, y down, z forward." }
        }
        (layout::times(asked.times, |step| step))
    };
    Ok(layout::page("Linkage: recognition", &body))
}

/// What was recognised, and each of its joints.
pub fn in_words(m: &Recognised) -> Markup {
    html! {
        p.lead { (m.object) " is recognised: " (probability(m.score)) " sure." }
        @if !m.base_known {
            p.warning {
                "Only a moving part is seen: where the object itself stands is a guess, "
                "the axis of the joint that carries the part is right."
            }
        }
        @for (i, joint) in m.joints.iter().enumerate() {
            section.joint style=(part_style(i + 1)) {
                p { (joint_in_words(joint)) }
            }
        }
    }
}

/// "joint1, a hinge, is at 34° ± 1.0°, of 0° to 72° that were learned."
pub fn joint_in_words(joint: &JointState) -> String {
    let of = |q: f64| amount(joint.kind, q);
    let (name, kind) = (&joint.name, kind_in_words(joint.kind));
    let [low, high] = joint.range;
    match joint.configuration {
        Some(q) => {
            let deviation = joint
                .deviation
                .map_or_else(|| " (how sure is not known)".to_owned(), |d| format!(" ± {}", of(d)));
            let learned = format!("{} to {}", of(low), of(high));
            format!("{name}, {kind}, is at {}{deviation}, of {learned} that were learned.", of(q))
        }
        None => {
            let reason = joint.reason.as_deref().unwrap_or("it is not seen");
            format!("{name}, {kind}: how far it is moved is not known, because {reason}.")
        }
    }
}

/// What came next, and was refused.
fn runner_up(recognition: &Recognition, asked: &Asked) -> String {
    let limit = format!("an object is reported from {:.0} % on", 100.0 * asked.min_score);
    let Some(object) = &recognition.best_refused_object else {
        let what = if recognition.matches.is_empty() { "No known object" } else { "Nothing else" };
        return format!("{what} came near; {limit}.");
    };
    let is_there_too = recognition.matches.iter().any(|m| m.object == *object);
    let what = if is_there_too { format!("a further {object}") } else { object.clone() };
    let score = probability(recognition.best_refused);
    format!("The best of what was refused was {what}, {score} sure; {limit}.")
}

/// The frame with the learned surface and the axes of one object.
pub fn overlaid(
    frame: &RgbdFrame,
    m: &Recognised,
    object: Option<&StoredObject>,
) -> anyhow::Result<ColorImage> {
    let mut canvas = Canvas::new(frame)?;
    if let Some(object) = object {
        let poses = camera_from_part(&object.model, m);
        overlay::surface(&mut canvas, frame, &object.appearance, &poses)?;
    }
    for (i, joint) in m.joints.iter().enumerate() {
        canvas.axis(&joint.geometry(), part_colour(i + 1))?;
    }
    canvas.finish()
}

/// Where each part is; `None` for parts that a joint carries whose configuration is not known.
pub fn camera_from_part(model: &ObjectModel, m: &Recognised) -> Vec<Option<Pose>> {
    let Some(camera_from_object) = pose_from_array(&m.camera_from_object) else {
        return Vec::new();
    };
    let at = |(i, j): (usize, &JointState)| {
        j.configuration.or_else(|| m.assumed.get(i).copied()).unwrap_or(0.0)
    };
    let configurations: Vec<f64> = m.joints.iter().enumerate().map(at).collect();
    let motions = model.part_motions(&configurations);
    let poses = motions.into_iter().map(|motion| camera_from_object * motion);
    poses.enumerate().map(|(part, pose)| is_known(model, m, part).then_some(pose)).collect()
}

/// All joints between a part and the base have a known configuration.
fn is_known(model: &ObjectModel, m: &Recognised, part: usize) -> bool {
    let mut carriers = part;
    // A chain has no more joints than the model.
    for _ in 0..model.joints.len() {
        let Some(i) = model.joints.iter().position(|j| j.child == carriers) else { break };
        if m.joints.get(i).is_none_or(|j| j.configuration.is_none()) {
            return false;
        }
        carriers = model.joints[i].parent;
    }
    true
}

/// A table with what was seen of each part of an object.
fn evidence(m: &Recognised) -> Markup {
    let colour = |e: &PartEvidence| {
        e.colour.map_or_else(|| "not compared".to_owned(), |c| format!("{c:.2}"))
    };
    html! {
        table {
            tr {
                th { (m.object) } th { "found by its own surface" } th { "surface points that agree" }
                th { "seen through" } th { "correlation of colour" }
            }
            @for e in &m.evidence {
                tr {
                    td { (e.part) } td { (if e.placed { "yes" } else { "no" }) }
                    td { (e.surface) } td { (e.seen_through) } td { (colour(e)) }
                }
            }
        }
        p.note {
            "The configuration of a joint is mostly told where the parts on both sides of it are found by their own "
            "surface. The place of a part may also follow from the room, or from what the image rules out."
        }
    }
}

/// A table of the object and one a joint.
pub fn numbers(m: &Recognised) -> Markup {
    let pose = m.camera_from_object.map(|x| format!("{x:.3}")).join(", ");
    let object = [
        ("score", format!("{:.3}", m.score)),
        ("matches that agree", m.inliers.to_string()),
        ("camera from object: x, y, z / m, quaternion", pose),
        ("base known", if m.base_known { "yes" } else { "no" }.to_owned()),
    ];
    html! {
        div.facts {
            (facts(&m.object, &object))
            @for j in &m.joints { (facts(&format!("{}: {}", m.object, j.name), &rows(j))) }
        }
    }
}

fn rows(j: &JointState) -> Vec<(&'static str, String)> {
    let unit = j.kind.unit();
    let number = |q: Option<f64>| q.map_or("not known".to_owned(), |q| format!("{q:.4} {unit}"));
    vec![
        ("type", j.kind.name().to_owned()),
        ("configuration", number(j.configuration)),
        ("deviation", number(j.deviation)),
        ("learned range", format!("{:.3} to {:.3} {unit}", j.range[0], j.range[1])),
        ("axis", vector(j.axis)),
        ("origin / m", vector(j.origin)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_skill::object::JointKind;

    fn hinge(configuration: Option<f64>) -> JointState {
        JointState {
            name: "joint1".to_owned(),
            kind: JointKind::Revolute,
            axis: [0.0, 1.0, 0.0],
            origin: [0.0, 0.0, 1.0],
            pitch: 0.0,
            configuration,
            deviation: configuration.map(|_| 0.0175),
            reason: configuration
                .is_none()
                .then(|| "nothing seen of door tells where it is".into()),
            range: [0.0, 72.0_f64.to_radians()],
        }
    }

    #[test]
    fn a_joint_is_told_with_its_deviation_or_with_the_reason_why_not() {
        let told = joint_in_words(&hinge(Some(34.0_f64.to_radians())));
        assert_eq!(told, "joint1, a hinge, is at 34° ± 1.0°, of 0.0° to 72° that were learned.");
        let hidden = "joint1, a hinge: how far it is moved is not known, because nothing seen of \
                      door tells where it is.";
        assert_eq!(joint_in_words(&hinge(None)), hidden);
    }

    fn drawer() -> Recognised {
        Recognised {
            object: "drawer".to_owned(),
            score: 0.9,
            inliers: 40,
            camera_from_object: [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            base_known: true,
            joints: Vec::new(),
            evidence: Vec::new(),
            assumed: Vec::new(),
        }
    }

    #[test]
    fn what_was_seen_of_each_part_is_told() {
        let seen = |part: &str, placed, colour| PartEvidence {
            part: part.to_owned(),
            placed,
            surface: 480,
            seen_through: 2,
            colour,
        };
        let evidence = vec![seen("base", true, Some(0.912)), seen("part1", false, None)];
        let told = super::evidence(&Recognised { evidence, ..drawer() }).into_string();
        let row = |part: &str, rest: &str| format!("<td>{part}</td>{rest}");
        let base = row("base", "<td>yes</td><td>480</td><td>2</td><td>0.91</td>");
        let part = row("part1", "<td>no</td><td>480</td><td>2</td><td>not compared</td>");
        assert!(told.contains(&base) && told.contains(&part), "{told}");
    }

    #[test]
    fn the_best_of_what_was_refused_is_named_and_told_with_the_limit() {
        let asked = Asked { known: 3, min_score: 0.5, objects: &[], times: &StageTimes::default() };
        let found = |name: &str| Recognised { object: name.to_owned(), ..drawer() };
        let said = |matches, score, refused: Option<&str>| {
            let best_refused_object = refused.map(str::to_owned);
            let matches = Recognition::new(matches);
            runner_up(&Recognition { best_refused: score, best_refused_object, ..matches }, &asked)
        };
        let limit = "an object is reported from 50 % on.";
        assert_eq!(
            said(vec![found("fridge")], 0.31, Some("drawer")),
            format!("The best of what was refused was drawer, 31 % sure; {limit}")
        );
        assert_eq!(
            said(vec![found("drawer")], 0.31, Some("drawer")),
            format!("The best of what was refused was a further drawer, 31 % sure; {limit}")
        );
        assert!(said(Vec::new(), 0.0, None).starts_with("No known object came near"));
    }
}
