//! `linkage recognise`.

use crate::cli::{Common, RecogniseArgs};
use crate::outcome::{Failure, Outcome};
use crate::output::{write_json, write_text};
use crate::report::{self, describe};
use crate::source;
use crate::steps::{recognise_view, skill_config};
use linkage_skill::store::Store;

pub fn run(args: &RecogniseArgs, common: &Common) -> Outcome {
    let config = skill_config(common)?;
    let library = Store::open(&args.store)?.load()?;
    let still = source::open(&args.source, &args.take)?.still_frames()?;
    let (frame, recognition) = recognise_view(&library, &still, &args.source, &config)?;
    if !common.quiet && still.len() > 1 {
        eprintln!("the camera stands still: the last {} frames count together", still.len());
    }
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
