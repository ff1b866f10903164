//! An observation of a point, and its uncertainty. A demonstration has millions of observations, so
//! each takes little memory.
//!
//! In: a point in the camera frame, metres, the pose of the camera, and the depth sensor.
//! Out: the point in the base frame, with its inverse covariance.

use crate::math::rigid::Pose;
use linkage_frames::depth::{DepthSensor, feature_across_sigma};
use nalgebra::{IsometryMatrix3, Matrix3, Point3, Vector3};

/// Noise of a tracked feature, as a share of the sensor's `feature_sigma`.
const TRACKED_SHARE: f64 = 0.7;
/// Smallest distance from a place that is motion, metres.
const MOVED_M: f64 = 0.012;
/// Smallest distance from a place that is motion, in standard deviations.
const MOVED_SIGMAS: f64 = 3.0;

/// One observation of a track, in the base frame or in the frame of a part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BaseObservation {
    /// Place, metres.
    pub point: Point3<f64>,
    /// Inverse covariance of the place.
    pub precision: Information,
    sigma: f32,
}

impl BaseObservation {
    /// An observation; `sigma` is one figure for its noise in all directions, metres.
    pub fn new(point: Point3<f64>, precision: Information, sigma: f64) -> Self {
        Self { point, precision, sigma: sigma as f32 }
    }

    /// The observation in the base frame of a point that is given in the camera frame.
    pub fn by_camera(
        in_camera: &Point3<f64>,
        camera_from_base: &Pose,
        sensor: DepthSensor,
    ) -> Self {
        let base_from_camera = camera_from_base.inverse();
        let ray = base_from_camera * in_camera.coords.normalize();
        let precision = Information::new(
            &ray,
            feature_across_sigma(in_camera.z),
            sensor.feature_ray_sigma(in_camera.z),
        );
        let sigma = TRACKED_SHARE * sensor.feature_sigma(in_camera.z);
        Self::new(base_from_camera * in_camera, precision, sigma)
    }

    /// The observation in another frame.
    pub fn moved(&self, other_from_this: &IsometryMatrix3<f64>) -> Self {
        let precision = self.precision.rotated(other_from_this.rotation.matrix());
        Self { point: other_from_this * self.point, precision, ..*self }
    }

    /// Standard deviation of the place in all directions, as one figure, metres.
    pub fn sigma(&self) -> f64 {
        f64::from(self.sigma)
    }

    /// True if the observation is farther from a place than noise explains.
    pub fn is_away_from(&self, place: &Point3<f64>) -> bool {
        (self.point - place).norm() > (MOVED_SIGMAS * self.sigma()).max(MOVED_M)
    }

    /// Squared Mahalanobis distance of a place from the observation.
    pub fn distance_sq(&self, place: &Point3<f64>) -> f64 {
        self.precision.norm_sq(&(place - self.point))
    }
}

/// Inverse covariance of a point that a camera saw: one variance along the viewing ray, another
/// across it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Information {
    /// Unit direction of the viewing ray.
    pub(crate) ray: Vector3<f32>,
    /// Inverse variance across the ray.
    pub(crate) across: f32,
    /// Inverse variance along the ray less that across it; negative where depth is less precise
    /// than the place in the image.
    pub(crate) excess: f32,
}

impl Information {
    /// Information of a point on a ray of unit direction `ray`, with standard deviations across the
    /// ray and along it, metres.
    pub fn new(ray: &Vector3<f64>, across_sigma: f64, ray_sigma: f64) -> Self {
        let (across, along) = (across_sigma.powi(-2), ray_sigma.powi(-2));
        Self { ray: ray.cast(), across: across as f32, excess: (along - across) as f32 }
    }

    /// The information in another frame.
    fn rotated(&self, rotation: &Matrix3<f64>) -> Self {
        Self { ray: (rotation * self.ray.cast::<f64>()).cast(), ..*self }
    }

    /// Product of the information matrix and a vector.
    pub fn times(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        let ray = self.ray.cast::<f64>();
        vector * f64::from(self.across) + ray * (f64::from(self.excess) * ray.dot(vector))
    }

    /// Squared Mahalanobis norm of a vector.
    pub fn norm_sq(&self, vector: &Vector3<f64>) -> f64 {
        let along = self.ray.cast::<f64>().dot(vector);
        f64::from(self.across) * vector.norm_squared() + f64::from(self.excess) * along * along
    }

    /// The inverse covariance as a matrix.
    pub fn matrix(&self) -> Matrix3<f64> {
        let ray = self.ray.cast::<f64>();
        Matrix3::from_diagonal_element(f64::from(self.across))
            + ray * ray.transpose() * f64::from(self.excess)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_was_seen_is_told_across_the_ray_and_less_along_it(
            turn in prop::array::uniform3(-2.0..2.0_f64),
            vector in prop::array::uniform3(-0.1..0.1_f64),
            z in 0.4..4.0_f64,
        ) {
            let (rotation, vector) = (Rotation3::new(turn.into()), Vector3::from(vector));
            let ray = DepthSensor::Stereo.feature_ray_sigma(z);
            let of_camera = Information::new(&Vector3::z(), feature_across_sigma(z), ray);
            let across = feature_across_sigma(z).powi(-2);
            let expected = Matrix3::from_diagonal(&[across, across, ray.powi(-2)].into());
            let turned = rotation.matrix() * expected * rotation.matrix().transpose();
            let precision = of_camera.rotated(rotation.matrix());
            let near = |a: f64, b: f64| (a - b).abs() < 1e-5 * across;
            prop_assert!((precision.matrix() - turned).iter().all(|d| near(*d, 0.0)));
            prop_assert!((precision.times(&vector) - turned * vector).iter().all(|d| near(*d, 0.0)));
            prop_assert!(near(precision.norm_sq(&vector), vector.dot(&(turned * vector))));
        }
    }
}
