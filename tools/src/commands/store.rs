//! `linkage store`.

use crate::cli::{StoreAction, StoreArgs};
use crate::console::{answer, say};
use crate::interrupt;
use crate::outcome::Outcome;
use crate::output::write_json;
use anyhow::anyhow;
use linkage_skill::object::StoredObject;
use linkage_skill::store::Store;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

pub fn run(args: &StoreArgs) -> Outcome {
    match &args.action {
        StoreAction::List { store } => {
            for name in Store::open(store)?.names()? {
                answer(name)?;
            }
            Ok(())
        }
        StoreAction::Show { object, store } => {
            let stored = Store::open(store)?.get(object)?;
            for p in &stored.provenance {
                say(format!("learned from {} at {} us", p.source, p.learned_utime));
            }
            say(format!(
                "{} features, {} surfels",
                stored.appearance.features.len(),
                stored.appearance.surfels.len()
            ));
            write_json(Path::new("-"), &stored.model)
        }
        StoreAction::Remove { object, store } => Ok(Store::open(store)?.remove(object)?),
        StoreAction::Merge { from, replace, store } => merge(from, *replace, store),
    }
}

/// Puts all objects of other stores into one. Those that are there already, and are not the same,
/// are left alone unless they are to be replaced.
fn merge(from: &[PathBuf], replace: bool, into: &Path) -> Outcome {
    let mut objects: BTreeMap<String, StoredObject> = BTreeMap::new();
    let mut differing: BTreeSet<String> = BTreeSet::new();
    for other in from {
        let other = Store::open(other)?;
        for name in other.names()? {
            let object = other.get(&name)?;
            let before = objects.insert(name.clone(), object);
            if before.is_some_and(|before| before != objects[&name]) {
                differing.insert(name);
            }
        }
    }
    let mut store = Store::open_or_create(into)?;
    let count = objects.len();
    let (mut changed, mut before) = (Vec::new(), Vec::new());
    for (name, object) in objects {
        let revision = store.revision(&name)?;
        // What is damaged is no reason to keep what is whole out.
        let known = store.find(&name).unwrap_or_default();
        if known.as_ref() == Some(&object) {
            continue;
        }
        if known.is_some() {
            differing.insert(name);
        }
        before.push(revision);
        changed.push(object);
    }
    if !(replace || differing.is_empty()) {
        let names = differing.into_iter().collect::<Vec<_>>().join(", ");
        let into = into.display();
        return Err(anyhow!(
            "{into}: these objects are known already, and differ: {names}; give --replace to put \
             the others in their place"
        )
        .into());
    }
    interrupt::uninterrupted(|| store.put_unchanged(&changed, &before))?;
    say(format!("{count} objects merged into {}", into.display()));
    Ok(())
}
