//! Which way is up, which way the object faces, and how the boxes of its parts lie.
//!
//! The model does not know gravity: its object frame is the camera's of the first demonstration. But
//! people hold cameras upright, and furniture has level tops, upright fronts, and joints along
//! these. Up is the direction near the camera's up that most of the surface and the joints are
//! parallel or perpendicular to.

use linkage_skill::internals::orthonormal_basis;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use std::f64::consts::{FRAC_PI_2, PI};

/// Up of the camera in the object frame.
const CAMERA_UP: [f64; 3] = [0.0, -1.0, 0.0];
/// Towards the camera in the object frame.
const TO_CAMERA: [f64; 3] = [0.0, 0.0, -1.0];
/// A camera is tilted by less than this, radians.
const LARGEST_TILT_RAD: f64 = 0.8;
/// Directions this near to parallel or perpendicular are taken for it, radians.
const NEAR_RAD: f64 = 0.17;
/// Joints this near to parallel or perpendicular to up are made so, radians.
const SNAP_RAD: f64 = 0.1;
/// What a joint counts for, as a share of the whole surface.
const JOINT_WEIGHT: f64 = 0.3;
/// Most normals that are candidates for up.
const CANDIDATES: usize = 200;
/// Share of the upright surface that must face one of four directions to tell how a box lies.
const CLEAR_SHARE: f64 = 0.25;
/// Least number of normals that tell how a box lies.
const LEAST_NORMALS: usize = 30;

/// Rotation of the export's frame (z up, x towards the viewer) from the object frame.
pub fn world_from_object(normals: &[Vector3<f64>], axes: &[Vector3<f64>]) -> UnitQuaternion<f64> {
    let up = up(normals, axes);
    let level = |d: Vector3<f64>| (d - up * up.dot(&d)).try_normalize(1e-6);
    let forward = level(TO_CAMERA.into()).unwrap_or_else(|| orthonormal_basis(&up).0);
    // A slide, or the hinge of a lid, tells more precisely how the thing is turned than its surface.
    let level_axis = axes.iter().find(|a| up.dot(a).abs() < SNAP_RAD.sin()).and_then(|a| level(*a));
    let side = level_axis.or_else(|| facing(normals, &up)).unwrap_or(forward);
    let quarter = (0..4).map(|i| {
        Rotation3::from_axis_angle(
            &nalgebra::UnitVector3::new_unchecked(up),
            FRAC_PI_2 * f64::from(i),
        ) * side
    });
    let x = quarter.max_by(|a, b| a.dot(&forward).total_cmp(&b.dot(&forward))).unwrap_or(forward);
    rotation_of(x, up).inverse()
}

/// Rotation of a part's box: one side lies along `along`, the others as its surface lies about that,
/// or level and upright where the surface does not tell.
pub fn box_rotation(
    along: &Vector3<f64>,
    normals: &[Vector3<f64>],
    surface: &[Vector3<f64>],
) -> UnitQuaternion<f64> {
    let side = facing(normals, along).or_else(|| {
        let upright = Vector3::z() - along * along.z;
        if upright.norm() > 0.5 { upright.try_normalize(0.0) } else { narrowest(surface, along) }
    });
    rotation_of(side.unwrap_or_else(|| orthonormal_basis(along).0), *along)
}

/// The rotation whose x and z are these two; both are unit and perpendicular.
fn rotation_of(x: Vector3<f64>, z: Vector3<f64>) -> UnitQuaternion<f64> {
    let matrix = Matrix3::from_columns(&[x, z.cross(&x), z]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix))
}

/// True where two directions are parallel or perpendicular within an angle.
fn is_square(a: &Vector3<f64>, b: &Vector3<f64>, within_rad: f64) -> bool {
    let along = a.dot(b).abs();
    along > within_rad.cos() || along < within_rad.sin()
}

/// The direction near the camera's up that most is square to.
fn up(normals: &[Vector3<f64>], axes: &[Vector3<f64>]) -> Vector3<f64> {
    let camera_up = Vector3::from(CAMERA_UP);
    let stride = normals.len().div_ceil(CANDIDATES).max(1);
    let sample: Vec<Vector3<f64>> = normals.iter().step_by(stride).copied().collect();
    let upright = |a: &Vector3<f64>| (camera_up - a * a.dot(&camera_up)).try_normalize(0.3);
    let mut candidates = vec![camera_up];
    for direction in axes.iter().chain(&sample) {
        candidates.extend([*direction, -direction]);
        candidates.extend(upright(direction));
    }
    let tilt = |d: &Vector3<f64>| d.dot(&camera_up).clamp(-1.0, 1.0).acos();
    let score = |d: &Vector3<f64>| {
        let square = sample.iter().filter(|n| is_square(d, n, NEAR_RAD)).count() as f64;
        let joints = axes.iter().filter(|a| is_square(d, a, SNAP_RAD)).count() as f64;
        square / sample.len().max(1) as f64 + JOINT_WEIGHT * (joints - tilt(d) / LARGEST_TILT_RAD)
    };
    let near = candidates.into_iter().filter(|d| tilt(d) < LARGEST_TILT_RAD);
    let best = near.map(|d| (score(&d), d)).reduce(|a, b| if b.0 > a.0 { b } else { a });
    refined(best.map_or(camera_up, |(_, d)| d), &sample, axes)
}

/// Up as the joints along it or across it have it, and as the level surface has it where none is.
fn refined(up: Vector3<f64>, normals: &[Vector3<f64>], axes: &[Vector3<f64>]) -> Vector3<f64> {
    if let Some(axis) = axes.iter().find(|a| a.dot(&up).abs() > SNAP_RAD.cos()) {
        return axis * axis.dot(&up).signum();
    }
    let level = normals.iter().filter(|n| n.dot(&up) > NEAR_RAD.cos());
    let (sum, count) = level.fold((Vector3::zeros(), 0), |(sum, n), d| (sum + d, n + 1));
    let mean = if count < LEAST_NORMALS / 3 { up } else { sum.normalize() };
    let across = axes.iter().find(|a| a.dot(&mean).abs() < SNAP_RAD.sin());
    let square = across.map_or(mean, |a| mean - a * a.dot(&mean));
    square.try_normalize(1e-6).unwrap_or(up)
}

/// The direction across `about` that most normals across it are parallel or perpendicular to;
/// `None` where no direction is clear.
fn facing(normals: &[Vector3<f64>], about: &Vector3<f64>) -> Option<Vector3<f64>> {
    let (u, v) = orthonormal_basis(about);
    let across = normals.iter().filter(|n| n.dot(about).abs() < 0.5);
    let angles: Vec<f64> =
        across.map(|n| n.dot(&v).atan2(n.dot(&u)).rem_euclid(FRAC_PI_2)).collect();
    if angles.len() < LEAST_NORMALS {
        return None;
    }
    // Difference of two angles of which a quarter turn makes no other.
    let apart = |a: f64, b: f64| (a - b + FRAC_PI_2 / 2.0).rem_euclid(FRAC_PI_2) - FRAC_PI_2 / 2.0;
    let near =
        |at: f64| angles.iter().map(move |a| apart(*a, at)).filter(|d| d.abs() < NEAR_RAD / 2.0);
    let degrees = (0..90).map(|i| f64::from(i) * PI / 180.0);
    let (count, at) = degrees
        .map(|at| (near(at).count(), at))
        .reduce(|best, other| if other.0 > best.0 { other } else { best })?;
    if (count as f64) < CLEAR_SHARE * angles.len() as f64 {
        return None;
    }
    let mut offsets: Vec<f64> = near(at).collect();
    offsets.sort_by(f64::total_cmp);
    let angle = at + offsets[offsets.len() / 2];
    Some(u * angle.cos() + v * angle.sin())
}

/// The side of the rectangle of least area across `about` that holds the surface.
fn narrowest(surface: &[Vector3<f64>], about: &Vector3<f64>) -> Option<Vector3<f64>> {
    let (u, v) = orthonormal_basis(about);
    let extent = |d: &Vector3<f64>| {
        let along = surface.iter().map(|p| p.dot(d));
        let (low, high) =
            along.fold((f64::MAX, f64::MIN), |(low, high), x| (low.min(x), high.max(x)));
        high - low
    };
    let directions = (0..45).map(|i| {
        let angle = f64::from(i) * PI / 90.0;
        u * angle.cos() + v * angle.sin()
    });
    let area = |d: &Vector3<f64>| extent(d) * extent(&about.cross(d));
    let measured = directions.map(|d| (area(&d), d)).filter(|_| surface.len() > 2);
    measured.reduce(|a, b| if b.0 < a.0 { b } else { a }).map(|(_, d)| d)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Normals of a chest's front, top and one side, that a camera sees which is pitched and rolled.
    fn chest(camera_from_level: &Rotation3<f64>) -> Vec<Vector3<f64>> {
        let turned = |d: [f64; 3]| camera_from_level * Vector3::from(d);
        let noise = |i: usize| 0.03 * Vector3::new((i as f64).sin(), (2.7 * i as f64).cos(), 0.0);
        let (front, top, side) = ([0.3, 0.0, -0.954], [0.0, -1.0, 0.0], [0.954, 0.0, 0.3]);
        let faces = [(front, 200), (top, 80), (side, 40)];
        let normals = faces
            .into_iter()
            .flat_map(|(n, count)| (0..count).map(move |i| (turned(n) + noise(i)).normalize()));
        normals.collect()
    }

    #[test]
    fn up_is_what_the_thing_s_top_and_joints_say_however_the_camera_was_held() {
        for (pitch, roll) in [(0.0, 0.0), (0.45, 0.0), (-0.2, 0.1), (0.3, -0.15)] {
            let camera_from_level = Rotation3::from_euler_angles(pitch, 0.0, roll);
            let normals = chest(&camera_from_level);
            let slide = camera_from_level * Vector3::new(0.3, 0.0, -0.954).normalize();
            for axes in [vec![], vec![slide]] {
                let world = world_from_object(&normals, &axes);
                let up = world * (camera_from_level * -Vector3::y());
                assert!(up.z > 0.03_f64.cos(), "{pitch} {roll}: {up}");
                let front = world * slide;
                assert!(front.x > 0.03_f64.cos(), "{pitch} {roll}: {front}");
            }
        }
    }

    #[test]
    fn without_surface_or_joints_up_is_the_camera_s() {
        let up = world_from_object(&[], &[]) * Vector3::from(CAMERA_UP);
        assert!((up - Vector3::z()).norm() < 1e-12, "{up}");
    }

    #[test]
    fn a_box_lies_along_its_joint_and_as_its_surface_does() {
        let axis = Vector3::new(0.02, 0.01, 1.0).normalize();
        let tilt = UnitQuaternion::rotation_between(&Vector3::z(), &axis).unwrap();
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.4);
        let front: Vec<Vector3<f64>> = vec![tilt * turn * Vector3::x(); 50];
        let rotation = box_rotation(&axis, &front, &[]);
        assert!((rotation * Vector3::z() - axis).norm() < 1e-9);
        let seen = rotation.inverse() * front[0];
        assert!(is_square(&seen, &Vector3::x(), 0.02), "{seen}");
    }
}
