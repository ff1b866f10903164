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
        let mut index = Index::new();
        let objects = objects
            .into_iter()
            .map(|o| {
                index.insert(&Words::of(&o.appearance));
                let name = o.model.object.clone();
                let known = Arc::new(KnownObject::new(o.model, &o.appearance));
                Entry { name, known: OnceLock::from(known) }
            })
            .collect();
        Self { objects, index, store: None }
    }

    /// Of a store's objects, by their words and names.
    pub(super) fn lazy(store: Store, objects: Vec<(Words, String)>) -> Self {
        let mut index = Index::new();
        let objects = objects
            .into_iter()
            .map(|(words, name)| {
                index.insert(&words);
                Entry { name, known: OnceLock::new() }
            })
            .collect();
        Self { objects, index, store: Some(Mutex::new(store)) }
    }

    /// Number of objects.
    pub fn len(&self) -> usize {
        self.objects.len()
    }

    /// True when nothing is known.
    pub fn is_empty(&self) -> bool {
        self.objects.is_empty()
    }

    /// What of it is in the scene, best first.
    ///
    /// # Errors
    /// [`StoreError::Damaged`], [`StoreError::Database`] for an object that cannot be read.
    pub fn recognise(
        &self,
        scene: &Scene,
        config: &RecogniseConfig,
        seed: u64,
    ) -> Result<Recognition, StoreError> {
        let objects: Vec<Arc<KnownObject>> = self
            .shortlist(scene, config)
            .into_iter()
            .map(|number| self.object(number))
            .collect::<Result<_, _>>()?;
        Ok(recognise(scene, &objects, config, seed))
    }

    /// Numbers of the objects that are worth looking for.
    pub fn shortlist(&self, scene: &Scene, config: &RecogniseConfig) -> Vec<usize> {
        if self.len() <= config.shortlist {
            return (0..self.len()).collect();
        }
        self.index
            .rank(&scene.features, config.shortlist)
            .into_iter()
            .map(|(number, _)| number)
            .collect()
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
