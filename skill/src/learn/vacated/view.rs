//! A keyframe with the camera's pose: what it shows at a place of the base frame.

use crate::learn::free_space::{Probe, depth_margin, probe_point};
use crate::learn::recording::Recording;
use crate::math::rigid::matrix_pose;
use linkage_frames::RgbdFrame;
use linkage_frames::depth::SurfacePatch;
use nalgebra::{IsometryMatrix3, Point2, Point3, Vector3};
use std::sync::atomic::{AtomicU8, Ordering};

/// Pixels at the border of a picture that are not asked.
const BORDER_PX: f64 = 3.0;

/// A keyframe.
pub struct View<'r> {
    /// Frame number.
    pub frame: usize,
    /// The picture.
    pub picture: &'r RgbdFrame,
    /// Pose of the base in the camera frame.
    pub camera_from_base: IsometryMatrix3<f64>,
    base_from_camera: IsometryMatrix3<f64>,
    /// Whether other keyframes see through the reading of each pixel, where that was asked.
    is_seen_through: Vec<AtomicU8>,
}

/// What is remembered of a pixel.
const NOT_ASKED: u8 = 0;
const NO: u8 = 1;
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

    /// The surface at a pixel, base frame.
    pub fn surface_at(&self, u: usize, v: usize) -> Option<Point3<f64>> {
        let z = self.picture.depth.at(u, v)?;
        let camera = &self.picture.camera;
        Some(self.base_from_camera * camera.back_project(u as f64, v as f64, f64::from(z)))
    }

    /// The surface at a pixel with its normal, by the readings around it; base frame.
    pub fn patch_at(&self, u: usize, v: usize) -> Option<(Point3<f64>, Vector3<f64>)> {
        let RgbdFrame { camera, depth, .. } = self.picture;
        let patch = SurfacePatch::at(depth, camera, u, v)?;
        let place = camera.back_project(u as f64, v as f64, patch.z);
        Some((self.base_from_camera * place, self.base_from_camera * patch.normal))
    }

    /// Whether other keyframes see through the reading at a column and row; `None` where that was not asked yet. The
    /// answer is the same for each surface at rest.
    pub fn is_seen_through(&self, pixel: [usize; 2]) -> Option<bool> {
        match self.is_seen_through.get(self.index(pixel))?.load(Ordering::Relaxed) {
            NOT_ASKED => None,
            known => Some(known == YES),
        }
    }

    /// Keeps the answer to [`Self::is_seen_through`]. Threads that ask at once get the same answer.
    pub fn keep_seen_through(&self, pixel: [usize; 2], answer: bool) {
        if let Some(kept) = self.is_seen_through.get(self.index(pixel)) {
            kept.store(if answer { YES } else { NO }, Ordering::Relaxed);
        }
    }

    fn index(&self, [u, v]: [usize; 2]) -> usize {
        v * self.picture.depth.width() + u
    }

    /// The surface at a place's pixel, base frame.
    pub fn surface_near(&self, place: &Point3<f64>) -> Option<Point3<f64>> {
        let camera = &self.picture.camera;
        let pixel = self.pixel_of(place).filter(|px| camera.sees(px, BORDER_PX))?;
        self.surface_at(pixel.x.round() as usize, pixel.y.round() as usize)
    }

    /// Where the camera is, base frame.
    pub fn camera_place(&self) -> Point3<f64> {
        self.base_from_camera * Point3::origin()
    }

    /// The pixel of a place; `None` behind the camera.
    pub fn pixel_of(&self, place: &Point3<f64>) -> Option<Point2<f64>> {
        self.picture.camera.project(&(self.camera_from_base * place))
    }

    /// What the picture says about a place, by the readings around its pixel.
    pub fn probe(&self, place: &Point3<f64>) -> Probe {
        probe_point(self.picture, &(self.camera_from_base * place))
    }

    /// The reading at a place's pixel is of something behind it.
    pub fn shows_behind(&self, place: &Point3<f64>) -> bool {
        self.reading_behind(place).is_some_and(|(behind, margin)| behind > margin)
    }

    /// The reading at a place's pixel is of the place.
    pub fn shows(&self, place: &Point3<f64>) -> bool {
        self.reading_behind(place).is_some_and(|(behind, margin)| behind.abs() < 0.5 * margin)
    }

    /// How far the reading at a place's pixel is behind it, and what may be noise of that; metres.
    fn reading_behind(&self, place: &Point3<f64>) -> Option<(f64, f64)> {
        let in_camera = self.camera_from_base * place;
        let camera = &self.picture.camera;
        let pixel = camera.project(&in_camera).filter(|px| camera.sees(px, BORDER_PX))?;
        let z = self.picture.depth.at_nearest(pixel.x, pixel.y)?;
        Some((f64::from(z) - in_camera.z, depth_margin(camera.depth_sensor, in_camera.z)))
    }
}
