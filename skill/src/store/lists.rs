//! What the inverted index needs of each object, as the store keeps it: its words, until those of
//! many have come together; then their postings by lists, of which a picture asks for a few.

use super::{Store, StoreError, schema};
use crate::recognise::{Posting, Postings, Words};
use lru::LruCache;
use rayon::prelude::*;
use rusqlite::{Connection, OptionalExtension, Transaction, TransactionBehavior, params};
use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::sync::Arc;

/// Objects whose words are not listed: so many at least may be before all are,
const FEW: u32 = 2_000;
/// and one of so many that are listed. The first keeps small stores simple; the second bounds both
/// what is read when a store is opened and how often lists are written anew.
const ONE_OF: u32 = 8;

/// Whether the words of so many objects should be listed, where those of so many are.
fn are_many(unlisted: u32, listed: u32) -> bool {
    unlisted > FEW.max(listed / ONE_OF)
}

/// Lists the words of all objects if they are many.
pub fn list_if_many(path: &Path, connection: &Connection) -> Result<(), StoreError> {
    let sql = |e| schema::explain(path, e);
    let count = |of: &str| -> rusqlite::Result<u32> {
        connection.query_row(&format!("SELECT count(*) FROM words {of}"), [], |row| row.get(0))
    };
    let unlisted = count("WHERE words IS NOT NULL").map_err(sql)?;
    if are_many(unlisted, 0) && are_many(unlisted, count("").map_err(sql)? - unlisted) {
        list(connection, unlisted).map_err(sql)?;
    }
    Ok(())
}

/// Puts the words of all objects in lists, in place of postings of what is no more.
fn list(connection: &Connection, unlisted: u32) -> rusqlite::Result<()> {
    tracing::info!(objects = unlisted, "listing words: once for many objects");
    let alone = Transaction::new_unchecked(connection, TransactionBehavior::Immediate)?;
    let objects: Vec<(u32, Words)> = all(
        &alone,
        "SELECT number, words FROM words WHERE words IS NOT NULL ORDER BY number",
        |row| Ok((row.get(0)?, row.get(1)?)),
    )?
    .into_iter()
    .filter_map(|(number, words)| Some((number, Words::from_bytes(words)?)))
    .collect();
    let known: HashSet<u32> =
        all(&alone, "SELECT number FROM words", |row| row.get(0))?.into_iter().collect();
    let mut read = alone.prepare("SELECT postings FROM postings WHERE list = ?1")?;
    let mut write =
        alone.prepare("INSERT OR REPLACE INTO postings (list, postings) VALUES (?1, ?2)")?;
    for (list, postings) in Postings::of(&objects).lists() {
        let kept: Option<Vec<u8>> = read.query_row([list as u32], |row| row.get(0)).optional()?;
        let kept = Posting::all_from_bytes(kept.as_deref().unwrap_or_default());
        let all = kept.filter(|p| known.contains(&p.object)).chain(postings.iter().copied());
        let bytes: Vec<u8> = all.flat_map(Posting::to_bytes).collect();
        write.execute(params![list as u32, bytes])?;
    }
    let mut listed = alone.prepare("UPDATE words SET words = NULL WHERE number = ?1")?;
    for (number, _) in &objects {
        listed.execute([number])?;
    }
    drop((read, write, listed));
    alone.commit()
}

/// All rows of a query.
pub fn all<T>(
    connection: &Connection,
    query: &str,
    of_row: impl FnMut(&rusqlite::Row) -> rusqlite::Result<T>,
) -> rusqlite::Result<Vec<T>> {
    connection.prepare(query)?.query_map([], of_row)?.collect()
}

/// Memory for lists that were read: those of many pictures, however many objects are listed.
const MOST_BYTES: usize = 256 << 20;

/// A store's lists as a library reads them: the most recently used stay in memory.
pub struct Lists {
    /// What is listed: the library's own numbers by the store's. Those of the store are never used
    /// again, so that it may change meanwhile.
    numbers: HashMap<u32, u32>,
    recent: LruCache<usize, Arc<[Posting]>>,
    bytes: usize,
}

impl Lists {
    /// Of objects by their numbers in the store, with their numbers in the library.
    pub fn of(numbers: HashMap<u32, u32>) -> Self {
        Self { numbers, recent: LruCache::unbounded(), bytes: 0 }
    }

    /// The postings of some lists, in their order, with the library's numbers.
    pub fn read(
        &mut self,
        store: &Store,
        lists: &[usize],
    ) -> Result<Vec<Arc<[Posting]>>, StoreError> {
        if self.numbers.is_empty() {
            return Ok(Vec::new());
        }
        let unread: Vec<usize> =
            lists.iter().copied().filter(|list| !self.recent.contains(list)).collect();
        let kept = store.sql(kept(&store.connection, &unread))?;
        let read: Vec<Arc<[Posting]>> =
            kept.par_iter().map(|bytes| self.in_library(bytes)).collect();
        for (list, postings) in unread.into_iter().zip(read) {
            self.bytes += size_of_val(&postings[..]);
            self.recent.put(list, postings);
        }
        let read =
            lists.iter().map(|list| self.recent.get(list).cloned().unwrap_or_default()).collect();
        self.forget_beyond(MOST_BYTES);
        Ok(read)
    }

    fn forget_beyond(&mut self, bytes: usize) {
        while self.bytes > bytes
            && let Some((_, postings)) = self.recent.pop_lru()
        {
            self.bytes -= size_of_val(&postings[..]);
        }
    }

    fn in_library(&self, bytes: &[u8]) -> Arc<[Posting]> {
        let own = |mut posting: Posting| {
            posting.object = *self.numbers.get(&posting.object)?;
            Some(posting)
        };
        Posting::all_from_bytes(bytes).filter_map(own).collect()
    }
}

/// The postings of each list as they are kept.
fn kept(connection: &Connection, lists: &[usize]) -> rusqlite::Result<Vec<Vec<u8>>> {
    // One transaction: the file is locked once, not for every list.
    let together = connection.unchecked_transaction()?;
    let mut statement = together.prepare_cached("SELECT postings FROM postings WHERE list = ?1")?;
    let mut kept = |list: &usize| {
        let row = statement.query_row([*list as u32], |row| row.get(0)).optional()?;
        Ok(row.unwrap_or_default())
    };
    lists.iter().map(&mut kept).collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::object;
    use super::super::{Library, StoredObject};
    use super::*;
    use crate::specimen::{features, features_seen};
    use tempfile::TempDir;

    fn thing(name: &str, seed: u64) -> StoredObject {
        StoredObject { appearance: features(seed), ..object(name) }
    }

    fn things(seeds: std::ops::Range<u64>) -> Vec<StoredObject> {
        seeds.map(|seed| thing(&format!("thing {seed:02}"), seed)).collect()
    }

    fn empty_store() -> (TempDir, Store) {
        let dir = tempfile::tempdir().unwrap();
        let store = Store::open_or_create(&dir.path().join("s.linkage")).unwrap();
        (dir, store)
    }

    fn list_all(store: &Store) {
        list(&store.connection, 0).unwrap();
        let unlisted = "SELECT number FROM words WHERE words IS NOT NULL";
        assert!(all(&store.connection, unlisted, |row| row.get::<_, u32>(0)).unwrap().is_empty());
    }

    fn ranked(library: &Library, seed: u64) -> Vec<(usize, f64)> {
        library.rank(&features_seen(seed, 1.0), 5).unwrap()
    }

    #[test]
    fn listed_objects_have_the_votes_that_they_have_unlisted() {
        let (_dir, mut store) = empty_store();
        let in_memory = Library::new(things(0..20));
        for some in [7..13, 0..7, 13..20] {
            list_all(&store);
            store.put_all(&things(some)).unwrap();
        }
        let library = store.load().unwrap();
        for seed in [3, 9, 16] {
            assert_eq!(ranked(&library, seed)[0].0, seed as usize);
            assert_eq!(ranked(&library, seed), ranked(&in_memory, seed));
        }
    }

    #[test]
    fn what_is_replaced_is_not_found_as_it_was() {
        let (_dir, mut store) = empty_store();
        store.put_all(&things(0..5)).unwrap();
        list_all(&store);
        store.put(&thing("thing 03", 40)).unwrap();
        for _ in 0..2 {
            let library = store.load().unwrap();
            assert_eq!(ranked(&library, 40)[0].0, 3);
            assert!(ranked(&library, 3).iter().all(|(number, _)| *number != 3));
            list_all(&store);
        }
    }

    #[test]
    fn postings_of_what_is_no_more_go_when_others_come() {
        let (_dir, mut store) = empty_store();
        let bytes = |store: &Store| -> u32 {
            let sum = "SELECT sum(length(postings)) FROM postings";
            store.connection.query_row(sum, [], |row| row.get(0)).unwrap()
        };
        store.put(&thing("door", 1)).unwrap();
        list_all(&store);
        let of_one = bytes(&store);
        store.remove("door").unwrap();
        store.put(&thing("fridge", 1)).unwrap();
        list_all(&store);
        assert_eq!(bytes(&store), of_one);
    }

    #[test]
    fn a_library_is_right_while_another_process_lists_objects() {
        let (_dir, mut store) = empty_store();
        store.put_all(&things(0..10)).unwrap();
        list_all(&store);
        store.put_all(&things(10..20)).unwrap();
        let library = store.load().unwrap();
        let before = ranked(&library, 12);
        list_all(&store);
        assert_eq!(ranked(&library, 12), before);
        assert_eq!(ranked(&library, 15), ranked(&store.load().unwrap(), 15));
    }

    #[test]
    fn damaged_lists_find_less_and_nothing_worse() {
        let (_dir, mut store) = empty_store();
        store.put_all(&things(0..20)).unwrap();
        list_all(&store);
        let damage = "UPDATE postings SET postings = randomblob(1000) WHERE list % 2 = 1";
        store.connection.execute(damage, []).unwrap();
        assert_eq!(ranked(&store.load().unwrap(), 3)[0].0, 3);
        store.connection.execute("UPDATE postings SET postings = randomblob(100)", []).unwrap();
        assert!(ranked(&store.load().unwrap(), 3).is_empty());
    }

    #[test]
    fn what_was_forgotten_is_read_again() {
        let (_dir, mut store) = empty_store();
        store.put_all(&things(0..3)).unwrap();
        list_all(&store);
        let lists: Vec<usize> =
            all(&store.connection, "SELECT list FROM postings ORDER BY list", |row| row.get(0))
                .unwrap()
                .into_iter()
                .map(|list: u32| list as usize)
                .collect();
        let numbers = [1, 2, 3].into_iter().zip(0..).collect();
        let mut kept = Lists::of(numbers);
        let read = kept.read(&store, &lists).unwrap();
        let whole = kept.bytes;
        kept.forget_beyond(whole / 2);
        assert!(kept.bytes <= whole / 2 && kept.bytes > 0);
        assert_eq!(kept.read(&store, &lists).unwrap(), read);
        assert_eq!(kept.bytes, whole);
    }

    #[test]
    fn words_are_listed_when_they_are_many_and_lists_are_written_anew_ever_more_rarely() {
        assert!(!are_many(FEW, 0) && are_many(FEW + 1, 0));
        assert!(!are_many(12_000, 100_000) && are_many(13_000, 100_000));
    }
}
