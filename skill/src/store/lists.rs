//! What the inverted index needs of each object, as the store keeps it: its words, until those of
//! many have come together; then their postings by lists, of which a picture asks for a few.

use super::{Store, StoreError};
use crate::recognise::{Posting, Postings, Words};
use lru::LruCache;
use rusqlite::{Connection, OptionalExtension, Row, Transaction, TransactionBehavior, params};
use std::collections::HashSet;
use std::sync::Arc;

/// Objects whose words are not listed: so many at least may be before all are,
const FEW: u32 = 2_000;
/// and one of so many that are listed. The first keeps small stores simple; the second bounds both
/// what is read when a store is opened and how often lists are written anew.
const ONE_OF: u32 = 8;
/// Lists that are written at a time: some ten megabytes where 100 000 objects are listed.
const LISTS_AT_ONCE: usize = 4_096;

/// Whether the words of so many objects should be listed, where those of so many are.
fn are_many(unlisted: u32, listed: u32) -> bool {
    unlisted > FEW.max(listed / ONE_OF)
}

/// Lists the words of all objects if they are many.
pub fn list_if_many(connection: &Connection) -> rusqlite::Result<()> {
    let count = |of: &str| -> rusqlite::Result<u32> {
        connection.query_row(&format!("SELECT count(*) FROM words {of}"), [], |row| row.get(0))
    };
    let unlisted = count("WHERE words IS NOT NULL")?;
    if are_many(unlisted, 0) && are_many(unlisted, count("")? - unlisted) {
        tracing::info!(objects = unlisted, "listing words: once for many objects");
        list(connection)?;
    }
    Ok(())
}

/// Puts the words of all objects in lists. Some lists at a time: other processes wait for no more,
/// and until the words are taken away, which is last, they are what counts.
fn list(connection: &Connection) -> rusqlite::Result<()> {
    let objects = unlisted(connection)?;
    let numbers: HashSet<u32> = objects.iter().map(|(number, _)| *number).collect();
    let postings = Postings::of(&objects);
    let lists: Vec<(usize, &[Posting])> = postings.lists().collect();
    lists.chunks(LISTS_AT_ONCE).try_for_each(|some| lengthen(connection, some, &numbers))?;
    let together = begin(connection)?;
    let mut listed = together.prepare("UPDATE words SET words = NULL WHERE number = ?1")?;
    numbers.iter().try_for_each(|number| listed.execute([number]).map(drop))?;
    drop(listed);
    together.commit()
}

/// Words that are not listed, by the numbers of their objects, in order.
fn unlisted(connection: &Connection) -> rusqlite::Result<Vec<(u32, Words)>> {
    let query = "SELECT number, words FROM words WHERE words IS NOT NULL ORDER BY number";
    let rows = all(connection, query, |row| Ok((row.get(0)?, Words::from_bytes(row.get(1)?))))?;
    Ok(rows.into_iter().filter_map(|(number, words)| Some((number, words?))).collect())
}

/// Puts postings of objects with these numbers at the ends of lists. Postings that they have there
/// already, and those of objects that are no more, go.
fn lengthen(
    connection: &Connection,
    lists: &[(usize, &[Posting])],
    numbers: &HashSet<u32>,
) -> rusqlite::Result<()> {
    let together = begin(connection)?;
    let known: HashSet<u32> =
        all(&together, "SELECT number FROM words", |row| row.get(0))?.into_iter().collect();
    let is_kept = |p: &Posting| known.contains(&p.object) && !numbers.contains(&p.object);
    let mut read = together.prepare("SELECT postings FROM postings WHERE list = ?1")?;
    let mut write =
        together.prepare("INSERT OR REPLACE INTO postings (list, postings) VALUES (?1, ?2)")?;
    for &(list, postings) in lists {
        let list = list as u32;
        let before: Option<Vec<u8>> = read.query_row([list], |row| row.get(0)).optional()?;
        let before = Posting::all_from_bytes(before.as_deref().unwrap_or_default());
        let all = before.filter(is_kept).chain(postings.iter().copied());
        write.execute(params![list, all.flat_map(Posting::to_bytes).collect::<Vec<u8>>()])?;
    }
    drop((read, write));
    together.commit()
}

/// A change during which no other process makes one.
fn begin(connection: &Connection) -> rusqlite::Result<Transaction<'_>> {
    Transaction::new_unchecked(connection, TransactionBehavior::Immediate)
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

/// A store's lists as a library reads them: the most recently used stay in memory. Numbers of
/// objects are never used again, so that the store may change meanwhile.
pub struct Lists {
    recent: LruCache<usize, Arc<[Posting]>>,
    bytes: usize,
}

impl Lists {
    /// None read yet.
    pub fn new() -> Self {
        Self { recent: LruCache::unbounded(), bytes: 0 }
    }

    /// The postings of some lists, in their order, with the store's numbers.
    pub fn read(
        &mut self,
        store: &Store,
        lists: &[usize],
    ) -> Result<Vec<Arc<[Posting]>>, StoreError> {
        let unread: Vec<usize> =
            lists.iter().copied().filter(|list| !self.recent.contains(list)).collect();
        let read = store.sql(read(&store.connection, &unread))?;
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
}

/// The postings of each list.
fn read(connection: &Connection, lists: &[usize]) -> rusqlite::Result<Vec<Arc<[Posting]>>> {
    // One transaction: the file is locked once, not for every list.
    let together = connection.unchecked_transaction()?;
    let mut statement = together.prepare_cached("SELECT postings FROM postings WHERE list = ?1")?;
    let mut postings = |list: &usize| {
        let of_row = |row: &Row| Ok(Posting::all_from_bytes(row.get_ref(0)?.as_blob()?).collect());
        Ok(statement.query_row([*list as u32], of_row).optional()?.unwrap_or_default())
    };
    lists.iter().map(&mut postings).collect()
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

    /// A store whose objects are all listed.
    fn store_of(objects: &[StoredObject]) -> (TempDir, Store) {
        let dir = tempfile::tempdir().unwrap();
        let mut store = Store::open_or_create(&dir.path().join("s.linkage")).unwrap();
        store.put_all(objects).unwrap();
        list_all(&store);
        (dir, store)
    }

    fn list_all(store: &Store) {
        list(&store.connection).unwrap();
        assert!(unlisted(&store.connection).unwrap().is_empty());
    }

    /// Bytes of all postings.
    fn bytes(store: &Store) -> u32 {
        let sum = "SELECT sum(length(postings)) FROM postings";
        store.connection.query_row(sum, [], |row| row.get(0)).unwrap()
    }

    fn ranked(library: &Library, seed: u64) -> Vec<(usize, f64)> {
        library.rank(&features_seen(seed, 1.0), 5).unwrap()
    }

    #[test]
    fn listed_objects_have_the_votes_that_they_have_unlisted() {
        let (_dir, mut store) = store_of(&things(7..13));
        let in_memory = Library::new(things(0..20));
        for some in [0..7, 13..20] {
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
        let (_dir, mut store) = store_of(&things(0..5));
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
        let (_dir, mut store) = store_of(&[thing("door", 1)]);
        let of_one = bytes(&store);
        store.remove("door").unwrap();
        store.put(&thing("fridge", 1)).unwrap();
        list_all(&store);
        assert_eq!(bytes(&store), of_one);
    }

    #[test]
    fn listing_that_was_killed_is_begun_anew() {
        let (_dir, mut store) = store_of(&things(0..5));
        store.put_all(&things(5..10)).unwrap();
        let whole = ranked(&store.load().unwrap(), 7);
        let of_five = bytes(&store);
        let objects = unlisted(&store.connection).unwrap();
        let numbers = objects.iter().map(|(number, _)| *number).collect();
        let postings = Postings::of(&objects);
        let lists: Vec<(usize, &[Posting])> = postings.lists().collect();
        lengthen(&store.connection, &lists[..lists.len() / 2], &numbers).unwrap();
        assert_eq!(ranked(&store.load().unwrap(), 7), whole);
        list_all(&store);
        assert_eq!(ranked(&store.load().unwrap(), 7), whole);
        assert_eq!(bytes(&store), 2 * of_five);
    }

    #[test]
    fn a_library_is_right_while_another_process_lists_objects() {
        let (_dir, mut store) = store_of(&things(0..10));
        store.put_all(&things(10..20)).unwrap();
        let library = store.load().unwrap();
        let before = ranked(&library, 12);
        list_all(&store);
        assert_eq!(ranked(&library, 12), before);
        assert_eq!(ranked(&library, 15), ranked(&store.load().unwrap(), 15));
    }

    #[test]
    fn damaged_lists_find_less_and_nothing_worse() {
        let (_dir, store) = store_of(&things(0..20));
        let damage = "UPDATE postings SET postings = randomblob(1000) WHERE list % 2 = 1";
        store.connection.execute(damage, []).unwrap();
        assert_eq!(ranked(&store.load().unwrap(), 3)[0].0, 3);
        store.connection.execute("UPDATE postings SET postings = randomblob(100)", []).unwrap();
        assert!(ranked(&store.load().unwrap(), 3).is_empty());
    }

    #[test]
    fn what_was_forgotten_is_read_again() {
        let (_dir, store) = store_of(&things(0..3));
        let lists: Vec<usize> =
            all(&store.connection, "SELECT list FROM postings ORDER BY list", |row| row.get(0))
                .unwrap()
                .into_iter()
                .map(|list: u32| list as usize)
                .collect();
        let mut kept = Lists::new();
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
