//! Aligns a hinge's line to all depth images at once: the four unknowns of the line are shared by all keyframes, and
//! each keyframe has its configuration.
//!
//! Keyframes that show the other face of a part than the known one see it farther away by the part's thickness, a
//! fifth shared unknown. (A cooker's oven door, whose inside was seen while it was open, was placed 6.7 cm off
//! without it; its planes alone put it 0.8 cm off.) A plane that turns little hardly determines how far the line lies
//! from it; there a prior holds: a hinge is within some centimetres of the face of its part.
//!
//! In: the surface of the part, the hinge from its planes, and its followed configurations (base frame).
//! Out: the line with its covariance, and the residual, metres.
//! From: point-to-plane alignment by Gauss-Newton; the configurations are eliminated (Schur complement), as bundle
//! adjustment eliminates points.

use super::depth_following::{Following, Surface, residuals};
use super::hinge::Hinge;
use crate::learn::line_step::{line_covariance, moved_line};
use crate::learn::recording::Recording;
use crate::math::normal_equations::NormalEquations;
use crate::math::rigid::orthonormal_basis;
use crate::object::joint_geometry::JointGeometry;
use nalgebra::{Const, Matrix3x2, Matrix4, Matrix6, Point3, Vector3, Vector4, Vector5, Vector6};

/// Most Gauss-Newton steps.
const STEPS: usize = 6;
/// Standard deviation of a residual, metres.
const RESIDUAL_M: f64 = 0.004;
/// Largest number of independent residuals of one keyframe. There are many more residuals, but neighbouring readings
/// of a depth camera share their errors.
const INDEPENDENT: f64 = 8.0;
/// Standard deviation of a hinge's distance from its part's face, metres: parts have a thickness.
const OFFSET_M: f64 = 0.03;
/// Largest standard deviation of the direction in the prior, radians.
const PRIOR_RAD: f64 = 0.01;
/// Largest standard deviation of the place in the prior, metres.
const PRIOR_M: f64 = 0.05;
/// Expected thickness of a part, metres.
const THICKNESS_M: f64 = 0.01;
/// Standard deviation of a part's thickness, metres.
const THICKNESS_SIGMA_M: f64 = 0.01;
/// Residual from which a reading has no weight (Tukey's biweight), metres.
const CUT_M: f64 = 0.02;
/// Step of numerical derivatives, radians or metres.
const DIFFERENCE: f64 = 1e-5;

/// A line that was aligned to the depth images.
#[derive(Debug, Clone)]
pub struct AlignedLine {
    /// The aligned line, base frame.
    pub geometry: JointGeometry,
    /// Covariance of (axis, origin) from residuals and prior, without errors that all readings share.
    pub covariance: Matrix6<f64>,
    /// Root mean square residual, metres.
    pub rmse: f64,
}

/// Aligns a line to the keyframes that show its part, unless its planes determine its place well: a good line gains
/// nothing, because all readings of a keyframe may belong to the wrong surface.
pub fn align_line(
    surface: &Surface,
    from_planes: &Hinge,
    following: &Following,
    recording: &Recording,
) -> AlignedLine {
    let mut geometry = from_planes.geometry();
    let mut thickness = THICKNESS_M;
    let known = prior(surface, from_planes, &geometry, thickness);
    let covariance = line_covariance(&geometry, &information_of_line(&known));
    if from_planes.is_well_known() {
        return AlignedLine { geometry, covariance, rmse: from_planes.rmse };
    }
    let mut q: Vec<(usize, f64)> = following.shown().map(|p| (p.frame, p.q)).collect();
    let mut information = Matrix4::identity();
    let mut rmse = 0.0;
    for _ in 0..STEPS {
        let (pictures, squares, weight) =
            reduced_system(surface, &geometry, thickness, &mut q, recording);
        rmse = (squares / weight.max(1e-9)).sqrt();
        let known = prior(surface, from_planes, &geometry, thickness);
        let mut system = pictures;
        system.add_weighted(&known, 1.0);
        information = information_of_line(&system);
        let Some(step) = system.solution() else { break };
        geometry = moved_line(&geometry, &step.fixed_rows::<4>(0).into_owned());
        thickness += step[THICKNESS];
        if step.norm() < 1e-6 {
            break;
        }
    }
    let covariance = line_covariance(&geometry, &information);
    AlignedLine { geometry, covariance, rmse }
}

/// Index of the unknown thickness, after the unknowns of the line.
const THICKNESS: usize = 4;
/// Index of a keyframe's configuration, after all unknowns that the keyframes share.
const CONFIGURATION: usize = 5;

/// Normal equations of the line's four unknowns and the thickness of its part.
type LineEquations = NormalEquations<Const<5>>;

/// Information of the line after the thickness is eliminated.
fn information_of_line(equations: &LineEquations) -> Matrix4<f64> {
    equations.without_last::<4>().information()
}

/// The normal equations after the configurations are eliminated, the weighted sum of squared residuals, and the sum
/// of weights. The configurations in `q` are updated.
fn reduced_system(
    surface: &Surface,
    geometry: &JointGeometry,
    thickness: f64,
    q: &mut [(usize, f64)],
    recording: &Recording,
) -> (LineEquations, f64, f64) {
    let mut all = LineEquations::zero();
    let (mut squares, mut weights) = (0.0, 0.0);
    let shifted: [JointGeometry; 4] = std::array::from_fn(|k| {
        let mut step = Vector4::zeros();
        step[k] = DIFFERENCE;
        moved_line(geometry, &step)
    });
    for (frame, q) in q {
        let Some((_, picture)) = recording.keyframes.iter().find(|(f, _)| f == frame) else {
            continue;
        };
        let camera_from_base = recording.ego_motion.camera_from_base[*frame];
        let motion = geometry.motion(*q);
        let beside = shifted.each_ref().map(|g| g.motion(*q));
        let other_face = f64::from(!surface.is_turned_to_camera(&(camera_from_base * motion)));
        let mut own = NormalEquations::<Const<6>>::zero();
        let mut found = 0.0;
        let behind = other_face * thickness;
        for r in residuals(surface, behind, &motion, picture, &camera_from_base) {
            let place = motion * r.point;
            let slopes = Vector6::from_fn(|k, _| match beside.get(k) {
                Some(beside) => r.normal.dot(&(beside * r.point - place)) / DIFFERENCE,
                None if k == THICKNESS => -other_face,
                None => r.normal.dot(&geometry.velocity(&place)),
            });
            let w = (1.0 - (r.distance / CUT_M).powi(2)).max(0.0).powi(2);
            own.add(&slopes, r.distance, w);
            squares += w * r.distance * r.distance;
            found += w;
        }
        let of_configuration = own.left[(CONFIGURATION, CONFIGURATION)];
        if of_configuration < 1e-9 || found < 1.0 {
            continue;
        }
        *q += own.right[CONFIGURATION] / of_configuration;
        let weight = INDEPENDENT.min(found) / found / RESIDUAL_M.powi(2);
        all.add_weighted(&own.without_last(), weight);
        weights += found;
    }
    (all, squares, weights)
}

/// Prior without the residuals: the line from the planes with its standard deviations, the hinge near the face of its
/// part, and the thickness of parts.
fn prior(
    surface: &Surface,
    from_planes: &Hinge,
    now: &JointGeometry,
    thickness: f64,
) -> LineEquations {
    let (u, v) = orthonormal_basis(&now.axis);
    let n = surface.points.len().max(1) as f64;
    let mean = Point3::from(surface.points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / n);
    let mut all = LineEquations::zero();
    let mut add = |slopes: Vector5<f64>, off: f64, sigma: f64| {
        all.add(&slopes, -off, 1.0 / sigma.powi(2));
    };
    let turned = now.axis.into_inner() - from_planes.axis;
    let shifted = now.origin - from_planes.origin;
    for (k, side) in [u, v].iter().enumerate() {
        add(unit(k), side.dot(&turned), from_planes.direction_sigma(side).min(PRIOR_RAD));
        add(unit(k + 2), side.dot(&shifted), PRIOR_M);
    }
    add(unit(THICKNESS), thickness - THICKNESS_M, THICKNESS_SIGMA_M);
    let across = Vector5::new(0.0, 0.0, surface.normal.dot(&u), surface.normal.dot(&v), 0.0);
    add(across, surface.normal.dot(&(now.origin - mean)), OFFSET_M);
    let sides = Matrix3x2::from_columns(&[u, v]);
    let information = sides.transpose() * from_planes.place_information;
    let mut place = all.left.fixed_view_mut::<2, 2>(2, 2);
    place += information * sides;
    let mut right = all.right.fixed_rows_mut::<2>(2);
    right -= information * shifted;
    all
}

/// The unit vector of an unknown.
fn unit(unknown: usize) -> Vector5<f64> {
    Vector5::from_fn(|i, _| f64::from(u8::from(i == unknown)))
}

/// Largest standard deviation of a line's place, metres, from the covariance of (axis, origin).
pub fn largest_place_sigma(covariance: &Matrix6<f64>) -> f64 {
    let place = covariance.fixed_view::<3, 3>(3, 3).into_owned();
    place.symmetric_eigenvalues().max().max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::super::depth_following::{Search, follow};
    use super::super::face_edge::FaceEdges;
    use super::super::hinge::candidates;
    use super::super::plane_segments::{Sampling, moving_patches};
    use super::super::test_data::{HINGE_M, WIDTH_M, door_recording, turn};
    use super::*;
    use crate::math::rigid::distance_to_line;

    /// The hinge that the planes of a door give, and the line aligned to its pictures; `share` of the
    /// whole opening is shown.
    fn aligned(share: f64) -> (Hinge, AlignedLine) {
        let recording = door_recording(24, |f| share * turn(f));
        let patches = moving_patches(&recording, Sampling::Coarse, None);
        let best = &candidates(&patches, 1)[0];
        let planes = best.hinge(&patches, &best.support, &FaceEdges::default()).unwrap();
        let surface = closed_door();
        let range = [planes.range()[0] - 0.1, planes.range()[1] + 0.1];
        let search = Search { range, ..Search::default() };
        let following = follow(&surface, &planes.geometry(), planes.reach(), &search, &recording);
        let line = align_line(&surface, &planes, &following, &recording);
        (planes, line)
    }

    fn closed_door() -> Surface {
        let [x, z] = HINGE_M;
        let at = |i: i32| {
            let (out, up) = (f64::from(i % 12) + 0.5, f64::from(i / 12) - 5.5);
            Point3::new(x + WIDTH_M / 12.0 * out, 0.08 * up, z)
        };
        let points = (0..144).map(at).collect();
        Surface { points, normal: -Vector3::z(), back: Vec::new() }
    }

    fn distance(line: &JointGeometry) -> f64 {
        distance_to_line(&Point3::new(HINGE_M[0], 0.0, HINGE_M[1]), &line.axis, &line.origin)
    }

    #[test]
    fn a_line_that_its_planes_give_well_is_kept() {
        let (planes, line) = aligned(1.0);
        assert!(planes.is_well_known());
        assert_eq!((line.geometry, line.rmse), (planes.geometry(), planes.rmse));
    }

    #[test]
    fn a_line_that_they_do_not_give_well_is_drawn_to_the_true_one() {
        let (planes, line) = aligned(0.3);
        assert!(!planes.is_well_known());
        assert!(line.rmse < 0.004, "{}", line.rmse);
        let (before, after) = (distance(&planes.geometry()), distance(&line.geometry));
        assert!(after < before.max(0.01), "{before} m off, then {after} m");
    }

    #[test]
    fn no_line_is_known_better_than_its_noise_allows_nor_along_itself() {
        let (_, line) = aligned(1.0);
        let place = largest_place_sigma(&line.covariance);
        assert!(place > 1e-5 && place < PRIOR_M, "{place}");
        let along = line.geometry.axis.into_inner();
        let block = line.covariance.fixed_view::<3, 3>(3, 3).into_owned();
        assert!((block * along).norm() < 1e-12);
    }

    #[test]
    fn an_unknown_thickness_takes_what_the_line_would_explain_as_well() {
        let mut system = LineEquations::zero();
        // Each reading measures a shift of the line less the thickness, which is unknown.
        (0..100).for_each(|_| system.add(&(unit(2) - unit(THICKNESS)), 0.0, 1.0));
        system.add(&unit(3), 0.0, 1.0);
        let information = information_of_line(&system);
        assert!(information[(2, 2)].abs() < 1e-9 && (information[(3, 3)] - 1.0).abs() < 1e-9);
        system.add(&unit(THICKNESS), 0.0, 100.0);
        assert!((information_of_line(&system)[(2, 2)] - 50.0).abs() < 1e-9, "half as well");
    }

    #[test]
    fn the_largest_deviation_of_a_place_is_that_of_its_worst_direction() {
        let covariance = Matrix6::from_diagonal(&Vector6::new(9.0, 9.0, 9.0, 1e-4, 4e-4, 0.0));
        assert!((largest_place_sigma(&covariance) - 0.02).abs() < 1e-12);
        assert_eq!(largest_place_sigma(&Matrix6::zeros()), 0.0);
    }
}
