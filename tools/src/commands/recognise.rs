//! `linkage recognise`.

use crate::cli::{Common, RecogniseArgs};
use crate::console::say;
use crate::outcome::{Failure, Outcome};
use crate::output::{write_json, write_text};
use crate::report::{self, Asked, describe};
use crate::source;
use crate::steps::{READING_FRAMES, READING_STORE, RECOGNITION, recognise_view, skill_config};
use crate::view::{View, Wanted};
use linkage_skill::learn::StageTimes;
use linkage_skill::object::StoredObject;
use linkage_skill::recognise::Recognition;
use linkage_skill::store::Store;
use std::collections::BTreeSet;

pub fn run(args: &RecogniseArgs, common: &Common) -> Outcome {
    let config = skill_config(common)?;
    let view = View::open(&Wanted { mcap: args.mcap.clone(), address: None })?;
    let store = Store::open(&args.store)?;
    let mut times = StageTimes::default();
    let library = times.measure(READING_STORE, || store.load())?;
    let mut source = source::open(&args.source, &args.take)?;
    let still = times.measure(READING_FRAMES, || source.still_frames())?;
    let recognised =
        times.measure(RECOGNITION, || recognise_view(&library, &still, &args.source, &config));
    let (frame, recognition) = recognised?;
    if !common.quiet && still.len() > 1 {
        say(format!("the camera stands still: the last {} frames count together", still.len()));
    }
    if let Some(path) = &args.json {
        write_json(path, &recognition)?;
    }
    let objects = match args.report.is_some() || view.is_some() {
        true => recognised_objects(&store, &recognition)?,
        false => Vec::new(),
    };
    if let Some(view) = view {
        view.frame(&frame);
        view.recognition(frame.utime, &recognition, &objects);
        for m in &recognition.matches {
            view.say(frame.utime, false, describe(m).trim_end());
        }
        view.close()?;
    }
    if let Some(path) = &args.report {
        let min_score = config.recognise.min_score;
        let (known, objects, times) = (library.len(), &objects[..], &times);
        let asked = Asked { known, min_score, objects, times };
        write_text(path, &report::recognition_page(&frame, &recognition, &asked)?)?;
    }
    if recognition.matches.is_empty() {
        return Err(Failure::no_answer(format!("{}: nothing is recognised", args.source)));
    }
    if !common.quiet {
        for m in &recognition.matches {
            say(describe(m).trim_end());
        }
    }
    Ok(())
}

/// The objects that were recognised, as they are stored, each once.
fn recognised_objects(store: &Store, recognition: &Recognition) -> Outcome<Vec<StoredObject>> {
    let names: BTreeSet<&str> = recognition.matches.iter().map(|m| m.object.as_str()).collect();
    names.into_iter().map(|name| Ok(store.get(name)?)).collect()
}
