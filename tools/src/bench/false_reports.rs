//! `--suite false-reports DIR --store FILE`: does recognition report what is not there? Every object of a
//! store is looked for in stills of recordings that do not show it. No truth is needed beside them: a
//! recording shows the object whose name its folder's name begins with (`fridge_encounter1`: fridge), and
//! of other objects nothing.
//!
//! Each still is asked about as `linkage recognise` asks about a recording that ends there: frames of a
//! camera that stands still count together, and what is plain is looked for in its room and by its shape.

use crate::cli::{BenchArgs, Common};
use crate::console::Progress;
use crate::outcome::Outcome;
use crate::output::write_json;
use crate::steps::{recognise_view, skill_config};
use anyhow::{Context, anyhow};
use linkage_driver::RgbdSource;
use linkage_skill::SkillConfig;
use linkage_skill::object::StoredObject;
use linkage_skill::recognise::StillFrames;
use linkage_skill::store::{Library, Store};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// An object that was reported in a recording that does not show it.
#[derive(Serialize)]
struct FalseReport {
    recording: String,
    /// Number of the frame in its recording, the first being 0.
    frame: usize,
    object: String,
    score: f64,
}

#[derive(Serialize, Default)]
struct Report {
    stills: usize,
    /// An object and a still that does not show it make a pair.
    pairs: usize,
    /// Highest score of what was not reported.
    highest_refused: f64,
    false_reports: Vec<FalseReport>,
}

pub fn run(args: &BenchArgs, common: &Common) -> Outcome {
    let dir = args.dir.as_ref().ok_or_else(|| anyhow!("--suite false-reports needs a folder"))?;
    let store =
        args.store.as_ref().ok_or_else(|| anyhow!("--suite false-reports needs --store"))?;
    let mut config = skill_config(common)?;
    let store = Store::open(store)?;
    let objects: Vec<StoredObject> =
        store.names()?.iter().map(|name| store.get(name)).collect::<Result<_, _>>()?;
    // All are compared, not those alone that stand out by their words.
    config.recognise.shortlist = objects.len();
    let mut report = Report::default();
    let recordings = folders(dir)?;
    let progress = Progress::new("recordings", Some(recordings.len()), common.quiet);
    for recording in &recordings {
        look_through(recording, &objects, args.stills, &config, &mut report)?;
        progress.step();
    }
    progress.finish(&format!("{} recordings of {}", recordings.len(), dir.display()));
    print(&report);
    if let Some(path) = &args.json {
        write_json(path, &report)?;
    }
    Ok(())
}

/// Folders of a folder, by name.
fn folders(dir: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(dir).with_context(|| dir.display().to_string())?;
    let mut found: Vec<PathBuf> =
        entries.filter_map(|e| Some(e.ok()?.path())).filter(|p| p.is_dir()).collect();
    found.sort();
    Ok(found)
}

/// Looks for the objects that a recording does not show in some of its stills.
fn look_through(
    recording: &Path,
    objects: &[StoredObject],
    stills: usize,
    config: &SkillConfig,
    report: &mut Report,
) -> Outcome {
    let name = recording.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let source = recording.display().to_string();
    let (mut frames, count) = match opened(&source) {
        Ok(opened) => opened,
        Err(error) => {
            println!("{name}: not read: {error:#}");
            return Ok(());
        }
    };
    let others = objects.iter().filter(|o| !shows(&name, &o.model.object)).cloned().collect();
    let library = Library::new(others);
    let asked = spread(count, stills);
    let mut still = StillFrames::default();
    for number in 0..count {
        let frame = match frames.next_frame() {
            Ok(Some(frame)) => frame,
            Ok(None) => break,
            Err(error) => {
                println!("{name}: read up to frame {number}: {error}");
                break;
            }
        };
        still.push(frame);
        if !asked.contains(&number) {
            continue;
        }
        let (_, found) = recognise_view(&library, &still, &source, config)?;
        report.stills += 1;
        report.pairs += library.len();
        report.highest_refused = report.highest_refused.max(found.best_refused);
        for m in found.matches {
            println!("{name} frame {number}: {} reported, score {:.2}", m.object, m.score);
            report.false_reports.push(FalseReport {
                recording: name.clone(),
                frame: number,
                object: m.object,
                score: m.score,
            });
        }
    }
    Ok(())
}

/// A recording, and how many frames it has.
fn opened(source: &str) -> anyhow::Result<(Box<dyn RgbdSource>, usize)> {
    let frames = linkage_driver::open(source)?;
    let count = frames.frame_count().context("it does not tell how many frames it has")?;
    Ok((frames, count))
}

/// A recording's name says that it shows this object.
fn shows(recording: &str, object: &str) -> bool {
    recording == object || recording.strip_prefix(object).is_some_and(|rest| rest.starts_with('_'))
}

/// So many numbers below `count`, evenly spread; the first and the last are among them, where there are two.
fn spread(count: usize, wanted: usize) -> Vec<usize> {
    let Some(last) = count.checked_sub(1) else { return Vec::new() };
    let steps = wanted.clamp(1, count) - 1;
    (0..=steps).map(|i| last - (steps - i) * last / steps.max(1)).collect()
}

fn print(report: &Report) {
    let found = report.false_reports.len();
    println!("{} stills, {} wrong pairs, {found} false reports", report.stills, report.pairs);
    println!("highest score of what was not reported: {:.2}", report.highest_refused);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_of_a_recording_says_what_it_shows() {
        assert!(shows("fridge_demo1", "fridge") && shows("fridge", "fridge"));
        assert!(!shows("fridge_demo1", "fridge2") && !shows("fridges_demo1", "fridge"));
    }

    #[test]
    fn stills_are_spread_over_a_recording() {
        assert_eq!(spread(101, 3), [0, 50, 100]);
        assert_eq!(spread(101, 1), [100]);
        assert_eq!(spread(2, 5), [0, 1]);
        assert!(spread(0, 3).is_empty());
    }
}
