//! `--suite ablation DIR`: our way of learning with one choice at a time undone, on every
//! demonstration of a folder. What a choice is worth is the difference to the first line.

use super::dir::recordings;
use super::score::{LearnScore, score_model};
use crate::cli::{BenchArgs, Common};
use crate::outcome::Outcome;
use crate::output::write_json;
use crate::steps::{demonstrate, skill_config};
use crate::truth::Truth;
use anyhow::anyhow;
use linkage_skill::SkillConfig;
use linkage_skill::config::{DepthLift, DescriptorKind};
use linkage_skill::internals::median;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;

/// A choice, and how it is undone.
struct Choice {
    name: &'static str,
    undo: fn(&mut SkillConfig),
}

const CHOICES: &[Choice] = &[
    Choice { name: "all choices", undo: |_| () },
    Choice {
        name: "depth pictures are not asked",
        undo: |c| (c.joints.max_through, c.joints.max_unobserved) = (1.0, 1.0),
    },
    Choice { name: "outliers stay", undo: |c| c.joints.remove_outliers = false },
    Choice { name: "uncovered tracks allowed", undo: |c| c.joints.max_uncovered = 1.0 },
    Choice { name: "stretches not merged", undo: |c| c.joints.merge = false },
    Choice { name: "no chains", undo: |c| c.joints.chains = false },
    Choice { name: "no screws", undo: |c| c.joints.screws = false },
    Choice { name: "no planes", undo: |c| c.planes.enabled = false },
    Choice { name: "no vacated surfaces", undo: |c| c.planes.vacated = false },
    Choice { name: "rest is no evidence", undo: |c| c.joints.rest_frames = 0 },
    Choice { name: "half the hypotheses", undo: |c| c.joints.max_hypotheses /= 2 },
    Choice { name: "half the features", undo: |c| c.track.max_features /= 2 },
    Choice {
        name: "bilateral depth",
        undo: |c| c.track.lift = DepthLift::Bilateral(Default::default()),
    },
    Choice {
        name: "no forward-backward check",
        undo: |c| c.track.max_forward_backward_px = f64::INFINITY,
    },
    Choice { name: "SIFT verifies tracks", undo: |c| c.track.descriptor = DescriptorKind::Sift },
];

/// A line of the table.
#[derive(Serialize)]
struct Row {
    choice: &'static str,
    demonstrations: usize,
    right: usize,
    missed: usize,
    spurious: usize,
    median_axis_deg: Option<f64>,
    mean_axis_deg: Option<f64>,
    median_position_cm: Option<f64>,
    seconds: f64,
}

pub fn run(args: &BenchArgs, common: &Common) -> Outcome {
    let dir = args.dir.as_ref().ok_or_else(|| anyhow!("--suite ablation needs a folder"))?;
    let demonstrations: Vec<(PathBuf, Truth)> =
        recordings(dir)?.into_iter().filter(|(_, t)| !t.encounter).collect();
    println!(
        "{:32} {:>8} {:>6} {:>8} {:>11} {:>9} {:>11} {:>9}",
        "undone", "right", "missed", "spurious", "axis med/°", "mean/°", "pos med/cm", "seconds"
    );
    let mut rows = Vec::new();
    for choice in CHOICES {
        let mut config = skill_config(common)?;
        (choice.undo)(&mut config);
        let row = learn_all(choice.name, &demonstrations, &config)?;
        print_row(&row);
        rows.push(row);
    }
    if let Some(path) = &args.json {
        write_json(path, &rows)?;
    }
    Ok(())
}

fn learn_all(
    choice: &'static str,
    demonstrations: &[(PathBuf, Truth)],
    config: &SkillConfig,
) -> Outcome<Row> {
    let start = Instant::now();
    let scores: Vec<LearnScore> = demonstrations
        .iter()
        .map(|(recording, truth)| {
            let source = recording.display().to_string();
            let found = demonstrate(&source, &truth.object, config, true)?;
            Ok(score_model(&found.model, truth))
        })
        .collect::<Outcome<_>>()?;
    let joints = || scores.iter().flat_map(|s| &s.joints);
    let mut axes: Vec<f64> = joints().filter_map(|j| j.axis_deg).collect();
    let mut positions: Vec<f64> = joints().filter_map(|j| j.position_cm).collect();
    Ok(Row {
        choice,
        demonstrations: demonstrations.len(),
        right: scores.iter().filter(|s| s.succeeds(10.0, 5.0)).count(),
        missed: joints().filter(|j| j.found.is_none()).count(),
        spurious: scores.iter().map(|s| s.spurious).sum(),
        mean_axis_deg: (!axes.is_empty()).then(|| axes.iter().sum::<f64>() / axes.len() as f64),
        median_axis_deg: median(&mut axes),
        median_position_cm: median(&mut positions),
        seconds: start.elapsed().as_secs_f64() / demonstrations.len().max(1) as f64,
    })
}

fn print_row(row: &Row) {
    let number = |value: Option<f64>| value.map_or("-".to_owned(), |x| format!("{x:.2}"));
    println!(
        "{:32} {:>8} {:>6} {:>8} {:>11} {:>9} {:>11} {:>9.1}",
        row.choice,
        format!("{}/{}", row.right, row.demonstrations),
        row.missed,
        row.spurious,
        number(row.median_axis_deg),
        number(row.mean_axis_deg),
        number(row.median_position_cm),
        row.seconds
    );
}
