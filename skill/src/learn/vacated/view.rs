//! Shows what a keyframe, with the camera's pose, has at a place of the base frame.

use crate::learn::free_space::{Probe, depth_margin, probe_point};
use crate::learn::recording::Recording;
use crate::math::rigid::matrix_pose;
use linkage_frames::RgbdFrame;
use linkage_frames::depth::SurfacePatch;
use nalgebra::{IsometryMatrix3, Point2, Point3, Vector3};
use std::sync::atomic::{AtomicU8, Ordering};

/// Width of the image border that is not used, pixels.
const BORDER_PX: f64 = 3.0;

/// A keyframe with the camera's pose.
pub struct View<'r> {
    /// Frame number.
    pub frame: usize,
    /// Colour and depth image.
    pub picture: &'r RgbdFrame,
    /// Pose of the base in the camera frame.
    pub camera_from_base: IsometryMatrix3<f64>,
    base_from_camera: IsometryMatrix3<f64>,
    /// For each pixel, whether other keyframes see through its reading, if that was tested.
    is_seen_through: Vec<AtomicU8>,
}

/// Value of a pixel that was not tested.
const NOT_ASKED: u8 = 0;
/// Value of a pixel through whose reading other keyframes do not see.
const NO: u8 = 1;
/// Value of a pixel through whose reading other keyframes see.
const YES: u8 = 2;

impl<'r> View<'r> {
    /// All keyframes of a recording, in time order.
    pub fn all(recording: &'r Recording) -> Vec<Self> {
        let of = |(frame, picture): (usize, &'r RgbdFrame)| {
            let camera_from_base = matrix_pose(&recording.ego_motion.camera_from_base[frame]);
            let base_from_camera = camera_from_base.inverse();
            let pixels = picture.depth.width() * picture.depth.height();
            let is_seen_through = (0..pixels).map(|_| AtomicU8::new(NOT_ASKED)).collect();
            Self { frame, picture, camera_from_base, base_from_camera, is_seen_through }
        };
        recording.keyframes.iter().map(of).collect()
    }

    /// The surface point at a pixel, base frame.
    pub fn surface_at(&self, u: usize, v: usize) -> Option<Point3<f64>> {
        let z = self.picture.depth.at(u, v)?;
        let camera = &self.picture.camera;
        Some(self.base_from_camera * camera.back_project(u as f64, v as f64, f64::from(z)))
    }

    /// The surface point at a pixel with its normal, from the readings around it; base frame.
    pub fn patch_at(&self, u: usize, v: usize) -> Option<(Point3<f64>, Vector3<f64>)> {
        let RgbdFrame { camera, depth, .. } = self.picture;
        let patch = SurfacePatch::at(depth, camera, u, v)?;
        let place = camera.back_project(u as f64, v as f64, patch.z);
        Some((self.base_from_camera * place, self.base_from_camera * patch.normal))
    }

    /// True if other keyframes see through the reading at a column and row; `None` if that was not tested yet. The
    /// result is the same for each surface at rest.
    pub fn is_seen_through(&self, pixel: [usize; 2]) -> Option<bool> {
        match self.is_seen_through.get(self.index(pixel))?.load(Ordering::Relaxed) {
            NOT_ASKED => None,
            known => Some(known == YES),
        }
    }

    /// Stores the result for [`Self::is_seen_through`]. Threads that test a pixel at the same time get the same
    /// result.
    pub fn keep_seen_through(&self, pixel: [usize; 2], answer: bool) {
        if let Some(kept) = self.is_seen_through.get(self.index(pixel)) {
            kept.store(if answer { YES } else { NO }, Ordering::Relaxed);
        }
    }

    fn index(&self, [u, v]: [usize; 2]) -> usize {
        v * self.picture.depth.width() + u
    }

    /// The surface point at a place's pixel, base frame.
    pub fn surface_near(&self, place: &Point3<f64>) -> Option<Point3<f64>> {
        let camera = &self.picture.camera;
        let pixel = self.pixel_of(place).filter(|px| camera.sees(px, BORDER_PX))?;
        self.surface_at(pixel.x.round() as usize, pixel.y.round() as usize)
    }

    /// Position of the camera, base frame.
    pub fn camera_place(&self) -> Point3<f64> {
        self.base_from_camera * Point3::origin()
    }

    /// The pixel of a place; `None` behind the camera.
    pub fn pixel_of(&self, place: &Point3<f64>) -> Option<Point2<f64>> {
        self.picture.camera.project(&(self.camera_from_base * place))
    }

    /// What the readings around a place's pixel show of the place.
    pub fn probe(&self, place: &Point3<f64>) -> Probe {
        probe_point(self.picture, &(self.camera_from_base * place))
    }

    /// True if the reading at a place's pixel is of something behind the place.
    pub fn shows_behind(&self, place: &Point3<f64>) -> bool {
        self.reading_behind(place).is_some_and(|(behind, margin)| behind > margin)
    }

    /// True if the reading at a place's pixel is of the place.
    pub fn shows(&self, place: &Point3<f64>) -> bool {
        self.reading_behind(place).is_some_and(|(behind, margin)| behind.abs() < 0.5 * margin)
    }

    /// How far the reading at a place's pixel is behind the place, and how much of that may be noise, metres.
    fn reading_behind(&self, place: &Point3<f64>) -> Option<(f64, f64)> {
        let in_camera = self.camera_from_base * place;
        let camera = &self.picture.camera;
        let pixel = camera.project(&in_camera).filter(|px| camera.sees(px, BORDER_PX))?;
        let z = self.picture.depth.at_nearest(pixel.x, pixel.y)?;
        Some((f64::from(z) - in_camera.z, depth_margin(camera.depth_sensor, in_camera.z)))
    }
}
