//! The page about a demonstration: what was learned in words, what was refused, the motion in
//! pictures, and the numbers at its end.

use super::band::{self, Band};
use super::chart::{self, Curve, Ground};
use super::depth_spread::Surface;
use super::draw::{Canvas, part_colour};
use super::film_strip::film_strip;
use super::hidden_hinge::hidden_hinge;
use super::layout::{self, facts, keys, part_style, vector};
use super::motion_warnings::motion_warnings;
use super::part_tracks::tracks_of;
use super::range_picture::range_picture;
use super::tree::tree;
use super::units::{angle, length, probability};
use super::words::{self, Seen};
use super::{animation, spread};
use linkage_driver::{ColorImage, RgbdFrame, image_file};
use linkage_planner_bridge::joint_deviation::{axis_deviation_rad, hinge_deviation_m};
use linkage_skill::Demonstration;
use linkage_skill::object::{Appearance, Joint, ObjectModel};
use maud::{Markup, html};
use nalgebra::{Point2, Point3, Vector3};
use std::path::{Path, PathBuf};

/// Frames of the film strip, and how wide they are in pixels.
const STRIP_FRAMES: usize = 6;
const STRIP_WIDTH: i32 = 320;
/// Refused candidates that are listed.
const MOST_REFUSED: usize = 40;

/// A page about a demonstration. `appearance`: what was learned from this demonstration alone.
pub fn demonstration_page(
    demonstration: &Demonstration,
    appearance: Option<&Appearance>,
) -> anyhow::Result<String> {
    let model = &demonstration.model;
    let body = html! {
        h1 { (model.object) }
        (in_words(demonstration, appearance))
        (refused(demonstration))
        @if !model.joints.is_empty() {
            h2 { "How it moves" }
            (animation(demonstration, appearance)?)
            (motion(demonstration, appearance)?)
            (strip(demonstration, appearance)?)
            h2 { "How its parts hang together" }
            (tree(model))
        }
        (pictures(demonstration, appearance)?)
        @if !model.joints.is_empty() {
            h2 { "Numbers" }
            (numbers(model))
        }
        (layout::times(&demonstration.times, stage_in_words))
    };
    Ok(layout::page(&format!("Linkage: {}", model.object), &body))
}

/// Writes a demonstration's pictures into a folder; their paths.
pub fn save_demonstration_pictures(
    demonstration: &Demonstration,
    appearance: Option<&Appearance>,
    dir: &Path,
) -> anyhow::Result<Vec<PathBuf>> {
    let mut written = Vec::new();
    if let Some((index, frame)) = middle_keyframe(demonstration) {
        for (name, picture) in [
            ("tracks.png", tracks_picture(demonstration, index, frame)?),
            ("joints.png", range_picture(demonstration, appearance, index, frame)?),
        ] {
            let path = dir.join(name);
            image_file::write_color(&path, &picture)?;
            written.push(path);
        }
    }
    let path = dir.join("configuration.svg");
    std::fs::write(&path, chart::svg(&curves(demonstration, appearance), Ground::White)?)?;
    written.push(path);
    Ok(written)
}

/// The sentences of each joint, with what its evidence is.
pub fn in_words(demonstration: &Demonstration, appearance: Option<&Appearance>) -> Markup {
    let model = &demonstration.model;
    html! {
        @if model.joints.is_empty() {
            p.lead { "Nothing articulated moves." }
            p { "No motion was seen that a hinge, a slide or a screw explains." }
        }
        @for joint in &model.joints {
            @let seen = seen(demonstration, joint);
            section.joint style=(part_style(joint.child)) {
                p.lead { (words::sentence(joint, &seen)) }
                p { (words::certainty(joint)) }
                @let unseen = motion_warnings(joint, &times_that_may_show(demonstration, joint));
                @let hidden = hidden_hinge(demonstration, appearance, joint);
                @for warning in words::warnings(joint, &seen).into_iter().chain(unseen).chain(hidden) {
                    p.warning { (warning) }
                }
                p.note { (joint.name) ": " (evidence(demonstration, joint)) }
            }
        }
        @if !model.joints.is_empty() {
            p.note {
                "Left, right, up and down are as the camera saw them at the beginning. "
                "± is one standard deviation."
            }
        }
    }
}

fn seen<'d>(demonstration: &'d Demonstration, joint: &Joint) -> Seen<'d> {
    Seen {
        middle: middle_of(demonstration, joint.child),
        carrier: (joint.parent != 0)
            .then(|| demonstration.model.parts.get(joint.parent).map(|p| p.name.as_str()))
            .flatten(),
        frames: times_that_may_show(demonstration, joint).len(),
    }
}

/// Times of the frames in which a joint's configuration could be known, seconds: planes are sought in keyframes alone.
fn times_that_may_show(demonstration: &Demonstration, joint: &Joint) -> Vec<f64> {
    let seconds = |utime: &i64| *utime as f64 * 1e-6;
    match tracks_of(demonstration, joint.child).next() {
        Some(_) => demonstration.frame_utimes.iter().map(seconds).collect(),
        None => demonstration.keyframes.iter().map(|(_, frame)| seconds(&frame.utime)).collect(),
    }
}

/// What a joint was learned from.
fn evidence(demonstration: &Demonstration, joint: &Joint) -> String {
    let tracked = tracks_of(demonstration, joint.child).count();
    let planes = demonstration.plain_surface.get(joint.child).is_some_and(|s| !s.is_empty());
    let from = match (tracked, planes) {
        (0, true) => "its surface in the depth pictures".to_owned(),
        (0, false) => "no tracked features of its own".to_owned(),
        (n, true) => format!("{n} tracked features and its surface in the depth pictures"),
        (n, false) => format!("{n} tracked features"),
    };
    let (frames, all) = (joint.observations, times_that_may_show(demonstration, joint).len());
    let kept = if tracked == 0 { " that were kept whole" } else { "" };
    format!("learned from {from}; its configuration is known in {frames} of {all} frames{kept}.")
}

/// What was refused, and why; those that were followed most first.
fn refused(demonstration: &Demonstration) -> Markup {
    let mut all: Vec<_> = demonstration.rejections.iter().collect();
    all.sort_by_key(|r| std::cmp::Reverse(r.tracks.saturating_mul(r.frames)));
    html! {
        @if !all.is_empty() {
            details.refused {
                summary { "What else moved and was refused: " (all.len()) }
                ul {
                    @for r in all.iter().take(MOST_REFUSED) {
                        li {
                            "As " (words::kind_in_words(r.kind)) " (" (r.tracks) " tracks, "
                            (r.frames) " frames): " (r.reason) "."
                        }
                    }
                }
                @if all.len() > MOST_REFUSED {
                    p.note { (all.len() - MOST_REFUSED) " more are not listed." }
                }
            }
        } @else if demonstration.model.joints.is_empty() {
            p { "Nothing was refused: what moved was not followed long enough to be a candidate." }
        }
    }
}

/// Configurations over time.
fn motion(
    demonstration: &Demonstration,
    appearance: Option<&Appearance>,
) -> anyhow::Result<Markup> {
    let joints = &demonstration.model.joints;
    let charts = curves(demonstration, appearance).into_iter().zip(joints).map(|(curve, joint)| {
        let band = band::in_words(Band {
            kind: joint.kind,
            deviations: &curve.deviations,
            has_tracks: tracks_of(demonstration, joint.child).next().is_some(),
        });
        let caption = format!("{}: configuration over time. {band}", joint.name);
        Ok(layout::chart(&chart::svg(&[curve], Ground::Page)?, &caption))
    });
    let charts: Vec<Markup> = charts.collect::<anyhow::Result<_>>()?;
    Ok(html! { @for chart in charts { (chart) } })
}

/// Each joint's configuration over time, with how well the features agree on it.
fn curves(demonstration: &Demonstration, appearance: Option<&Appearance>) -> Vec<Curve> {
    let of_joint = |joint: &Joint| {
        let by_frame = deviations_by_frame(demonstration, appearance, joint);
        let at = |t: f64| {
            let utime = (t * 1e6).round() as i64;
            let after = demonstration.frame_utimes.partition_point(|u| *u < utime - 1);
            by_frame.get(after).copied().flatten()
        };
        Curve {
            kind: joint.kind,
            colour: part_colour(joint.child),
            deviations: joint.configuration.iter().map(|c| at(c[0])).collect(),
            points: joint.configuration.clone(),
        }
    };
    demonstration.model.joints.iter().map(of_joint).collect()
}

/// Standard deviation of a joint's configuration in each frame, where it is known: as tracked features
/// tell it, or depth where there are none.
pub fn deviations_by_frame(
    demonstration: &Demonstration,
    appearance: Option<&Appearance>,
    joint: &Joint,
) -> Vec<Option<f64>> {
    let (part, line) = (joint.child, joint.geometry());
    let poses = &demonstration.camera_from_part[part];
    match tracks_of(demonstration, part).next() {
        Some(_) => spread::deviations(tracks_of(demonstration, part), poses, &line),
        None => {
            let places = demonstration.plain_surface.get(part).map_or(&[][..], Vec::as_slice);
            Surface::of(appearance, part, places).deviations(
                demonstration.keyframes.iter(),
                poses,
                &line,
            )
        }
    }
}

/// The motion as an animation.
pub fn animation(
    demonstration: &Demonstration,
    appearance: Option<&Appearance>,
) -> anyhow::Result<Markup> {
    let frames = film_strip(demonstration, appearance, animation::MOST_FRAMES, animation::WIDTH)?;
    let opened = |i: &usize| frames[*i].opened;
    let still = (0..frames.len()).max_by(|a, b| opened(a).total_cmp(&opened(b))).unwrap_or(0);
    let pictures: Vec<ColorImage> = frames.into_iter().map(|f| f.picture).collect();
    animation::animation(
        &pictures,
        still,
        "The motion as it was seen, with what was learned from it",
    )
}

fn strip(demonstration: &Demonstration, appearance: Option<&Appearance>) -> anyhow::Result<Markup> {
    let frames = film_strip(demonstration, appearance, STRIP_FRAMES, STRIP_WIDTH)?;
    let frames: Vec<Markup> = frames
        .iter()
        .map(|frame| layout::picture(&frame.picture, &frame.caption))
        .collect::<anyhow::Result<_>>()?;
    Ok(html! {
        h3 { "The motion as it was seen" }
        div.strip { @for frame in frames { (frame) } }
        p.note { "Lines are axes; dots are places of the surface as they were learned." }
        (part_keys(&demonstration.model))
    })
}

/// Pictures of one frame: what was tracked, and where the parts may go.
fn pictures(
    demonstration: &Demonstration,
    appearance: Option<&Appearance>,
) -> anyhow::Result<Markup> {
    let Some((index, frame)) = middle_keyframe(demonstration) else { return Ok(html! {}) };
    let tracks = tracks_picture(demonstration, index, frame)?;
    let joints = range_picture(demonstration, appearance, index, frame)?;
    Ok(html! {
        h2 { "In one picture" }
        (part_keys(&demonstration.model))
        @if !demonstration.model.joints.is_empty() {
            (layout::picture(&joints, range_caption(&demonstration.model))?)
        }
        (layout::picture(&tracks, "Tracked features by part; grey: of no part")?)
    })
}

/// What the picture of the ranges shows.
fn range_caption(model: &ObjectModel) -> &'static str {
    match model.parts.iter().any(|part| part.grasp.is_some()) {
        true => "Axes, the parts over their ranges, and the way of the place that one was held at",
        false => "Axes, and the parts over their ranges",
    }
}

fn part_keys(model: &ObjectModel) -> Markup {
    keys(model.parts.iter().map(|p| (p.id, p.name.as_str())))
}

/// A table a joint: the model as numbers.
fn numbers(model: &ObjectModel) -> Markup {
    let part = |id: usize| model.parts.get(id).map_or("?", |p| p.name.as_str()).to_owned();
    html! {
        div.facts {
            @for j in &model.joints {
                (facts(&j.name, &rows(j, &part)))
            }
        }
        p.note {
            "Axis and origin are in the camera frame of the first frame: x right, y down, z forward."
        }
    }
}

fn rows(j: &Joint, part: &dyn Fn(usize) -> String) -> Vec<(&'static str, String)> {
    let unit = j.kind.unit();
    let unknown = || "not known".to_owned();
    let mut rows = vec![
        ("type", j.kind.name().to_owned()),
        ("moves", format!("{} on {}", part(j.child), part(j.parent))),
        ("range", format!("{:.3} to {:.3} {unit}", j.range[0], j.range[1])),
        ("axis", vector(j.axis)),
        ("origin / m", vector(j.origin)),
        ("deviation of the direction", axis_deviation_rad(j).map_or_else(unknown, angle)),
    ];
    if unit == "rad" {
        let deviation = hinge_deviation_m(j).map_or_else(unknown, length);
        rows.push(("deviation of the hinge", deviation));
    }
    if j.pitch != 0.0 {
        rows.push(("pitch", format!("{:.4} m a turn", j.pitch)));
    }
    for (kind, p) in &j.type_probabilities {
        rows.push((kind.name(), probability(*p)));
    }
    rows.push(("distance to the model, rms", format!("{:.1} mm", 1000.0 * j.position_rmse)));
    if j.orientation_rmse > 0.0 {
        rows.push(("angle to the model, rms", format!("{:.2}°", j.orientation_rmse.to_degrees())));
    }
    rows.push(("frames with a configuration", j.observations.to_string()));
    rows
}

/// What a stage of learning does.
fn stage_in_words(stage: &'static str) -> &'static str {
    match stage {
        "ahead" => "handing frames to the search in the background",
        "articulate" | "katz" => "joints, from poses of parts",
        "base" => "tracks in the frame of the base",
        "camera" => "motion of the camera",
        "edge on" => "how far hinged parts turned that were seen from their edge",
        "grasp" => "where the hand held the part",
        "joints" => "joints, from tracks",
        "planes" => "joints, from planes in depth",
        "pose" => "motion of each group of tracks",
        "segment" => "which tracks move together",
        "track" => "tracking features",
        "vacated" => "joints, from what left its place",
        other => other,
    }
}

/// Middle of a part's known places at configuration 0, in the object frame.
fn middle_of(demonstration: &Demonstration, part: usize) -> Option<Point3<f64>> {
    let poses = demonstration.camera_from_part.get(part)?;
    let tracked = tracks_of(demonstration, part).filter_map(|track| {
        track.lifted().find_map(|(f, p)| Some(poses.get(f)?.as_ref()?.inverse_transform_point(&p)))
    });
    let plain = demonstration.plain_surface.get(part)?.iter().copied();
    let (count, sum) = tracked
        .chain(plain)
        .fold((0_usize, Vector3::zeros()), |(n, sum), p: Point3<f64>| (n + 1, sum + p.coords));
    (count > 0).then(|| Point3::from(sum / count as f64))
}

/// The keyframe in which the parts have moved most, nearly half way through.
fn middle_keyframe(demonstration: &Demonstration) -> Option<(usize, &RgbdFrame)> {
    let moved = |index: usize| {
        demonstration.camera_from_part.iter().skip(1).filter_map(|t| t[index].as_ref()).count()
    };
    let frames: Vec<(usize, &RgbdFrame)> = demonstration.keyframes.iter().collect();
    let middle = frames.len() / 2;
    frames
        .iter()
        .enumerate()
        .max_by_key(|(i, (index, _))| (moved(*index), std::cmp::Reverse(i.abs_diff(middle))))
        .map(|(_, f)| *f)
}

fn tracks_picture(
    demonstration: &Demonstration,
    index: usize,
    frame: &RgbdFrame,
) -> anyhow::Result<ColorImage> {
    let mut canvas = Canvas::new(frame)?;
    for (track, part) in demonstration.tracks.tracks.iter().zip(&demonstration.track_parts) {
        let Some(seen) = track.at(index) else { continue };
        let at = Point2::new(f64::from(seen.pixel.x), f64::from(seen.pixel.y));
        match part {
            Some(p) => canvas.dot(at, if *p == 0 { 1 } else { 3 }, part_colour(*p))?,
            None => canvas.dot(at, 2, [160, 160, 160])?,
        }
    }
    canvas.finish()
}
