//! The page about a prediction: how each joint will move in words and over time, and where its part
//! goes; or why nothing is predicted.

use super::animation;
use super::chart::{self, Curve, Ground};
use super::draw::{Canvas, part_colour};
use super::encountered::{in_words, numbers, overlaid};
use super::layout::{self, facts};
use super::moving_surface::MovingSurface;
use super::overlay::{outline_of, surface};
use super::units::{amount, length};
use super::words::kind_in_words;
use linkage_driver::{ColorImage, RgbdFrame};
use linkage_planner_bridge::Prediction;
use linkage_planner_bridge::plan::PlannedJoint;
use linkage_skill::learn::StageTimes;
use linkage_skill::object::{Appearance, StoredObject};
use linkage_skill::recognise::{JointState, Recognised};
use linkage_skill::{Pose, pose_from_array};
use maud::{Markup, html};
use nalgebra::Point3;
use std::path::Path;

/// Outlines drawn along the path of a part.
const OUTLINES: usize = 9;

/// A page about a prediction, or about why there is none.
pub fn prediction_page(
    frame: &RgbdFrame,
    recognised: &Recognised,
    object: &StoredObject,
    predicted: Result<&Prediction, &str>,
    times: &StageTimes,
) -> anyhow::Result<String> {
    let body = html! {
        h1 { "Prediction: " (recognised.object) }
        @match predicted {
            Ok(prediction) => (motion(frame, recognised, object, prediction)?),
            Err(why) => {
                p.lead { "No motion is predicted." }
                p.warning { (why) "." }
            }
        }
        h2 { "From where it starts" }
        (in_words(recognised))
        (layout::picture(&overlaid(frame, recognised, Some(object))?, "The object as recognised")?)
        h2 { "Numbers" }
        @if let Ok(prediction) = predicted {
            div.facts { @for j in moving(prediction) { (facts(&j.state.name, &rows(j))) } }
        }
        (numbers(recognised))
        (layout::times(times, |step| step))
    };
    Ok(layout::page(&format!("Linkage: prediction of {}", recognised.object), &body))
}

/// Draws a prediction into the frame that it starts from.
pub fn save_prediction_picture(
    frame: &RgbdFrame,
    recognised: &Recognised,
    prediction: &Prediction,
    object: &StoredObject,
    path: &Path,
) -> anyhow::Result<()> {
    let picture = path_picture(frame, recognised, prediction, object)?;
    Ok(linkage_driver::image_file::write_color(path, &picture)?)
}

/// The motion in words, over time, and in the picture.
fn motion(
    frame: &RgbdFrame,
    recognised: &Recognised,
    object: &StoredObject,
    prediction: &Prediction,
) -> anyhow::Result<Markup> {
    let picture = path_picture(frame, recognised, prediction, object)?;
    let charts: Vec<Markup> = moving(prediction)
        .map(|j| {
            let caption = planned_in_words(j);
            let colour = colour_of(recognised, j);
            Ok(layout::chart(&chart::svg(&[curve(j, colour)], Ground::Page)?, &caption))
        })
        .collect::<anyhow::Result<_>>()?;
    Ok(html! {
        (in_words_of(prediction))
        (animation(frame, recognised, object, prediction)?)
        (layout::picture(&picture, "Where the parts go, darkest first")?)
        @for chart in charts { (chart) }
    })
}

/// Where each joint goes.
pub fn in_words_of(prediction: &Prediction) -> Markup {
    html! {
        @if moving(prediction).next().is_none() { p.lead { "Nothing is to move." } }
        @for j in moving(prediction) { p.lead { (joint_in_words(j)) } }
    }
}

/// The motion as an animation: the learned surface and the outlines of the parts on their way.
pub fn animation(
    frame: &RgbdFrame,
    recognised: &Recognised,
    object: &StoredObject,
    prediction: &Prediction,
) -> anyhow::Result<Markup> {
    let longest = prediction.parts.iter().map(|p| p.poses.len()).max().unwrap_or(0);
    let count = longest.min(animation::MOST_FRAMES);
    let outlines = outlines(frame, &object.appearance, &poses_at(prediction, 0.0))?;
    let mut pictures = Vec::new();
    for i in 0..count {
        let share = i as f64 / (count.max(2) - 1) as f64;
        let mut canvas = Canvas::new(frame)?;
        let poses = poses_at(prediction, share);
        surface(&mut canvas, frame, &object.appearance, &poses)?;
        for Outlined { part, outline, camera_from_part } in &outlines {
            if let Some(pose) = poses[*part] {
                let way = [Pose::identity(), pose * camera_from_part.inverse()];
                canvas.manifold(outline, &way, part_colour(*part))?;
            }
        }
        for (i, joint) in recognised.joints.iter().enumerate() {
            canvas.axis(&joint.geometry(), part_colour(i + 1))?;
        }
        canvas.shrink_to(animation::WIDTH)?;
        pictures.push(canvas.finish()?);
    }
    let caption = "The motion as predicted: dots are the learned surface, lines the outline of what is \
                   seen of it";
    animation::animation(&pictures, pictures.len().saturating_sub(1), caption)
}

/// What is seen of a part at the start of its path.
struct Outlined {
    part: usize,
    /// Its outline in the camera frame, metres.
    outline: Vec<Point3<f64>>,
    camera_from_part: Pose,
}

/// What is seen of parts at the start of their path.
fn outlines(
    frame: &RgbdFrame,
    appearance: &Appearance,
    camera_from_part: &[Option<Pose>],
) -> anyhow::Result<Vec<Outlined>> {
    let mut all = Vec::new();
    for (part, pose) in camera_from_part.iter().enumerate() {
        let Some(pose) = pose else { continue };
        if let Some(outline) = outline_of(frame, appearance, part, pose)? {
            all.push(Outlined { part, outline, camera_from_part: *pose });
        }
    }
    Ok(all)
}

/// `camera_from_part` of the parts that move, at a share of their path.
fn poses_at(prediction: &Prediction, share: f64) -> Vec<Option<Pose>> {
    let parts = prediction.parts.iter().map(|p| p.part + 1).max().unwrap_or(0);
    let mut poses = vec![None; parts];
    for part in &prediction.parts {
        let last = part.poses.len().saturating_sub(1) as f64;
        let pose = part.poses.get((share * last).round() as usize);
        poses[part.part] = pose.and_then(|[_, pose @ ..]| pose_from_array(pose));
    }
    poses
}

fn moving(prediction: &Prediction) -> impl Iterator<Item = &PlannedJoint> {
    prediction.joints.iter().filter(|j| !j.trajectory.is_empty())
}

/// "joint1, a hinge, goes from 12° to 72° in 3.4 s."
fn joint_in_words(j: &PlannedJoint) -> String {
    let (name, kind) = (&j.state.name, j.state.kind);
    let (Some(first), Some(last)) = (j.trajectory.first(), j.trajectory.last()) else {
        return format!("{name} stays as it is.");
    };
    let (from, to) = (amount(kind, first[1]), amount(kind, last[1]));
    let seconds = last[0] - first[0];
    format!("{name}, {}, goes from {from} to {to} in {seconds:.1} s.", kind_in_words(kind))
}

fn colour_of(recognised: &Recognised, j: &PlannedJoint) -> [u8; 3] {
    let number = recognised.joints.iter().position(|known| known.name == j.state.name);
    part_colour(number.map_or(1, |n| n + 1))
}

/// "joint1: configuration over time, as planned. The band is ± 1.0°, how exactly it is known where the joint is now."
fn planned_in_words(j: &PlannedJoint) -> String {
    let JointState { name, kind, deviation, .. } = &j.state;
    let band = match deviation {
        Some(d) => format!(
            "The band is ± {}, the standard deviation of where the joint is now.",
            amount(*kind, *d)
        ),
        None => "No band is drawn, for how exactly it is known where the joint is now is not told."
            .to_owned(),
    };
    format!("{name}: configuration over time, as planned. {band}")
}

fn curve(j: &PlannedJoint, colour: [u8; 3]) -> Curve {
    Curve {
        kind: j.state.kind,
        colour,
        points: j.trajectory.iter().map(|k| [k[0], k[1]]).collect(),
        deviations: vec![j.state.deviation; j.trajectory.len()],
    }
}

fn rows(j: &PlannedJoint) -> Vec<(&'static str, String)> {
    let unit = j.state.kind.unit();
    let ends = [j.trajectory.first(), j.trajectory.last()].map(|k| k.map_or(0.0, |k| k[1]));
    let fastest = |i: usize| j.trajectory.iter().map(|k| k[i].abs()).fold(0.0, f64::max);
    let way = (ends[1] - ends[0]).abs();
    vec![
        ("from", format!("{:.4} {unit}", ends[0])),
        ("to", format!("{:.4} {unit}", ends[1])),
        ("way", if unit == "m" { length(way) } else { format!("{way:.4} rad") }),
        ("time", format!("{:.2} s", j.trajectory.last().map_or(0.0, |k| k[0]))),
        ("greatest speed", format!("{:.3} {unit}/s", fastest(2))),
        ("greatest acceleration", format!("{:.3} {unit}/s²", fastest(3))),
    ]
}

/// The frame with the axes, and each part that moves along its way.
pub fn path_picture(
    frame: &RgbdFrame,
    recognised: &Recognised,
    prediction: &Prediction,
    object: &StoredObject,
) -> anyhow::Result<ColorImage> {
    let mut canvas = Canvas::new(frame)?;
    for part in &prediction.parts {
        let poses: Vec<Pose> = part
            .poses
            .iter()
            .filter_map(|p| pose_from_array(&[p[1], p[2], p[3], p[4], p[5], p[6], p[7]]))
            .collect();
        let Some(first) = poses.first() else { continue };
        let stride = poses.len().div_ceil(OUTLINES).max(1);
        let motions: Vec<Pose> =
            poses.iter().step_by(stride).map(|p| p * first.inverse()).collect();
        if let Some(surface) = MovingSurface::new(&object.appearance, part.part) {
            let way: Vec<Pose> =
                poses.iter().step_by(stride).chain(poses.last()).copied().collect();
            surface.held_as_in(&object.model).draw(&mut canvas, &way)?;
        } else if let Some(outline) = outline_of(frame, &object.appearance, part.part, first)? {
            canvas.manifold(&outline, &motions, part_colour(part.part))?;
        }
    }
    for (i, joint) in recognised.joints.iter().enumerate() {
        canvas.axis(&joint.geometry(), part_colour(i + 1))?;
    }
    canvas.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_skill::object::JointKind;

    fn slide(deviation: Option<f64>) -> PlannedJoint {
        let state = JointState {
            name: "joint1".to_owned(),
            kind: JointKind::Prismatic,
            axis: [0.0, 0.0, -1.0],
            origin: [0.0, 0.0, 1.0],
            pitch: 0.0,
            configuration: Some(0.05),
            deviation,
            reason: None,
            range: [0.0, 0.3],
        };
        let trajectory = vec![[0.0, 0.05, 0.0, 0.0], [2.5, 0.3, 0.0, 0.0]];
        PlannedJoint { state, trajectory }
    }

    #[test]
    fn a_motion_is_told_from_where_to_where_in_which_time() {
        let told = joint_in_words(&slide(None));
        assert_eq!(told, "joint1, a slide, goes from 5.0 cm to 30 cm in 2.5 s.");
    }

    #[test]
    fn the_curve_has_the_band_of_where_the_joint_is_now() {
        let known = slide(Some(0.004));
        assert_eq!(curve(&known, [0; 3]).deviations, [Some(0.004); 2]);
        assert!(
            planned_in_words(&known).contains("The band is ± 4 mm"),
            "{}",
            planned_in_words(&known)
        );
        assert!(planned_in_words(&slide(None)).contains("No band is drawn"));
    }
}
