//! `--suite recognise`: does recognition err? Things are learned from one demonstration each;
//! every one of them is looked for in every still, and each score is kept: those of right pairs
//! and those of wrong ones.

mod ablation;
mod question;
pub mod scale;
mod stills;
mod times;

use super::dir::ConfigurationScore;
use crate::cli::{BenchArgs, Common};
use crate::outcome::Outcome;
use crate::output::write_json;
use crate::simulate::{Surfaces, TextureClass};
use crate::steps::{demonstrate, last_frame, remember, skill_config};
use crate::truth::Truth;
use anyhow::anyhow;
use linkage_skill::SkillConfig;
use linkage_skill::internals::median;
use linkage_skill::learn::StageTimes;
use linkage_skill::object::StoredObject;
use linkage_skill::recognise::{Recognised, Recognition, Scene, find};
use linkage_skill::store::{Library, Store, StoreError};
use question::{Learned, Precision, Question, precision};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use stills::{Shows, Still, THINGS};

/// Where recordings are kept when no folder is named.
const DEFAULT_DIR: &str = "out/recognise";
/// Bands of viewpoints by the turn's upper end, degrees.
const BANDS: [f64; 4] = [15.0, 30.0, 45.0, 60.0];

/// Largest turn of a viewpoint from which a thing should be recognised, degrees.
const MEANT_DEG: f64 = 45.0;

/// One still with what was found in it.
#[derive(Serialize)]
struct Row {
    still: String,
    shows: Shows,
    texture: Option<TextureClass>,
    turn_deg: f64,
    roll_deg: f64,
    occluded: bool,
    /// Score of the right object; `None`: there is none, or too few matches agree.
    own: Option<f64>,
    /// Best score of a wrong object, and which.
    wrong: Option<(String, f64)>,
    /// What the library reports, best first.
    reported: Vec<String>,
    right: bool,
    precision: Option<Precision>,
    /// Time of each stage.
    milliseconds: BTreeMap<&'static str, f64>,
}

impl Row {
    fn total_milliseconds(&self) -> f64 {
        self.milliseconds.values().sum()
    }
}

#[derive(Serialize)]
struct Report {
    threshold: f64,
    rows: Vec<Row>,
    wrong_scores: Vec<f64>,
    times: Vec<times::Row>,
    ablation: Vec<ablation::Row>,
    scale: Vec<scale::Row>,
}

pub fn run(args: &BenchArgs, common: &Common) -> Outcome {
    let mut config = skill_config(common)?;
    // Plain things have no features. The bench has one frame a still, so that it searches by shape in that frame.
    config.recognise.try_shape |= args.surfaces != Surfaces::Speckled;
    let dir = folder(args, config.seed);
    let surfaces = args.surfaces;
    let mut store = args.store.as_deref().map(Store::open_or_create).transpose()?;
    let learned: Vec<Learned> = THINGS
        .iter()
        .map(|thing| {
            known_or_learned(store.as_mut(), thing, surfaces, &dir.join(thing), &config, common)
        })
        .collect::<Outcome<Vec<Option<Learned>>>>()?
        .into_iter()
        .flatten()
        .collect();
    println!("{} of {} things learned", learned.len(), THINGS.len());
    let library = Library::new(learned.iter().map(|l| l.stored.clone()).collect());
    let names: Vec<String> = learned.iter().map(|l| l.stored.model.object.clone()).collect();
    let mut report = Report {
        threshold: config.recognise.min_score,
        rows: Vec::new(),
        wrong_scores: Vec::new(),
        times: Vec::new(),
        ablation: Vec::new(),
        scale: Vec::new(),
    };
    let mut questions = Vec::new();
    for still in stills::all(config.seed, surfaces) {
        let recording = dir.join(&still.name);
        still.render(&recording, common.quiet)?;
        let (row, scene) =
            look(&still, &recording, &library, &learned, &config, &mut report.wrong_scores)?;
        print_row(&row);
        let Scene { frame, features, .. } = scene;
        report.rows.push(row);
        let known = still.shows == Shows::Known;
        let number = names.iter().position(|n| known && *n == still.thing);
        questions.push(Question {
            truth: Truth::read(&recording)?,
            still,
            frame,
            features,
            number,
        });
    }
    print_bands(&report);
    print_wrong(&report);
    print_precision(&report);
    report.times = times::run(&learned, &questions, &config)?;
    if !args.brief {
        let stored: Vec<StoredObject> = learned.iter().map(|l| l.stored.clone()).collect();
        report.scale = scale::run(&stored, &questions, args.largest_store)?;
        report.ablation = ablation::run(&learned, &questions, &config)?;
    }
    if let Some(path) = &args.json {
        write_json(path, &report)?;
    }
    Ok(())
}

/// Where the recordings of a draw are kept.
fn folder(args: &BenchArgs, draw: u64) -> PathBuf {
    let dir = args.dir.clone().unwrap_or_else(|| args.surfaces.folder(DEFAULT_DIR));
    if draw == SkillConfig::default().seed { dir } else { dir.join(format!("draw_{draw}")) }
}

/// What a store knows already, or else what is learned now and kept there.
fn known_or_learned(
    store: Option<&mut Store>,
    thing: &str,
    surfaces: Surfaces,
    recording: &Path,
    config: &SkillConfig,
    common: &Common,
) -> Outcome<Option<Learned>> {
    stills::demonstration(thing, surfaces, config.seed, recording, common.quiet)?;
    let known = store.as_ref().map(|store| store.find(thing)).transpose()?.flatten();
    let source = recording.display().to_string();
    if let Some(other) = known.iter().flat_map(|k| &k.provenance).find(|p| p.source != source) {
        let other = &other.source;
        return Err(anyhow!("{thing} was learned from {other}: give another --store").into());
    }
    let stored = match known {
        Some(known) => known,
        None => {
            let Some(stored) = learn(thing, &source, config, common.quiet)? else {
                println!("{thing}: nothing learned");
                return Ok(None);
            };
            if let Some(store) = store {
                store.put(&stored)?;
            }
            stored
        }
    };
    Ok(Some(Learned { stored, truth: Truth::read(recording)? }))
}

/// Learns a thing from its recording; `None` where nothing moves.
fn learn(
    thing: &str,
    source: &str,
    config: &SkillConfig,
    quiet: bool,
) -> Outcome<Option<StoredObject>> {
    let demonstration = demonstrate(source, thing, config, quiet)?;
    if demonstration.model.joints.is_empty() {
        return Ok(None);
    }
    Ok(Some(remember(None, &demonstration, source, config)?))
}

/// The stage in which further shortlists are gone through.
const FURTHER: &str = "further";

/// What the library recognises in a still, and how long each stage takes.
fn recognise_timed(
    scene: &Scene,
    library: &Library,
    config: &SkillConfig,
    times: &mut StageTimes,
) -> Outcome<Recognition> {
    let mut lists =
        times.measure("shortlist", || library.shortlists(scene, &config.recognise))?.into_iter();
    let compare = |listed: Vec<usize>| {
        library.recognise_listed(scene, &listed, &config.recognise, config.seed)
    };
    let first = lists.next().unwrap_or_default();
    let mut recognition = times.measure("compare", || compare(first))?;
    for listed in lists {
        if recognition.matches.is_empty() {
            recognition = times.measure(FURTHER, || compare(listed))?;
        }
    }
    Ok(recognition)
}

/// What each object scores in a still, whatever it shows.
struct PairScores {
    /// The report of the right object.
    own: Option<Recognised>,
    /// The best of the wrong objects, with its name.
    wrong: Option<(String, f64)>,
}

/// Looks for every object in a still; scores of wrong pairs are added to `wrong_scores`.
fn pair_scores(
    still: &Still,
    scene: &Scene,
    library: &Library,
    config: &SkillConfig,
    wrong_scores: &mut Vec<f64>,
) -> Outcome<PairScores> {
    let all: Vec<(String, Option<Recognised>)> = (0..library.len())
        .into_par_iter()
        .map(|number| {
            let object = library.object(number)?;
            let found = find(scene, &object, &config.recognise, config.seed);
            Ok((object.model.object.clone(), found))
        })
        .collect::<Result<_, StoreError>>()?;
    let mut scores = PairScores { own: None, wrong: None };
    for (name, found) in all {
        if still.shows == Shows::Known && name == still.thing {
            scores.own = found;
            continue;
        }
        let score = found.map_or(0.0, |f| f.score);
        tracing::debug!(still = still.name, object = name, score, "wrong pair");
        wrong_scores.push(score);
        if scores.wrong.as_ref().is_none_or(|(_, s)| score > *s) {
            scores.wrong = Some((name, score));
        }
    }
    Ok(scores)
}

/// Asks about one still.
fn look(
    still: &Still,
    recording: &Path,
    library: &Library,
    learned: &[Learned],
    config: &SkillConfig,
    wrong_scores: &mut Vec<f64>,
) -> Outcome<(Row, Scene)> {
    let truth = Truth::read(recording)?;
    let frame = last_frame(&recording.display().to_string())?;
    let mut times = StageTimes::default();
    let scene = times.measure("describe", || Scene::new(&frame))?;
    let recognition = recognise_timed(&scene, library, config, &mut times)?;
    let milliseconds = times.iter().map(|(stage, t)| (stage, t.as_secs_f64() * 1e3)).collect();
    let PairScores { own, wrong } = pair_scores(still, &scene, library, config, wrong_scores)?;
    let reported: Vec<String> = recognition.matches.iter().map(|m| m.object.clone()).collect();
    let demonstrated = learned.iter().find(|l| l.stored.model.object == still.thing);
    let precision = match (recognition.matches.first(), demonstrated) {
        (Some(m), Some(l)) if still.shows == Shows::Known && m.object == still.thing => {
            precision(m, &truth, &l.truth)
        }
        _ => None,
    };
    let right = if still.shows == Shows::Known {
        reported == [still.thing.clone()] && precision.as_ref().is_some_and(Precision::is_right)
    } else {
        reported.is_empty()
    };
    let row = Row {
        still: still.name.clone(),
        shows: still.shows,
        texture: still.texture,
        turn_deg: still.shot.turn_deg.abs(),
        roll_deg: still.shot.roll_deg,
        occluded: still.shot.occluded,
        own: own.map(|o| o.score),
        wrong,
        reported,
        right,
        precision,
        milliseconds,
    };
    Ok((row, scene))
}

fn print_row(row: &Row) {
    let number = |x: Option<f64>| x.map_or("-".to_owned(), |x| format!("{x:.2}"));
    println!(
        "{:32} turn {:>3.0} roll {:>4.0}{} own {:>5} wrong {:>5} {:>6.0} ms {} {}",
        row.still,
        row.turn_deg,
        row.roll_deg,
        if row.occluded { " behind" } else { "       " },
        number(row.own),
        number(row.wrong.as_ref().map(|w| w.1)),
        row.total_milliseconds(),
        if row.right { "right" } else { "WRONG" },
        row.reported.join(", "),
    );
}

fn print_bands(report: &Report) {
    println!("\nknown things by viewpoint");
    let mut low = 0.0;
    for high in BANDS {
        let rows: Vec<&Row> = report
            .rows
            .iter()
            .filter(|r| r.shows == Shows::Known && r.turn_deg > low && r.turn_deg <= high)
            .collect();
        let right = rows.iter().filter(|r| r.right).count();
        println!("{low:>3.0}-{high:.0}° {right:>3} of {} right", rows.len());
        low = high;
    }
    let known: Vec<&Row> = report.rows.iter().filter(|r| r.shows == Shows::Known).collect();
    let print_share = |what: &str, is_meant: &dyn Fn(&Row) -> bool| {
        let rows: Vec<&&Row> =
            known.iter().filter(|r| r.turn_deg <= MEANT_DEG && is_meant(r)).collect();
        let right = rows.iter().filter(|r| r.right).count();
        if !rows.is_empty() {
            println!("up to {MEANT_DEG}°, {what:8} {right:>3} of {} right", rows.len());
        }
    };
    print_share("occluded", &|r| r.occluded);
    for texture in [TextureClass::Plain, TextureClass::Medium, TextureClass::Rich] {
        print_share(texture.name(), &|r| r.texture == Some(texture));
    }
    for shows in [Shows::Repainted, Shows::Reproportioned, Shows::Other] {
        let rows: Vec<&Row> = report.rows.iter().filter(|r| r.shows == shows).collect();
        let taken = rows.iter().filter(|r| !r.reported.is_empty()).count();
        println!("{shows:?}: something reported in {taken} of {}", rows.len());
    }
    let middle = |of: &dyn Fn(&Row) -> f64| {
        median(&mut report.rows.iter().map(of).collect::<Vec<f64>>()).unwrap_or(f64::NAN)
    };
    let at = |r: &Row, stage: &str| r.milliseconds.get(stage).copied().unwrap_or(0.0);
    let stages: Vec<String> = ["describe", "shortlist", "compare"]
        .iter()
        .map(|stage| format!("{stage} {:.0}", middle(&|r: &Row| at(r, stage))))
        .collect();
    let frame = middle(&|r: &Row| r.total_milliseconds() - at(r, FURTHER));
    println!("median {frame:.0} ms a frame: {}", stages.join(", "));
    let still = middle(&|r: &Row| r.total_milliseconds());
    println!(
        "median {still:.0} ms a still, further shortlists included where the first is in vain"
    );
}

fn print_wrong(report: &Report) {
    let mut wrong = report.wrong_scores.clone();
    wrong.sort_by(f64::total_cmp);
    let above = wrong.iter().filter(|s| **s >= report.threshold).count();
    println!(
        "\n{} wrong pairs, {above} at or above the threshold {}",
        wrong.len(),
        report.threshold
    );
    let own: Vec<f64> = report.rows.iter().filter_map(|r| r.own).collect();
    println!("score      wrong  right  share right");
    for tenth in 0..10 {
        let (low, high) = (0.1 * f64::from(tenth), 0.1 * f64::from(tenth + 1));
        let within = |scores: &[f64]| {
            scores.iter().filter(|s| **s >= low && (**s < high || tenth == 9)).count()
        };
        let (false_ones, true_ones) = (within(&wrong), within(&own));
        let share = match true_ones + false_ones {
            0 => "-".to_owned(),
            all => format!("{:.2}", true_ones as f64 / all as f64),
        };
        println!("{low:.1}-{high:.1} {false_ones:>9} {true_ones:>6} {share:>12}");
    }
    println!("highest wrong score {:.2}", wrong.last().copied().unwrap_or(0.0));
}

fn print_precision(report: &Report) {
    let all: Vec<&Precision> = report.rows.iter().filter_map(|r| r.precision.as_ref()).collect();
    let placed: Vec<&Precision> = all.iter().copied().filter(|p| p.base_known).collect();
    let middle = |values: Vec<f64>| median(&mut values.clone()).unwrap_or(f64::NAN);
    let of_unit = |unit: &str| -> Vec<f64> {
        all.iter()
            .flat_map(|p| &p.joints)
            .filter(|j| j.unit == unit)
            .filter_map(|j| j.error)
            .collect()
    };
    println!(
        "\nbase {:.2}° {:.2} cm; configuration {:.2}° {:.2} cm; axis {:.2}° {:.2} cm (medians of {})",
        middle(placed.iter().map(|p| p.base_deg).collect()),
        middle(placed.iter().map(|p| p.base_cm).collect()),
        middle(of_unit("°")),
        middle(of_unit("cm")),
        middle(all.iter().flat_map(|p| &p.joints).map(|j| j.axis_deg).collect()),
        middle(all.iter().flat_map(|p| p.axis_cm.clone()).collect()),
        all.len(),
    );
    println!("a moving part alone is seen, and said to be, in {}", all.len() - placed.len());
    let joints: Vec<&ConfigurationScore> = all.iter().flat_map(|p| &p.joints).collect();
    let told = joints.iter().filter(|j| j.error.is_some()).count();
    let right = joints.iter().filter(|j| j.is_right()).count();
    println!("configurations: {told} of {} told, {right} right (5°, 2 cm)", joints.len());
}
