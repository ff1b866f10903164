//! What was recognised and predicted, read item by item.

use crate::boundary::{Failure, c_text, call, free, given, linkage_result, place};
use linkage_planner_bridge::Prediction;
use linkage_skill::recognise::{JointState, Recognised, Recognition};
use std::ffi::{CString, c_char};

/// What was recognised in a frame, best first.
#[allow(non_camel_case_types)]
pub struct linkage_recognition {
    found: Recognition,
    texts: Vec<MatchTexts>,
}

struct MatchTexts {
    object: CString,
    /// Of each joint its name, its type, and why its configuration is not known.
    joints: Vec<[CString; 3]>,
}

impl linkage_recognition {
    pub(crate) fn new(found: Recognition) -> Self {
        let joint = |j: &JointState| {
            [j.name.as_str(), j.kind.name(), j.reason.as_deref().unwrap_or_default()].map(c_text)
        };
        let texts = found
            .matches
            .iter()
            .map(|m| MatchTexts {
                object: c_text(&m.object),
                joints: m.joints.iter().map(joint).collect(),
            })
            .collect();
        Self { found, texts }
    }

    pub(crate) fn found(&self, index: usize) -> Result<&Recognised, Failure> {
        item(&self.found.matches, index, "match")
    }
}

fn item<'a, T>(list: &'a [T], index: usize, what: &str) -> Result<&'a T, Failure> {
    list.get(index).ok_or_else(|| Failure::bad(format!("{what} {index} of {}", list.len())))
}

/// A recognised object.
#[allow(non_camel_case_types)]
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct linkage_match {
    /// Its name.
    pub object: *const c_char,
    /// 0 to 1.
    pub score: f64,
    /// Pose of the object frame.
    pub camera_from_object: [f64; 7],
    /// False where nothing tells where the base is: `camera_from_object` is then a guess, while
    /// the joints are right.
    pub base_known: bool,
    /// Number of its joints.
    pub joint_count: usize,
}

/// A joint of a recognised object, in the camera frame.
#[allow(non_camel_case_types)]
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct linkage_joint {
    /// Its name.
    pub name: *const c_char,
    /// prismatic, revolute, helical or nonparametric.
    pub kind: *const c_char,
    /// Unit direction.
    pub axis: [f64; 3],
    /// A point on it, metres.
    pub origin: [f64; 3],
    /// Metres a turn, of helical joints; else 0.
    pub pitch: f64,
    /// Least and greatest configuration that was demonstrated.
    pub range: [f64; 2],
    /// False where nothing that was seen tells the configuration.
    pub configuration_known: bool,
    /// Radians or metres; NaN where it is not known.
    pub configuration: f64,
    /// Why it is not known; empty where it is.
    pub reason: *const c_char,
}

/// Number of recognised objects; 0 for NULL.
///
/// # Safety
/// `recognition` is NULL, or came from linkage_recognise.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_match_count(recognition: *const linkage_recognition) -> usize {
    let mut count = 0;
    call(|| {
        // SAFETY: the caller promises it.
        count = unsafe { given(recognition, "recognition") }?.found.matches.len();
        Ok(())
    });
    count
}

/// A recognised object, the best at index 0.
///
/// # Safety
/// `recognition` came from linkage_recognise; `out` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_match_at(
    recognition: *const linkage_recognition,
    index: usize,
    out: *mut linkage_match,
) -> linkage_result {
    call(|| {
        // SAFETY: the caller promises it.
        let (recognition, out) =
            unsafe { (given(recognition, "recognition")?, place(out, "out")?) };
        let found = recognition.found(index)?;
        *out = linkage_match {
            object: recognition.texts[index].object.as_ptr(),
            score: found.score,
            camera_from_object: found.camera_from_object,
            base_known: found.base_known,
            joint_count: found.joints.len(),
        };
        Ok(())
    })
}

/// A joint of a recognised object.
///
/// # Safety
/// `recognition` came from linkage_recognise; `out` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_joint_at(
    recognition: *const linkage_recognition,
    match_index: usize,
    joint_index: usize,
    out: *mut linkage_joint,
) -> linkage_result {
    call(|| {
        // SAFETY: the caller promises it.
        let (recognition, out) =
            unsafe { (given(recognition, "recognition")?, place(out, "out")?) };
        let joint = item(&recognition.found(match_index)?.joints, joint_index, "joint")?;
        let [name, kind, reason] = &recognition.texts[match_index].joints[joint_index];
        *out = linkage_joint {
            name: name.as_ptr(),
            kind: kind.as_ptr(),
            axis: joint.axis,
            origin: joint.origin,
            pitch: joint.pitch,
            range: joint.range,
            configuration_known: joint.configuration.is_some(),
            configuration: joint.configuration.unwrap_or(f64::NAN),
            reason: reason.as_ptr(),
        };
        Ok(())
    })
}

/// Frees a recognition. NULL is left alone.
///
/// # Safety
/// `recognition` is NULL, or came from linkage_recognise and is not used any more.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_free_recognition(recognition: *mut linkage_recognition) {
    // SAFETY: the caller promises it.
    unsafe { free(recognition) }
}

/// A planned motion: a trajectory for each joint that moves, a path for each part that it moves,
/// and one for what a gripper holds on such a part.
#[allow(non_camel_case_types)]
pub struct linkage_prediction {
    trajectories: Vec<(CString, Vec<[f64; 4]>)>,
    parts: Vec<Path>,
    handles: Vec<Path>,
}

/// A part's name, and `[t, x, y, z, qx, qy, qz, qw]`.
type Path = (CString, Vec<[f64; 8]>);

impl linkage_prediction {
    pub(crate) fn new(prediction: Prediction) -> Self {
        let moving = prediction.joints.into_iter().filter(|j| !j.trajectory.is_empty());
        let path = |p: linkage_planner_bridge::plan::PlannedPart| (c_text(&p.name), p.poses);
        Self {
            trajectories: moving.map(|j| (c_text(&j.state.name), j.trajectory)).collect(),
            parts: prediction.parts.into_iter().map(path).collect(),
            handles: prediction.handles.into_iter().map(path).collect(),
        }
    }

    fn paths(&self, kind: u32) -> Result<&[Path], Failure> {
        if kind == linkage_path_kind::Part as u32 {
            Ok(&self.parts)
        } else if kind == linkage_path_kind::Handle as u32 {
            Ok(&self.handles)
        } else {
            Err(Failure::bad(format!("path kind {kind} is none")))
        }
    }
}

/// The motion of one joint.
#[allow(non_camel_case_types)]
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct linkage_trajectory {
    /// The joint's name.
    pub joint: *const c_char,
    /// Number of its points, at least two.
    pub point_count: usize,
}

/// A joint at an instant.
#[allow(non_camel_case_types)]
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct linkage_point {
    /// Seconds from the start.
    pub time: f64,
    /// Configuration; radians or metres.
    pub position: f64,
    /// Velocity.
    pub velocity: f64,
    /// Acceleration.
    pub acceleration: f64,
}

/// Which paths are meant.
#[allow(non_camel_case_types)]
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum linkage_path_kind {
    /// Of the parts' own frames.
    Part = 0,
    /// Of what a gripper holds.
    Handle = 1,
}

/// The way of a part, or of what a gripper holds on it.
#[allow(non_camel_case_types)]
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct linkage_path {
    /// The part's name.
    pub part: *const c_char,
    /// Number of its poses, at least two.
    pub pose_count: usize,
}

/// Where something is at an instant.
#[allow(non_camel_case_types)]
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct linkage_pose {
    /// Seconds from the start.
    pub time: f64,
    /// x y z qx qy qz qw, into the camera frame.
    pub camera_from_it: [f64; 7],
}

/// Number of joints that move; 0 for NULL.
///
/// # Safety
/// `prediction` is NULL, or came from linkage_predict.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_trajectory_count(prediction: *const linkage_prediction) -> usize {
    let mut count = 0;
    call(|| {
        // SAFETY: the caller promises it.
        count = unsafe { given(prediction, "prediction") }?.trajectories.len();
        Ok(())
    });
    count
}

/// The trajectory of a joint that moves.
///
/// # Safety
/// `prediction` came from linkage_predict; `out` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_trajectory_at(
    prediction: *const linkage_prediction,
    index: usize,
    out: *mut linkage_trajectory,
) -> linkage_result {
    call(|| {
        // SAFETY: the caller promises it.
        let (prediction, out) = unsafe { (given(prediction, "prediction")?, place(out, "out")?) };
        let (joint, points) = item(&prediction.trajectories, index, "trajectory")?;
        *out = linkage_trajectory { joint: joint.as_ptr(), point_count: points.len() };
        Ok(())
    })
}

/// A point of a trajectory.
///
/// # Safety
/// `prediction` came from linkage_predict; `out` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_point_at(
    prediction: *const linkage_prediction,
    trajectory_index: usize,
    point_index: usize,
    out: *mut linkage_point,
) -> linkage_result {
    call(|| {
        // SAFETY: the caller promises it.
        let (prediction, out) = unsafe { (given(prediction, "prediction")?, place(out, "out")?) };
        let (_, points) = item(&prediction.trajectories, trajectory_index, "trajectory")?;
        let &[time, position, velocity, acceleration] = item(points, point_index, "point")?;
        *out = linkage_point { time, position, velocity, acceleration };
        Ok(())
    })
}

/// Number of paths of a kind (linkage_path_kind); 0 for NULL.
///
/// # Safety
/// `prediction` is NULL, or came from linkage_predict.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_path_count(
    prediction: *const linkage_prediction,
    kind: u32,
) -> usize {
    let mut count = 0;
    call(|| {
        // SAFETY: the caller promises it.
        count = unsafe { given(prediction, "prediction") }?.paths(kind)?.len();
        Ok(())
    });
    count
}

/// A path of a kind (linkage_path_kind).
///
/// # Safety
/// `prediction` came from linkage_predict; `out` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_path_at(
    prediction: *const linkage_prediction,
    kind: u32,
    index: usize,
    out: *mut linkage_path,
) -> linkage_result {
    call(|| {
        // SAFETY: the caller promises it.
        let (prediction, out) = unsafe { (given(prediction, "prediction")?, place(out, "out")?) };
        let (part, poses) = item(prediction.paths(kind)?, index, "path")?;
        *out = linkage_path { part: part.as_ptr(), pose_count: poses.len() };
        Ok(())
    })
}

/// A pose of a path.
///
/// # Safety
/// `prediction` came from linkage_predict; `out` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_pose_at(
    prediction: *const linkage_prediction,
    kind: u32,
    path_index: usize,
    pose_index: usize,
    out: *mut linkage_pose,
) -> linkage_result {
    call(|| {
        // SAFETY: the caller promises it.
        let (prediction, out) = unsafe { (given(prediction, "prediction")?, place(out, "out")?) };
        let (_, poses) = item(prediction.paths(kind)?, path_index, "path")?;
        let &[time, x, y, z, qx, qy, qz, qw] = item(poses, pose_index, "pose")?;
        *out = linkage_pose { time, camera_from_it: [x, y, z, qx, qy, qz, qw] };
        Ok(())
    })
}

/// Frees a prediction. NULL is left alone.
///
/// # Safety
/// `prediction` is NULL, or came from linkage_predict and is not used any more.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_free_prediction(prediction: *mut linkage_prediction) {
    // SAFETY: the caller promises it.
    unsafe { free(prediction) }
}
