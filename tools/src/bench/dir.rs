//! `--suite dir DIR`: every recording of a folder that has its truth beside it. Objects are
//! learned from demonstrations, then looked for in all encounters, known and unknown.

use super::score::{LearnScore, score_model};
use super::tags::{Watched, log_of, watch};
use crate::cli::{BenchArgs, Common};
use crate::outcome::Outcome;
use crate::output::write_json;
use crate::steps::{last_frame, remember, skill_config};
use crate::truth::{TrueJoint, Truth};
use anyhow::{Context, anyhow};
use linkage_skill::SkillConfig;
use linkage_skill::internals::{distance_to_line, line_angle, median};
use linkage_skill::object::{JointKind, StoredObject};
use linkage_skill::recognise::{JointState, Recognised, Scene};
use linkage_skill::store::Library;
use nalgebra::{Point3, Vector3};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

#[derive(Serialize)]
struct LearnRow {
    recording: String,
    frames_per_second: f64,
    stage_seconds: BTreeMap<String, f64>,
    score: LearnScore,
    success: bool,
    strict: bool,
}

#[derive(Serialize)]
struct EncounterRow {
    recording: String,
    expected: Option<String>,
    found: Option<String>,
    score: f64,
    milliseconds: f64,
    joints: Vec<ConfigurationScore>,
    right: bool,
}

#[derive(Serialize)]
pub struct ConfigurationScore {
    joint: String,
    /// Degrees or centimetres.
    pub error: Option<f64>,
    /// Angle between the found and the true axis, degrees.
    pub axis_deg: f64,
    /// The error's unit.
    pub unit: &'static str,
}

impl ConfigurationScore {
    /// Within 5 degrees or 2 cm.
    pub fn is_right(&self) -> bool {
        self.error.is_some_and(|e| e < if self.unit == "°" { 5.0 } else { 2.0 })
    }
}

#[derive(Serialize)]
struct Report {
    profile: String,
    demonstrations: Vec<LearnRow>,
    encounters: Vec<EncounterRow>,
}

pub fn run(args: &BenchArgs, common: &Common) -> Outcome {
    let dir = args.dir.as_ref().ok_or_else(|| anyhow!("--suite dir needs a folder"))?;
    let config = skill_config(common)?;
    let recordings = recordings(dir)?;
    let (demonstrations, learned) = learn_all(&recordings, args.tags, &config)?;
    let encounters = recognise_all(&recordings, learned, &config)?;
    let report = Report { profile: config.profile.clone(), demonstrations, encounters };
    if let Some(path) = &args.json {
        write_json(path, &report)?;
    }
    Ok(())
}

/// A learned object with the truth of its demonstration.
struct Learned {
    stored: StoredObject,
    truth: Truth,
}

/// Recordings of a folder that have their truth beside them, by name.
pub fn recordings(dir: &Path) -> anyhow::Result<Vec<(PathBuf, Truth)>> {
    let mut found: Vec<PathBuf> = std::fs::read_dir(dir)
        .with_context(|| dir.display().to_string())?
        .filter_map(|e| Some(e.ok()?.path()))
        .filter(|p| p.join("truth.json").is_file())
        .collect();
    found.sort();
    if found.is_empty() {
        return Err(anyhow!("{}: no recording with truth.json", dir.display()));
    }
    found.into_iter().map(|p| Ok((p.clone(), Truth::read(&p)?))).collect()
}

fn learn_all(
    recordings: &[(PathBuf, Truth)],
    by_tags: bool,
    config: &SkillConfig,
) -> Outcome<(Vec<LearnRow>, Vec<Learned>)> {
    println!(
        "{:20} {:12} {:10} {:10} {:>6} {:>6} {:>6} {:>5} {:>5} {:>6} verdict",
        "demonstration",
        "joint",
        "true",
        "found",
        "axis/°",
        "pos/cm",
        "range",
        "parts",
        "spur.",
        "fps"
    );
    let (mut rows, mut learned) = (Vec::new(), Vec::new());
    for (recording, _) in recordings.iter().filter(|(_, t)| !t.encounter) {
        let start = Instant::now();
        let source = recording.display().to_string();
        let mut tags = log_of(recording, by_tags)?;
        let Watched { found: demonstration, truth, .. } = watch(recording, tags.as_mut(), config)?;
        let seconds = start.elapsed().as_secs_f64();
        let score = score_model(&demonstration.model, &truth);
        let row = LearnRow {
            recording: name_of(recording),
            frames_per_second: demonstration.frame_utimes.len() as f64 / seconds,
            stage_seconds: demonstration
                .times
                .iter()
                .map(|(s, d)| (s.to_owned(), d.as_secs_f64()))
                .collect(),
            success: score.succeeds(10.0, 5.0),
            strict: score.succeeds(3.0, 2.0),
            score,
        };
        print_learn_row(&row);
        rows.push(row);
        if !demonstration.model.joints.is_empty() {
            let stored = remember(None, &demonstration, &source, config)?;
            learned.push(Learned { stored, truth });
        }
    }
    let (right, strict) =
        (rows.iter().filter(|r| r.success).count(), rows.iter().filter(|r| r.strict).count());
    println!(
        "{right} of {} demonstrations right (10°, 5 cm), {strict} strictly (3°, 2 cm)",
        rows.len()
    );
    print_stage_times(&rows);
    Ok((rows, learned))
}

fn print_stage_times(rows: &[LearnRow]) {
    let mut stages: BTreeMap<&str, f64> = BTreeMap::new();
    for (stage, seconds) in rows.iter().flat_map(|r| &r.stage_seconds) {
        *stages.entry(stage).or_default() += seconds / rows.len() as f64;
    }
    let parts: Vec<String> = stages.iter().map(|(s, t)| format!("{s} {t:.2}")).collect();
    println!("mean seconds a demonstration: {}", parts.join(", "));
    let mut rates: Vec<f64> = rows.iter().map(|r| r.frames_per_second).collect();
    let mut after: Vec<f64> = rows.iter().map(|r| after_last_frame(&r.stage_seconds)).collect();
    println!(
        "medians: {:.1} frames a second, {:.2} s after the last frame",
        median(&mut rates).unwrap_or(0.0),
        median(&mut after).unwrap_or(0.0)
    );
}

/// Seconds of the stages that run when all frames have come.
pub fn after_last_frame(stage_seconds: &BTreeMap<String, f64>) -> f64 {
    const WHILE_FRAMES_COME: [&str; 3] = ["camera", "track", "ahead"];
    let after = stage_seconds.iter().filter(|(s, _)| !WHILE_FRAMES_COME.contains(&s.as_str()));
    after.map(|(_, seconds)| seconds).sum()
}

fn print_learn_row(row: &LearnRow) {
    let verdict = match (row.success, row.strict) {
        (true, true) => "strict",
        (true, false) => "right",
        _ => "WRONG",
    };
    let number = |x: Option<f64>| x.map_or("-".to_owned(), |x| format!("{x:.2}"));
    let tail = format!(
        "{:>5} {:>5} {:>6.1} {verdict}",
        row.score.parts, row.score.spurious, row.frames_per_second
    );
    if row.score.joints.is_empty() {
        println!(
            "{:20} {:12} {:10} {:10} {:>6} {:>6} {:>6} {tail}",
            row.recording, "-", "none", "-", "-", "-", "-"
        );
    }
    for j in &row.score.joints {
        println!(
            "{:20} {:12} {:10} {:10} {:>6} {:>6} {:>6} {tail}",
            row.recording,
            j.name,
            j.true_kind.name(),
            j.found_kind.map_or("missed", |k| k.name()),
            number(j.axis_deg),
            number(j.position_cm),
            number(j.range_share),
        );
    }
}

fn recognise_all(
    recordings: &[(PathBuf, Truth)],
    learned: Vec<Learned>,
    config: &SkillConfig,
) -> Outcome<Vec<EncounterRow>> {
    let encounters: Vec<_> = recordings.iter().filter(|(_, t)| t.encounter).collect();
    if encounters.is_empty() {
        return Ok(Vec::new());
    }
    let truths: Vec<(String, Truth)> =
        learned.iter().map(|l| (l.stored.model.object.clone(), l.truth.clone())).collect();
    let objects: Vec<StoredObject> = learned.into_iter().map(|l| l.stored).collect();
    let library = Library::new(objects);
    println!(
        "\n{:20} {:14} {:14} {:>6} {:>24} {:>7} verdict",
        "encounter", "expected", "found", "score", "configuration error", "ms"
    );
    let mut rows = Vec::new();
    for (recording, truth) in encounters {
        let frame = last_frame(&recording.display().to_string())?;
        let start = Instant::now();
        let recognition =
            library.recognise(&Scene::new(&frame)?, &config.recognise, config.seed)?;
        let milliseconds = start.elapsed().as_secs_f64() * 1e3;
        let known = truths.iter().find(|(name, _)| *name == truth.object && !truth.unknown);
        let best = recognition.matches.first();
        let row = encounter_row(recording, truth, known.map(|k| &k.1), best, milliseconds);
        print_encounter_row(&row);
        rows.push(row);
    }
    let right = rows.iter().filter(|r| r.right).count();
    println!("{right} of {} encounters right", rows.len());
    Ok(rows)
}

fn encounter_row(
    recording: &Path,
    truth: &Truth,
    demonstrated: Option<&Truth>,
    best: Option<&Recognised>,
    milliseconds: f64,
) -> EncounterRow {
    let expected = demonstrated.map(|d| d.object.clone());
    let joints: Vec<ConfigurationScore> = match (best, demonstrated) {
        (Some(m), Some(d)) if m.object == truth.object => configuration_scores(m, truth, d),
        _ => Vec::new(),
    };
    let found = best.map(|m| m.object.clone());
    EncounterRow {
        recording: name_of(recording),
        right: found == expected && joints.iter().all(ConfigurationScore::is_right),
        expected,
        found,
        score: best.map_or(0.0, |m| m.score),
        milliseconds,
        joints,
    }
}

/// Configurations are compared as differences from the demonstration's first frame, the sign
/// following the predicted axis.
pub fn configuration_scores(
    found: &Recognised,
    truth: &Truth,
    demonstrated: &Truth,
) -> Vec<ConfigurationScore> {
    found
        .joints
        .iter()
        .filter_map(|j| {
            let axis = Vector3::from(j.axis);
            let t = nearest_joint(j, &truth.joints)?;
            let first = demonstrated.joints.iter().find(|d| d.name == t.name)?.configuration[0];
            let change = t.configuration.last()? - first;
            let sign = axis.dot(&Vector3::from(t.axis_last)).signum();
            let slide = t.kind == JointKind::Prismatic;
            let scale = if slide { 100.0 } else { 1.0_f64.to_degrees() };
            Some(ConfigurationScore {
                joint: t.name.clone(),
                error: j.configuration.map(|q| scale * (sign * q - change).abs()),
                axis_deg: line_angle(&axis, &Vector3::from(t.axis_last)).to_degrees(),
                unit: if slide { "cm" } else { "°" },
            })
        })
        .collect()
}

/// Angle between the directions of two lines that counts as much as a metre between their places, radians.
const ANGLE_LIKE_A_METRE_RAD: f64 = 0.2;

/// The true joint whose line is nearest, in the camera frame of the last frame: by its direction, and among parallel
/// ones, such as those of two drawers, by its place. A slide's place is the point that is given on its line.
fn nearest_joint<'t>(found: &JointState, all: &'t [TrueJoint]) -> Option<&'t TrueJoint> {
    let (axis, place) = (Vector3::from(found.axis), Point3::from(found.origin));
    let off = |t: &TrueJoint| {
        let (true_axis, true_place) = (Vector3::from(t.axis_last), Point3::from(t.origin_last));
        let apart_m = match t.kind {
            JointKind::Prismatic => (place - true_place).norm(),
            _ => distance_to_line(&true_place, &true_axis, &place),
        };
        line_angle(&axis, &true_axis) / ANGLE_LIKE_A_METRE_RAD + apart_m
    };
    all.iter().min_by(|a, b| off(a).total_cmp(&off(b)))
}

fn print_encounter_row(row: &EncounterRow) {
    let errors: Vec<String> = row
        .joints
        .iter()
        .map(|j| j.error.map_or("not seen".to_owned(), |e| format!("{e:.2}{}", j.unit)))
        .collect();
    let name = |n: &Option<String>| n.clone().unwrap_or_else(|| "nothing".to_owned());
    println!(
        "{:20} {:14} {:14} {:>6.2} {:>24} {:>7.0} {}",
        row.recording,
        name(&row.expected),
        name(&row.found),
        row.score,
        errors.join(", "),
        row.milliseconds,
        if row.right { "right" } else { "WRONG" }
    );
}

fn name_of(path: &Path) -> String {
    path.file_name()
        .map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_two_drawers_in_parallel_each_is_compared_with_itself() {
        let slide = |name: &str, y: f64| TrueJoint {
            name: name.to_owned(),
            kind: JointKind::Prismatic,
            parent: "base".to_owned(),
            child: name.to_owned(),
            axis: [0.0, 0.0, -1.0],
            origin: [0.0, y, 1.5],
            axis_last: [0.0, 0.0, -1.0],
            origin_last: [0.0, y, 1.5],
            pitch: 0.0,
            configuration: Vec::new(),
            range_observed: [0.0, 0.3],
            moved: true,
            grasp: None,
        };
        let found = |y: f64| JointState {
            name: "joint1".to_owned(),
            kind: JointKind::Prismatic,
            axis: [0.0, 0.01, -1.0],
            origin: [0.05, y, 1.45],
            pitch: 0.0,
            configuration: None,
            deviation: None,
            reason: None,
            range: [0.0, 0.3],
        };
        let all = [slide("upper", -0.1), slide("lower", 0.1)];
        let name = |y: f64| nearest_joint(&found(y), &all).map(|t| t.name.as_str());
        assert_eq!((name(-0.12), name(0.08)), (Some("upper"), Some("lower")));
        assert!(nearest_joint(&found(0.0), &[]).is_none());
    }
}
