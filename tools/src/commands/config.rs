//! `linkage config`.

use super::{Outcome, skill_config};
use crate::cli::{Common, ConfigAction, ConfigArgs};

pub fn run(args: &ConfigArgs, common: &Common) -> Outcome {
    match args.action {
        ConfigAction::Dump => {
            print!("{}", toml::to_string_pretty(&skill_config(common)?)?);
            Ok(())
        }
    }
}
