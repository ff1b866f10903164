//! Lifts a feature from its place in the image to its place in space.
//!
//! In: an RGB-D frame, and a place in it, pixels.
//! Out: the place in the camera frame, metres, and the surface normal.
//! From: paper, section III-A (bilateral filter); the robust mean is ours.

use super::track::Observation;
use linkage_frames::depth::{BilateralConfig, SurfacePatch, smooth};
use linkage_frames::{DepthImage, RgbdFrame};
use nalgebra::Point2;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// How depth is read at a feature.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthLift {
    /// Depth of the bilaterally filtered depth image. Paper, III-A.
    Bilateral(BilateralConfig),
    /// Mean inverse depth of those of the 5 x 5 readings that are near their median; none at depth
    /// edges. Ours: its noise along the ray is 0.9 mm at 0.75 m, 2.0 mm at 1.4 m, 4.1 mm at 2.3 m.
    RobustMean,
}

/// Half width of the window of [`DepthLift::RobustMean`], pixels.
const HALF: usize = 2;

/// Reads places and normals of features from one frame.
pub struct Lifter<'f> {
    frame: &'f RgbdFrame,
    depth: Cow<'f, DepthImage>,
    robust_mean: bool,
}

impl<'f> Lifter<'f> {
    /// Prepares the depth image of a frame.
    pub fn new(frame: &'f RgbdFrame, lift: &DepthLift) -> Self {
        let depth = match lift {
            DepthLift::Bilateral(config) => Cow::Owned(smooth(&frame.depth, config)),
            DepthLift::RobustMean => Cow::Borrowed(&frame.depth),
        };
        Self { frame, depth, robust_mean: matches!(lift, DepthLift::RobustMean) }
    }

    /// The place and the surface normal of a feature.
    pub fn observe(&self, pixel: Point2<f32>) -> Observation {
        let (u, v) = (f64::from(pixel.x), f64::from(pixel.y));
        let z = if self.robust_mean { self.robust_mean(u, v) } else { self.filtered(u, v) };
        let RgbdFrame { depth, camera, .. } = self.frame;
        let normal = if u >= 0.0 && v >= 0.0 {
            SurfacePatch::at(depth, camera, u.round() as usize, v.round() as usize)
        } else {
            None
        };
        Observation {
            pixel,
            point_in_camera: z.map(|z| camera.back_project(u, v, z)),
            normal_in_camera: normal.map(|n| n.normal),
        }
    }

    fn filtered(&self, u: f64, v: f64) -> Option<f64> {
        self.depth.at_nearest(u, v).map(f64::from)
    }

    fn robust_mean(&self, u: f64, v: f64) -> Option<f64> {
        let (u, v) = (u.round() as usize, v.round() as usize);
        let (columns, rows) = (self.depth.width(), self.depth.height());
        if u <= HALF || v <= HALF || u + HALF + 1 >= columns || v + HALF + 1 >= rows {
            return None;
        }
        let mut readings = [0.0_f64; (2 * HALF + 1) * (2 * HALF + 1)];
        let mut count = 0;
        for y in v - HALF..=v + HALF {
            for x in u - HALF..=u + HALF {
                if let Some(z) = self.depth.at(x, y) {
                    readings[count] = f64::from(z);
                    count += 1;
                }
            }
        }
        if 2 * count < readings.len() {
            return None;
        }
        let readings = &mut readings[..count];
        let middle = *readings.select_nth_unstable_by(count / 2, f64::total_cmp).1;
        let slope_allowance = 0.004 * HALF as f64 * middle;
        let reach = 4.0 * self.frame.camera.depth_sensor.reading_sigma(middle) + slope_allowance;
        let (mut inverse, mut agreeing) = (0.0, 0);
        for z in readings.iter().filter(|z| (**z - middle).abs() < reach) {
            inverse += 1.0 / z;
            agreeing += 1;
        }
        (5 * agreeing >= 4 * count as i32).then(|| f64::from(agreeing) / inverse)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::{board, seen};

    #[test]
    fn a_feature_on_a_surface_is_lifted_to_where_it_is() {
        let frame = seen(0, |_, _| 1.5);
        let observed =
            Lifter::new(&frame, &DepthLift::RobustMean).observe(Point2::new(220.0, 90.0));
        let point = observed.point_in_camera.unwrap();
        let expected = frame.camera.back_project(220.0, 90.0, 1.5);
        assert!((point - expected).norm() < 1e-5, "{point}");
        assert!(observed.normal_in_camera.unwrap().z < -0.99, "towards the camera");
    }

    #[test]
    fn at_an_edge_of_depth_there_is_no_place() {
        // The board's right edge is 0.2 m from the line of sight: 260 * 0.2 / 1.0 pixels.
        let frame = seen(0, board(0.2, 1.0, 2.0));
        let at = |u: f32| {
            let lifter = Lifter::new(&frame, &DepthLift::RobustMean);
            lifter.observe(Point2::new(u, 120.0)).point_in_camera
        };
        assert!(at(160.0 + 52.0).is_none());
        assert!((at(160.0 + 40.0).unwrap().z - 1.0).abs() < 1e-5);
        assert!((at(160.0 + 64.0).unwrap().z - 2.0).abs() < 1e-5);
    }

    #[test]
    fn where_most_readings_are_missing_there_is_no_place() {
        let frame = seen(0, |x, _| if x.abs() < 0.006 { 1.0 } else { f64::NAN });
        let lifter = Lifter::new(&frame, &DepthLift::RobustMean);
        assert!(lifter.observe(Point2::new(163.0, 120.0)).point_in_camera.is_none());
        assert!(lifter.observe(Point2::new(0.0, 0.0)).point_in_camera.is_none(), "the border");
    }
}
