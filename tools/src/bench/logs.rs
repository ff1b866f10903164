//! `--suite logs`: pose logs with a catalogue of their types.

use crate::cli::BenchArgs;
use crate::outcome::Outcome;
use crate::output::write_json;
use anyhow::{Context, anyhow};
use linkage_skill::articulation::{fit_models, read_pose_log, type_probabilities};
use serde::Serialize;
use std::time::Instant;

#[derive(Serialize)]
struct Row {
    log: String,
    expected: String,
    found: &'static str,
    probability: f64,
    samples: usize,
    rmse_mm: f64,
    milliseconds: f64,
    right: bool,
}

/// Fits every log that `DIR/catalogue.csv` gives a type for.
pub fn run(args: &BenchArgs) -> Outcome {
    let dir = args.dir.as_ref().ok_or_else(|| anyhow!("--suite logs needs a folder"))?;
    let path = dir.join("catalogue.csv");
    let catalogue = std::fs::read_to_string(&path)
        .with_context(|| format!("{}: cannot be read", path.display()))?;
    println!(
        "{:40} {:9} {:9} {:>6} {:>7} {:>7} {:>7} verdict",
        "log", "expected", "found", "prob.", "samples", "rmse/mm", "ms"
    );
    let mut rows = Vec::new();
    for line in catalogue.lines().skip(1) {
        let mut fields = line.split(',');
        let (Some(log), Some(expected)) = (fields.next(), fields.next()) else { continue };
        if !matches!(expected, "revolute" | "prismatic") {
            continue;
        }
        let samples = read_pose_log(&dir.join(log), None)?.samples;
        let begin = Instant::now();
        let fits = fit_models(&samples).with_context(|| log.to_owned())?;
        let milliseconds = 1e3 * begin.elapsed().as_secs_f64();
        let best = &fits[0];
        let row = Row {
            log: log.to_owned(),
            expected: expected.to_owned(),
            found: best.geometry.kind.name(),
            probability: type_probabilities(&fits)[&best.geometry.kind],
            samples: samples.len(),
            rmse_mm: 1e3 * best.position_rmse,
            milliseconds,
            right: best.geometry.kind.name() == expected,
        };
        println!(
            "{:40} {:9} {:9} {:6.3} {:7} {:7.2} {:7.2} {}",
            row.log,
            row.expected,
            row.found,
            row.probability,
            row.samples,
            row.rmse_mm,
            row.milliseconds,
            if row.right { "right" } else { "WRONG" }
        );
        rows.push(row);
    }
    let mut times: Vec<f64> = rows.iter().map(|r| r.milliseconds).collect();
    times.sort_by(f64::total_cmp);
    let right = rows.iter().filter(|r| r.right).count();
    let median = times.get(times.len() / 2).copied().unwrap_or(0.0);
    println!("{right} of {} logs right; median {median:.2} ms a log", rows.len());
    if let Some(path) = &args.json {
        write_json(path, &rows)?;
    }
    Ok(())
}
