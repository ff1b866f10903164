//! Tests: objects whose words are in posting lists, and objects whose words are not yet, are found
//! equally well, also while the store changes.

use super::contents::all_rows;
use super::database::Store;
use super::error::StoreError;
use super::inverted_index::{PostingCache, lengthen, list, unlisted};
use super::library::Library;
use super::test_data::object;
use crate::object::stored_object::StoredObject;
use crate::recognise::retrieval::{Posting, Postings};
use crate::test_data::{features, features_seen};
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
    assert!(unlisted(&store.connection).unwrap().0.is_empty());
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
    let (_, objects) = unlisted(&store.connection).unwrap();
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
fn lists_that_are_damaged_or_lost_are_told() {
    for damage in [
        "UPDATE postings SET postings = randomblob(1000)",
        "UPDATE postings SET postings = zeroblob(length(postings))",
        "DELETE FROM postings",
        "UPDATE listed SET lists = x''",
    ] {
        let (_dir, store) = store_of(&things(0..20));
        store.connection.execute(damage, []).unwrap();
        let error = store.load().unwrap().rank(&features_seen(3, 1.0), 5).unwrap_err();
        assert!(matches!(error, StoreError::DamagedFile { .. }), "{damage}: {error}");
        assert!(error.to_string().contains("s.linkage"), "{error}");
    }
}

#[test]
fn what_was_forgotten_is_read_again() {
    let (_dir, store) = store_of(&things(0..3));
    let lists: Vec<usize> =
        all_rows(&store.connection, "SELECT list FROM postings ORDER BY list", |row| row.get(0))
            .unwrap()
            .into_iter()
            .map(|list: u32| list as usize)
            .collect();
    let mut kept = PostingCache::new();
    let read = kept.read(&store.connection, &lists).unwrap();
    let whole = kept.bytes;
    kept.forget_beyond(whole / 2);
    assert!(kept.bytes <= whole / 2 && kept.bytes > 0);
    assert_eq!(kept.read(&store.connection, &lists).unwrap(), read);
    assert_eq!(kept.bytes, whole);
}
