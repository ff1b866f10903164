//! `linkage record`.

use crate::cli::{Common, RecordArgs, RecordFormat};
use crate::console::Progress;
use crate::interrupt;
use crate::outcome::{Failure, Outcome};
use crate::source::{losses, open, repairs};
use linkage_driver::{RgbdSource, record};

pub fn run(args: &RecordArgs, common: &Common) -> Outcome {
    let mut frames = open(&args.source, &args.take)?;
    let mut recorder = record::create(&args.out, format_of(args.format))?;
    let progress = Progress::new("recording", frames.frame_count(), common.quiet);
    let mut count = 0;
    let result = loop {
        match frames.next_frame() {
            Ok(Some(frame)) => recorder.write(&frame)?,
            Ok(None) => break Ok(()),
            // What came before the camera was lost is kept.
            Err(e) => break Err(e),
        }
        progress.step();
        count += 1;
    };
    let signal = interrupt::unwatch();
    recorder.finish()?;
    progress.finish(&format!("{count} frames in {}", args.out.display()));
    let statistics = frames.statistics();
    if let Some(losses) = losses(&statistics) {
        tracing::warn!(source = args.source, "not recorded: {losses}");
    }
    if let Some(repairs) = repairs(&statistics) {
        tracing::warn!(source = args.source, "{repairs}");
    }
    result?;
    if count == 0 {
        return Err(Failure::no_answer(format!("{}: no frame", args.source)));
    }
    // A camera has no end of its own; of a recording something is missing.
    if let (Some(signal), false) = (signal, frames.is_live()) {
        let what = format!("{} frames of {} are in {}", count, args.source, args.out.display());
        return Err(signal.failure(what));
    }
    Ok(())
}

fn format_of(format: RecordFormat) -> record::RecordFormat {
    match format {
        RecordFormat::Tum => record::RecordFormat::Tum,
        RecordFormat::TumJpeg => record::RecordFormat::TumJpeg,
        RecordFormat::LcmLog => record::RecordFormat::LcmLog,
        RecordFormat::Mcap => record::RecordFormat::Mcap,
        RecordFormat::Fakenect => record::RecordFormat::Fakenect,
    }
}
