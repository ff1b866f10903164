//! The library: all that is known, to be looked for in pictures.
//!
//! In: the objects of a store, or objects in memory. Out: for a scene the shortlists of objects that
//! are worth a search, by the inverted index, and what is recognised of them.

use super::contents::{self, Entry};
use super::database::Store;
use super::error::StoreError;
use super::inverted_index::PostingCache;
use super::transaction;
use crate::features::DescribedFeature;
use crate::object::stored_object::StoredObject;
use crate::recognise::config::RecogniseConfig;
use crate::recognise::retrieval::{Index, Words};
use crate::recognise::{KnownObject, Recognition, Scene, recognise};
use lru::LruCache;
use rayon::prelude::*;
use std::collections::HashMap;
use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, PoisonError};

/// Objects of a store that are kept ready: many shortlists of them, in memory that stays bounded
/// however many the store holds.
const MOST_READY: NonZeroUsize = NonZeroUsize::new(256).expect("256 is above 0");

/// Objects with their index. Those of a store are prepared when they are looked for.
pub struct Library {
    names: Vec<String>,
    index: Index,
    objects: Objects,
}

/// Where the objects are.
enum Objects {
    /// In memory.
    Ready(Vec<Arc<KnownObject>>),
    /// In a store, prepared when they are first needed.
    Stored(Box<Mutex<Reader>>),
}

/// Reads what a library needs of a store and prepares its objects; the most recently used are
/// kept.
struct Reader {
    store: Store,
    lists: PostingCache,
    ready: LruCache<usize, Arc<KnownObject>>,
}

impl Reader {
    fn object(&mut self, number: usize, name: &str) -> Result<Arc<KnownObject>, StoreError> {
        let Self { store, ready, .. } = self;
        let prepare = || {
            let stored = store.get(name)?;
            Ok(Arc::new(KnownObject::new(stored.model, &stored.appearance)))
        };
        ready.try_get_or_insert(number, prepare).cloned()
    }
}

impl Store {
    /// Everything, to be recognised. Objects themselves, and the lists in which many are looked up,
    /// are read when they are first needed.
    ///
    /// # Errors
    /// As [`Self::get`], for objects whose words were not kept.
    pub fn load(&self) -> Result<Library, StoreError> {
        let snapshot = self.snapshot()?;
        let mut entries = self.read(contents::entries(&snapshot))?;
        drop(snapshot);
        entries.sort_unstable_by(|a, b| a.object.cmp(&b.object));
        let mut names = Vec::with_capacity(entries.len());
        let (mut listed, mut unlisted, mut made) = (HashMap::new(), Vec::new(), Vec::new());
        for (own, mut entry) in (0..).zip(entries) {
            match entry.words.take().map(Words::from_bytes) {
                None => {
                    listed.insert(entry.number, own);
                }
                Some(Some(words)) => unlisted.push((own, words)),
                Some(None) => {
                    let words = self.words_of(&entry.object)?;
                    let bytes = words.as_bytes().to_vec();
                    made.push(Entry { words: Some(bytes), ..entry.clone() });
                    unlisted.push((own, words));
                }
            }
            names.push(entry.object);
        }
        self.keep_words(&made);
        self.list_if_many();
        Ok(Library::lazy(Self::open(&self.path)?, names, Index::of_some(&unlisted, listed)))
    }

    /// Words of an object; none of one that another process took out meanwhile.
    fn words_of(&self, name: &str) -> Result<Words, StoreError> {
        let object = self.find(name)?;
        Ok(object.map_or_else(Words::default, |o| Words::of(&o.appearance)))
    }

    /// Keeps words that had to be made. Where they cannot be written they are made again next time.
    fn keep_words(&self, made: &[Entry]) {
        if made.is_empty() || self.is_read_only() {
            return;
        }
        let written = || {
            let together = transaction::begin(&self.connection)?;
            made.iter().try_for_each(|entry| contents::update(&together, entry))?;
            together.commit()
        };
        if let Err(error) = written() {
            tracing::debug!(%error, "words are not kept");
        }
    }
}

impl Library {
    /// A library of objects in memory.
    pub fn new(objects: Vec<StoredObject>) -> Self {
        let words: Vec<Words> = objects.par_iter().map(|o| Words::of(&o.appearance)).collect();
        let names = objects.iter().map(|o| o.model.object.clone()).collect();
        let ready = |o: StoredObject| Arc::new(KnownObject::new(o.model, &o.appearance));
        let objects = Objects::Ready(objects.into_par_iter().map(ready).collect());
        Self { names, index: Index::new(words), objects }
    }

    /// A library of a store's objects, with their names and index.
    fn lazy(store: Store, names: Vec<String>, index: Index) -> Self {
        let reader = Reader { store, lists: PostingCache::new(), ready: LruCache::new(MOST_READY) };
        Self { names, index, objects: Objects::Stored(Box::new(Mutex::new(reader))) }
    }

    /// Number of objects.
    pub fn len(&self) -> usize {
        self.names.len()
    }

    /// True when nothing is known.
    pub fn is_empty(&self) -> bool {
        self.names.is_empty()
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
        let mut before = Recognition::new(Vec::new());
        for listed in self.shortlists(scene, config)? {
            let mut found = self.recognise_listed(scene, &listed, config, seed)?;
            if let Some(object) = &before.best_refused_object {
                found.refuse(object, before.best_refused);
            }
            if !found.matches.is_empty() {
                return Ok(found);
            }
            before = found;
        }
        Ok(before)
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
        let lists = self.shortlists(scene, config)?;
        let listed = lists.get(turn % lists.len().max(1)).map_or(&[][..], Vec::as_slice);
        self.recognise_listed(scene, listed, config, seed)
    }

    /// The same of given objects, except for those that were taken out of the store meanwhile.
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
        let is_there = |o: &Result<_, _>| !matches!(o, Err(StoreError::UnknownObject { .. }));
        let objects = listed.iter().map(|&number| self.object(number)).filter(is_there);
        let objects: Vec<Arc<KnownObject>> = objects.collect::<Result<_, _>>()?;
        Ok(recognise(scene, &objects, config, seed))
    }

    /// Numbers of the objects that are worth looking for, the likeliest in the first list: where
    /// some stand out, these alone.
    ///
    /// # Errors
    /// [`StoreError::Database`] where lists cannot be read.
    pub fn shortlists(
        &self,
        scene: &Scene,
        config: &RecogniseConfig,
    ) -> Result<Vec<Vec<usize>>, StoreError> {
        let most = config.shortlist.max(1);
        let all = most * config.shortlists.max(1);
        // Few are all compared at once, whoever has most votes.
        let is_asked = self.len() > most;
        let ranked = if is_asked { self.rank(&scene.features, all)? } else { Vec::new() };
        let mut likely: Vec<usize> = ranked.iter().map(|(number, _)| *number).collect();
        // Where there is room for all, those without votes are compared last.
        if self.len() <= all {
            let others = (0..self.len()).filter(|number| !likely.contains(number));
            likely.extend(others.collect::<Vec<_>>());
        }
        let votes: Vec<f64> = ranked.iter().map(|(_, votes)| *votes).collect();
        let (first, rest) = likely.split_at(outstanding(&votes, most).min(likely.len()));
        let lists = std::iter::once(first).chain(rest.chunks(most));
        Ok(lists.filter(|list| !list.is_empty()).map(<[usize]>::to_vec).collect())
    }

    /// The first `places` objects by the votes of a picture's features, with these.
    ///
    /// # Errors
    /// As [`Self::shortlists`].
    pub fn rank(
        &self,
        seen: &[DescribedFeature],
        places: usize,
    ) -> Result<Vec<(usize, f64)>, StoreError> {
        match &self.objects {
            Objects::Ready(_) => Ok(self.index.rank(seen, places)),
            Objects::Stored(reader) => self.index.rank_reading(seen, places, |lists| {
                let mut reader = reader.lock().unwrap_or_else(PoisonError::into_inner);
                let Reader { store, lists: kept, .. } = &mut *reader;
                store.read(kept.read(&store.connection, lists))
            }),
        }
    }

    /// The number of an object.
    pub fn number(&self, name: &str) -> Option<usize> {
        self.names.iter().position(|known| known == name)
    }

    /// An object by its number, below [`Self::len`].
    ///
    /// # Errors
    /// As [`Self::recognise`].
    pub fn object(&self, number: usize) -> Result<Arc<KnownObject>, StoreError> {
        match &self.objects {
            Objects::Ready(objects) => Ok(Arc::clone(&objects[number])),
            Objects::Stored(reader) => {
                let mut reader = reader.lock().unwrap_or_else(PoisonError::into_inner);
                reader.object(number, &self.names[number])
            }
        }
    }
}

/// Multiple of the votes that chance gives from which the first object stands out.
const OUTSTANDING: f64 = 4.0;
/// Multiple of the votes that chance gives from which others may be there too.
const NOTABLE: f64 = 2.0;

/// How many objects are worth comparing at first, of those with these votes, most first. Votes
/// beyond those of `most` objects are chance; where there are none, nothing tells what chance gives.
fn outstanding(votes: &[f64], most: usize) -> usize {
    let Some(by_chance) = votes.get(most) else { return most };
    if votes[0] <= OUTSTANDING * by_chance {
        return most;
    }
    votes[..most].iter().take_while(|v| **v > NOTABLE * by_chance).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::test_data::object;
    use crate::test_data::{board, seen};

    #[test]
    fn of_a_large_store_only_the_most_recently_used_stay_in_memory() {
        let dir = tempfile::tempdir().unwrap();
        let mut store = Store::open_or_create(&dir.path().join("s.linkage")).unwrap();
        let all: Vec<StoredObject> =
            (0..MOST_READY.get() + 2).map(|i| object(&format!("drawer {i:03}"))).collect();
        store.put_all(&all).unwrap();
        let library = store.load().unwrap();
        let [first, second] = [0, 1].map(|number| Arc::downgrade(&library.object(number).unwrap()));
        for number in 2..library.len() {
            library.object(0).unwrap();
            library.object(number).unwrap();
        }
        assert!(first.upgrade().is_some(), "used all the time");
        assert!(second.upgrade().is_none(), "used once, long ago");
        assert_eq!(library.object(1).unwrap().model.object, "drawer 001");
    }

    #[test]
    fn what_another_process_took_out_of_the_store_is_looked_for_no_more() {
        let dir = tempfile::tempdir().unwrap();
        let mut store = Store::open_or_create(&dir.path().join("s.linkage")).unwrap();
        store.put_all(&[object("door"), object("fridge")]).unwrap();
        let library = store.load().unwrap();
        store.remove("door").unwrap();
        let scene = Scene::new(&seen(1, board(0.2, 1.5, 1.5))).unwrap();
        let found = library.recognise(&scene, &RecogniseConfig::default(), 1).unwrap();
        assert!(found.matches.is_empty());
        assert!(matches!(library.object(0), Err(StoreError::UnknownObject { .. })));
    }

    #[test]
    fn objects_that_stand_out_are_compared_alone() {
        assert_eq!(outstanding(&[40.0, 9.0, 1.8, 1.1, 1.0, 0.9], 3), 2);
    }

    #[test]
    fn where_none_stands_out_as_many_are_compared_as_is_allowed() {
        assert_eq!(outstanding(&[3.0, 2.5, 1.8, 1.1, 1.0, 0.9], 3), 3);
    }

    #[test]
    fn where_no_votes_are_left_that_chance_gave_none_is_put_off() {
        assert_eq!(outstanding(&[40.0, 9.0, 8.0], 3), 3);
        assert_eq!(outstanding(&[40.0, 9.0], 3), 3);
        assert_eq!(outstanding(&[], 3), 3);
    }
}
