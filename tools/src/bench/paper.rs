//! `--suite paper`: the experiment of the paper's section IV. Its 43 demonstrations of ten kinds
//! of things are simulated, each is learned in the baseline's, the paper's and our way, and
//! the paper's two tables are printed, with a third for what they leave out. Truth is the
//! simulator's own; with `--tags`, AprilTags on the parts as in the paper.

use super::dir::after_last_frame;
use super::motion::{
    ConfigurationError, PoseScore, configuration_errors, pose_scores, segmentation_share,
};
use super::score::{LearnScore, score_model};
use super::tags::{Watched, log_of, watch};
use crate::cli::{BenchArgs, Common};
use crate::outcome::Outcome;
use crate::output::write_json;
use crate::simulate::{Surfaces, Take, instances};
use crate::steps::{FilmOrder, film, skill_config};
use crate::tags::TagLog;
use linkage_skill::SkillConfig;
use linkage_skill::internals::median;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

/// The columns.
const PROFILES: [&str; 3] = ["katz", "paper", "default"];
/// Where recordings are kept when no folder is named.
const DEFAULT_DIR: &str = "out/paper";
/// Texture classes, in the order in which they are printed.
const TEXTURES: [&str; 3] = ["plain", "medium", "rich"];
/// The paper's limits of a success: centimetres and degrees.
const SUCCESS: (f64, f64) = (10.0, 25.0);

/// One demonstration learned in one way.
#[derive(Serialize)]
struct Row {
    demonstration: String,
    kind: &'static str,
    /// How much there is to see on the thing: plain, medium or rich.
    texture: String,
    profile: &'static str,
    degrees_of_freedom: usize,
    /// Joints whose truth is by tags, where tags are asked for; the rest is exact.
    joints_by_tags: Option<usize>,
    learn: LearnScore,
    poses: Vec<PoseScore>,
    pose_success: bool,
    /// Mean distance of observed poses to the model, centimetres and degrees.
    model_fit: Option<[f64; 2]>,
    /// The paper's criterion: its joints were found.
    model_success: bool,
    /// Ours: the tree is right, too, and nothing spurious was found.
    whole: bool,
    configuration: Vec<ConfigurationError>,
    segmentation_share: Option<f64>,
    frames_per_second: f64,
    /// Seconds from the last frame to the model.
    finish_seconds: f64,
    stage_seconds: BTreeMap<String, f64>,
}

#[derive(Serialize)]
struct Report {
    truth: &'static str,
    rows: Vec<Row>,
}

pub fn run(args: &BenchArgs, common: &Common) -> Outcome {
    let dir = args.dir.clone().unwrap_or_else(|| args.surfaces.folder(DEFAULT_DIR));
    let configs: Vec<(&'static str, SkillConfig)> = PROFILES
        .iter()
        .filter(|profile| args.only.as_ref().is_none_or(|only| only == *profile))
        .map(|profile| {
            let common = Common { profile: (*profile).to_owned(), ..common.clone() };
            Ok((*profile, skill_config(&common)?))
        })
        .collect::<Outcome<_>>()?;
    let mut rows = Vec::new();
    for (kind, count) in instances::KINDS {
        for number in 1..=count {
            let name = format!("{kind}_{number}");
            let recording = dir.join(if args.tags { format!("{name}_tags") } else { name.clone() });
            // The truth is written last: with it the recording is whole.
            if !recording.join("truth.json").is_file() {
                let order = FilmOrder {
                    surfaces: args.surfaces,
                    with_tags: args.tags,
                    ..FilmOrder::of(&name, Take::Demonstration, instances::seed_of(&name))
                };
                film(&order, &recording, common.quiet)?;
            }
            let mut tags = log_of(&recording, args.tags)?;
            for (profile, config) in &configs {
                let row = learn(kind, &name, profile, &recording, tags.as_mut(), config)?;
                print_row(&row);
                rows.push(row);
            }
        }
    }
    if args.surfaces != Surfaces::Speckled {
        print_textures(&rows);
    }
    print_truth(&rows);
    print_pose_table(&rows);
    print_model_table(&rows);
    print_rest(&rows);
    if let Some(path) = &args.json {
        write_json(path, &Report { truth: if args.tags { "tags" } else { "exact" }, rows })?;
    }
    Ok(())
}

fn learn(
    kind: &'static str,
    name: &str,
    profile: &'static str,
    recording: &Path,
    tags: Option<&mut TagLog>,
    config: &SkillConfig,
) -> Outcome<Row> {
    let start = Instant::now();
    let Watched { found, truth, joints_by_tags } = watch(recording, tags, config)?;
    let seconds = start.elapsed().as_secs_f64();
    let score = score_model(&found.model, &truth);
    let poses = pose_scores(&found, &truth, &score);
    let stage_seconds: BTreeMap<String, f64> =
        found.times.iter().map(|(s, d)| (s.to_owned(), d.as_secs_f64())).collect();
    let joints: Vec<_> =
        score.joints.iter().filter_map(|j| Some(&found.model.joints[j.found?])).collect();
    Ok(Row {
        demonstration: name.to_owned(),
        kind,
        texture: truth.texture.clone(),
        profile,
        degrees_of_freedom: truth.moved().len(),
        joints_by_tags,
        pose_success: poses.len() == score.joints.len()
            && mean(poses.iter().map(|p| p.position_cm)).is_some_and(|x| x < SUCCESS.0)
            && mean(poses.iter().map(|p| p.orientation_deg)).is_some_and(|x| x < SUCCESS.1),
        model_fit: mean(joints.iter().map(|j| 100.0 * j.position_rmse))
            .zip(mean(joints.iter().map(|j| j.orientation_rmse.to_degrees())))
            .map(|(p, o)| [p, o]),
        model_success: score.finds_joints(SUCCESS.1, SUCCESS.0),
        whole: score.succeeds(SUCCESS.1, SUCCESS.0),
        configuration: configuration_errors(&found, &truth, &score),
        segmentation_share: segmentation_share(&found, &truth, &score, recording)?,
        frames_per_second: found.frame_utimes.len() as f64 / seconds,
        finish_seconds: after_last_frame(&stage_seconds),
        stage_seconds,
        learn: score,
        poses,
    })
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0), |(s, n), x| (s + x, n + 1));
    (count > 0).then(|| sum / f64::from(count))
}

fn number(value: Option<f64>) -> String {
    value.map_or("-".to_owned(), |x| format!("{x:.1}"))
}

fn print_row(row: &Row) {
    let joints: Vec<String> = row
        .learn
        .joints
        .iter()
        .map(|j| match (j.axis_deg, j.position_cm, j.found_kind) {
            (Some(deg), Some(cm), Some(kind)) => {
                let wrong = if kind == j.true_kind { "" } else { "!" };
                format!("{}{wrong} {deg:.2}° {cm:.2} cm", j.name)
            }
            _ => format!("{} missed", j.name),
        })
        .collect();
    println!(
        "{:12} {:8} {:5} {:5.1} fps, {:4.2} s after the last frame, {} spurious: {}",
        row.demonstration,
        row.profile,
        if row.whole { "right" } else { "WRONG" },
        row.frames_per_second,
        row.finish_seconds,
        row.learn.spurious,
        joints.join("; ")
    );
}

/// The profiles that were run, in their order.
fn profiles(rows: &[Row]) -> Vec<&'static str> {
    PROFILES.into_iter().filter(|profile| rows.iter().any(|row| row.profile == *profile)).collect()
}

/// Rows of a kind (all kinds for `None`) and profile.
fn of<'r>(rows: &'r [Row], kind: Option<&'r str>, profile: &'r str) -> Vec<&'r Row> {
    rows.iter().filter(|r| r.profile == profile && kind.is_none_or(|k| r.kind == k)).collect()
}

/// A line for each kind and one for all; `columns` are printed for each profile.
fn print_table(title: &str, header: &str, rows: &[Row], columns: impl Fn(&[&Row]) -> String) {
    println!("\n{title}");
    print!("{:10} {:>3}", "", "DOF");
    let profiles = profiles(rows);
    for profile in &profiles {
        print!(" | {:^width$}", profile, width = header.chars().count());
    }
    println!();
    print!("{:14}", "");
    for _ in &profiles {
        print!(" | {header}");
    }
    println!();
    let kinds = instances::KINDS.iter().map(|(k, _)| Some(*k)).chain([None]);
    for kind in kinds {
        let dof = rows.iter().find(|r| Some(r.kind) == kind).map_or(0, |r| r.degrees_of_freedom);
        let dof = if kind.is_some() { dof.to_string() } else { String::new() };
        print!("{:10} {:>3}", kind.unwrap_or("overall"), dof);
        for profile in &profiles {
            print!(" | {}", columns(&of(rows, kind, profile)));
        }
        println!();
    }
}

/// Demonstrations that were learned rightly, by texture class; plain ones first.
fn print_textures(rows: &[Row]) {
    println!(
        "\nLearned rightly (each joint's type, axis < 25° and < 10 cm, the tree, none spurious), by texture"
    );
    for texture in TEXTURES {
        let cell = |profile| {
            let own = of(rows, None, profile).into_iter().filter(|r| r.texture == texture);
            let (right, all) = own.fold((0, 0), |(n, all), r| (n + usize::from(r.whole), all + 1));
            format!("{profile} {right}/{all}")
        };
        let cells: Vec<String> = profiles(rows).into_iter().map(cell).collect();
        println!("{texture:10} {}", cells.join("   "));
    }
}

fn print_truth(rows: &[Row]) {
    let profiles = profiles(rows);
    let own: Vec<&Row> = profiles.last().map_or(Vec::new(), |last| of(rows, None, last));
    let all: usize = own.iter().map(|r| r.degrees_of_freedom).sum();
    let told: Option<usize> = own.iter().map(|r| r.joints_by_tags).sum();
    match told {
        None => println!("\nTruth: exact, the simulator's own"),
        Some(told) => println!("\nTruth: AprilTags for {told} of {all} joints, exact for the rest"),
    }
}

fn print_pose_table(rows: &[Row]) {
    print_table(
        "Table I: poses of the parts against the truth (success: all parts, < 10 cm, < 25°)",
        " pos/cm  orient/° success",
        rows,
        |rows| {
            let poses = || rows.iter().flat_map(|r| &r.poses);
            let successes = rows.iter().filter(|r| r.pose_success).count();
            format!(
                "{:>7} {:>9} {:>7}",
                number(mean(poses().map(|p| p.position_cm))),
                number(mean(poses().map(|p| p.orientation_deg))),
                format!("{successes}/{}", rows.len())
            )
        },
    );
}

fn print_model_table(rows: &[Row]) {
    print_table(
        "Table II: models (success: each joint's type, axis < 25° and < 10 cm; whole: also the tree, none spurious)",
        " fit/cm  fit/° param/° success   whole",
        rows,
        |rows| {
            let fits = || rows.iter().filter_map(|r| r.model_fit);
            let axes = rows.iter().flat_map(|r| &r.learn.joints).filter_map(|j| j.axis_deg);
            let count = |wanted: &dyn Fn(&Row) -> bool| {
                format!("{}/{}", rows.iter().filter(|r| wanted(r)).count(), rows.len())
            };
            format!(
                "{:>7} {:>6} {:>7} {:>7} {:>7}",
                number(mean(fits().map(|f| f[0]))),
                number(mean(fits().map(|f| f[1]))),
                number(mean(axes)),
                count(&|r| r.model_success),
                count(&|r| r.whole)
            )
        },
    );
}

/// What the paper's tables leave out.
fn print_rest(rows: &[Row]) {
    let profiles = profiles(rows);
    let named: String = profiles.iter().map(|profile| format!(" {profile:>9}")).collect();
    println!("\nWhat the tables leave out{:15}{named}", "");
    let line = |name: &str, value: &dyn Fn(&[&Row]) -> Option<f64>, digits: usize| {
        let cell = |profile: &&str| {
            value(&of(rows, None, profile)).map_or("-".to_owned(), |x| format!("{x:.digits$}"))
        };
        let cells: String = profiles.iter().map(cell).map(|value| format!(" {value:>9}")).collect();
        println!("{name:40}{cells}");
    };
    let joints = |rows: &[&Row], f: &dyn Fn(&super::score::JointScore) -> Option<f64>| {
        rows.iter().flat_map(|r| &r.learn.joints).filter_map(f).collect::<Vec<f64>>()
    };
    line("axis, median, degrees", &|r| median(&mut joints(r, &|j| j.axis_deg)), 2);
    line("axis, mean, degrees", &|r| mean(joints(r, &|j| j.axis_deg).into_iter()), 2);
    line("hinge's position, median, cm", &|r| median(&mut joints(r, &hinge_position)), 2);
    line("hinge's position, mean, cm", &|r| mean(joints(r, &hinge_position).into_iter()), 2);
    let of_right_kind =
        |j: &super::score::JointScore| j.found_kind.map(|k| f64::from(u8::from(k == j.true_kind)));
    line("right type, share of found joints", &|r| mean(joints(r, &of_right_kind).into_iter()), 3);
    let missed = |j: &super::score::JointScore| Some(f64::from(u8::from(j.found.is_none())));
    line("missed joints", &|r| Some(joints(r, &missed).iter().sum()), 0);
    line("spurious joints", &|r| Some(r.iter().map(|r| r.learn.spurious as f64).sum()), 0);
    let range = |j: &super::score::JointScore| j.range_share.map(|s| 100.0 * (s - 1.0).abs());
    line("range error, mean, %", &|r| mean(joints(r, &range).into_iter()), 1);
    let inside = |j: &super::score::JointScore| j.inside_95().map(|i| f64::from(u8::from(i)));
    line("true line in the 95 % ellipsoid, share", &|r| mean(joints(r, &inside).into_iter()), 3);
    line(
        "probability of the true type, mean",
        &|r| mean(joints(r, &|j| j.true_kind_probability).into_iter()),
        3,
    );
    let configuration = |unit: &'static str| {
        move |rows: &[&Row]| {
            let errors = rows.iter().flat_map(|r| &r.configuration).filter(|c| c.unit == unit);
            mean(errors.map(|c| c.mean))
        }
    };
    line("configuration over time, degrees", &configuration("deg"), 2);
    line("configuration over time, cm", &configuration("cm"), 2);
    line(
        "features on the right part, share",
        &|r| mean(r.iter().filter_map(|r| r.segmentation_share)),
        3,
    );
    let collected = |f: fn(&Row) -> f64| {
        move |rows: &[&Row]| median(&mut rows.iter().map(|r| f(r)).collect::<Vec<f64>>())
    };
    line("frames a second, median", &collected(|r| r.frames_per_second), 1);
    line("seconds after the last frame, median", &collected(|r| r.finish_seconds), 2);
    for profile in &profiles {
        let own = of(rows, None, profile);
        let mut stages: BTreeMap<&str, f64> = BTreeMap::new();
        for (stage, seconds) in own.iter().flat_map(|r| &r.stage_seconds) {
            *stages.entry(stage).or_default() += seconds / own.len() as f64;
        }
        let parts: Vec<String> = stages.iter().map(|(s, t)| format!("{s} {t:.2}")).collect();
        println!("mean seconds a demonstration, {profile}: {}", parts.join(", "));
    }
}

fn hinge_position(joint: &super::score::JointScore) -> Option<f64> {
    use linkage_skill::object::JointKind;
    joint.position_cm.filter(|_| joint.true_kind != JointKind::Prismatic)
}
