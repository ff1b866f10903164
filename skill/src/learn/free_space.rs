//! The free-space test. A model claims that a part has a surface at some points; a depth image
//! contradicts it where it shows something behind such a point. An arm moves with the part that it
//! holds, but is there only part of the time: other images see through the places where the model
//! would have it.
//!
//! In: a depth image, points of a part, and the pose of the part in the camera; metres.
//! Out: the number of points that the image sees through, and of those that it finds in place.

use crate::math::rigid::{Pose, matrix_pose};
use linkage_frames::RgbdFrame;
use linkage_frames::depth::DepthSensor;
use nalgebra::Point3;

/// What a depth image shows at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Probe {
    /// All readings around the point are behind it: it is in free space.
    Through,
    /// A reading around the point is at its depth, or some are in front of it and some behind it.
    Agrees,
    /// The point is hidden, outside the image, or without a reading.
    Unknown,
}

/// Number of points of a part that depth images see through, and of those that they find in place.
#[derive(Debug, Clone, Copy, Default)]
pub struct FreeSpaceCounts {
    /// Points behind which something is seen.
    pub through: usize,
    /// Points at which a surface is seen.
    pub agrees: usize,
}

impl FreeSpaceCounts {
    /// Adds the counts of another image.
    pub fn add(&mut self, other: Self) {
        self.through += other.through;
        self.agrees += other.agrees;
    }

    /// Number of points that are either seen through or found in place.
    pub fn count(self) -> usize {
        self.through + self.agrees
    }

    /// Number of points found in place less the number seen through.
    pub fn margin(self) -> i64 {
        self.agrees as i64 - self.through as i64
    }

    /// Share of the counted points that are seen through, 0 to 1.
    pub fn share_through(self) -> f64 {
        self.through as f64 / self.count().max(1) as f64
    }

    /// True if one point in many images is seen through fewer than three times, or in less than a
    /// third of the images that count.
    pub fn mostly_agrees(self) -> bool {
        self.through < 3 || 3 * self.through < self.count()
    }
}

/// Counts the points of a part that a depth image sees through, and those that it finds in place.
pub fn count_free_space(
    picture: &RgbdFrame,
    points: &[Point3<f64>],
    camera_from_part: &Pose,
) -> FreeSpaceCounts {
    let camera_from_part = matrix_pose(camera_from_part);
    let mut found = FreeSpaceCounts::default();
    for p in points {
        match probe_point(picture, &(camera_from_part * p)) {
            Probe::Through => found.through += 1,
            Probe::Agrees => found.agrees += 1,
            Probe::Unknown => {}
        }
    }
    found
}

/// At most `most` of the points, evenly spread over the list.
pub fn thinned(points: &[Point3<f64>], most: usize) -> Vec<Point3<f64>> {
    points.iter().copied().step_by(points.len().div_ceil(most).max(1)).collect()
}

/// Columns and rows from the pixel of a point to the readings that are compared with it.
const AROUND: [(isize, isize); 9] =
    [(0, 0), (-2, -2), (0, -2), (2, -2), (-2, 0), (2, 0), (-2, 2), (0, 2), (2, 2)];
/// Width of the image border in which points are not tested, pixels.
const BORDER_PX: f64 = 3.0;

/// Compares a point in the camera frame with the depth readings around its pixel.
pub fn probe_point(picture: &RgbdFrame, in_camera: &Point3<f64>) -> Probe {
    let Some(pixel) = picture.camera.project(in_camera) else { return Probe::Unknown };
    if !picture.camera.sees(&pixel, BORDER_PX) {
        return Probe::Unknown;
    }
    let width = picture.depth.width() as isize;
    let middle = (pixel.y + 0.5) as isize * width + (pixel.x + 0.5) as isize;
    let readings = picture.depth.as_metres();
    let margin = depth_margin(picture.camera.depth_sensor, in_camera.z);
    let (near, far) = (in_camera.z - margin, in_camera.z + margin);
    let (mut reaches, mut ends) = (false, false);
    // The first reading, at the pixel itself, most often decides. A missing reading is NaN, for
    // which no comparison holds.
    for (x, y) in AROUND {
        let z = readings.get((middle + y * width + x) as usize).map_or(f64::NAN, |z| f64::from(*z));
        reaches |= z >= near;
        ends |= z <= far;
        if reaches && ends {
            return Probe::Agrees;
        }
    }
    if reaches { Probe::Through } else { Probe::Unknown }
}

/// Largest difference between two depths of one surface at depth `z`, metres.
pub fn depth_margin(sensor: DepthSensor, z: f64) -> f64 {
    0.02 + 1.5 * sensor.feature_sigma(z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::{board, seen};

    #[test]
    fn a_picture_sees_through_a_point_before_a_board_and_not_behind_it() {
        let picture = seen(0, board(0.2, 1.5, 2.5));
        let count =
            |z: f64| count_free_space(&picture, &[Point3::new(0.0, 0.0, z)], &Pose::identity());
        assert_eq!((count(1.2).through, count(1.2).agrees), (1, 0));
        assert_eq!((count(1.5).through, count(1.5).agrees), (0, 1));
        assert_eq!(count(2.0).count(), 0, "the board hides it");
    }

    #[test]
    fn one_reading_around_a_point_that_is_of_it_agrees_and_a_hole_says_nothing() {
        let at = |picture: &RgbdFrame, x: f64| probe_point(picture, &Point3::new(x, 0.0, 1.5));
        let edge = seen(0, |x, _| if x < 0.0 { 1.5 } else { 2.5 });
        assert_eq!(at(&edge, -0.002), Probe::Agrees);
        assert_eq!(at(&edge, 0.05), Probe::Through);
        assert_eq!(at(&seen(0, |_, _| f64::NAN), 0.0), Probe::Unknown);
        assert_eq!(at(&edge, 9.0), Probe::Unknown, "outside the picture");
    }

    #[test]
    fn a_point_that_is_seldom_seen_through_mostly_agrees() {
        assert!(FreeSpaceCounts { through: 2, agrees: 0 }.mostly_agrees());
        assert!(FreeSpaceCounts { through: 3, agrees: 7 }.mostly_agrees());
        assert!(!FreeSpaceCounts { through: 5, agrees: 5 }.mostly_agrees());
    }
}
