//! `linkage record`.

use super::source::{losses, open, repairs};
use super::{Failure, Outcome};
use crate::cli::{Common, RecordArgs, RecordFormat};
use crate::console::Progress;
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
    Ok(())
}

fn format_of(format: RecordFormat) -> record::RecordFormat {
    match format {
        RecordFormat::Tum => record::RecordFormat::Tum,
        RecordFormat::TumJpeg => record::RecordFormat::TumJpeg,
        RecordFormat::LcmLog => record::RecordFormat::LcmLog,
        RecordFormat::Fakenect => record::RecordFormat::Fakenect,
    }
}
