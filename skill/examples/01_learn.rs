//! Learns a thing from a recording of one demonstration, and puts it into a store.
//!
//! ```sh
//! linkage simulate --scene drawer --out out/drawer      # or a recording of your own
//! cargo run --release -p linkage-skill --example 01_learn -- objects.linkage out/drawer drawer
//! ```
//!
//! In: a recording (a folder or a file that `linkage learn` reads), a store's path, a name. Out: the
//! joints that the demonstration shows, a line each, with what was rejected; the object in the store.
//! Metres and radians; axes are in the frame of the first picture's camera.

use linkage_driver::live::host_utime;
use linkage_skill::object::Provenance;
use linkage_skill::remember::to_stored;
use linkage_skill::store::Store;
use linkage_skill::{Learner, SkillConfig};
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
    let [path, recording, name] = arguments.as_slice() else {
        return Err("usage: 01_learn STORE RECORDING NAME".into());
    };
    // Before the work: `put` takes the place of an object of the same name.
    let mut store = Store::open_or_create(Path::new(path))?;
    if store.find(name)?.is_some() {
        return Err(format!("{path}: there is a \"{name}\" already; give another name").into());
    }

    let mut frames = linkage_driver::open(recording)?;
    let mut learner = Learner::new(&SkillConfig::default());
    while let Some(frame) = frames.next_frame()? {
        learner.push(&frame)?;
    }
    let demonstration = learner.finish(name)?;

    for rejected in &demonstration.rejections {
        println!("rejected: {rejected}");
    }
    if demonstration.model.joints.is_empty() {
        return Err(format!("{recording}: {}", demonstration.why_nothing()).into());
    }
    for joint in &demonstration.model.joints {
        let ([x, y, z], [low, high]) = (joint.axis, joint.range);
        let (kind, unit) = (joint.kind.name(), joint.kind.unit());
        println!("{}: {kind}, axis ({x:.3}, {y:.3}, {z:.3})", joint.name);
        println!("  seen from {low:.3} to {high:.3} {unit}");
    }

    let provenance = Provenance { source: recording.clone(), learned_utime: host_utime() };
    store.put(&to_stored(&demonstration, provenance)?)?;
    println!("\"{name}\" is in {path}, which holds: {}", store.names()?.join(", "));
    Ok(())
}
