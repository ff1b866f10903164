//! Finds the edges of a part's face along its hinge. Both keep their distance from the line, and a door, a lid or a
//! leaf is hinged near an edge of its face. This determines the place of the line where the part turned too little
//! for its planes: they determine their intersection, but a hinge lies behind the face by the thickness of the part.
//!
//! In each keyframe the plane is followed in the depth image from its middle towards the line and away from it, in
//! rows along the line, until the image shows another surface. No edge is found where the plane is occluded, or where
//! it continues (a closed door in a front).
//!
//! In: a rough line, the planes that turn about it, and their keyframes.
//! Out: points of the edges, base frame, metres.

use super::plane_segments::PlanePatch;
use super::planes_about_axis::PoseAboutAxis;
use crate::learn::recording::Recording;
use crate::math::robust::median;
use crate::object::joint_geometry::JointGeometry;
use linkage_frames::RgbdFrame;
use nalgebra::{Isometry3, Point3, Vector3};

/// Number of rows along the line in which a plane is followed.
const ROWS: usize = 16;
/// Fewest rows with a reading for a step to count.
const LEAST_ROWS: usize = 5;
/// Step towards the line or away from it, metres.
const STEP_M: f64 = 0.005;
/// Consecutive steps off the plane that mark its end.
const STEPS_OFF: usize = 3;
/// How far a plane is followed beyond the line, or beyond its reach, metres.
const BEYOND_M: f64 = 0.1;
/// Largest change of the rows' median residual from the step before, metres; half the depth noise is added.
const ON_PLANE_M: f64 = 0.005;
/// Largest distance of the rows' median from the plane, metres; `ON_PLANE_M` and half the depth noise are added.
const OFF_PLANE_M: f64 = 0.015;
/// Share of a change of the residual that the expected residual adopts at each step.
const DRIFT: f64 = 0.2;
/// Depth step behind the plane that marks an edge, metres. A face that bends away, or the front that a door is in, is
/// a smaller step.
const JUMP_M: f64 = 0.03;
/// A reading this much nearer than the plane is an occluder, metres.
const HIDING_M: f64 = 0.05;
/// Fewest planes whose edges must agree.
const LEAST_PLANES: usize = 3;
/// Largest distance of a plane's edge from the median of all planes, metres.
const AGREE_M: f64 = 0.04;

/// A point of a face's edge in one keyframe, and the unit vector in the face from the line to it. Base frame, metres.
pub type EdgePoint = (Point3<f64>, Vector3<f64>);

/// The two edges of a face along a hinge; each keeps its distance from the line.
#[derive(Debug, Clone, Default)]
pub struct FaceEdges {
    /// Points of the edge next to the hinge.
    pub near: Vec<EdgePoint>,
    /// Points of the free edge. It moves on the widest circle, and best determines how far the line lies behind the
    /// face.
    pub far: Vec<EdgePoint>,
}

/// The edge of a face that is searched for: next to the hinge, or free.
#[derive(Clone, Copy, PartialEq)]
enum Side {
    Near,
    Far,
}

/// The edges of a face about a line; an edge that is not seen has no points.
pub fn face_edges(
    line: &JointGeometry,
    planes: &[&PlanePatch],
    recording: &Recording,
) -> FaceEdges {
    let [near, far] = [Side::Near, Side::Far].map(|side| edge(line, planes, recording, side));
    FaceEdges { near, far }
}

fn edge(
    line: &JointGeometry,
    planes: &[&PlanePatch],
    recording: &Recording,
    side: Side,
) -> Vec<EdgePoint> {
    let mut edges: Vec<(f64, EdgePoint)> = planes
        .iter()
        .filter_map(|plane| {
            let (_, picture) = recording.keyframes.iter().find(|(f, _)| *f == plane.frame)?;
            let camera_from_base = recording.ego_motion.camera_from_base[plane.frame];
            let pose = PoseAboutAxis::of(plane, &line.origin, &line.axis)?;
            let face = Face::of(plane, &pose, line);
            let out = face.end(picture, &camera_from_base, &pose, side)?;
            Some((out, (face.at(0.0, out), face.arm)))
        })
        .collect();
    let mut places: Vec<f64> = edges.iter().map(|(out, ..)| *out).collect();
    let Some(middle) = median(&mut places) else { return Vec::new() };
    edges.retain(|(out, ..)| (out - middle).abs() < AGREE_M);
    if edges.len() < LEAST_PLANES || 2 * edges.len() < places.len() {
        return Vec::new();
    }
    edges.into_iter().map(|(_, point)| point).collect()
}

/// Coordinates in a plane beside a line: along the line, and out from it, metres.
struct Face {
    /// The line's origin, moved along the normal into the plane.
    origin: Point3<f64>,
    along: Vector3<f64>,
    arm: Vector3<f64>,
    normal: Vector3<f64>,
    /// Positions of the rows along the line, metres.
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

    /// Distance from the line at which the plane ends on one side, metres; `None` if no edge is seen.
    fn end(
        &self,
        picture: &RgbdFrame,
        camera_from_base: &Isometry3<f64>,
        pose: &PoseAboutAxis,
        side: Side,
    ) -> Option<f64> {
        let middle = 0.5 * (pose.least + pose.reach);
        let depth = (camera_from_base * self.at(0.0, middle)).z;
        let margin = ON_PLANE_M + 0.5 * picture.camera.depth_sensor.feature_sigma(depth);
        let (mut last_on, mut before, mut off) = (middle, 0.0, 0);
        let (way, step) = match side {
            Side::Near => (middle + BEYOND_M, -STEP_M),
            Side::Far => (pose.reach - middle + BEYOND_M, STEP_M),
        };
        let steps = (way / STEP_M) as usize;
        for out in (0..steps).map(|k| middle + step * k as f64) {
            let row = self.residuals(out, picture, camera_from_base);
            if 2 * row.hidden > ROWS {
                return None;
            }
            // There are often no readings where the surface ends; such a step does not count.
            let mut seen = row.residuals;
            if seen.len() < LEAST_ROWS {
                continue;
            }
            let residual = median(&mut seen)?;
            if (residual - before).abs() < margin && residual.abs() < OFF_PLANE_M + margin {
                // The fitted plane may be slightly off here, so the expected residual follows the readings.
                before += DRIFT * (residual - before);
                (last_on, off) = (out, 0);
            } else {
                off += 1;
                if off == STEPS_OFF {
                    let jumps = residual < before - JUMP_M;
                    return jumps.then_some(last_on + 0.5 * step);
                }
            }
        }
        None
    }

    /// Residuals of the rows at distance `out` from the line.
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

/// What an image shows along a line beside a hinge.
struct Row {
    /// Distance of each reading before the plane, metres.
    residuals: Vec<f64>,
    /// Number of rows that are occluded or outside the image.
    hidden: usize,
}

#[cfg(test)]
mod tests {
    use super::super::plane_segments::{Sampling, moving_patches};
    use super::super::test_data::{HINGE_M, WIDTH_M, door_recording, turn};
    use super::*;
    use crate::math::rigid::distance_to_line;
    use nalgebra::{UnitVector3, Vector3};

    /// The edges of an opened door, whose line is thought to be off by some metres to the side.
    fn edges(off: f64) -> FaceEdges {
        let recording = door_recording(24, turn);
        let origin = Point3::new(HINGE_M[0] + off, 0.0, HINGE_M[1]);
        let line = JointGeometry::hinge(Vector3::y_axis(), origin);
        let patches = moving_patches(&recording, Sampling::Coarse, None);
        // The planes of the door, but not of the closed one: that goes on as the front.
        let is_door = |p: &&PlanePatch| {
            let door = Vector3::new(-turn(p.frame).sin(), 0.0, -turn(p.frame).cos());
            turn(p.frame) > 0.3 && p.normal.dot(&door) > 0.99
        };
        let planes: Vec<&PlanePatch> = patches.iter().filter(is_door).collect();
        assert!(planes.len() >= LEAST_PLANES);
        face_edges(&line, &planes, &recording)
    }

    fn distances(points: &[EdgePoint]) -> Vec<f64> {
        let hinge = Point3::new(HINGE_M[0], 0.0, HINGE_M[1]);
        let axis: UnitVector3<f64> = Vector3::y_axis();
        points.iter().map(|(p, _)| distance_to_line(&hinge, &axis, p)).collect()
    }

    #[test]
    fn the_free_edge_of_a_door_keeps_its_distance_from_the_hinge() {
        for off in [0.0, 0.03] {
            let far = distances(&edges(off).far);
            assert!(far.len() >= LEAST_PLANES);
            assert!(far.iter().all(|d| (d - WIDTH_M).abs() < 0.02), "{far:?}");
        }
    }

    #[test]
    fn where_a_door_meets_its_front_no_edge_is_taken_for_it() {
        let near = distances(&edges(0.0).near);
        assert!(near.iter().all(|d| *d < 0.03), "{near:?}");
    }
}
