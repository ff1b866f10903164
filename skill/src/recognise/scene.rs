//! A frame of an encounter, prepared once for all objects.
//!
//! In: an RGB-D frame.
//! Out: its described features, the surface at any pixel (camera frame, metres), and its colour in L*a*b*.

use super::matching::Queries;
use super::surface_cache::Surfaces;
use crate::features::{DescribedFeature, FeatureDensity, Keypoints};
use crate::image::cielab::CielabImage;
use crate::vision_error::VisionError;
use linkage_frames::RgbdFrame;
use linkage_frames::depth::{NormalMap, SurfacePatch};
use nalgebra::Vector3;

/// A frame with features, normals and colour.
pub struct Scene {
    /// RGB-D frame.
    pub frame: RgbdFrame,
    /// Described features of the frame.
    pub features: Vec<DescribedFeature>,
    /// Colour of the frame in L*a*b*.
    pub lab: CielabImage,
    surfaces: Surfaces,
    queries: Queries,
}

/// Smallest share of pixels without depth at which the whole frame counts as without depth.
const MOSTLY_BLIND: f64 = 0.97;

impl Scene {
    /// Computes features, surface and colour of a frame.
    ///
    /// # Errors
    /// [`VisionError`] if the vision library fails.
    pub fn new(frame: &RgbdFrame) -> Result<Self, VisionError> {
        let (keypoints, (normals, lab)) = rayon::join(
            || Keypoints::new(frame, FeatureDensity::Query, |_, _| true),
            || (NormalMap::new(&frame.depth, &frame.camera), CielabImage::new(&frame.color)),
        );
        let features = keypoints
            .and_then(|keypoints| keypoints.describe(frame, &normals))
            .map_err(VisionError::new)?;
        Ok(Self::of(frame, features, normals, lab.map_err(VisionError::new)?))
    }

    /// Prepares a frame without features, for following by surface alone.
    ///
    /// # Errors
    /// [`VisionError`] if the vision library fails.
    pub fn plain(frame: &RgbdFrame) -> Result<Self, VisionError> {
        let (normals, lab) = rayon::join(
            || NormalMap::new(&frame.depth, &frame.camera),
            || CielabImage::new(&frame.color),
        );
        Ok(Self::of(frame, Vec::new(), normals, lab.map_err(VisionError::new)?))
    }

    fn of(
        frame: &RgbdFrame,
        features: Vec<DescribedFeature>,
        normals: NormalMap,
        lab: CielabImage,
    ) -> Self {
        let surfaces = Surfaces::new(normals, frame.depth.width(), frame.depth.height());
        Self {
            frame: frame.clone(),
            queries: Queries::new(&features, frame.camera.depth_sensor),
            features,
            lab,
            surfaces,
        }
    }

    /// Features of the frame, prepared for matching.
    pub(super) fn queries(&self) -> &Queries {
        &self.queries
    }

    /// True if more than 3 % of the pixels have depth.
    pub fn has_depth(&self) -> bool {
        self.frame.depth.invalid_share() < MOSTLY_BLIND
    }

    /// Surface at a pixel, camera frame; `None` if there is none.
    pub fn surface(&self, u: usize, v: usize) -> Option<SurfacePatch> {
        self.surfaces.at(u, v)
    }

    /// Unit normal of the surface at a pixel, camera frame; zero if there is no surface.
    pub fn normal(&self, u: usize, v: usize) -> Vector3<f64> {
        self.surface(u, v).map_or_else(Vector3::zeros, |s| s.normal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::{board, seen};

    #[test]
    fn a_wall_faces_the_camera_wherever_it_has_depth() {
        let scene = Scene::plain(&seen(0, |x, _| if x < 0.2 { 1.5 } else { f64::NAN })).unwrap();
        let patch = scene.surface(100, 100).unwrap();
        assert!((patch.z - 1.5).abs() < 1e-6);
        assert!((scene.normal(100, 100) + Vector3::z()).norm() < 1e-6);
        assert!(scene.surface(300, 100).is_none());
        assert_eq!(scene.normal(300, 100), Vector3::zeros());
        assert!(scene.features.is_empty());
    }

    #[test]
    fn what_lies_outside_the_picture_has_no_surface() {
        let scene = Scene::plain(&seen(0, |_, _| 1.5)).unwrap();
        for (u, v) in [(320, 0), (0, 240), (usize::MAX, usize::MAX)] {
            assert!(scene.surface(u, v).is_none(), "{u}, {v}");
        }
    }

    #[test]
    fn a_camera_that_is_covered_has_no_depth() {
        let with_depth = |share: f64| {
            let limit = 240.0 * share;
            let rows = move |y: f64| 260.0 * y + 120.0 < limit;
            Scene::plain(&seen(0, |_, y| if rows(y) { 1.0 } else { f64::NAN })).unwrap().has_depth()
        };
        assert!(with_depth(1.0) && with_depth(0.2));
        assert!(!with_depth(0.0) && !with_depth(0.02));
    }

    #[test]
    fn a_picture_without_texture_has_no_features() {
        assert!(Scene::new(&seen(0, board(0.3, 1.0, 2.0))).unwrap().features.is_empty());
    }
}
