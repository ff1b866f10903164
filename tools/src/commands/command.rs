//! `linkage command`: tells a running service what to do, and waits for its answer.

use super::{Failure, Outcome};
use crate::cli::{CommandArgs, ServiceAction};
use anyhow::anyhow;
use linkage_driver::live::host_utime;
use linkage_lcm::messages::linkage;
use linkage_lcm::{Lcm, decode};
use linkage_planner_bridge::channel;
use std::time::{Duration, Instant};

/// Time after which a command is sent again: it is not done twice.
const AGAIN_AFTER: Duration = Duration::from_millis(500);

pub fn run(args: &CommandArgs) -> Outcome {
    let command = message(args)?;
    let mut lcm = Lcm::new(&args.publish)?;
    lcm.subscribe(channel::STATUS)?;
    let wait = Duration::try_from_secs_f64(args.wait).map_err(|e| anyhow!("--wait: {e}"))?;
    let start = Instant::now();
    let mut sent: Option<Instant> = None;
    let mut progress =
        "no service answers; is \"linkage serve\" running on this network?".to_owned();
    while start.elapsed() < wait {
        if sent.is_none_or(|at| at.elapsed() > AGAIN_AFTER) {
            lcm.publish(channel::COMMAND, &command)?;
            sent = Some(Instant::now());
        }
        let Some(packet) = lcm.receive(AGAIN_AFTER)? else { continue };
        let Ok(status) = decode::<linkage::Status>(&packet.bytes) else { continue };
        if status.command_utime != command.utime {
            continue;
        }
        let answer = status.command_answer;
        if !status.command_accepted {
            return Err(Failure::no_answer(answer));
        }
        if status.command_done {
            println!("{answer}");
            return Ok(());
        }
        progress = format!("{answer}, not done yet; wait longer with --wait");
    }
    Err(Failure::no_answer(format!("{}: after {:.1} s: {progress}", args.publish, args.wait)))
}

fn message(args: &CommandArgs) -> Outcome<linkage::Command> {
    let empty = linkage::Command { utime: host_utime(), schema: 1, ..Default::default() };
    let named = |object: &Option<String>| object.clone().unwrap_or_default();
    Ok(match &args.action {
        ServiceAction::Start { object } => linkage::Command {
            action: linkage::Command::START_DEMONSTRATION,
            object: object.clone(),
            ..empty
        },
        ServiceAction::Finish => {
            linkage::Command { action: linkage::Command::FINISH_DEMONSTRATION, ..empty }
        }
        ServiceAction::Recognise { object } => {
            linkage::Command { action: linkage::Command::RECOGNISE, object: named(object), ..empty }
        }
        ServiceAction::Predict { object, joint, to, outside_range, grasp } => linkage::Command {
            action: linkage::Command::PREDICT,
            object: named(object),
            joint: named(joint),
            target: to.clone(),
            outside_range: *outside_range,
            has_grasp: grasp.is_some(),
            grasp: grasp.as_deref().map_or(Ok([0.0; 3]), |g| {
                <[f64; 3]>::try_from(g).map_err(|_| anyhow!("--grasp is x,y,z in metres"))
            })?,
            ..empty
        },
        ServiceAction::Cancel => linkage::Command { action: linkage::Command::CANCEL, ..empty },
    })
}
