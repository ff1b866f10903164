//! All that is known, to be looked for in pictures.

use super::{Store, StoreError, StoredObject};
use crate::recognise::{Index, KnownObject, RecogniseConfig, Recognition, Scene, Words, recognise};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Objects with their index. Each is prepared when it is first looked for.
pub struct Library {
    objects: Vec<Entry>,
    index: Index,
    /// Where objects come from that are not prepared yet.
    store: Option<Mutex<Store>>,
}

struct Entry {
    name: String,
    known: OnceLock<Arc<KnownObject>>,
}

impl Library {
    /// Of objects that are there already.
    pub fn new(objects: Vec<StoredObject>) -> Self {
        let index = Index::new(objects.iter().map(|o| Words::of(&o.appearance)));
        let known = |o: StoredObject| {
            let name = o.model.object.clone();
            let known = Arc::new(KnownObject::new(o.model, &o.appearance));
            Entry { name, known: OnceLock::from(known) }
        };
        Self { objects: objects.into_iter().map(known).collect(), index, store: None }
    }

    /// Of a store's objects, by their names and index.
    pub(super) fn lazy(store: Store, names: Vec<String>, index: Index) -> Self {
        let unread = |name| Entry { name, known: OnceLock::new() };
        Self {
            objects: names.into_iter().map(unread).collect(),
            index,
            store: Some(Mutex::new(store)),
        }
    }

    /// Number of objects.
    pub fn len(&self) -> usize {
        self.objects.len()
    }

    /// True when nothing is known.
    pub fn is_empty(&self) -> bool {
        self.objects.is_empty()
    }

    /// What of it is in the scene, best first. One shortlist after the other is gone through until
    /// something is recognised.
    ///
    /// # Errors
    /// [`StoreError::Damaged`], [`StoreError::Database`] for an object that cannot be read.
    pub fn recognise(
        &self,
        scene: &Scene,
        config: &RecogniseConfig,
        seed: u64,
    ) -> Result<Recognition, StoreError> {
        let mut best_refused: f64 = 0.0;
        for listed in self.shortlists(scene, config) {
            let found = self.recognise_listed(scene, &listed, config, seed)?;
            best_refused = best_refused.max(found.best_refused);
            if !found.matches.is_empty() {
                return Ok(Recognition { best_refused, ..found });
            }
        }
        Ok(Recognition { best_refused, ..Recognition::new(Vec::new()) })
    }

    /// The same of one shortlist, so that no frame of a stream takes longer than another: of the
    /// first in turn 0, of the next in turn 1, and of the first again after the last.
    ///
    /// # Errors
    /// As [`Self::recognise`].
    pub fn recognise_in_turn(
        &self,
        scene: &Scene,
        config: &RecogniseConfig,
        seed: u64,
        turn: usize,
    ) -> Result<Recognition, StoreError> {
        let lists = self.shortlists(scene, config);
        let listed = lists.get(turn % lists.len().max(1)).map_or(&[][..], Vec::as_slice);
        self.recognise_listed(scene, listed, config, seed)
    }

    /// The same of given objects.
    ///
    /// # Errors
    /// As [`Self::recognise`].
    pub fn recognise_listed(
        &self,
        scene: &Scene,
        listed: &[usize],
        config: &RecogniseConfig,
        seed: u64,
    ) -> Result<Recognition, StoreError> {
        let objects: Vec<Arc<KnownObject>> =
            listed.iter().map(|&number| self.object(number)).collect::<Result<_, _>>()?;
        Ok(recognise(scene, &objects, config, seed))
    }

    /// Numbers of the objects that are worth looking for, the likeliest in the first list.
    pub fn shortlists(&self, scene: &Scene, config: &RecogniseConfig) -> Vec<Vec<usize>> {
        let most = config.shortlist.max(1);
        let likely: Vec<usize> = if self.len() <= most {
            (0..self.len()).collect()
        } else {
            let all = most * config.shortlists.max(1);
            let ranked = self.index.rank(&scene.features, all);
            let mut likely: Vec<usize> = ranked.into_iter().map(|(number, _)| number).collect();
            // Where there is room for all, those without votes are compared last.
            if self.len() <= all {
                let others = (0..self.len()).filter(|number| !likely.contains(number));
                likely.extend(others.collect::<Vec<_>>());
            }
            likely
        };
        likely.chunks(most).map(<[usize]>::to_vec).collect()
    }

    /// The number of an object.
    pub fn number(&self, name: &str) -> Option<usize> {
        self.objects.iter().position(|entry| entry.name == name)
    }

    /// An object by its number, below [`Self::len`].
    ///
    /// # Errors
    /// As [`Self::recognise`].
    pub fn object(&self, number: usize) -> Result<Arc<KnownObject>, StoreError> {
        let entry = &self.objects[number];
        if let Some(known) = entry.known.get() {
            return Ok(Arc::clone(known));
        }
        let store =
            self.store.as_ref().expect("objects without a store are prepared from the start");
        let stored = store.lock().unwrap_or_else(PoisonError::into_inner).get(&entry.name)?;
        let known = Arc::new(KnownObject::new(stored.model, &stored.appearance));
        Ok(Arc::clone(entry.known.get_or_init(|| known)))
    }
}
