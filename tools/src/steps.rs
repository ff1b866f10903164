//! Steps that several commands and benches share: the configuration, a simulated recording, a
//! demonstration, what is learned from it, a recognition.
//!
//! In: names of sources and scenes as on the command line. Out: the library's own types; each step
//! shows its progress and fails with the exit status of a command.

use crate::cli::{Common, SourceArgs};
use crate::console::Progress;
use crate::outcome::{BAD_INPUT, Failure, INTERNAL, NO_ANSWER, Outcome};
use crate::simulate::{SCENES, Surfaces, Take, paint, record, scene};
use crate::tags::TagLog;
use crate::{interrupt, source};
use anyhow::{Context, anyhow};
use linkage_driver::live::host_utime;
use linkage_driver::{RgbdFrame, RgbdSource};
use linkage_skill::object::{Provenance, StoredObject};
use linkage_skill::recognise::{Recognition, Scene, StillFrames};
use linkage_skill::remember::add_demonstration;
use linkage_skill::store::Library;
use linkage_skill::{Demonstration, LearnError, Learner, SkillConfig};
use std::path::Path;

/// What reports call the steps that take time.
pub const READING_FRAMES: &str = "reading the frames";
pub const READING_STORE: &str = "reading the store";
pub const RECOGNITION: &str = "recognition";
pub const PREDICTION: &str = "the prediction and its plan";

/// The effective configuration.
pub fn skill_config(common: &Common) -> Outcome<SkillConfig> {
    let mut config = SkillConfig::load(&common.profile, common.config.as_deref())?;
    if let Some(seed) = common.seed {
        config.seed = seed;
    }
    Ok(config)
}

/// A recording to be rendered.
pub struct FilmOrder<'n> {
    /// Name of the scene.
    pub scene: &'n str,
    /// What is filmed of it.
    pub take: Take,
    /// Surfaces of thing and room.
    pub surfaces: Surfaces,
    /// AprilTags are stuck on the parts.
    pub with_tags: bool,
    /// Seed of room, light, person and noise.
    pub seed: u64,
}

impl<'n> FilmOrder<'n> {
    /// A take with speckled surfaces and without tags.
    pub fn of(scene: &'n str, take: Take, seed: u64) -> Self {
        Self { scene, take, surfaces: Surfaces::Speckled, with_tags: false, seed }
    }
}

/// Renders a scene with progress.
pub fn film(order: &FilmOrder, out: &Path, quiet: bool) -> Outcome {
    let FilmOrder { scene: name, take, surfaces, with_tags, seed } = *order;
    let mut scene = scene(name, seed).ok_or_else(|| {
        let known: Vec<&str> = SCENES.iter().map(|s| s.0).collect();
        anyhow!("no scene \"{name}\"; known: {}", known.join(", "))
    })?;
    paint(&mut scene, surfaces.texture(seed), seed);
    let total = take.frames(&scene);
    let progress = Progress::new("rendering", Some(total), quiet);
    record(&scene, take, seed, out, with_tags, || progress.step())?;
    progress.finish(&format!("{total} frames in {}", out.display()));
    Ok(())
}

/// Learns from one recording, with progress.
pub fn demonstrate(
    source: &str,
    object: &str,
    config: &SkillConfig,
    quiet: bool,
) -> Outcome<Demonstration> {
    let mut frames = linkage_driver::open(source)?;
    demonstrate_past(None, &mut *frames, object, config, quiet)
}

/// Learns from frames, with progress. With tags, these are noted and nothing is learned from what
/// lies on them.
pub fn demonstrate_past(
    mut tags: Option<&mut TagLog>,
    frames: &mut dyn RgbdSource,
    object: &str,
    config: &SkillConfig,
    quiet: bool,
) -> Outcome<Demonstration> {
    let source = frames.name().to_owned();
    let progress = Progress::new("watching", frames.frame_count(), quiet);
    let mut learner = Learner::new(config);
    let mut count = 0;
    while let Some(mut frame) = frames.next_frame()? {
        if let Some(tags) = &mut tags {
            frame = tags.note(&frame)?;
        }
        learner.push(&frame).with_context(|| source.clone())?;
        progress.step();
        count += 1;
    }
    progress.finish(&format!("{count} frames of {source}"));
    interrupt::stopped(&source, frames.is_live())?;
    learner.finish(object).map_err(|error| {
        let status = match &error {
            LearnError::TooShort { .. } | LearnError::NoDepth => NO_ANSWER,
            LearnError::Vision(_) => INTERNAL,
            _ => BAD_INPUT,
        };
        Failure { status, cause: anyhow::Error::new(error).context(source) }
    })
}

/// A demonstration as an object, registered into what is known of it already.
pub fn remember(
    known: Option<&StoredObject>,
    demonstration: &Demonstration,
    source: &str,
    config: &SkillConfig,
) -> Outcome<StoredObject> {
    let provenance = Provenance { source: source.to_owned(), learned_utime: host_utime() };
    Ok(add_demonstration(known, demonstration, provenance, config)?)
}

/// The last frame of a recording.
pub fn last_frame(recording: &str) -> Outcome<RgbdFrame> {
    source::open(recording, &SourceArgs::default())?.last_frame()
}

/// Recognises in one frame.
fn recognise_frame(
    library: &Library,
    frame: &RgbdFrame,
    source: &str,
    config: &SkillConfig,
) -> Outcome<Recognition> {
    warn_without_depth(frame, source);
    Ok(library.recognise(&Scene::new(frame)?, &config.recognise, config.seed)?)
}

/// Recognises in the frames of a camera that stands still, as one with less noise; where that shows
/// nothing, in the last of them alone, and then by shape in all of them: that takes its time, and edges are exact
/// enough in depth of little noise alone. Returns the frame that the answer is of, too.
pub fn recognise_view(
    library: &Library,
    still: &StillFrames,
    source: &str,
    config: &SkillConfig,
) -> Outcome<(RgbdFrame, Recognition)> {
    let fused = still.fused().map_err(anyhow::Error::new)?;
    let fused = fused.ok_or_else(|| Failure::no_answer(format!("{source}: no frame")))?;
    let of_all = recognise_frame(library, &fused, source, config)?;
    let Some(last) = still.last().filter(|_| of_all.matches.is_empty() && still.len() > 1) else {
        return Ok((fused, of_all));
    };
    let of_last = recognise_frame(library, last, source, config)?;
    if !of_last.matches.is_empty() || config.recognise.try_shape {
        return Ok((last.clone(), of_last));
    }
    let mut by_shape = config.recognise.clone();
    by_shape.try_shape = true;
    let found = library.recognise(&Scene::new(&fused)?, &by_shape, config.seed)?;
    Ok(if found.matches.is_empty() { (last.clone(), of_last) } else { (fused, found) })
}

/// Warns of a frame without depth.
fn warn_without_depth(frame: &RgbdFrame, source: &str) {
    if frame.depth.invalid_share() >= 1.0 {
        tracing::warn!(source, "no depth at all: poses come from colour alone and are less sure");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_scene_is_refused_with_the_names_of_those_that_there_are() {
        let out = tempfile::tempdir().unwrap();
        let order = FilmOrder::of("castle", Take::Encounter, 1);
        let failed = film(&order, out.path(), true).err().unwrap();
        let said = failed.cause.to_string();
        assert!(said.contains("\"castle\"") && said.contains("two_drawers"), "{said}");
        assert_eq!(failed.status, BAD_INPUT);
    }
}
