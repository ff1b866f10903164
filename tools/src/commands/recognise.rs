//! `linkage recognise`.

use super::{Failure, Outcome, skill_config, source, warn_without_depth, write_json, write_text};
use crate::cli::{Common, RecogniseArgs, SourceArgs};
use crate::report;
use linkage_driver::RgbdFrame;
use linkage_skill::SkillConfig;
use linkage_skill::recognise::{Recognition, Scene};
use linkage_skill::store::{Library, Store};

pub fn run(args: &RecogniseArgs, common: &Common) -> Outcome {
    let config = skill_config(common)?;
    let library = Store::open(&args.store)?.load()?;
    let frame = source::open(&args.source, &args.take)?.last_frame()?;
    let recognition = recognise_frame(&library, &frame, &args.source, &config)?;
    if let Some(path) = &args.json {
        write_json(path, &recognition)?;
    }
    if let Some(path) = &args.report {
        write_text(path, &report::recognition_page(&frame, &recognition, &library)?)?;
    }
    if recognition.matches.is_empty() {
        return Err(Failure::no_answer(format!("{}: nothing is recognised", args.source)));
    }
    if !common.quiet {
        for m in &recognition.matches {
            eprint!("{}", describe(m));
        }
    }
    Ok(())
}

/// Recognises in one frame.
pub fn recognise_frame(
    library: &Library,
    frame: &RgbdFrame,
    source: &str,
    config: &SkillConfig,
) -> Outcome<Recognition> {
    warn_without_depth(frame, source);
    Ok(library.recognise(&Scene::new(frame)?, &config.recognise, config.seed)?)
}

/// The last frame of a recording.
pub fn last_frame(recording: &str) -> Outcome<RgbdFrame> {
    source::open(recording, &SourceArgs::default())?.last_frame()
}

/// A few lines for people.
pub fn describe(m: &linkage_skill::recognise::Recognised) -> String {
    let joints: Vec<String> = m
        .joints
        .iter()
        .map(|j| match j.configuration {
            Some(q) => format!("{} at {q:.3} {}", j.name, j.kind.unit()),
            None => format!("{} not known: {}", j.name, j.reason.as_deref().unwrap_or("not seen")),
        })
        .collect();
    format!("{}: score {:.2}, {} inliers, {}\n", m.object, m.score, m.inliers, joints.join(", "))
}
