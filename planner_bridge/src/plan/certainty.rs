//! Whether a joint is known well enough for a robot to move it.
//!
//! In: the joint as it was learned, with the covariance of its line, the standard deviation of its
//! present configuration (radians or metres), and the rig's limits of both. Out: nothing, or the
//! refusal that says what is not known well.

use super::error::PlanError;
use crate::joint_deviation::{axis_deviation_rad, hinge_deviation_m};
use crate::limits::Safety;
use linkage_skill::object::{Joint, JointKind};

/// Refuses a joint that was not learned well enough.
pub fn assure(joint: &Joint, safety: &Safety) -> Result<(), PlanError> {
    let uncertain = |what: String| PlanError::Uncertain { joint: joint.name.clone(), what };
    if joint.undecided {
        return Err(uncertain(format!("its type, {}, is not sure", joint.kind.name())));
    }
    if joint.kind == JointKind::Fixed {
        return Ok(());
    }
    let axis = axis_deviation_rad(joint)
        .ok_or_else(|| uncertain("how far its axis deviates is not known".to_owned()))?;
    if axis > safety.axis_deviation {
        let (is, limit) = (axis.to_degrees(), safety.axis_deviation.to_degrees());
        return Err(uncertain(format!("its axis deviates by {is:.1}°, {limit:.1}° are allowed")));
    }
    if joint.kind == JointKind::Prismatic {
        return Ok(());
    }
    let hinge = hinge_deviation_m(joint)
        .ok_or_else(|| uncertain("how far its hinge deviates is not known".to_owned()))?;
    if hinge > safety.hinge_deviation {
        let (is, limit) = (100.0 * hinge, 100.0 * safety.hinge_deviation);
        return Err(uncertain(format!("its hinge deviates by {is:.1} cm, {limit:.1} are allowed")));
    }
    Ok(())
}

/// Refuses a joint whose present configuration was not seen well enough.
pub fn assure_configuration(
    joint: &Joint,
    deviation: Option<f64>,
    safety: &Safety,
) -> Result<(), PlanError> {
    let unclear = |what: String| PlanError::Unclear { joint: joint.name.clone(), what };
    let deviation = deviation
        .filter(|deviation| deviation.is_finite() && *deviation > 0.0)
        .ok_or_else(|| unclear("how far it deviates is not known".to_owned()))?;
    match joint.kind {
        JointKind::Revolute | JointKind::Helical if deviation > safety.angle_deviation => {
            let (is, limit) = (deviation.to_degrees(), safety.angle_deviation.to_degrees());
            Err(unclear(format!("it deviates by {is:.1}°, {limit:.1}° are allowed")))
        }
        JointKind::Prismatic | JointKind::Nonparametric if deviation > safety.offset_deviation => {
            let (is, limit) = (100.0 * deviation, 100.0 * safety.offset_deviation);
            Err(unclear(format!("it deviates by {is:.1} cm, {limit:.1} are allowed")))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_data::fridge;
    use super::*;
    use crate::limits::Rig;

    #[test]
    fn a_configuration_that_was_not_seen_well_is_refused_with_how_far_it_deviates() {
        let (model, _) = fridge();
        let hinge = &model.joints[0];
        let slide = Joint { kind: JointKind::Prismatic, ..hinge.clone() };
        let safety = Rig::default().safety;
        let said = |joint: &Joint, deviation: f64| {
            assure_configuration(joint, Some(deviation), &safety).map_err(|e| e.to_string())
        };
        assert_eq!(said(hinge, 0.04), Ok(()));
        assert!(said(hinge, 0.2).unwrap_err().contains("deviates by 11.5°, 2.9° are allowed"));
        assert_eq!(said(&slide, 0.01), Ok(()));
        assert!(said(&slide, 0.04).unwrap_err().contains("deviates by 4.0 cm, 2.0 are allowed"));
        for nothing in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(said(hinge, nothing).unwrap_err().contains("is not known"));
        }
        assert!(assure_configuration(hinge, None, &safety).is_err());
    }
}
