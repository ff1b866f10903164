//! `--suite dir DIR`: every recording of a folder that has its truth beside it.

use super::score::{LearnScore, score_model};
use super::truth::Truth;
use crate::cli::{BenchArgs, Common};
use crate::commands::{Outcome, demonstrate, skill_config, write_json};
use anyhow::{Context, anyhow};
use linkage_skill::SkillConfig;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

#[derive(Serialize)]
struct LearnRow {
    recording: String,
    frames_per_second: f64,
    finish_seconds: f64,
    score: LearnScore,
    success: bool,
    strict: bool,
}

pub fn run(args: &BenchArgs, common: &Common) -> Outcome {
    let dir = args.dir.as_ref().ok_or_else(|| anyhow!("--suite dir needs a folder"))?;
    let config = skill_config(common)?;
    let mut rows = Vec::new();
    println!("{:22} {:10} {:10} {:10} {:>7} {:>7} {:>7} {:>5} {:>6} {:>6} {}", "recording", "joint", "true", "found", "axis/°", "pos/cm", "range", "parts", "spur.", "fps", "verdict");
    for recording in recordings(dir)? {
        let truth = Truth::read(&recording)?;
        if truth.encounter {
            continue;
        }
        let row = learn_row(&recording, &truth, &config)?;
        print_learn_row(&row);
        rows.push(row);
    }
    if let Some(path) = &args.json {
        write_json(path, &rows)?;
    }
    let good = rows.iter().filter(|r| r.success).count();
    println!("{good} of {} demonstrations right", rows.len());
    Ok(())
}

fn recordings(dir: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let mut found: Vec<PathBuf> = std::fs::read_dir(dir)
        .with_context(|| dir.display().to_string())?
        .filter_map(|e| Some(e.ok()?.path()))
        .filter(|p| p.join("truth.json").is_file())
        .collect();
    found.sort();
    if found.is_empty() {
        return Err(anyhow!("{}: no recording with truth.json", dir.display()));
    }
    Ok(found)
}

fn learn_row(recording: &Path, truth: &Truth, config: &SkillConfig) -> Outcome<LearnRow> {
    let start = Instant::now();
    let source = recording.display().to_string();
    let demonstration = demonstrate(&source, &truth.object, config, true)?;
    let seconds = start.elapsed().as_secs_f64();
    let score = score_model(&demonstration.model, truth);
    let finish_seconds = demonstration
        .times
        .iter()
        .filter(|(s, _)| *s != "track")
        .map(|(_, d)| d.as_secs_f64())
        .sum();
    for (stage, time) in demonstration.times.iter() {
        tracing::info!(stage, ms = time.as_millis() as u64, "time");
    }
    Ok(LearnRow {
        recording: name_of(recording),
        frames_per_second: demonstration.frame_utimes.len() as f64 / seconds,
        finish_seconds,
        success: score.succeeds(10.0, 5.0),
        strict: score.succeeds(3.0, 2.0),
        score,
    })
}

fn print_learn_row(row: &LearnRow) {
    let verdict = match (row.success, row.strict) {
        (true, true) => "strict",
        (true, false) => "right",
        _ => "WRONG",
    };
    let number = |x: Option<f64>| x.map_or("-".to_owned(), |x| format!("{x:.2}"));
    let tail = format!("{:>5} {:>6} {:>6.1} {verdict} ({:.2} s)", row.score.parts, row.score.spurious, row.frames_per_second, row.finish_seconds);
    if row.score.joints.is_empty() {
        println!("{:22} {:10} {:10} {:10} {:>7} {:>7} {:>7} {tail}", row.recording, "-", "-", "-", "-", "-", "-");
    }
    for j in &row.score.joints {
        println!(
            "{:22} {:10} {:10} {:10} {:>7} {:>7} {:>7} {tail}",
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

fn name_of(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned())
}
