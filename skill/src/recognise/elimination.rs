//! Configurations by elimination. A part that is seen edge-on, or from a side that was never demonstrated, gives no
//! evidence of its own; but anywhere else it would occlude what is seen behind it. If that leaves only a narrow
//! interval, the configuration is known.
//!
//! In: a detection and its scene.
//! Out: the detection with further configurations and their standard deviations (rad or m).

use super::evidence::{Detection, told_within};
use super::kinematics::{Articulated, State};
use super::render_cloud::Cloud;
use super::scene::Scene;
use super::verify::verify;
use rayon::prelude::*;
use std::collections::HashSet;

/// Number of configurations tried of a joint.
const STEPS: usize = 61;
/// Side of the cells in which contradictions are counted, pixels.
const CELL_PX: usize = 4;
/// Smallest number of cells that contradict the worst configuration; with fewer nothing can be ruled out.
const MIN_CELLS: usize = 60;
/// Largest share of the cells of the worst configuration that may contradict another one by noise.
const NOISE_SHARE: f64 = 0.08;
/// Smallest share of the resting parts' surface that must remain visible at a possible configuration.
const KEPT_SURFACE: f64 = 0.85;

/// Adds the configurations for which all others are ruled out, of joints with no evidence on their moving side.
pub fn add_by_elimination(
    scene: &Scene,
    articulated: &Articulated,
    cloud: &Cloud,
    found: &mut Detection,
) {
    for j in 0..articulated.joints.len() {
        let moved = articulated.moved_by(j);
        let held = (0..articulated.parts).any(|p| found.placed[p] && !moved.contains(&p));
        if found.evident[j] || !held {
            continue;
        }
        if let Some(left) = remaining(scene, articulated, cloud, &found.state, j) {
            found.state.q[j] = left.middle;
            found.deviations[j] = Some(left.deviation());
            found.evident[j] = true;
        }
    }
}

/// Interval of configurations that the image leaves possible, rad or m.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Remaining {
    /// Middle of the interval.
    middle: f64,
    /// Half the width of the interval.
    half_width: f64,
}

impl Remaining {
    /// Standard deviation of a configuration that may lie anywhere in the interval.
    fn deviation(&self) -> f64 {
        self.half_width / 3.0_f64.sqrt()
    }
}

/// Configurations of `joint` that the image leaves possible, all else being as in `state`; `None` if the interval is
/// too wide or empty, or reaches an end of the range.
fn remaining(
    scene: &Scene,
    articulated: &Articulated,
    cloud: &Cloud,
    state: &State,
    joint: usize,
) -> Option<Remaining> {
    let j = &articulated.joints[joint];
    let moved = articulated.moved_by(joint);
    let step = (j.high - j.low) / (STEPS - 1) as f64;
    let tried: Vec<Trial> = (0..STEPS)
        .into_par_iter()
        .map(|i| {
            let q = j.low + step * i as f64;
            let mut there = state.clone();
            there.q[joint] = q;
            Trial::new(scene, articulated, cloud, &there, &moved, q)
        })
        .collect();
    let most = tried.iter().map(|t| t.contradictions).max()?;
    let surface = tried.iter().map(|t| t.resting).max()? as f64;
    if most < MIN_CELLS {
        return None;
    }
    let possible: Vec<&Trial> = tried
        .iter()
        .filter(|t| {
            (t.contradictions as f64) < NOISE_SHARE * most as f64
                && t.resting as f64 > KEPT_SURFACE * surface
        })
        .collect();
    let (low, high) = (possible.first()?.q, possible.last()?.q);
    tracing::debug!(joint, low, high, most, surface, of = possible.len(), "by elimination");
    // If the true configuration is beyond the range, only the end of the range remains: this is not accepted.
    let inside = low > j.low + 0.5 * step && high < j.high - 0.5 * step;
    let (middle, half_width) = (0.5 * (low + high), 0.5 * (high - low) + 0.5 * step);
    let narrow = 0.5 * (high - low) < told_within(j.geometry.kind);
    (inside && narrow).then_some(Remaining { middle, half_width })
}

/// A tried configuration and the evidence against it.
struct Trial {
    q: f64,
    /// Number of cells of the image in which the moved parts would occlude what is seen.
    contradictions: usize,
    /// Number of surfels of the other parts that agree with the image.
    resting: usize,
}

impl Trial {
    fn new(
        scene: &Scene,
        articulated: &Articulated,
        cloud: &Cloud,
        state: &State,
        moved: &[usize],
        q: f64,
    ) -> Self {
        let poses = articulated.poses(state);
        let camera = &scene.frame.camera;
        // Opaque from either side: whichever way a surfel faces, it hides what is behind it.
        let contradictions: HashSet<(usize, usize)> = cloud
            .surfels
            .iter()
            .filter(|s| moved.contains(&s.part))
            .filter_map(|s| {
                let point = poses[s.part] * s.point;
                let pixel = camera.project(&point).filter(|p| camera.sees(p, 2.0))?;
                let (u, v) = (pixel.x.round() as usize, pixel.y.round() as usize);
                let behind = f64::from(scene.frame.depth.at(u, v)?) - point.z;
                (behind > 2.0 * camera.depth_sensor.tolerance(point.z, 1.0))
                    .then_some((u / CELL_PX, v / CELL_PX))
            })
            .collect();
        let verdict = verify(scene, articulated, cloud, state);
        let resting = |part: &usize| !moved.contains(part);
        Self {
            q,
            contradictions: contradictions.len(),
            resting: (0..articulated.parts).filter(resting).map(|p| verdict.parts[p].agree).sum(),
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::math::rigid::Pose;
    use crate::object::joint_geometry::JointGeometry;
    use crate::recognise::kinematics::ChainJoint;
    use crate::recognise::render_cloud::CloudPoint;
    use linkage_frames::{ColorImage, DepthImage, PinholeCamera, RgbdFrame};
    use nalgebra::{Point3, Vector3};
    use std::sync::Arc;

    const WALL_M: f32 = 2.0;

    /// A wall, with `board` telling which pixels a near board hides.
    pub fn scene(board: impl Fn(usize, usize) -> bool) -> Scene {
        let camera = PinholeCamera::kinect();
        let (w, h) = (camera.width, camera.height);
        let depth = (0..w * h).map(|i| if board(i % w, i / w) { 0.8 } else { WALL_M }).collect();
        let color = ColorImage::new(w, h, vec![128; w * h * 3]).unwrap();
        let depth = DepthImage::from_metres(w, h, depth).unwrap();
        Scene::new(&RgbdFrame::new(0, Arc::new(camera), color, depth).unwrap()).unwrap()
    }

    /// A flap hinged in front of the wall, pointing straight away from the camera at 0.
    pub fn flap() -> (Articulated, Cloud) {
        let geometry = JointGeometry::hinge(Vector3::x_axis(), Point3::new(0.0, 0.0, 1.2));
        let joints = vec![ChainJoint::new(geometry, [0, 1], [-1.0, 1.0])];
        let grid = || {
            (0..30).flat_map(|i| (0..30).map(move |j| (0.01 * f64::from(i), 0.01 * f64::from(j))))
        };
        let point = |part, point, normal| CloudPoint { part, point, normal, lab: [50.0, 0.0, 0.0] };
        let wall = grid()
            .map(|(x, y)| point(0, Point3::new(0.5 + x, y, f64::from(WALL_M)), -Vector3::z()));
        let flap = grid().map(|(x, z)| point(1, Point3::new(x - 0.15, 0.0, 1.2 + z), Vector3::y()));
        (Articulated { parts: 2, joints }, Cloud::of(wall.chain(flap).collect()))
    }

    fn told(scene: &Scene) -> Option<f64> {
        let (articulated, cloud) = flap();
        let state = State { camera_from_object: Pose::identity(), q: vec![0.7] };
        remaining(scene, &articulated, &cloud, &state, 0).map(|left| left.middle)
    }

    #[test]
    fn a_flap_that_hides_nothing_is_seen_edge_on() {
        let q = told(&scene(|_, _| false)).unwrap();
        assert!(q.abs() < 0.04, "{q}");
    }

    #[test]
    fn a_flap_that_may_be_anywhere_behind_a_board_is_not_told() {
        assert_eq!(told(&scene(|_, v| v > 240)), None);
    }
}
