//! How far a learned joint may be off: standard deviations of its direction and of its place, out of
//! the covariance of (axis, origin). They are `None` where nothing is known, which is not the same as
//! nothing deviating.

use linkage_skill::object::{Joint, JointKind};
use nalgebra::{Matrix3, Vector3};

/// Lesser of two variances as a share of the greater, below which it is none.
const LEAST_SHARE: f64 = 1e-12;

/// Greatest standard deviation of the axis' direction, radians.
pub fn axis_deviation_rad(joint: &Joint) -> Option<f64> {
    deviation_across(joint, 0)
}

/// Greatest standard deviation of a hinge's place across its axis, metres; `None` for a slide, which
/// has no place.
pub fn hinge_deviation_m(joint: &Joint) -> Option<f64> {
    (joint.kind != JointKind::Prismatic).then(|| deviation_across(joint, 3)).flatten()
}

/// Greatest standard deviation across the axis of what begins at a row of the joint's covariance:
/// its direction at 0, a point on it at 3. None where the covariance is missing, short, not
/// finite, or not positive.
fn deviation_across(joint: &Joint, from: usize) -> Option<f64> {
    let covariance = &joint.covariance;
    if covariance.len() != 6 || !covariance.iter().flatten().all(|x| x.is_finite()) {
        return None;
    }
    let block = Matrix3::from_fn(|r, c| covariance[from + r][from + c]);
    let along = Vector3::from(joint.axis).try_normalize(0.0)?;
    let across = Matrix3::identity() - along * along.transpose();
    let mut variances: Vec<f64> =
        (across * block * across).symmetric_eigenvalues().iter().copied().collect();
    // One of the three is that along the axis, which is 0.
    variances.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    let (least, greatest) = (variances[1].min(variances[2]), variances[1].max(variances[2]));
    (least > LEAST_SHARE * greatest && least > 0.0).then(|| greatest.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_skill::object::JointGeometry;
    use nalgebra::Point3;

    fn of(line: &JointGeometry, variances: [f64; 6]) -> Joint {
        let mut joint = Joint::of(line);
        joint.covariance = vec![[0.0; 6]; 6];
        (0..6).for_each(|i| joint.covariance[i][i] = variances[i]);
        joint
    }

    #[test]
    fn deviations_are_the_greatest_across_the_axis() {
        let hinge = JointGeometry::hinge(Vector3::y_axis(), Point3::origin());
        let joint = of(&hinge, [1e-4, 0.0, 4e-4, 9e-6, 1.0, 1e-6]);
        assert!((axis_deviation_rad(&joint).unwrap() - 0.02).abs() < 1e-12);
        assert!((hinge_deviation_m(&joint).unwrap() - 0.003).abs() < 1e-12);
    }

    #[test]
    fn a_slide_has_no_place_and_a_missing_covariance_tells_nothing() {
        let slide = JointGeometry::slide(Vector3::y_axis(), Point3::origin());
        assert_eq!(hinge_deviation_m(&of(&slide, [1e-4; 6])), None);
        let unknown = Joint { covariance: Vec::new(), ..Joint::of(&slide) };
        assert_eq!(axis_deviation_rad(&unknown), None);
    }
}
