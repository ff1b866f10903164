//! `linkage command`: tells a running service what to do, and waits for its answer.

use crate::cli::{CommandArgs, ServiceAction};
use crate::console::answer;
use crate::outcome::{Failure, Outcome};
use anyhow::anyhow;
use linkage_lcm::messages::linkage;
use linkage_planner_bridge::service::CommandKey;
use linkage_planner_bridge::{Client, ClientError};
use std::time::Duration;

pub fn run(args: &CommandArgs) -> Outcome {
    let command = message(args)?;
    let wait = Duration::try_from_secs_f64(args.wait).map_err(|e| anyhow!("--wait: {e}"))?;
    let key = args.key.as_deref().map(CommandKey::read).transpose()?;
    let mut client = Client::new(&args.publish, key)?;
    match client.done(&command, wait) {
        Ok(said) => answer(said),
        Err(e @ ClientError::Lcm(_)) => Err(e.into()),
        Err(e) => Err(Failure::no_answer(e)),
    }
}

fn message(args: &CommandArgs) -> Outcome<linkage::Command> {
    let empty = linkage::Command::default();
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
