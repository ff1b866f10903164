//! Tests of damaged files: a damaged store gives the same answers as before, or an error that names
//! the file; never another answer.

use super::database::Store;
use super::error::StoreError;
use super::inverted_index;
use super::test_data::object;
use crate::object::stored_object::StoredObject;
use crate::test_data::{features, features_seen};
use rusqlite::Connection;
use std::fs;
use std::path::Path;

/// All that a store can be asked.
type Answer = (Vec<StoredObject>, Vec<Vec<(usize, f64)>>);

const SEEDS: [u64; 3] = [1, 2, 3];

fn ask(path: &Path) -> Result<Answer, StoreError> {
    let store = Store::open(path)?;
    let objects = store.names()?.iter().map(|name| store.get(name)).collect::<Result<_, _>>()?;
    let library = store.load()?;
    let rank = |seed: &u64| library.rank(&features_seen(*seed, 1.0), 3);
    Ok((objects, SEEDS.iter().map(rank).collect::<Result<_, _>>()?))
}

/// Bytes of a store; with objects of which some are listed, and some not yet.
fn bytes() -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("whole.linkage");
    let mut store = Store::open_or_create(&path).unwrap();
    for seed in SEEDS {
        if seed == 3 {
            inverted_index::list(&store.connection).unwrap();
        }
        let thing = object(&format!("thing {seed}"));
        store.put(&StoredObject { appearance: features(seed), ..thing }).unwrap();
    }
    drop(store);
    fs::read(path).unwrap()
}

/// How many of a file's damaged forms gave an error; fails for one that gives another answer.
fn errors_of(damaged: impl Iterator<Item = (usize, Vec<u8>)>, answer: &Answer) -> usize {
    let dir = tempfile::tempdir().unwrap();
    let mut errors = 0;
    for (place, bytes) in damaged {
        let path = dir.path().join(format!("damaged-{place}.linkage"));
        fs::write(&path, bytes).unwrap();
        match ask(&path) {
            Ok(given) => assert!(given == *answer, "another answer: byte {place}"),
            Err(error) => {
                let said = error.to_string();
                assert!(said.contains("damaged-"), "byte {place}: {said}");
                errors += 1;
            }
        }
        for entry in fs::read_dir(dir.path()).unwrap() {
            fs::remove_file(entry.unwrap().path()).unwrap();
        }
    }
    errors
}

/// Distance between the bytes that are changed; `LINKAGE_FLIP_EVERY` asks for more of them or
/// fewer.
fn every() -> usize {
    std::env::var("LINKAGE_FLIP_EVERY").ok().and_then(|n| n.parse().ok()).unwrap_or(397)
}

fn answer_of(bytes: &[u8]) -> Answer {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("whole.linkage");
    fs::write(&path, bytes).unwrap();
    ask(&path).unwrap()
}

#[test]
fn a_changed_bit_gives_the_same_answer_or_an_error_that_names_the_file() {
    let bytes = bytes();
    let answer = answer_of(&bytes);
    assert_eq!(answer.1.iter().map(|ranked| ranked[0].0).collect::<Vec<_>>(), [0, 1, 2]);
    let damaged = (0..bytes.len()).step_by(every()).map(|place| {
        let mut bytes = bytes.clone();
        bytes[place] ^= 1 << (place / every() % 8);
        (place, bytes)
    });
    let errors = errors_of(damaged, &answer);
    println!("{errors} of {} changed bits gave an error", bytes.len().div_ceil(every()));
    assert!(errors > 20);
}

#[test]
fn a_cut_file_gives_an_error_that_names_it() {
    let bytes = bytes();
    let answer = answer_of(&bytes);
    let step = bytes.len() / 40;
    let cut = |length: usize| (length, bytes[..length].to_vec());
    let lengths = (0..bytes.len()).step_by(step).chain((0..bytes.len()).step_by(16_384));
    let lengths: Vec<usize> = lengths.chain([1, 100, bytes.len() - 1]).collect();
    assert_eq!(errors_of(lengths.iter().map(|length| cut(*length)), &answer), lengths.len());
}

#[test]
fn a_row_that_is_lost_is_told() {
    for loss in [
        "DELETE FROM object WHERE name = 'thing 2'",
        "DELETE FROM demonstration",
        "DROP TRIGGER object_removed; DELETE FROM words WHERE object = 'thing 2'",
        "DELETE FROM total",
        "UPDATE words SET words = NULL WHERE object = 'thing 3'",
        "UPDATE object SET model = replace(model, '\"features\":1', '\"features\":2')",
    ] {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.linkage");
        fs::write(&path, bytes()).unwrap();
        let other = Connection::open(&path).unwrap();
        other.pragma_update(None, "foreign_keys", false).unwrap();
        other.execute_batch(loss).unwrap();
        drop(other);
        let error = ask(&path).unwrap_err().to_string();
        assert!(error.contains("s.linkage"), "{loss}: {error}");
    }
}
