//! `linkage config`.

use crate::cli::{Common, ConfigAction, ConfigArgs};
use crate::console::answer;
use crate::outcome::Outcome;
use crate::steps::skill_config;

pub fn run(args: &ConfigArgs, common: &Common) -> Outcome {
    match args.action {
        ConfigAction::Dump => answer(skill_config(common)?.to_explained_toml().trim_end()),
    }
}
