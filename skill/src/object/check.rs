//! Checks of a model, whatever its source. Kinematics, planning and reports rely on it: they index
//! parts by their numbers and multiply motions down the tree.

use super::model::{
    Joint, LARGEST_VARIANCE, MODEL_SCHEMA, ObjectModel, Part, ROUNDING, ReferenceFrame,
    is_covariance,
};
use linkage_frames::plain_text::is_control;
use std::collections::HashSet;
use std::fmt::Display;

/// Most parts of an object, the base among them.
pub const MOST_PARTS: usize = 256;
/// Longest name, bytes.
pub const LONGEST_NAME: usize = 255;
/// Largest configuration of a joint, radians or metres.
pub const LARGEST_CONFIGURATION: f64 = 1_000.0;
/// Largest distance from the origin, and largest pitch, metres.
const LARGEST_LENGTH: f64 = 1e4;
/// Largest time, seconds: what microseconds in 64 bits can tell.
const LARGEST_TIME: f64 = 1e13;
/// How far from 1 the length of a unit vector or of a unit quaternion may be.
const UNIT_TOLERANCE: f64 = 1e-6;

/// A model that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {reason}")]
pub struct InvalidModel {
    /// The field, as in the JSON: `joints[1].axis`.
    pub place: String,
    /// What is wrong with it.
    pub reason: String,
}

type Checked = Result<(), InvalidModel>;

fn wrong(place: impl Display, reason: impl Display) -> InvalidModel {
    InvalidModel { place: place.to_string(), reason: reason.to_string() }
}

fn ensure(holds: bool, place: impl Display, reason: impl Display) -> Checked {
    if holds { Ok(()) } else { Err(wrong(place, reason)) }
}

impl ObjectModel {
    /// Tells whether this is a model that everything here can work with: a tree of parts, its
    /// joints in order, all numbers finite and within bounds. Models from files are checked as
    /// they are read; learned ones as they are stored.
    ///
    /// # Errors
    /// [`InvalidModel`] says what is wrong, and where.
    pub fn check(&self) -> Result<(), InvalidModel> {
        check(self)
    }
}

/// Checks a whole model.
fn check(model: &ObjectModel) -> Checked {
    let schema = format!("must be \"{MODEL_SCHEMA}\"");
    ensure(model.schema == MODEL_SCHEMA, "schema", schema)?;
    check_name(&model.object).map_err(|reason| wrong("object", reason))?;
    check_text("profile", &model.profile)?;
    check_text("version", &model.version)?;
    check_frame(&model.reference_frame)?;
    check_parts(&model.parts)?;
    check_tree(model)?;
    model.joints.iter().enumerate().try_for_each(|(i, joint)| check_joint(i, joint))
}

/// Checks the name of an object, a part or a joint.
///
/// # Errors
/// What is wrong with it, in words.
pub fn check_name(name: &str) -> Result<(), String> {
    if name.trim().is_empty() {
        return Err("a name is needed".to_owned());
    }
    if name.len() > LONGEST_NAME {
        return Err(format!("the name has {} bytes, at most {LONGEST_NAME} can be", name.len()));
    }
    match name.chars().find(|c| is_control(*c)) {
        Some(c) => Err(format!("the name {name:?} has the control character {c:?}")),
        None => Ok(()),
    }
}

fn check_text(place: &str, text: &str) -> Checked {
    let is_plain = text.len() <= LONGEST_NAME && !text.contains(is_control);
    ensure(is_plain, place, "it is too long, or has control characters")
}

/// Refuses what is not finite or too large.
fn check_numbers(place: impl Display, numbers: &[f64], largest: f64) -> Checked {
    match numbers.iter().find(|x| !x.is_finite() || x.abs() > largest) {
        Some(x) if !x.is_finite() => Err(wrong(place, format!("{x} is not a finite number"))),
        Some(x) => Err(wrong(place, format!("{x} is beyond {largest}"))),
        None => Ok(()),
    }
}

fn check_unit(place: impl Display, numbers: &[f64]) -> Checked {
    check_numbers(&place, numbers, LARGEST_LENGTH)?;
    let length = numbers.iter().map(|x| x * x).sum::<f64>().sqrt();
    let is_unit = (length - 1.0).abs() <= UNIT_TOLERANCE;
    ensure(is_unit, place, format!("its length is {length}, not 1"))
}

fn check_frame(frame: &ReferenceFrame) -> Checked {
    check_numbers("reference_frame.t", &[frame.t], LARGEST_TIME)?;
    let (position, quaternion) = frame.camera_from_object.split_at(3);
    let place = "reference_frame.camera_from_object";
    check_numbers(place, position, LARGEST_LENGTH)?;
    check_unit(place, quaternion)
}

fn check_parts(parts: &[Part]) -> Checked {
    let count = format!("{} parts, 1 to {MOST_PARTS} can be", parts.len());
    ensure((1..=MOST_PARTS).contains(&parts.len()), "parts", count)?;
    let mut names = HashSet::new();
    for (i, part) in parts.iter().enumerate() {
        ensure(part.id == i, format!("parts[{i}].id"), format!("{} instead of {i}", part.id))?;
        check_name(&part.name).map_err(|reason| wrong(format!("parts[{i}].name"), reason))?;
        let is_new = names.insert(&part.name);
        ensure(is_new, format!("parts[{i}].name"), format!("\"{}\" comes twice", part.name))?;
        let grasp = part.grasp.unwrap_or_default();
        check_numbers(format!("parts[{i}].grasp"), &grasp, LARGEST_LENGTH)?;
    }
    Ok(())
}

/// Each part but the base is moved by one joint, which comes after the one that moves its parent.
fn check_tree(model: &ObjectModel) -> Checked {
    let (parts, joints) = (model.parts.len(), model.joints.len());
    let count = format!("{joints} joints of {parts} parts: each part but the base needs one");
    ensure(joints + 1 == parts, "joints", count)?;
    let mut is_placed = vec![false; parts];
    is_placed[0] = true;
    let mut names = HashSet::new();
    for (i, joint) in model.joints.iter().enumerate() {
        let place = |field: &str| format!("joints[{i}].{field}");
        let Joint { name, parent, child, .. } = joint;
        check_name(name).map_err(|reason| wrong(place("name"), reason))?;
        ensure(names.insert(name), place("name"), format!("\"{name}\" comes twice"))?;
        let outside = |part: &usize| format!("no part {part}: there are {parts}");
        ensure(*parent < parts, place("parent"), outside(parent))?;
        ensure(*child < parts, place("child"), outside(child))?;
        let early = format!("part {parent} is moved by no earlier joint");
        ensure(is_placed[*parent], place("parent"), early)?;
        let twice = format!("part {child} is the base, or moved by an earlier joint");
        ensure(!is_placed[*child], place("child"), twice)?;
        is_placed[*child] = true;
    }
    Ok(())
}

fn check_joint(i: usize, joint: &Joint) -> Checked {
    let place = |field: &str| format!("joints[{i}].{field}");
    check_unit(place("axis"), &joint.axis)?;
    check_numbers(place("origin"), &joint.origin, LARGEST_LENGTH)?;
    check_numbers(place("pitch"), &[joint.pitch], LARGEST_LENGTH)?;
    check_numbers(place("range"), &joint.range, LARGEST_CONFIGURATION)?;
    let [low, high] = joint.range;
    ensure(low <= high, place("range"), format!("{low} to {high} is not in order"))?;
    check_covariance(&place("covariance"), joint)?;
    let fit = [joint.bic, joint.log_likelihood];
    check_numbers(place("bic"), &fit, f64::MAX)?;
    let rmse = [joint.position_rmse, joint.orientation_rmse];
    check_numbers(place("position_rmse"), &rmse, LARGEST_LENGTH)?;
    ensure(rmse.iter().all(|x| *x >= 0.0), place("position_rmse"), "it is below 0")?;
    let times: Vec<f64> = joint.configuration.iter().map(|c| c[0]).collect();
    let values: Vec<f64> = joint.configuration.iter().map(|c| c[1]).collect();
    check_numbers(place("configuration"), &times, LARGEST_TIME)?;
    check_numbers(place("configuration"), &values, LARGEST_CONFIGURATION)?;
    let is_probability = |p: &f64| (-ROUNDING..=1.0 + ROUNDING).contains(p);
    let are_probabilities = joint.type_probabilities.values().all(is_probability);
    ensure(are_probabilities, place("type_probabilities"), "one is not between 0 and 1")
}

fn check_covariance(place: &str, joint: &Joint) -> Checked {
    if joint.covariance.is_empty() {
        return Ok(());
    }
    let size = format!("{} rows: 6, or none, can be", joint.covariance.len());
    let covariance = joint.known_covariance().ok_or_else(|| wrong(place, size))?;
    check_numbers(place, covariance.as_slice(), LARGEST_VARIANCE)?;
    ensure(is_covariance(&covariance), place, "it is not symmetric, or has an eigenvalue below 0")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object::joint_geometry::JointGeometry;
    use crate::object::model::covariance_rows;
    use crate::object::model::tests::door;
    use nalgebra::{Matrix6, Point3, Vector3};

    /// A door with a handle on it.
    fn with_handle() -> ObjectModel {
        let mut model = door();
        let slide = JointGeometry::slide(Vector3::x_axis(), Point3::origin());
        let (name, parent, child) = ("joint2".to_owned(), 1, 2);
        model.joints.push(Joint { name, parent, child, ..Joint::of(&slide) });
        model.parts.push(Part::new(2, "part2", 3));
        model
    }

    fn says(change: impl Fn(&mut ObjectModel)) -> String {
        let mut model = with_handle();
        change(&mut model);
        model.check().unwrap_err().to_string()
    }

    #[test]
    fn a_tree_of_parts_is_a_model() {
        assert_eq!(with_handle().check(), Ok(()));
        let mut base_alone = door();
        base_alone.joints.clear();
        base_alone.parts.truncate(1);
        assert_eq!(base_alone.check(), Ok(()));
    }

    #[test]
    fn what_is_no_tree_is_refused_with_its_place() {
        assert!(says(|m| m.joints.swap(0, 1)).starts_with("joints[0].parent: part 1"));
        assert!(says(|m| m.joints[1].child = 7).starts_with("joints[1].child: no part 7"));
        assert!(says(|m| m.joints[1].parent = 2).starts_with("joints[1].parent"));
        assert!(says(|m| m.joints[1].child = 1).starts_with("joints[1].child"));
        assert!(says(|m| m.joints[0].child = 0).starts_with("joints[0].child"));
        assert!(says(|m| m.joints.truncate(1)).starts_with("joints: 1 joints of 3 parts"));
        assert!(says(|m| m.parts.clear()).starts_with("parts: 0 parts"));
        assert!(says(|m| m.parts[1].id = 2).starts_with("parts[1].id"));
        let many = |m: &mut ObjectModel| {
            let part = |i: usize| Part::new(i, format!("part{i}"), 0);
            m.parts = (0..=MOST_PARTS).map(part).collect();
        };
        assert!(says(many).starts_with("parts: 257 parts"));
    }

    #[test]
    fn numbers_that_nothing_can_be_done_with_are_refused_with_their_place() {
        for (x, joint) in [(f64::NAN, 0), (f64::INFINITY, 1), (-1e300, 0)] {
            let place = format!("joints[{joint}].");
            let check = |set: fn(&mut Joint, f64), field: &str| {
                let said = says(|m| set(&mut m.joints[joint], x));
                assert!(said.starts_with(&format!("{place}{field}")), "{field}: {said}");
            };
            check(|j, x| j.axis[1] = x, "axis");
            check(|j, x| j.origin[2] = x, "origin");
            check(|j, x| j.pitch = x, "pitch");
            check(|j, x| j.range[0] = x, "range");
            check(|j, x| j.covariance[3][3] = x, "covariance");
            check(|j, x| j.position_rmse = x, "position_rmse");
            check(|j, x| j.configuration = vec![[0.0, x]], "configuration");
            check(|j, x| j.type_probabilities = [(j.kind, x)].into(), "type_probabilities");
            assert!(says(|m| m.reference_frame.t = x).starts_with("reference_frame.t"));
            assert!(says(|m| m.parts[1].grasp = Some([0.0, x, 0.0])).starts_with("parts[1].grasp"));
        }
        assert!(says(|m| m.joints[0].bic = f64::NAN).starts_with("joints[0].bic"));
        assert!(says(|m| m.joints[0].axis = [0.0, 0.5, 0.0]).contains("its length is 0.5"));
        assert!(says(|m| m.joints[0].range = [1.0, -1.0]).contains("not in order"));
        let no_turn = |m: &mut ObjectModel| m.reference_frame.camera_from_object = [0.0; 7];
        assert!(says(no_turn).starts_with("reference_frame.camera_from_object"));
    }

    #[test]
    fn a_covariance_is_symmetric_and_nowhere_negative_or_not_there() {
        assert!(says(|m| m.joints[0].covariance.truncate(3)).contains("3 rows"));
        assert!(says(|m| m.joints[0].covariance[0][1] = 1e-3).contains("not symmetric"));
        assert!(says(|m| m.joints[0].covariance[2][2] = -1e-3).contains("below 0"));
        let mut unknown = door();
        unknown.joints[0].covariance.clear();
        assert_eq!(unknown.check(), Ok(()));
    }

    #[test]
    fn rounding_leaves_a_covariance_one_and_a_failed_fit_none() {
        let mut rounded = Matrix6::from_diagonal_element(1e-4);
        rounded[(0, 1)] = 1e-14;
        rounded[(5, 5)] = -1e-14;
        let rows = covariance_rows(&rounded);
        assert!(rows[0][1] == rows[1][0] && rows.len() == 6);
        rounded[(5, 5)] = f64::NAN;
        assert!(covariance_rows(&rounded).is_empty());
    }

    #[test]
    fn names_are_there_are_short_and_print() {
        for name in ["", "  ", "door\n", "do\u{0}or", "\u{1b}[31m", &"x".repeat(300)] {
            assert!(says(|m| m.object = name.to_owned()).starts_with("object: "), "{name:?}");
            assert!(says(|m| m.joints[1].name = name.to_owned()).starts_with("joints[1].name"));
            assert!(says(|m| m.parts[1].name = name.to_owned()).starts_with("parts[1].name"));
        }
        assert!(says(|m| m.joints[1].name = "joint1".to_owned()).contains("comes twice"));
        assert!(says(|m| m.parts[2].name = "base".to_owned()).contains("comes twice"));
        assert!(says(|m| m.schema = "linkage.model/2".to_owned()).starts_with("schema"));
        assert!(says(|m| m.profile = "\u{7}".to_owned()).starts_with("profile"));
    }

    #[test]
    fn what_is_read_is_checked() {
        let mut json = serde_json::to_value(with_handle()).unwrap();
        json["joints"][1]["child"] = 9.into();
        let refused = serde_json::from_value::<ObjectModel>(json).unwrap_err().to_string();
        assert!(refused.contains("joints[1].child: no part 9"), "{refused}");
    }
}
