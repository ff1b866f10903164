//! Where `linkage learn` keeps what it learns. Everything that prevents storing is found before
//! learning begins, which takes long.

use crate::cli::{DEFAULT_STORE, LearnArgs};
use crate::console::say;
use crate::interrupt;
use crate::outcome::{Failure, Outcome};
use anyhow::{Context, anyhow};
use linkage_skill::internals::check_name;
use linkage_skill::object::StoredObject;
use linkage_skill::store::{Revision, Store, StoreError};
use std::path::{Path, PathBuf};

/// A place in a store for one object.
pub struct Destination {
    path: PathBuf,
    object: String,
    mode: Mode,
}

/// What happens to an existing object of that name.
enum Mode {
    /// There is none, and must be none when the new one is stored.
    New,
    /// It is replaced.
    Replace,
    /// Demonstrations are added to it, if there is one.
    Add(Option<Box<StoredObject>>),
}

impl Destination {
    /// What the command line asks for; `None` where nothing is to be stored.
    pub fn of(args: &LearnArgs) -> Outcome<Option<Self>> {
        check_name(&args.object).map_err(|reason| anyhow!("--object: {reason}"))?;
        if args.no_store {
            return Ok(None);
        }
        let path = args.store.clone().unwrap_or_else(|| PathBuf::from(DEFAULT_STORE));
        match Self::at(path, args) {
            // Files that are asked for, and no store, are made whatever becomes of the store.
            Err(failure) if is_for_files(args) => {
                tracing::warn!("nothing is stored: {:#}", failure.cause);
                Ok(None)
            }
            found => found.map(Some),
        }
    }

    fn at(path: PathBuf, args: &LearnArgs) -> Outcome<Self> {
        let store = existing(&path)?;
        let mode = match &store {
            _ if args.replace => Mode::Replace,
            Some(store) if args.add => Mode::Add(store.find(&args.object)?.map(Box::new)),
            None if args.add => Mode::Add(None),
            Some(store) if store.revision(&args.object)?.is_some() => {
                return Err(taken(&path, &args.object));
            }
            _ => Mode::New,
        };
        Ok(Self { path, object: args.object.clone(), mode })
    }

    /// What demonstrations are added to.
    pub fn known(&self) -> Option<&StoredObject> {
        match &self.mode {
            Mode::Add(known) => known.as_deref(),
            Mode::New | Mode::Replace => None,
        }
    }

    /// Stores the object, and says where. Where another program changed what it was added to
    /// meanwhile, `again` adds to that.
    pub fn keep(
        self,
        object: StoredObject,
        again: impl Fn(Option<&StoredObject>) -> Outcome<StoredObject>,
        quiet: bool,
    ) -> Outcome<StoredObject> {
        let stored = interrupt::uninterrupted(|| self.put(object, again))?;
        if !quiet {
            say(format!("{} is saved in {}", self.object, self.path.display()));
        }
        Ok(stored)
    }

    fn put(
        &self,
        object: StoredObject,
        again: impl Fn(Option<&StoredObject>) -> Outcome<StoredObject>,
    ) -> Outcome<StoredObject> {
        let mut store = Store::open_or_create(&self.path)?;
        match &self.mode {
            Mode::New => {
                match store.put_unchanged(std::slice::from_ref(&object), &[None::<Revision>]) {
                    Err(StoreError::Changed { .. }) => return Err(taken(&self.path, &self.object)),
                    result => result?,
                }
            }
            Mode::Replace => store.put(&object)?,
            Mode::Add(before) => {
                return store.update(&self.object, |now| {
                    if now == before.as_deref() { Ok(object.clone()) } else { again(now) }
                });
            }
        }
        Ok(object)
    }
}

/// The store of a name, if there is one, and it can be written.
fn existing(path: &Path) -> Outcome<Option<Store>> {
    match Store::open(path) {
        Ok(store) if store.is_read_only() => {
            Err(StoreError::ReadOnly { path: path.display().to_string() }.into())
        }
        Ok(store) => Ok(Some(store)),
        Err(StoreError::Missing { .. }) => {
            let folder = path.parent().filter(|dir| !dir.as_os_str().is_empty());
            tempfile::tempfile_in(folder.unwrap_or(Path::new(".")))
                .with_context(|| format!("{}: no store can be made here", path.display()))?;
            Ok(None)
        }
        Err(error) => Err(error.into()),
    }
}

/// True where files are asked for, and neither a store nor what is to become of what it holds.
fn is_for_files(args: &LearnArgs) -> bool {
    let files = [&args.json, &args.poses, &args.tum, &args.report, &args.tag_poses, &args.mcap];
    let says_nothing_of_stores = args.store.is_none() && !args.replace && !args.add;
    says_nothing_of_stores && files.iter().any(|file| file.is_some())
}

fn taken(path: &Path, object: &str) -> Failure {
    anyhow!(
        "{}: there is an object \"{object}\" already; give --replace to put the new one in its \
         place, --add to add the demonstration to it, or another --object",
        path.display()
    )
    .into()
}
