//! `linkage store`.

use super::{Outcome, write_json};
use crate::cli::{StoreAction, StoreArgs};
use linkage_skill::store::{Store, StoredObject};
use std::path::Path;

pub fn run(args: &StoreArgs) -> Outcome {
    match &args.action {
        StoreAction::List { store } => {
            for name in Store::open(store)?.names()? {
                println!("{name}");
            }
            Ok(())
        }
        StoreAction::Show { object, store } => {
            let stored = Store::open(store)?.get(object)?;
            for p in &stored.provenance {
                eprintln!("learned from {} at {} us", p.source, p.learned_utime);
            }
            eprintln!(
                "{} features, {} surfels",
                stored.appearance.features.len(),
                stored.appearance.surfels.len()
            );
            write_json(Path::new("-"), &stored.model)
        }
        StoreAction::Remove { object, store } => Ok(Store::open(store)?.remove(object)?),
        StoreAction::Merge { from, store } => {
            let mut objects: Vec<StoredObject> = Vec::new();
            for other in from {
                let other = Store::open(other)?;
                for name in other.names()? {
                    objects.push(other.get(&name)?);
                }
            }
            Store::open_or_create(store)?.put_all(&objects)?;
            eprintln!("{} objects merged into {}", objects.len(), store.display());
            Ok(())
        }
    }
}
