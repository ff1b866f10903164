//! Recognises the things of a store in a recording of another day and viewpoint.
//!
//! ```sh
//! linkage simulate --scene drawer --encounter --out out/encounter
//! cargo run --release -p linkage-skill --example 02_recognise -- objects.linkage out/encounter
//! ```
//!
//! In: a store (`01_learn` makes one) and a recording. Out: what is seen in its last frame: each
//! thing with its score and its pose, each joint with its configuration, or why that is not known.
//! Camera frame (x right, y down, z forward), metres and radians.

use linkage_skill::SkillConfig;
use linkage_skill::recognise::{JointState, Scene, StillFrames};
use linkage_skill::store::Store;
use std::error::Error;
use std::path::Path;
use std::process::ExitCode;

fn main() -> ExitCode {
    let Err(error) = run() else { return ExitCode::SUCCESS };
    eprintln!("{error}");
    ExitCode::FAILURE
}

fn run() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, recording] = arguments.as_slice() else {
        return Err("usage: 02_recognise STORE RECORDING".into());
    };
    let library = Store::open(Path::new(path))?.load()?;

    // Frames of a camera that stands still count together: they have less noise.
    let mut frames = linkage_driver::open(recording)?;
    let mut still = StillFrames::default();
    while let Some(frame) = frames.next_frame()? {
        still.push(frame);
    }
    let no_frame = || format!("{recording}: it holds no frame");
    let frame = still.fused()?.ok_or_else(no_frame)?;

    let config = SkillConfig::default();
    let found = library.recognise(&Scene::new(&frame)?, &config.recognise, config.seed)?;
    if found.matches.is_empty() {
        println!("none of the {} known objects is recognised", library.len());
    }
    for object in &found.matches {
        let [x, y, z, ..] = object.camera_from_object;
        let guess = if object.base_known { "" } else { " (a guess: the base is not seen)" };
        println!("{}, score {:.2}", object.object, object.score);
        println!("  its frame is at ({x:.3}, {y:.3}, {z:.3}) m{guess}");
        for joint in &object.joints {
            println!("  {}: {}", joint.name, configuration(joint));
        }
    }
    Ok(())
}

/// A joint's configuration in words, or why it is not known.
fn configuration(joint: &JointState) -> String {
    let unit = joint.kind.unit();
    match (joint.configuration, joint.deviation) {
        (Some(q), Some(deviation)) => format!("at {q:.3} ± {deviation:.3} {unit}"),
        (Some(q), None) => format!("at {q:.3} {unit}"),
        (None, _) => joint.reason.clone().unwrap_or_else(|| "not known".to_owned()),
    }
}
