//! `--suite follow`: a recognised object followed through a recording with truth. It is learned
//! from the recording, recognised in its first frame, and then followed from frame to frame,
//! with the person before it.

use super::dir::recordings;
use crate::cli::{BenchArgs, Common};
use crate::outcome::Outcome;
use crate::output::write_json;
use crate::steps::{demonstrate, remember, skill_config};
use crate::truth::{TrueJoint, Truth};
use anyhow::anyhow;
use linkage_driver::RgbdFrame;
use linkage_skill::internals::median;
use linkage_skill::learn::Demonstration;
use linkage_skill::object::{Joint, JointKind};
use linkage_skill::recognise::{Followed, Follower, KnownObject, Recognised, Scene, find};
use linkage_skill::{SkillConfig, pose_from_array};
use nalgebra::Vector3;
use serde::Serialize;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// One recording.
#[derive(Serialize)]
struct Row {
    recording: String,
    frames: usize,
    /// Frames in which the object was seen.
    seen: usize,
    /// The frame in which it was lost for good.
    lost_at: Option<usize>,
    joints: Vec<JointRow>,
    /// Median distance of the base from where it truly is, centimetres.
    base_cm: f64,
    /// Median time of a frame.
    milliseconds: f64,
}

/// A joint that truly moves.
#[derive(Serialize)]
struct JointRow {
    name: String,
    unit: &'static str,
    /// Share of frames in which its configuration is told.
    told: f64,
    /// Errors of the configurations that are told.
    median: f64,
    at_95_percent: f64,
}

pub fn run(args: &BenchArgs, common: &Common) -> Outcome {
    let dir = args.dir.as_ref().ok_or_else(|| anyhow!("--suite follow needs a folder"))?;
    let config = skill_config(common)?;
    let mut rows = Vec::new();
    for (recording, truth) in recordings(dir)? {
        if truth.encounter || truth.joints.is_empty() {
            continue;
        }
        let Some(row) = follow(&recording, &truth, &config)? else {
            println!("{:20} not learned or not recognised", recording.display());
            continue;
        };
        print_row(&row);
        rows.push(row);
    }
    let all = |f: &dyn Fn(&Row) -> Vec<f64>| {
        median(&mut rows.iter().flat_map(f).collect::<Vec<_>>()).unwrap_or(f64::NAN)
    };
    let of_unit = |unit: &'static str| {
        move |r: &Row| r.joints.iter().filter(|j| j.unit == unit).map(|j| j.median).collect()
    };
    println!(
        "medians: {:.2}° {:.2} cm, base {:.2} cm, {:.0} ms a frame; lost in {} of {}",
        all(&of_unit("°")),
        all(&of_unit("cm")),
        all(&|r| vec![r.base_cm]),
        all(&|r| vec![r.milliseconds]),
        rows.iter().filter(|r| r.lost_at.is_some()).count(),
        rows.len()
    );
    if let Some(path) = &args.json {
        write_json(path, &rows)?;
    }
    Ok(())
}

fn frames_of(recording: &Path) -> Outcome<Vec<RgbdFrame>> {
    let mut source = linkage_driver::open(&recording.display().to_string())?;
    let mut frames = Vec::new();
    while let Some(frame) = source.next_frame()? {
        frames.push(frame);
    }
    Ok(frames)
}

fn follow(recording: &Path, truth: &Truth, config: &SkillConfig) -> Outcome<Option<Row>> {
    let source = recording.display().to_string();
    let demonstration = demonstrate(&source, &truth.object, config, true)?;
    if demonstration.model.joints.is_empty() {
        return Ok(None);
    }
    let stored = remember(None, &demonstration, &source, config)?;
    let object = Arc::new(KnownObject::new(stored.model, &stored.appearance));
    let frames = frames_of(recording)?;
    let Some(found) = first_sight(&frames, &object, config)? else { return Ok(None) };
    let Some(mut follower) = Follower::new(object, &found) else {
        return Ok(None);
    };
    let (mut answers, mut times, mut lost_at) = (Vec::new(), Vec::new(), None);
    for (i, frame) in frames.iter().enumerate() {
        let start = Instant::now();
        match follower.follow(frame) {
            Ok(answer) => answers.push(answer),
            Err(e) => {
                tracing::debug!(recording = source, frame = i, "{e}");
                lost_at = Some(i);
                break;
            }
        }
        times.push(start.elapsed().as_secs_f64() * 1e3);
    }
    Ok(Some(Row {
        recording: recording.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        frames: frames.len(),
        seen: answers.iter().filter(|a| a.seen).count(),
        lost_at,
        joints: joint_rows(&answers, &frames, &demonstration, truth),
        base_cm: base_error(&answers, truth),
        milliseconds: median(&mut times).unwrap_or(f64::NAN),
    }))
}

fn first_sight(
    frames: &[RgbdFrame],
    object: &KnownObject,
    config: &SkillConfig,
) -> Outcome<Option<Recognised>> {
    let Some(first) = frames.first() else { return Ok(None) };
    let found = find(&Scene::new(first)?, object, &config.recognise, config.seed);
    Ok(found.filter(|f| f.score >= config.recognise.min_score))
}

fn joint_rows(
    answers: &[Followed],
    frames: &[RgbdFrame],
    demonstration: &Demonstration,
    truth: &Truth,
) -> Vec<JointRow> {
    truth
        .moved()
        .into_iter()
        .filter_map(|moved| {
            let index = found_joint(demonstration, moved, truth)?;
            let axis = Vector3::from(demonstration.model.joints[index].axis);
            let sign = axis.dot(&Vector3::from(moved.axis)).signum();
            let slide = moved.kind == JointKind::Prismatic;
            let scale = if slide { 100.0 } else { 1.0_f64.to_degrees() };
            let mut errors: Vec<f64> = answers
                .iter()
                .zip(frames)
                .filter_map(|(answer, frame)| {
                    let q = answer.recognised.joints[index].configuration?;
                    let at = truth.frame_at(frame.utime)?;
                    let truly = moved.configuration[at] - moved.configuration[0];
                    Some(scale * (sign * q - truly).abs())
                })
                .collect();
            errors.sort_by(f64::total_cmp);
            let at = |share: f64| {
                let last = errors.len().checked_sub(1)?;
                errors.get((last as f64 * share).round() as usize).copied()
            };
            Some(JointRow {
                name: moved.name.clone(),
                unit: if slide { "cm" } else { "°" },
                told: errors.len() as f64 / frames.len() as f64,
                median: at(0.5)?,
                at_95_percent: at(0.95)?,
            })
        })
        .collect()
}

/// The learned joint of a true one's kind that moved most like it while it was learned: two
/// drawers have one axis.
fn found_joint(demonstration: &Demonstration, moved: &TrueJoint, truth: &Truth) -> Option<usize> {
    let apart = |joint: &Joint| -> f64 {
        let sign = Vector3::from(joint.axis).dot(&Vector3::from(moved.axis)).signum();
        let differences: Vec<f64> = joint
            .configuration
            .iter()
            .filter_map(|[t, q]| {
                let at = truth.frame_at((t * 1e6).round() as i64)?;
                Some((sign * q - moved.configuration[at] + moved.configuration[0]).abs())
            })
            .collect();
        differences.iter().sum::<f64>() / differences.len().max(1) as f64
    };
    let joints = demonstration.model.joints.iter().enumerate();
    joints
        .filter(|(_, j)| j.kind == moved.kind)
        .min_by(|a, b| apart(a.1).total_cmp(&apart(b.1)))
        .map(|(index, _)| index)
}

/// The object frame is the first camera's.
fn base_error(answers: &[Followed], truth: &Truth) -> f64 {
    let world_from = |i: usize| pose_from_array(truth.world_from_camera.get(i)?);
    let mut errors: Vec<f64> = answers
        .iter()
        .enumerate()
        .filter(|(_, a)| a.seen)
        .filter_map(|(i, a)| {
            let truly = world_from(i)?.inverse() * world_from(0)?;
            let found = pose_from_array(&a.recognised.camera_from_object)?;
            Some(100.0 * (truly.inverse() * found).translation.vector.norm())
        })
        .collect();
    median(&mut errors).unwrap_or(f64::NAN)
}

fn print_row(row: &Row) {
    let joints: Vec<String> = row
        .joints
        .iter()
        .map(|j| {
            format!(
                "{} {:.2}{} (95 %: {:.2}) told {:.0} %",
                j.name,
                j.median,
                j.unit,
                j.at_95_percent,
                100.0 * j.told
            )
        })
        .collect();
    println!(
        "{:20} seen {:>3} of {:>3}{} base {:.2} cm, {:.0} ms a frame: {}",
        row.recording,
        row.seen,
        row.frames,
        row.lost_at.map_or(String::new(), |f| format!(", lost at {f},")),
        row.base_cm,
        row.milliseconds,
        joints.join("; ")
    );
}
