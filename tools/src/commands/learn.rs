//! `linkage learn`.

use super::destination::Destination;
use crate::cli::{Common, LearnArgs};
use crate::console::say;
use crate::outcome::{Failure, Outcome};
use crate::output::{write_json, write_text};
use crate::report::{self, summary};
use crate::source;
use crate::steps::{demonstrate_past, remember, skill_config};
use crate::tags::TagLog;
use crate::view::{View, Wanted, watched};
use linkage_driver::{RgbdFrame, RgbdSource};
use linkage_skill::object::{Appearance, StoredObject};
use linkage_skill::{Demonstration, SkillConfig, pose_to_array};
use std::fmt::Write;
use std::path::Path;

/// A demonstration with the source that it was seen in.
type Seen<'a> = (&'a str, Demonstration);

pub fn run(args: &LearnArgs, common: &Common) -> Outcome {
    let config = skill_config(common)?;
    let destination = Destination::of(args)?;
    let view = View::open(&Wanted { mcap: args.mcap.clone(), address: None })?;
    let mut all: Vec<Seen> = Vec::new();
    for source in &args.sources {
        // Times of several demonstrations may overlap: one of them is shown.
        let view = view.as_ref().filter(|_| all.is_empty());
        all.push(watch(args, source, &config, view, common.quiet)?);
    }
    let Some((_, first)) = all.first() else { return Ok(()) };
    let known = destination.as_ref().and_then(Destination::known);
    let object = remember_all(known, &all, &config)?;
    let model = object.as_ref().map_or(&first.model, |o| &o.model);
    if let Some(path) = &args.json {
        write_json(path, model)?;
    }
    if let Some(path) = &args.poses {
        write_text(path, &poses_csv(first))?;
    }
    if let Some(dir) = &args.tum {
        write_tum(dir, first)?;
    }
    let looks = match args.report.is_some() || view.is_some() {
        true => looks_of_first(known, object.as_ref(), &all, &config)?,
        false => None,
    };
    if let Some(path) = &args.report {
        write_text(path, &report::demonstration_page(first, looks.as_ref())?)?;
    }
    if let Some(view) = view {
        view.demonstration(first, looks.as_ref());
        view.close()?;
    }
    let Some(object) = object else {
        let why = first.why_nothing();
        return Err(Failure::no_answer(format!("{}: {why}", args.sources.join(", "))));
    };
    let again = |known: Option<&StoredObject>| {
        let object = remember_all(known, &all, &config)?;
        object.ok_or_else(|| Failure::no_answer("nothing was learned"))
    };
    let stored = match destination {
        Some(destination) => destination.keep(object, again, common.quiet)?,
        None => object,
    };
    if !common.quiet {
        say(summary(&stored.model).trim_end());
    }
    Ok(())
}

/// Watches one demonstration.
fn watch<'a>(
    args: &LearnArgs,
    source: &'a str,
    config: &SkillConfig,
    view: Option<&View>,
    quiet: bool,
) -> Outcome<Seen<'a>> {
    let mut tags = if args.tags { Some(TagLog::of(recording_of(source))?) } else { None };
    let show = |frame: &RgbdFrame| {
        if let Some(view) = view {
            view.frame(frame);
        }
    };
    let mut frames = watched(source::open(source, &args.take)?, show);
    let demonstration = demonstrate_past(tags.as_mut(), &mut frames, &args.object, config, quiet)?;
    if let Some(losses) = source::losses(&frames.statistics()) {
        tracing::warn!(source, "not learned from: {losses}");
    }
    if let Some(tags) = &tags {
        report_tags(tags, args.tag_poses.as_deref())?;
    }
    Ok((source, demonstration))
}

/// All demonstrations as one object, registered into what is known of it already; `None` where
/// nothing moves in any of them.
fn remember_all(
    known: Option<&StoredObject>,
    all: &[Seen],
    config: &SkillConfig,
) -> Outcome<Option<StoredObject>> {
    let mut object: Option<StoredObject> = None;
    for (source, demonstration) in all {
        if !demonstration.model.joints.is_empty() {
            let before = object.as_ref().or(known);
            object = Some(remember(before, demonstration, source, config)?);
        }
    }
    Ok(object)
}

/// What the first demonstration's parts look like, in its own object frame. That of an object that was
/// known already is another frame.
fn looks_of_first(
    known: Option<&StoredObject>,
    object: Option<&StoredObject>,
    all: &[Seen],
    config: &SkillConfig,
) -> Outcome<Option<Appearance>> {
    match (known, all) {
        (None, [_]) => Ok(object.map(|o| o.appearance.clone())),
        (_, [first, ..]) => {
            Ok(remember_all(None, std::slice::from_ref(first), config)?.map(|o| o.appearance))
        }
        (_, []) => Ok(None),
    }
}

/// The directory that a source's name stands for.
fn recording_of(source: &str) -> &Path {
    Path::new(source.strip_prefix("tum:").unwrap_or(source))
}

/// Says how well tags were seen, and writes their poses.
fn report_tags(tags: &TagLog, poses: Option<&Path>) -> Outcome {
    for (place, share) in tags.seen() {
        tracing::info!(tag = place.id, part = place.part, share, "tag seen");
        if share == 0.0 {
            tracing::warn!(tag = place.id, part = place.part, "tag never seen");
        }
    }
    let Some(path) = poses else { return Ok(()) };
    let mut text = String::from("t,part,x,y,z,qx,qy,qz,qw\n");
    for (place, _) in tags.seen() {
        for (utime, pose) in tags.part_poses(&place.part) {
            let numbers = pose_to_array(&pose).map(|x| format!("{x:.9}")).join(",");
            let _ = writeln!(text, "{:.6},{},{numbers}", utime as f64 * 1e-6, place.part);
        }
    }
    write_text(path, &text)
}

/// `t,part,x,y,z,qx,qy,qz,qw`: camera_from_part.
fn poses_csv(demonstration: &Demonstration) -> String {
    let mut text = String::from("t,part,x,y,z,qx,qy,qz,qw\n");
    for (frame, utime) in demonstration.frame_utimes.iter().enumerate() {
        for (part, poses) in demonstration.camera_from_part.iter().enumerate() {
            if let Some(pose) = &poses[frame] {
                let numbers = pose_to_array(pose).map(|x| format!("{x:.9}")).join(",");
                let _ = writeln!(text, "{:.6},{part},{numbers}", *utime as f64 * 1e-6);
            }
        }
    }
    text
}

/// A file for each part in TUM's format: `timestamp tx ty tz qx qy qz qw`, camera_from_part.
fn write_tum(dir: &Path, demonstration: &Demonstration) -> Outcome {
    for (part, poses) in demonstration.camera_from_part.iter().enumerate() {
        let named = demonstration.model.parts.iter().find(|p| p.id == part);
        let name = named.map_or_else(|| format!("part{part}"), |p| p.name.clone());
        let mut text = String::from("# timestamp tx ty tz qx qy qz qw\n");
        for (utime, pose) in demonstration.frame_utimes.iter().zip(poses) {
            if let Some(pose) = pose {
                let numbers = pose_to_array(pose).map(|x| format!("{x:.9}")).join(" ");
                let _ = writeln!(text, "{:.6} {numbers}", *utime as f64 * 1e-6);
            }
        }
        write_text(&dir.join(format!("{name}.txt")), &text)?;
    }
    Ok(())
}
