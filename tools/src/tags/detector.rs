//! Tags in one frame: corners by the vision library, poses by depth.

use linkage_driver::RgbdFrame;
use linkage_skill::Pose;
use linkage_skill::internals::{Gray, plane_through, rigid_fit};
use nalgebra::{Point2, Point3, Vector2, Vector3};
use opencv::aruco;
use opencv::core::{Mat, Point2f, Ptr, Vector};
use opencv::prelude::*;

/// Cells of a tag of this family along a side, its black border included.
pub const CELLS: usize = 8;
/// Fewest depth readings that a tag's plane is taken from.
const MIN_READINGS: usize = 12;
/// Readings farther from the plane are let go, metres: a step of a Kinect's depth is 1 cm at 2 m.
const MAX_STRAY: f64 = 0.03;
/// Farthest corner from its place on a square, in sides of the tag.
const MAX_CORNER_OFF: f64 = 0.1;
/// Side of the square of paper that a tag's plane is taken from, in tags: most of the white rim,
/// a cell wide, tells too.
const PLANE_SIDE: f64 = 1.2;

/// A tag in a picture.
#[derive(Debug, Clone)]
pub struct TagSighting {
    /// Its number.
    pub id: u32,
    /// Its corners in pixels: top left, top right, bottom right, bottom left of the tag.
    pub corners: [Point2<f64>; 4],
}

/// Finds tags.
pub struct TagDetector {
    dictionary: Ptr<aruco::Dictionary>,
    parameters: Ptr<aruco::DetectorParameters>,
}

impl TagDetector {
    /// One for the family 36h11.
    pub fn new() -> opencv::Result<Self> {
        let mut parameters = aruco::DetectorParameters::create()?;
        // Quads and corners from lines along the black border, as the family's own detector
        // finds them: others take a narrow white rim for the tag.
        parameters.set_corner_refinement_method(aruco::CORNER_REFINE_APRILTAG);
        Ok(Self {
            dictionary: aruco::get_predefined_dictionary_i32(aruco::DICT_APRILTAG_36h11)?,
            parameters,
        })
    }

    /// All tags of a frame.
    pub fn detect(&self, frame: &RgbdFrame) -> opencv::Result<Vec<TagSighting>> {
        let grey = Gray::from_color(&frame.color)?;
        let mut corners = Vector::<Vector<Point2f>>::new();
        let mut ids = Vector::<i32>::new();
        let mut rejected = Vector::<Vector<Point2f>>::new();
        aruco::detect_markers(
            grey.mat(),
            &self.dictionary,
            &mut corners,
            &mut ids,
            &self.parameters,
            &mut rejected,
        )?;
        let mut sightings = Vec::new();
        for (id, quad) in ids.iter().zip(corners.iter()) {
            let corners: Vec<Point2<f64>> =
                quad.iter().map(|p| Point2::new(f64::from(p.x), f64::from(p.y))).collect();
            if let (Ok(id), Ok(corners)) = (u32::try_from(id), corners.try_into()) {
                sightings.push(TagSighting { id, corners });
            }
        }
        Ok(sightings)
    }
}

impl TagSighting {
    /// Pose of the tag (x to its right, y up, z out of it) from its corners' rays and the plane
    /// of its depth readings; `None` without depth there, or where corners and plane do not make a
    /// square of that size, as at a grazing angle. Four corners alone leave a mirrored solution;
    /// depth does not.
    pub fn camera_from_tag(&self, frame: &RgbdFrame, size_m: f64) -> Option<Pose> {
        let (point, normal) = plane(&self.readings(frame))?;
        let seen: Vec<Point3<f64>> = self
            .corners
            .iter()
            .map(|c| {
                let ray = frame.camera.back_project(c.x, c.y, 1.0).coords;
                let along = normal.dot(&ray);
                (along.abs() > 1e-6)
                    .then(|| Point3::from(ray * (normal.dot(&point.coords) / along)))
            })
            .collect::<Option<_>>()?;
        let h = 0.5 * size_m;
        let own = [[-h, h], [h, h], [h, -h], [-h, -h]].map(|[x, y]| Point3::new(x, y, 0.0));
        let pose = rigid_fit(&own, &seen, &[1.0; 4])?;
        let off = own.iter().zip(&seen).map(|(own, seen)| (pose * own - seen).norm());
        (off.fold(0.0, f64::max) < MAX_CORNER_OFF * size_m).then_some(pose)
    }

    /// Its corners, this many times as far from its middle, pixels.
    pub fn grown(&self, by: f64) -> [Point2<f64>; 4] {
        let centre = self.corners.iter().map(|c| c.coords).sum::<Vector2<f64>>() / 4.0;
        self.corners.map(|c| Point2::from(centre + by * (c.coords - centre)))
    }

    /// Depth readings on the tag's paper.
    fn readings(&self, frame: &RgbdFrame) -> Vec<Point3<f64>> {
        pixels_within(&self.grown(PLANE_SIDE), frame.color.width(), frame.color.height())
            .into_iter()
            .filter_map(|(u, v)| frame.point_at(u, v))
            .collect()
    }
}

/// A point and the normal of the plane through most points.
fn plane(points: &[Point3<f64>]) -> Option<(Point3<f64>, Vector3<f64>)> {
    let mut kept = points.to_vec();
    let mut found = None;
    for _ in 0..3 {
        if kept.len() < MIN_READINGS {
            return None;
        }
        let (mean, normal) = plane_through(&kept);
        kept =
            points.iter().copied().filter(|p| normal.dot(&(p - mean)).abs() < MAX_STRAY).collect();
        found = Some((mean, normal));
    }
    found
}

/// Pixels of a convex quadrilateral.
pub fn pixels_within(
    corners: &[Point2<f64>; 4],
    width: usize,
    height: usize,
) -> Vec<(usize, usize)> {
    let bound = |f: fn(f64, f64) -> f64, of: fn(&Point2<f64>) -> f64, start: f64| {
        corners.iter().map(of).fold(start, f)
    };
    let low_u = bound(f64::min, |c| c.x, f64::INFINITY).max(0.0) as usize;
    let low_v = bound(f64::min, |c| c.y, f64::INFINITY).max(0.0) as usize;
    let high_u = (bound(f64::max, |c| c.x, 0.0) as usize + 1).min(width);
    let high_v = (bound(f64::max, |c| c.y, 0.0) as usize + 1).min(height);
    let side = |k: usize, u: f64, v: f64| {
        let (a, b) = (corners[k], corners[(k + 1) % 4]);
        (b.x - a.x) * (v - a.y) - (b.y - a.y) * (u - a.x)
    };
    let mut pixels = Vec::new();
    for v in low_v..high_v {
        for u in low_u..high_u {
            let sides: [f64; 4] = std::array::from_fn(|k| side(k, u as f64, v as f64));
            if sides.iter().all(|s| *s >= 0.0) || sides.iter().all(|s| *s <= 0.0) {
                pixels.push((u, v));
            }
        }
    }
    pixels
}

/// The tag's cells, true where white, top row first, black border included: to paint it.
///
/// # Errors
/// When the family has no tag of this number.
pub fn bit_pattern(id: u32) -> opencv::Result<Vec<Vec<bool>>> {
    let dictionary = aruco::get_predefined_dictionary_i32(aruco::DICT_APRILTAG_36h11)?;
    let mut picture = Mat::default();
    let id = i32::try_from(id).unwrap_or(i32::MAX);
    aruco::draw_marker(&dictionary, id, CELLS as i32, &mut picture, 1)?;
    (0..CELLS as i32)
        .map(|v| (0..CELLS as i32).map(|u| Ok(*picture.at_2d::<u8>(v, u)? > 127)).collect())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_driver::{ColorImage, DepthImage, PinholeCamera};
    use linkage_skill::internals::rotation_about;
    use std::sync::Arc;

    /// A brown wall with a tag of 16 cm on it, on paper that is a cell wider to each side, seen
    /// through a Kinect's camera.
    fn picture_of(camera_from_tag: &Pose, id: u32) -> RgbdFrame {
        let camera = PinholeCamera::kinect();
        let cells = bit_pattern(id).unwrap();
        let (tag_from_camera, size) = (camera_from_tag.inverse(), 0.16);
        let (mut rgb, mut depth) = (Vec::new(), Vec::new());
        for v in 0..camera.height {
            for u in 0..camera.width {
                let eye = tag_from_camera * Point3::origin();
                let ray = tag_from_camera * camera.back_project(u as f64, v as f64, 1.0).coords;
                let z = -eye.z / ray.z;
                let at = eye + ray * z;
                let cell = |x: f64| ((x / size + 0.5) * CELLS as f64).floor() as i64;
                let (column, row) = (cell(at.x), cell(-at.y));
                let within = |rim: i64| {
                    let cells = -rim..CELLS as i64 + rim;
                    cells.contains(&column) && cells.contains(&row)
                };
                let black = within(0) && !cells[row as usize][column as usize];
                rgb.extend(if black {
                    [20_u8; 3]
                } else if within(1) {
                    [230; 3]
                } else {
                    [120, 80, 50]
                });
                depth.push(z as f32);
            }
        }
        let color = ColorImage::new(camera.width, camera.height, rgb).unwrap();
        let depth = DepthImage::from_metres(camera.width, camera.height, depth).unwrap();
        RgbdFrame::new(1, Arc::new(camera), color, depth).unwrap()
    }

    #[test]
    fn a_tag_seen_askew_gives_its_number_and_pose() {
        // Tag axes: x right, y up, z towards the camera.
        let facing = rotation_about(&Point3::origin(), &Vector3::x_axis(), std::f64::consts::PI);
        let askew = rotation_about(&Point3::origin(), &Vector3::y_axis(), 0.5);
        let truly = Pose::translation(0.1, -0.05, 1.2) * askew * facing;
        let frame = picture_of(&truly, 7);
        let found = TagDetector::new().unwrap().detect(&frame).unwrap();
        assert_eq!(found.iter().map(|t| t.id).collect::<Vec<_>>(), [7]);
        assert!(found[0].camera_from_tag(&frame, 0.25).is_none(), "a tag of another size");
        let pose = found[0].camera_from_tag(&frame, 0.16).unwrap();
        assert!((pose.translation.vector - truly.translation.vector).norm() < 0.003);
        assert!(pose.rotation.angle_to(&truly.rotation).to_degrees() < 1.0);
        let masked = super::super::mask::masked(&frame, &found).unwrap();
        assert!(TagDetector::new().unwrap().detect(&masked).unwrap().is_empty());
    }
}
