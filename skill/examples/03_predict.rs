//! Predicts how a recognised thing will move: the path of each part to a target.
//!
//! ```sh
//! cargo run --release -p linkage-skill --example 03_predict -- objects.linkage out/encounter open
//! ```
//!
//! In: a store (`01_learn` makes one), a recording, and a target: `open`, `closed`, or a
//! configuration in radians or metres. Out: for each joint that is seen, poses `camera_from_part` on
//! the way, `[x, y, z, qx, qy, qz, qw]`, and where the part is held, where that was learned. Camera
//! frame, metres. Times and limits of motion are the planner bridge's.

use linkage_skill::predict::{PredictionContext, Target};
use linkage_skill::recognise::Scene;
use linkage_skill::store::Store;
use linkage_skill::{SkillConfig, pose_to_array};
use nalgebra::Point3;
use std::error::Error;
use std::path::Path;
use std::process::ExitCode;

/// Steps of the way that are printed.
const STEPS: u32 = 4;

fn main() -> ExitCode {
    let Err(error) = run() else { return ExitCode::SUCCESS };
    eprintln!("{error}");
    ExitCode::FAILURE
}

fn run() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, recording, target] = arguments.as_slice() else {
        return Err("usage: 03_predict STORE RECORDING TARGET".into());
    };
    let target: Target = target.parse()?;
    let store = Store::open(Path::new(path))?;

    let (mut frames, mut last) = (linkage_driver::open(recording)?, None);
    while let Some(frame) = frames.next_frame()? {
        last = Some(frame);
    }
    let scene = Scene::new(&last.ok_or_else(|| format!("{recording}: it holds no frame"))?)?;
    let config = SkillConfig::default();
    let found = store.load()?.recognise(&scene, &config.recognise, config.seed)?;
    let nothing = || format!("{recording}: nothing known is recognised");
    let recognised = found.matches.first().ok_or_else(nothing)?;

    let model = store.get(&recognised.object)?.model;
    let object = PredictionContext::new(&model, recognised)?;
    for motion in object.motions(None, target)? {
        let joint = &model.joints[motion.joint];
        let (from, to) = (motion.from, motion.to);
        println!("{}/{} ({}):", model.object, joint.name, joint.kind.name());
        for step in 0..=STEPS {
            let q = from + (to - from) * f64::from(step) / f64::from(STEPS);
            let camera_from_part = object.part_poses(&[(motion.joint, q)])[joint.child];
            let pose = pose_to_array(&camera_from_part);
            println!("  at {q:.3} {}: camera_from_part {pose:.3?}", joint.kind.unit());
            if let Some(grasp) = model.parts[joint.child].grasp {
                let held = camera_from_part * Point3::from(grasp);
                println!("    held at ({:.3}, {:.3}, {:.3}) m", held.x, held.y, held.z);
            }
        }
    }
    Ok(())
}
