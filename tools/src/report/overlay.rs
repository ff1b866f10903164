//! What was learned of parts, drawn where the parts are in a frame: their surface points, and the
//! outline of what is seen of them.

use super::draw::{Canvas, part_colour};
use linkage_driver::RgbdFrame;
use linkage_skill::Pose;
use linkage_skill::object::Appearance;
use linkage_skill::predict::moved_surface;
use nalgebra::{Point2, Point3, Vector3};

/// Farther than this behind what depth shows a surface point is hidden, metres.
const HIDDEN_M: f64 = 0.04;
/// Farther than this from its middle an outline's depth is that of something else, metres.
const OTHER_M: f64 = 0.4;

/// Draws the surface points that face the camera and that nothing hides. `camera_from_part`: by part;
/// a part without a pose is left out.
pub fn surface(
    canvas: &mut Canvas,
    frame: &RgbdFrame,
    appearance: &Appearance,
    camera_from_part: &[Option<Pose>],
) -> anyhow::Result<()> {
    for surfel in &appearance.surfels {
        let part = usize::from(surfel.part);
        let Some(pose) = camera_from_part.get(part).copied().flatten() else { continue };
        let place = pose * point(surfel.point);
        let normal = pose * Vector3::from(surfel.normal).map(f64::from);
        if normal.dot(&place.coords) > 0.0 {
            continue;
        }
        let Some(pixel) = frame.camera.project(&place) else { continue };
        let seen = frame.depth.at_nearest(pixel.x, pixel.y).map(f64::from);
        if seen.is_none_or(|z| place.z - z < HIDDEN_M) {
            canvas.dot(pixel, 2, part_colour(part))?;
        }
    }
    Ok(())
}

/// Outline of what is seen of a part, places in the camera frame.
pub fn outline_of(
    frame: &RgbdFrame,
    appearance: &Appearance,
    part: usize,
    camera_from_part: &Pose,
) -> anyhow::Result<Option<Vec<Point3<f64>>>> {
    let features: Vec<Point2<f64>> = appearance
        .surfels
        .iter()
        .filter(|s| usize::from(s.part) == part)
        .filter_map(|s| {
            let place = camera_from_part * point(s.point);
            let pixel = frame.camera.project(&place)?;
            let z = f64::from(frame.depth.at_nearest(pixel.x, pixel.y)?);
            ((z - place.z).abs() < HIDDEN_M).then_some(pixel)
        })
        .collect();
    lifted_outline(frame, &features)
}

/// Outline of the surface that carries features at these pixels, places in the camera frame.
pub fn lifted_outline(
    frame: &RgbdFrame,
    features: &[Point2<f64>],
) -> anyhow::Result<Option<Vec<Point3<f64>>>> {
    let Some(outline) = moved_surface(frame, features)? else { return Ok(None) };
    let depth_at = |p: &Point2<f64>| frame.depth.at_nearest(p.x, p.y).map(f64::from);
    let mut depths: Vec<f64> = features.iter().filter_map(depth_at).collect();
    depths.sort_by(f64::total_cmp);
    let middle = depths.get(depths.len() / 2).copied().unwrap_or(1.0);
    let lifted = outline.iter().map(|p| {
        // An outline runs along edges, where depth belongs to either side.
        let z = depth_at(p).filter(|z| (z - middle).abs() < OTHER_M).unwrap_or(middle);
        frame.camera.back_project(p.x, p.y, z)
    });
    Ok(Some(lifted.collect()))
}

fn point(place: [f32; 3]) -> Point3<f64> {
    Point3::from(Vector3::from(place).map(f64::from))
}
