//! Where the parts of a demonstration may go, in one of its frames: each part's surface over the range of
//! its joint, or the outline of its features where little of its surface was learned.

use super::draw::{Canvas, part_colour};
use super::film_strip::{axes, configuration_at};
use super::moving_surface::MovingSurface;
use super::overlay::lifted_outline;
use super::part_tracks::tracks_of;
use linkage_driver::{ColorImage, RgbdFrame};
use linkage_skill::object::{Appearance, Joint};
use linkage_skill::{Demonstration, Pose};
use nalgebra::Point2;

/// Configurations of a joint at which its part is drawn.
const STEPS: usize = 9;

/// The frame with the axes, and each part along its way. `index`: the frame's number.
pub fn range_picture(
    demonstration: &Demonstration,
    appearance: Option<&Appearance>,
    index: usize,
    frame: &RgbdFrame,
) -> anyhow::Result<ColorImage> {
    let mut canvas = Canvas::new(frame)?;
    let model = &demonstration.model;
    let poses: Vec<Option<Pose>> =
        demonstration.camera_from_part.iter().map(|t| t.get(index).copied()?).collect();
    for joint in &model.joints {
        let Some(camera_from_parent) = poses[joint.parent] else { continue };
        let surface = appearance.and_then(|a| MovingSurface::new(a, joint.child));
        let way = configurations(joint);
        if let Some(surface) = surface {
            let line = joint.geometry();
            let way: Vec<Pose> = way.iter().map(|q| camera_from_parent * line.motion(*q)).collect();
            surface.held_as_in(model).draw(&mut canvas, &way)?;
        } else if let Some(present) = configuration_at(joint, frame.utime) {
            let features = pixels_of(demonstration, joint.child, index, frame);
            let Some(outline) = lifted_outline(frame, &features)? else { continue };
            let line = joint.geometry().transformed(&camera_from_parent);
            let motions: Vec<Pose> = way.iter().map(|q| line.motion(q - present)).collect();
            canvas.manifold(&outline, &motions, part_colour(joint.child))?;
        }
    }
    axes(&mut canvas, model, &poses)?;
    canvas.finish()
}

/// From one end of the range to the other, that one last which is farther from where it began.
fn configurations(joint: &Joint) -> Vec<f64> {
    let [mut first, mut last] = joint.range;
    if first.abs() > last.abs() {
        std::mem::swap(&mut first, &mut last);
    }
    let step = (last - first) / (STEPS - 1) as f64;
    (0..STEPS).map(|i| first + step * i as f64).collect()
}

/// Pixels at which a part is seen in a keyframe: of its tracks, and of a plain part's places.
fn pixels_of(
    demonstration: &Demonstration,
    part: usize,
    index: usize,
    frame: &RgbdFrame,
) -> Vec<Point2<f64>> {
    let tracked = tracks_of(demonstration, part)
        .filter_map(|t| t.at(index))
        .map(|o| Point2::new(f64::from(o.pixel.x), f64::from(o.pixel.y)));
    let pose = demonstration.camera_from_part.get(part).and_then(|t| t.get(index).copied()?);
    let plain = demonstration.plain_surface.get(part).map_or(&[][..], Vec::as_slice).iter();
    let plain = plain.filter_map(|place| frame.camera.project(&(pose? * place)));
    tracked.chain(plain.filter(|pixel| frame.camera.sees(pixel, 1.0))).collect()
}
