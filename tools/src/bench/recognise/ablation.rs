//! What each choice of recognition is worth: the same stills with one choice at a time undone.

use super::question::{Learned, Precision, Question, precision};
use crate::outcome::Outcome;
use linkage_driver::{DepthImage, RgbdFrame};
use linkage_skill::SkillConfig;
use linkage_skill::config::RecogniseConfig;
use linkage_skill::internals::{FeatureKind, median};
use linkage_skill::object::Appearance;
use linkage_skill::recognise::{KnownObject, Recognised, Scene, find};
use rayon::prelude::*;
use serde::Serialize;
use std::time::Instant;

/// A choice, and how it is undone, when things are learned or looked for.
struct Choice {
    name: &'static str,
    learned: fn(&mut Appearance),
    sought: fn(&mut RecogniseConfig),
    /// The camera gives no depth.
    blind: bool,
}

impl Choice {
    const fn of_search(name: &'static str, sought: fn(&mut RecogniseConfig)) -> Self {
        Self { name, learned: |_| (), sought, blind: false }
    }

    const fn of_model(name: &'static str, learned: fn(&mut Appearance)) -> Self {
        Self { name, learned, sought: |_| (), blind: false }
    }
}

const CHOICES: &[Choice] = &[
    Choice::of_search("all choices", |_| ()),
    Choice::of_search("depth alone verifies", |c| c.compare_colour = false),
    Choice::of_search("free space not checked", |c| c.check_free_space = false),
    Choice::of_search("edges not checked", |c| c.check_edges = false),
    Choice::of_search("matches alone align", |c| c.align_surface = false),
    Choice::of_search("all hypotheses followed", |c| c.dismiss_early = false),
    Choice::of_search("configurations by votes alone", |c| c.search_configurations = false),
    Choice::of_search("ambiguity not checked", |c| c.check_ambiguity = false),
    Choice::of_search("nothing ruled out", |c| c.eliminate = false),
    Choice::of_search("distinct matches alone", |c| c.try_all_matches = false),
    Choice::of_search("the other choice of search by shape", |c| c.try_shape = !c.try_shape),
    Choice::of_search("one hypothesis", |c| c.hypotheses = 1),
    Choice::of_search("no ratio test", |c| c.max_ratio = f64::INFINITY),
    Choice::of_model("no features of the room", |a| a.room.clear()),
    Choice::of_model("no rectified features", |a| {
        a.features.retain(|f| f.kind != FeatureKind::Rectified);
    }),
    Choice::of_model("no features of the picture", |a| {
        a.features.retain(|f| f.kind != FeatureKind::Picture);
    }),
    Choice::of_model("a third of the features", |a| {
        a.features = a.features.iter().step_by(3).cloned().collect();
    }),
    Choice { blind: true, ..Choice::of_search("no depth in the picture", |_| ()) },
];

/// A line of the table.
#[derive(Serialize)]
pub struct Row {
    choice: &'static str,
    /// Right stills to a turn of 45°, and of how many.
    right_to_45: [usize; 2],
    right_beyond: [usize; 2],
    /// Wrong pairs at or above the threshold.
    false_reports: usize,
    configurations_told: usize,
    base_deg: f64,
    base_cm: f64,
    /// Time for all objects in one still.
    milliseconds: f64,
}

pub fn run(learned: &[Learned], questions: &[Question], config: &SkillConfig) -> Outcome<Vec<Row>> {
    println!(
        "\n{:30} {:>8} {:>8} {:>6} {:>5} {:>7} {:>7} {:>6}",
        "undone", "to 45°", "beyond", "false", "told", "base/°", "/cm", "ms"
    );
    CHOICES
        .iter()
        .map(|choice| {
            let row = with(choice, learned, questions, config)?;
            println!(
                "{:30} {:>8} {:>8} {:>6} {:>5} {:>7.2} {:>7.2} {:>6.0}",
                row.choice,
                format!("{}/{}", row.right_to_45[0], row.right_to_45[1]),
                format!("{}/{}", row.right_beyond[0], row.right_beyond[1]),
                row.false_reports,
                row.configurations_told,
                row.base_deg,
                row.base_cm,
                row.milliseconds,
            );
            Ok(row)
        })
        .collect()
}

/// A frame's scene, or that of a camera that gives no depth.
fn scene_of(frame: &RgbdFrame, blind: bool) -> Outcome<Scene> {
    if !blind {
        return Ok(Scene::new(frame)?);
    }
    let mut frame = frame.clone();
    let (width, height) = (frame.depth.width(), frame.depth.height());
    frame.depth = DepthImage::from_metres(width, height, vec![0.0; width * height])?;
    Ok(Scene::new(&frame)?)
}

/// A learned thing without what a choice leaves out of its appearance.
fn known_with(choice: &Choice, learned: &Learned) -> KnownObject {
    let mut appearance = learned.stored.appearance.clone();
    (choice.learned)(&mut appearance);
    KnownObject::new(learned.stored.model.clone(), &appearance)
}

/// The suite's results with one choice made otherwise.
fn with(
    choice: &Choice,
    learned: &[Learned],
    questions: &[Question],
    config: &SkillConfig,
) -> Outcome<Row> {
    let mut sought = config.recognise.clone();
    (choice.sought)(&mut sought);
    let objects: Vec<KnownObject> = learned.iter().map(|l| known_with(choice, l)).collect();
    let mut row = Row {
        choice: choice.name,
        right_to_45: [0; 2],
        right_beyond: [0; 2],
        false_reports: 0,
        configurations_told: 0,
        base_deg: 0.0,
        base_cm: 0.0,
        milliseconds: 0.0,
    };
    let (mut precise, mut times): (Vec<Precision>, Vec<f64>) = (Vec::new(), Vec::new());
    for question in questions {
        let scene = scene_of(&question.frame, choice.blind)?;
        let start = Instant::now();
        let reported: Vec<(usize, Recognised)> = objects
            .par_iter()
            .enumerate()
            .filter_map(|(i, object)| Some((i, find(&scene, object, &sought, config.seed)?)))
            .filter(|(_, found)| found.score >= sought.min_score)
            .collect();
        times.push(start.elapsed().as_secs_f64() * 1e3);
        row.false_reports += reported.iter().filter(|(i, _)| Some(*i) != question.number).count();
        let Some(number) = question.number else { continue };
        let own = reported.iter().find(|(i, _)| *i == number);
        let found = own.and_then(|(_, r)| precision(r, &question.truth, &learned[number].truth));
        let right = reported.len() == 1 && found.as_ref().is_some_and(Precision::is_right);
        let count = if question.still.shot.turn_deg.abs() <= 45.0 {
            &mut row.right_to_45
        } else {
            &mut row.right_beyond
        };
        count[0] += usize::from(right);
        count[1] += 1;
        precise.extend(found);
    }
    let middle = |of: &dyn Fn(&Precision) -> f64| {
        median(&mut precise.iter().map(of).collect::<Vec<f64>>()).unwrap_or(f64::NAN)
    };
    row.base_deg = middle(&|p| p.base_deg);
    row.base_cm = middle(&|p| p.base_cm);
    row.configurations_told =
        precise.iter().flat_map(|p| &p.joints).filter(|j| j.error.is_some()).count();
    row.milliseconds = median(&mut times).unwrap_or(f64::NAN);
    Ok(row)
}
