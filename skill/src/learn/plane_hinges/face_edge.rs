//! The edge of a part's face next to its hinge. A door, a lid or a leaf is hinged near an edge of its
//! face, which tells the place of the line in the face where the part turned too little for its planes
//! to tell it.
//!
//! In: a rough line, the planes that turn about it, and their keyframes. Out: points of the edge, base
//! frame, metres. At each keyframe the plane is followed in the depth picture from its middle towards
//! the line, in rows along it, until the picture shows another surface. Where something hides the plane,
//! or it goes on beyond the line (a closed door in a front), no edge is seen.

use super::plane_segments::PlanePatch;
use super::planes_about_axis::PoseAboutAxis;
use crate::learn::ego_motion::coarse_sigma;
use crate::learn::recording::Recording;
use crate::math::robust::median;
use crate::object::joint_geometry::JointGeometry;
use linkage_frames::RgbdFrame;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

/// Rows along the line in which a plane is followed.
const ROWS: usize = 16;
/// Rows of which a reading is needed to go on.
const LEAST_ROWS: usize = 5;
/// Step towards the line, metres.
const STEP_M: f64 = 0.005;
/// Steps off the plane, one after the other, that end it.
const STEPS_OFF: usize = 3;
/// Beyond the line by so much the plane is followed, metres.
const BEYOND_M: f64 = 0.1;
/// Largest change of the rows' median from before, and largest distance from the plane, metres; a share
/// of the depth noise comes on top of both.
const ON_PLANE_M: f64 = 0.005;
const OFF_PLANE_M: f64 = 0.015;
/// Share of a change that is taken over at each step.
const DRIFT: f64 = 0.2;
/// So much nearer to the camera something hides the plane, metres.
const HIDING_M: f64 = 0.05;
/// Fewest planes whose edges agree.
const LEAST_PLANES: usize = 3;
/// Edges agree within this, metres.
const AGREE_M: f64 = 0.03;
/// Standard deviation of a hinge's distance from the edge of its face, metres.
const EDGE_M: f64 = 0.02;

/// Points of an edge that is the same part's at several keyframes.
#[derive(Debug, Clone, Default)]
pub struct FaceEdge {
    /// At each keyframe that shows it: a point of the edge, and the unit vector in the face across it.
    pub points: Vec<(Point3<f64>, Vector3<f64>)>,
}

impl FaceEdge {
    /// Standard deviation of the line's distance from one of them as if they were independent, so that
    /// all together have theirs.
    pub fn sigma_of_one(&self) -> f64 {
        EDGE_M * (self.points.len().max(1) as f64).sqrt()
    }

    /// Information (inverse covariance) of the line's place, base frame.
    pub fn information(&self) -> Matrix3<f64> {
        let across: Matrix3<f64> = self.points.iter().map(|(_, arm)| arm * arm.transpose()).sum();
        across / self.sigma_of_one().powi(2)
    }
}

/// The edge of the face next to a line; empty where it is not seen.
pub fn near_edge(line: &JointGeometry, planes: &[&PlanePatch], recording: &Recording) -> FaceEdge {
    let mut edges: Vec<(f64, Point3<f64>, Vector3<f64>)> = planes
        .iter()
        .filter_map(|plane| {
            let (_, picture) = recording.keyframes.iter().find(|(f, _)| *f == plane.frame)?;
            let camera_from_base = recording.ego_motion.camera_from_base[plane.frame];
            let pose = PoseAboutAxis::of(plane, &line.origin, &line.axis)?;
            let face = Face::of(plane, &pose, line);
            let out = face.end(picture, &camera_from_base, &pose)?;
            Some((out, face.at(0.0, out), face.arm))
        })
        .collect();
    let mut places: Vec<f64> = edges.iter().map(|(out, ..)| *out).collect();
    let Some(middle) = median(&mut places) else { return FaceEdge::default() };
    edges.retain(|(out, ..)| (out - middle).abs() < AGREE_M);
    if edges.len() < LEAST_PLANES || 2 * edges.len() < places.len() {
        return FaceEdge::default();
    }
    let points = edges.into_iter().map(|(_, point, arm)| (point, arm)).collect();
    FaceEdge { points }
}

/// Coordinates in a plane beside a line: along it, and out from it.
struct Face {
    /// The line's origin, moved along the normal into the plane.
    origin: Point3<f64>,
    along: Vector3<f64>,
    arm: Vector3<f64>,
    normal: Vector3<f64>,
    /// The rows' places along the line.
    rows: Vec<f64>,
}

impl Face {
    fn of(plane: &PlanePatch, pose: &PoseAboutAxis, line: &JointGeometry) -> Self {
        let normal = plane.normal;
        let along = pose.arm.cross(&normal);
        let origin = line.origin + normal * (plane.offset - normal.dot(&line.origin.coords));
        let mut places: Vec<f64> = plane.points.iter().map(|p| along.dot(&(p - origin))).collect();
        places.sort_by(f64::total_cmp);
        let row = |k: usize| places[(places.len() - 1) * (k + 1) / (ROWS + 1)];
        Self { origin, along, arm: pose.arm, normal, rows: (0..ROWS).map(row).collect() }
    }

    fn at(&self, along: f64, out: f64) -> Point3<f64> {
        self.origin + self.along * along + self.arm * out
    }

    /// Where the plane ends on the side of the line.
    fn end(
        &self,
        picture: &RgbdFrame,
        camera_from_base: &Isometry3<f64>,
        pose: &PoseAboutAxis,
    ) -> Option<f64> {
        let middle = 0.5 * (pose.least + pose.reach);
        let depth = (camera_from_base * self.at(0.0, middle)).z;
        let margin = ON_PLANE_M + 0.5 * coarse_sigma(depth);
        let (mut last_on, mut before, mut off) = (middle, 0.0, 0);
        let steps = ((middle + BEYOND_M) / STEP_M) as usize;
        for out in (0..steps).map(|k| middle - STEP_M * k as f64) {
            let row = self.residuals(out, picture, camera_from_base);
            if 2 * row.hidden > ROWS {
                return None;
            }
            // A camera has no readings where the surface ends.
            let mut seen = row.residuals;
            if seen.len() < LEAST_ROWS {
                continue;
            }
            let residual = median(&mut seen)?;
            if (residual - before).abs() < margin && residual.abs() < OFF_PLANE_M + margin {
                // The plane of the part's far half is a little off here.
                before += DRIFT * (residual - before);
                (last_on, off) = (out, 0);
            } else {
                off += 1;
                if off == STEPS_OFF {
                    return Some(last_on - 0.5 * STEP_M);
                }
            }
        }
        None
    }

    /// What a picture shows along the rows at a distance from the line.
    fn residuals(&self, out: f64, picture: &RgbdFrame, camera_from_base: &Isometry3<f64>) -> Row {
        let normal = camera_from_base * self.normal;
        let mut row = Row { residuals: Vec::with_capacity(ROWS), hidden: 0 };
        for along in &self.rows {
            let place = camera_from_base * self.at(*along, out);
            let pixel = picture.camera.project(&place).filter(|px| picture.camera.sees(px, 3.0));
            let Some(z) = pixel.and_then(|px| picture.depth.at_nearest(px.x, px.y)) else {
                row.hidden += usize::from(pixel.is_none());
                continue;
            };
            let before = normal.dot(&place.coords) * (f64::from(z) / place.z - 1.0);
            if before < HIDING_M {
                row.residuals.push(before);
            } else {
                row.hidden += 1;
            }
        }
        row
    }
}

/// What a picture shows along a line beside a hinge.
struct Row {
    /// How far the surface lies before the plane, metres.
    residuals: Vec<f64>,
    /// Places that something hides, or that lie outside the picture.
    hidden: usize,
}
