//! `linkage config`.

use crate::cli::{Common, ConfigAction, ConfigArgs};
use crate::console::answer;
use crate::outcome::Outcome;
use crate::steps::skill_config;
use linkage_planner_bridge::Rig;

pub fn run(args: &ConfigArgs, common: &Common) -> Outcome {
    match args.action {
        ConfigAction::Dump => {
            let configuration = skill_config(common)?.to_explained_toml();
            answer(format!("{}\n\n{}", configuration.trim_end(), rig_as_comments()))
        }
    }
}

/// The default rig, which has a file of its own, in comment lines.
fn rig_as_comments() -> String {
    let head = "# What a rig sets stands in a file of its own (--rig FILE). Its defaults:";
    let lines = Rig::DEFAULT_TEXT.lines().map(|line| format!("#   {line}"));
    let lines: Vec<String> = lines.map(|line| line.trim_end().to_owned()).collect();
    format!("{head}\n#\n{}", lines.join("\n"))
}
