//! Storage of the inverted index (Sivic and Zisserman 2003): what it needs of each object, as the
//! store keeps it.
//!
//! In: the words of objects. They are kept object by object until those of many have come together;
//! then they are kept as posting lists, one for each word, of which a picture asks for a few. Out: the
//! postings of the lists that are asked for. Each list has a checksum, and a directory says which
//! lists there are.

use super::contents::{self, Entry};
use super::error::Fault;
use super::record::Checksum;
use super::transaction::begin;
use crate::recognise::retrieval::{Posting, Postings, Words};
use lru::LruCache;
use rusqlite::{Connection, OptionalExtension, params};
use std::collections::HashSet;
use std::sync::Arc;

/// Objects that may always be without lists: it keeps small stores simple.
const FEW: u32 = 2_000;
/// One object for each `ONE_OF` that are listed may be without lists. That bounds both what is read
/// when a store is opened and how often lists are written anew.
const ONE_OF: u32 = 8;
/// Lists that are written at a time: some ten megabytes where 100 000 objects are listed.
const LISTS_AT_ONCE: usize = 4_096;

/// Whether the words of `unlisted` objects should be listed, where those of `listed` objects are.
fn are_many(unlisted: u32, listed: u32) -> bool {
    unlisted > FEW.max(listed / ONE_OF)
}

/// Lists the words of all objects if they are many.
pub fn list_if_many(connection: &Connection) -> Result<(), Fault> {
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
pub fn list(connection: &Connection) -> Result<(), Fault> {
    let (emptied, objects) = unlisted(connection)?;
    let numbers: HashSet<u32> = objects.iter().map(|(number, _)| *number).collect();
    let postings = Postings::of(&objects);
    let lists: Vec<(usize, &[Posting])> = postings.lists().collect();
    lists.chunks(LISTS_AT_ONCE).try_for_each(|some| lengthen(connection, some, &numbers))?;
    let together = begin(connection)?;
    emptied.iter().try_for_each(|entry| contents::update(&together, entry))?;
    Ok(together.commit()?)
}

/// Objects that are not in the lists yet, and the words of each by its number.
pub(super) type Unlisted = (Vec<Entry>, Vec<(u32, Words)>);

/// Rows whose words are not listed, without these, and the words by the numbers of their objects,
/// in order.
pub(super) fn unlisted(connection: &Connection) -> Result<Unlisted, Fault> {
    let split = |mut entry: Entry| {
        let words = Words::from_bytes(entry.words.take()?)?;
        let number = entry.number;
        Some((entry, (number, words)))
    };
    Ok(contents::unlisted(connection)?.into_iter().filter_map(split).unzip())
}

/// Puts postings of objects with these numbers at the ends of lists. Postings that they have there
/// already, and those of objects that are no more, go.
pub(super) fn lengthen(
    connection: &Connection,
    lists: &[(usize, &[Posting])],
    numbers: &HashSet<u32>,
) -> Result<(), Fault> {
    let together = begin(connection)?;
    let known: HashSet<u32> =
        contents::all_rows(&together, "SELECT number FROM words", |row| row.get(0))?
            .into_iter()
            .collect();
    let is_kept = |p: &Posting| known.contains(&p.object) && !numbers.contains(&p.object);
    let mut directory = Directory::read(&together)?;
    for &(list, postings) in lists {
        let before = read_list(&together, list, &directory)?.unwrap_or_default();
        let before = Posting::all_from_bytes(&before).filter(is_kept);
        let all = before.chain(postings.iter().copied());
        let bytes = all.flat_map(Posting::to_bytes).collect::<Vec<u8>>();
        write_list(&together, list, &bytes)?;
        directory.insert(list);
    }
    directory.write(&together)?;
    Ok(together.commit()?)
}

/// The postings of a list as they are kept; `None` where there is no such list.
fn read_list(
    connection: &Connection,
    list: usize,
    directory: &Directory,
) -> Result<Option<Vec<u8>>, Fault> {
    let mut statement =
        connection.prepare_cached("SELECT postings, checksum FROM postings WHERE list = ?1")?;
    let row = statement.query_row([list as u32], |row| <(Vec<u8>, u32)>::try_from(row));
    match row.optional()? {
        Some((bytes, checksum)) if checksum_of(list, &bytes) == checksum => Ok(Some(bytes)),
        None if !directory.contains(list) => Ok(None),
        Some(_) => Err(damaged(list, "does not match its checksum")),
        None => Err(damaged(list, "is lost")),
    }
}

fn damaged(list: usize, how: &str) -> Fault {
    Fault::File(format!("list {list} of its index {how}"))
}

fn write_list(connection: &Connection, list: usize, bytes: &[u8]) -> rusqlite::Result<()> {
    let mut statement = connection.prepare_cached(
        "INSERT OR REPLACE INTO postings (list, postings, checksum) VALUES (?1, ?2, ?3)",
    )?;
    statement.execute(params![list as u32, bytes, checksum_of(list, bytes)]).map(drop)
}

fn checksum_of(list: usize, bytes: &[u8]) -> u32 {
    let mut sum = Checksum::default();
    sum.field(&(list as u64).to_le_bytes());
    sum.field(bytes);
    sum.finish()
}

/// Which lists there are, a bit each: one that is lost would look like one that never was.
#[derive(Default)]
struct Directory(Vec<u8>);

/// What stands for its list's number in the directory's checksum.
const DIRECTORY: usize = usize::MAX;
/// More lists than any vocabulary has.
const MOST_LISTS: usize = 1 << 24;

impl Directory {
    fn read(connection: &Connection) -> Result<Self, Fault> {
        let row = connection.query_row("SELECT lists, checksum FROM listed", [], |row| {
            <(Vec<u8>, u32)>::try_from(row)
        });
        match row.optional()? {
            Some((lists, checksum)) if checksum_of(DIRECTORY, &lists) == checksum => {
                Ok(Self(lists))
            }
            _ => Err(Fault::File("the directory of its index is damaged".to_owned())),
        }
    }

    fn write(&self, connection: &Connection) -> rusqlite::Result<()> {
        let row = params![self.0, checksum_of(DIRECTORY, &self.0)];
        let sql = "INSERT OR REPLACE INTO listed (id, lists, checksum) VALUES (0, ?1, ?2)";
        connection.execute(sql, row).map(drop)
    }

    fn contains(&self, list: usize) -> bool {
        self.0.get(list / 8).is_some_and(|byte| byte >> (list % 8) & 1 == 1)
    }

    fn insert(&mut self, list: usize) {
        if self.0.len() <= list / 8 {
            self.0.resize(list / 8 + 1, 0);
        }
        self.0[list / 8] |= 1 << (list % 8);
    }
}

/// Writes that there is no list.
pub fn write_empty_directory(connection: &Connection) -> rusqlite::Result<()> {
    Directory::default().write(connection)
}

/// Adds checksums to the lists of an older store.
pub fn add_checksums(connection: &Connection) -> Result<(), Fault> {
    let lists: Vec<u32> =
        contents::all_rows(connection, "SELECT list FROM postings", |row| row.get(0))?;
    let mut directory = Directory::default();
    for list in lists.into_iter().map(|list| list as usize) {
        if list >= MOST_LISTS {
            return Err(damaged(list, "can not be"));
        }
        let sql = "SELECT postings FROM postings WHERE list = ?1";
        let bytes: Vec<u8> = connection.query_row(sql, [list as u32], |row| row.get(0))?;
        write_list(connection, list, &bytes)?;
        directory.insert(list);
    }
    Ok(directory.write(connection)?)
}

/// Memory for lists that were read: those of many pictures, however many objects are listed.
const MOST_BYTES: usize = 256 << 20;

/// A store's lists as a library reads them: the most recently used stay in memory. Numbers of
/// objects are never used again, so that the store may change meanwhile.
pub struct PostingCache {
    recent: LruCache<usize, Arc<[Posting]>>,
    /// Bytes of the postings in memory.
    pub(super) bytes: usize,
}

impl PostingCache {
    /// An empty cache.
    pub fn new() -> Self {
        Self { recent: LruCache::unbounded(), bytes: 0 }
    }

    /// The postings of some lists, in their order, with the store's numbers.
    pub fn read(
        &mut self,
        connection: &Connection,
        lists: &[usize],
    ) -> Result<Vec<Arc<[Posting]>>, Fault> {
        let unread: Vec<usize> =
            lists.iter().copied().filter(|list| !self.recent.contains(list)).collect();
        let read = read(connection, &unread)?;
        for (list, postings) in unread.into_iter().zip(read) {
            self.bytes += size_of_val(&postings[..]);
            self.recent.put(list, postings);
        }
        let read =
            lists.iter().map(|list| self.recent.get(list).cloned().unwrap_or_default()).collect();
        self.forget_beyond(MOST_BYTES);
        Ok(read)
    }

    /// Forgets the least recently used lists, until no more than these bytes are in memory.
    pub(super) fn forget_beyond(&mut self, bytes: usize) {
        while self.bytes > bytes
            && let Some((_, postings)) = self.recent.pop_lru()
        {
            self.bytes -= size_of_val(&postings[..]);
        }
    }
}

/// The postings of each list.
fn read(connection: &Connection, lists: &[usize]) -> Result<Vec<Arc<[Posting]>>, Fault> {
    if lists.is_empty() {
        return Ok(Vec::new());
    }
    // One transaction: the file is locked once, not for every list.
    let together = connection.unchecked_transaction()?;
    let directory = Directory::read(&together)?;
    let postings = |list: &usize| {
        let bytes = read_list(&together, *list, &directory)?.unwrap_or_default();
        Ok(Posting::all_from_bytes(&bytes).collect())
    };
    lists.iter().map(postings).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_listed_when_they_are_many_and_lists_are_written_anew_ever_more_rarely() {
        assert!(!are_many(FEW, 0) && are_many(FEW + 1, 0));
        assert!(!are_many(12_000, 100_000) && are_many(13_000, 100_000));
    }
}
