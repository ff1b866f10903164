//! A joint that was fitted to a log of poses.

use crate::object::joint_geometry::JointGeometry;
use nalgebra::{DMatrix, Point3, UnitQuaternion};

/// One joint fitted to all samples.
#[derive(Debug, Clone)]
pub struct FittedJoint {
    /// Its line, in the parent's frame.
    pub geometry: JointGeometry,
    /// Where the part's origin is at configuration 0.
    pub rest_position: Point3<f64>,
    /// How the part is turned at configuration 0.
    pub rest_orientation: UnitQuaternion<f64>,
    /// Configuration of each sample.
    pub configuration: Vec<f64>,
    /// Log likelihood of the effective observations.
    pub log_likelihood: f64,
    /// Bayesian information criterion; least is best.
    pub bic: f64,
    /// Root mean square distance of the inliers, metres.
    pub position_rmse: f64,
    /// Root mean square angle of the inliers, radians; 0 without orientations.
    pub orientation_rmse: f64,
    /// Share of position outliers.
    pub outlier_ratio: f64,
    /// By sample: whether the joint explains its position; the configuration of others means
    /// nothing.
    pub inlier: Vec<bool>,
    /// Independent observations that the samples amount to.
    pub effective_observations: f64,
    /// Covariance of (axis x, y, z, origin x, y, z).
    pub covariance: DMatrix<f64>,
}
