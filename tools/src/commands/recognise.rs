//! `linkage recognise`.

use crate::cli::{Common, RecogniseArgs};
use crate::outcome::{Failure, Outcome};
use crate::output::{write_json, write_text};
use crate::report::{self, describe};
use crate::source;
use crate::steps::{recognise_frame, skill_config};
use linkage_skill::store::Store;

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
