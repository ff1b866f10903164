//! Tests of the rows that a store keeps of its objects: their order, their numbers, and what is told of a
//! row that was changed beside us.

use super::contents::{Entry, entries, entry, unlisted, update};
use super::database::Store;
use super::error::Fault;
use super::test_data::object;
use tempfile::TempDir;

/// A store of some objects.
fn store(names: &[&str]) -> (TempDir, Store) {
    let dir = tempfile::tempdir().unwrap();
    let mut store = Store::open_or_create(&dir.path().join("s.linkage")).unwrap();
    names.iter().for_each(|name| store.put(&object(name)).unwrap());
    (dir, store)
}

#[test]
fn rows_come_in_the_order_of_their_numbers_and_each_can_be_asked_for() {
    let (_dir, store) = store(&["oven", "door", "fridge"]);
    let all = entries(&store.connection).unwrap();
    let names: Vec<&str> = all.iter().map(|e| e.object.as_str()).collect();
    assert_eq!(names, ["oven", "door", "fridge"]);
    assert!(all.is_sorted_by(|a, b| a.number < b.number));
    let door = entry(&store.connection, "door").unwrap().unwrap();
    assert_eq!(door.number, all[1].number);
    assert!(entry(&store.connection, "no such").unwrap().is_none());
}

#[test]
fn a_number_is_never_used_again() {
    let (_dir, mut store) = store(&["door"]);
    let first = entry(&store.connection, "door").unwrap().unwrap().number;
    store.remove("door").unwrap();
    assert!(entries(&store.connection).unwrap().is_empty());
    store.put(&object("door")).unwrap();
    assert!(entry(&store.connection, "door").unwrap().unwrap().number > first);
}

#[test]
fn a_row_whose_words_are_listed_is_unlisted_no_more() {
    let (_dir, store) = store(&["oven", "door"]);
    assert_eq!(unlisted(&store.connection).unwrap().len(), 2);
    let oven = entry(&store.connection, "oven").unwrap().unwrap();
    update(&store.connection, &Entry { words: None, ..oven }).unwrap();
    let left = unlisted(&store.connection).unwrap();
    assert_eq!(left.iter().map(|e| e.object.as_str()).collect::<Vec<_>>(), ["door"]);
}

#[test]
fn a_row_that_was_changed_beside_us_is_told_by_its_name() {
    let (_dir, store) = store(&["oven", "door"]);
    let change = "UPDATE words SET content = content + 1 WHERE object = 'door'";
    store.connection.execute(change, []).unwrap();
    for result in [entries(&store.connection).err(), entry(&store.connection, "door").err()] {
        assert!(matches!(result, Some(Fault::Object { object, .. }) if object == "door"));
    }
    assert!(entry(&store.connection, "oven").is_ok());
}
