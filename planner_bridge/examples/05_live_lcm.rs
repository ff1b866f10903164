//! Tells a running service to plan how a thing opens, and prints what it publishes: a planner's end
//! of the network in a page.
//!
//! ```sh
//! linkage serve --source freenect:0 --store objects.linkage &     # or --source RECORDING --repeat
//! cargo run --release -p linkage-planner-bridge --example 05_live_lcm -- drawer
//! ```
//!
//! In: the name of an object that the service knows, and the URL of its network. Out: its answer, each
//! joint as it is seen, and each joint's trajectory. Metres, radians, seconds. A robot needs more: it
//! moves on the setpoints of `linkage serve --stream-hz`, as SAFETY.md says.

use linkage_lcm::messages::linkage::{Command, Joint, JointTrajectory, Prediction, Recognition};
use linkage_lcm::{DEFAULT_URL, Lcm, decode};
use linkage_planner_bridge::{Client, channel};
use std::error::Error;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Longest wait for what was asked for.
const LONGEST_WAIT: Duration = Duration::from_secs(20);

fn main() -> ExitCode {
    let Err(error) = run() else { return ExitCode::SUCCESS };
    eprintln!("{error}");
    ExitCode::FAILURE
}

fn run() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (object, url) = match arguments.as_slice() {
        [object] => (object, DEFAULT_URL),
        [object, url] => (object, url.as_str()),
        _ => return Err("usage: 05_live_lcm OBJECT [URL]".into()),
    };
    // Before the command is sent, or the prediction could be missed.
    let mut lcm = Lcm::new(url)?;
    lcm.subscribe(channel::RECOGNITION)?;
    lcm.subscribe(channel::PREDICTION)?;

    let (action, target) = (Command::PREDICT, "open".to_owned());
    let command = Command { action, object: object.clone(), target, ..Command::default() };
    let answer = Client::new(url, None)?.done(&command, LONGEST_WAIT)?;
    println!("{answer}");

    let (start, mut seen) = (Instant::now(), Vec::new());
    while start.elapsed() < LONGEST_WAIT {
        let Some(packet) = lcm.receive(Duration::from_millis(100))? else { continue };
        if packet.channel == channel::RECOGNITION {
            // Packets come from a network: one that is no message is passed over.
            let Ok(recognition) = decode::<Recognition>(&packet.bytes) else { continue };
            let of_object = recognition.matches.into_iter().find(|m| m.object == *object);
            seen = of_object.map_or_else(Vec::new, |m| m.joints);
        } else if let Ok(prediction) = decode::<Prediction>(&packet.bytes)
            && prediction.recognition.object == *object
        {
            seen.iter().for_each(print_joint);
            prediction.trajectories.iter().for_each(print_trajectory);
            return Ok(());
        }
    }
    Err(format!("{url}: no prediction of \"{object}\" within {LONGEST_WAIT:?}").into())
}

fn print_joint(joint: &Joint) {
    match joint.configuration_known {
        true => println!("{} is at {:.3}", joint.name, joint.configuration),
        false => println!("{} is not known: {}", joint.name, joint.reason),
    }
}

fn print_trajectory(trajectory: &JointTrajectory) {
    let last = (trajectory.position.last(), trajectory.time_from_start_us.last());
    if let (Some(position), Some(time_us)) = last {
        let seconds = *time_us as f64 * 1e-6;
        println!("{} arrives at {position:.3} after {seconds:.2} s", trajectory.joint);
    }
}
