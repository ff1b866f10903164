//! What a frame costs, from the picture to the answer, with few and with many objects known.

use super::question::{Learned, Question};
use super::scale::made_up;
use crate::outcome::Outcome;
use linkage_skill::SkillConfig;
use linkage_skill::internals::{ModelFeature, median};
use linkage_skill::learn::StageTimes;
use linkage_skill::object::{Appearance, StoredObject};
use linkage_skill::recognise::Scene;
use linkage_skill::store::Library;
use serde::Serialize;
use std::collections::BTreeMap;

/// Objects known.
const SIZES: [usize; 3] = [1, 10, 100];
/// Stages, in their order.
const STAGES: [&str; 3] = ["describe", "shortlist", "compare"];

/// Frames of known things looked at with this many objects known.
#[derive(Serialize)]
pub struct Row {
    objects: usize,
    frames: usize,
    /// Frames whose thing alone was recognised.
    right: usize,
    /// Medians by stage; of shortlists the first is compared.
    milliseconds: BTreeMap<&'static str, f64>,
    /// Median and 95th percentile of all stages together.
    frame_milliseconds: [f64; 2],
}

/// Looks at each still of a known thing with larger and larger libraries.
pub fn run(learned: &[Learned], questions: &[Question], config: &SkillConfig) -> Outcome<Vec<Row>> {
    println!("\nobjects  frames  right  describe  shortlist  compare  ms a frame   95 %");
    SIZES
        .iter()
        .map(|&objects| {
            let row = with(objects, learned, questions, config)?;
            let [describe, shortlist, compare] = STAGES.map(|stage| row.milliseconds[stage]);
            let [frame, slow] = row.frame_milliseconds;
            println!(
                "{:>7} {:>7} {:>6} {describe:>9.0} {shortlist:>10.0} {compare:>8.0} {frame:>11.0} {slow:>6.0}",
                row.objects, row.frames, row.right,
            );
            Ok(row)
        })
        .collect()
}

fn with(
    objects: usize,
    learned: &[Learned],
    questions: &[Question],
    config: &SkillConfig,
) -> Outcome<Row> {
    let mut of_stage: BTreeMap<&'static str, Vec<f64>> = BTreeMap::new();
    let mut frames = Vec::new();
    let mut right = 0;
    for (number, thing) in learned.iter().enumerate() {
        let library = Library::new(among_others(number, objects, learned));
        for question in questions.iter().filter(|q| q.number == Some(number)) {
            let mut times = StageTimes::default();
            let scene = times.measure("describe", || Scene::new(&question.frame))?;
            let lists =
                times.measure("shortlist", || library.shortlists(&scene, &config.recognise))?;
            let first = lists.first().map_or(&[][..], Vec::as_slice);
            let recognition = times.measure("compare", || {
                library.recognise_listed(&scene, first, &config.recognise, config.seed)
            })?;
            let name = &thing.stored.model.object;
            let names: Vec<&String> = recognition.matches.iter().map(|m| &m.object).collect();
            right += usize::from(names == [name]);
            let milliseconds = times.iter().map(|(stage, time)| (stage, time.as_secs_f64() * 1e3));
            let mut total = 0.0;
            for (stage, time) in milliseconds {
                of_stage.entry(stage).or_default().push(time);
                total += time;
            }
            frames.push(total);
        }
    }
    frames.sort_by(f64::total_cmp);
    let slow = frames.get(frames.len() * 95 / 100).copied().unwrap_or(f64::NAN);
    Ok(Row {
        objects,
        frames: frames.len(),
        right,
        milliseconds: STAGES
            .map(|stage| (stage, median(of_stage.entry(stage).or_default()).unwrap_or(f64::NAN)))
            .into(),
        frame_milliseconds: [median(&mut frames).unwrap_or(f64::NAN), slow],
    })
}

/// A learned thing, other learned things, and synthetic ones that have a learned one's shape.
fn among_others(number: usize, objects: usize, learned: &[Learned]) -> Vec<StoredObject> {
    let stored = |number: usize| &learned[number % learned.len()].stored;
    let features: Vec<&ModelFeature> =
        learned.iter().flat_map(|l| &l.stored.appearance.features).collect();
    (0..objects)
        .map(|i| {
            let learned_one = stored(number + i);
            if i < learned.len() {
                return learned_one.clone();
            }
            let mut other = learned_one.clone();
            other.model.object = format!("made up {i}");
            let made_up = made_up(&features, i as u64);
            let features = of_parts(made_up.features, other.model.parts.len());
            other.appearance = Appearance { features, ..other.appearance };
            other
        })
        .collect()
}

/// Features of an object that has this many parts.
fn of_parts(features: Vec<ModelFeature>, parts: usize) -> Vec<ModelFeature> {
    let of_part = |f: ModelFeature| ModelFeature { part: f.part % parts as u16, ..f };
    features.into_iter().map(of_part).collect()
}
