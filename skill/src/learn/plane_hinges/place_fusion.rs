//! Fuses two estimates of the place of a hinge's line: from its tracks, and from its planes.
//!
//! In: the joint that tracks showed, and the same hinge as a plain part has it, both in the base frame.
//! Out: the tracks' line, shifted to the weighted mean of both places.
//! From: Kalman update. Measured: tracks on a plain door are few and slip along its edges and reflections; those of
//! one dishwasher put the line 5.7 cm off, its planes 1.0 cm.

use crate::learn::learned_joint::LearnedJoint;
use crate::math::rigid::orthonormal_basis;
use crate::object::model::{Joint, covariance_rows};
use nalgebra::{Matrix2, Matrix2x3, Matrix2x6, Vector2, Vector3, Vector6};

/// Largest squared Mahalanobis distance between both places: of one hinge 99.9 % are nearer (chi-squared with two
/// degrees of freedom).
const MAX_DIFFERENCE_SQ: f64 = 13.8;

/// Shifts a tracked joint's line to the weighted mean of its place and a plain part's (Kalman update). False if their
/// covariances are not known, or if the places contradict each other.
pub fn fuse_place(tracked: &mut LearnedJoint, plain: &Joint) -> bool {
    let joint = &mut tracked.joint;
    let Some(covariance) = joint.known_covariance() else { return false };
    let axis = Vector3::from(joint.axis);
    let Some(Measured { shift, covariance: noise, across }) = measured(joint, plain) else {
        return false;
    };
    let mut place = Matrix2x6::zeros();
    place.fixed_view_mut::<2, 3>(0, 3).copy_from(&across);
    let Some(information) = (place * covariance * place.transpose() + noise).try_inverse() else {
        return false;
    };
    if shift.dot(&(information * shift)) > MAX_DIFFERENCE_SQ {
        return false;
    }
    let gain = covariance * place.transpose() * information;
    let step: Vector6<f64> = gain * shift;
    joint.axis = (axis + step.fixed_rows::<3>(0)).normalize().into();
    joint.origin = (Vector3::from(joint.origin) + step.fixed_rows::<3>(3)).into();
    joint.covariance = covariance_rows(&(covariance - gain * place * covariance));
    true
}

/// Place of a plain part's line relative to a tracked joint's origin.
struct Measured {
    /// Shift from the joint's origin to the plain part's line, along two directions across the joint's axis, metres.
    shift: Vector2<f64>,
    covariance: Matrix2<f64>,
    /// The two directions of the shift, unit vectors.
    across: Matrix2x3<f64>,
}

fn measured(joint: &Joint, plain: &Joint) -> Option<Measured> {
    let covariance = plain.known_covariance()?;
    let [axis, origin] = [joint.axis, joint.origin].map(Vector3::from);
    let [other_axis, other_origin] = [plain.axis, plain.origin].map(Vector3::from);
    let (u, v) = orthonormal_basis(&axis);
    let across = Matrix2x3::from_rows(&[u.transpose(), v.transpose()]);
    // The plain part's line is evaluated beside the joint's origin; an error of its direction shifts this place in
    // proportion to the distance from its own origin.
    let way = axis.dot(&(origin - other_origin)) / axis.dot(&other_axis);
    let shift = across * (other_origin + other_axis * way - origin);
    let mut place = Matrix2x6::zeros();
    place.fixed_view_mut::<2, 3>(0, 0).copy_from(&(across * way));
    place.fixed_view_mut::<2, 3>(0, 3).copy_from(&across);
    let measured = Measured { shift, covariance: place * covariance * place.transpose(), across };
    shift.iter().all(|s| s.is_finite()).then_some(measured)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object::joint_geometry::JointGeometry;
    use nalgebra::{Matrix6, Point3, UnitVector3};
    use proptest::prelude::*;

    /// A hinge along z, or turned from it, with standard deviations of direction and place.
    fn line(direction: [f64; 3], origin: [f64; 3], sigmas: [f64; 2]) -> Joint {
        let axis = UnitVector3::new_normalize(Vector3::from(direction));
        let [direction, place] = sigmas.map(|s| s * s);
        let diagonal = Vector6::new(direction, direction, direction, place, place, place);
        Joint {
            covariance: covariance_rows(&Matrix6::from_diagonal(&diagonal)),
            ..Joint::of(&JointGeometry::hinge(axis, Point3::from(origin)))
        }
    }

    fn tracked(joint: Joint) -> LearnedJoint {
        LearnedJoint {
            joint,
            base_from_part: Vec::new(),
            tracks: Vec::new(),
            plain_surface: Vec::new(),
        }
    }

    #[test]
    fn of_two_places_that_are_known_alike_the_middle_is_taken_and_known_better() {
        let mut joint = tracked(line([0.0, 0.0, 1.0], [0.0; 3], [0.001, 0.02]));
        assert!(fuse_place(&mut joint, &line([0.0, 0.0, -1.0], [0.04, 0.0, 0.0], [0.0, 0.02])));
        let [x, y, z] = joint.joint.origin;
        assert!((x - 0.02).abs() < 1e-9 && y.abs() < 1e-9 && z.abs() < 1e-9);
        assert!((joint.joint.covariance[3][3].sqrt() - 0.02 / 2.0_f64.sqrt()).abs() < 1e-6);
        assert_eq!(joint.joint.axis, [0.0, 0.0, 1.0]);
    }

    #[test]
    fn a_place_that_is_known_well_stays() {
        let mut joint = tracked(line([0.0, 0.0, 1.0], [0.0; 3], [0.001, 0.002]));
        assert!(fuse_place(&mut joint, &line([0.0, 0.0, 1.0], [0.07, 0.0, 0.0], [0.0, 0.03])));
        assert!(joint.joint.origin[0] < 0.001);
    }

    #[test]
    fn places_that_contradict_each_other_are_not_mixed() {
        let before = line([0.0, 0.0, 1.0], [0.0; 3], [0.001, 0.005]);
        let mut joint = tracked(before.clone());
        assert!(!fuse_place(&mut joint, &line([0.0, 0.0, 1.0], [0.05, 0.0, 0.0], [0.0, 0.005])));
        assert_eq!(joint.joint.origin, before.origin);
    }

    #[test]
    fn a_direction_that_is_not_known_says_little_of_the_place_far_along_the_line() {
        let shifted = |way: f64| {
            let mut joint = tracked(line([0.0, 0.0, 1.0], [0.0; 3], [0.0, 0.02]));
            let plain = line([0.0, 0.0, 1.0], [0.03, 0.0, way], [0.05, 0.01]);
            assert!(fuse_place(&mut joint, &plain));
            joint.joint.origin[0]
        };
        assert!(shifted(0.0) > 0.02 && shifted(1.0) < 0.01);
    }

    proptest! {
        #[test]
        fn what_is_fused_lies_between_both(
            shift in prop::array::uniform2(-0.02..0.02_f64), z in -1.0..1.0_f64, sigma in 0.005..0.05_f64,
        ) {
            let mut joint = tracked(line([0.0, 0.0, 1.0], [0.0; 3], [0.001, 0.02]));
            let plain = line([0.0, 0.0, 1.0], [shift[0], shift[1], z], [0.0, sigma]);
            if fuse_place(&mut joint, &plain) {
                for (fused, full) in joint.joint.origin.iter().zip(shift) {
                    prop_assert!(fused.abs() <= full.abs() + 1e-12 && fused * full >= -1e-12);
                }
            }
        }
    }
}
