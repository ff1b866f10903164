//! The store among processes: many that write at once, and some that are killed.

use linkage_skill::object::{
    Appearance, MODEL_SCHEMA, ObjectModel, Part, Provenance, ReferenceFrame, StoredObject,
};
use linkage_skill::store::{Store, StoreError};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// An object of some size, so that it takes more than one page.
fn object(name: &str, demonstrations: usize) -> StoredObject {
    StoredObject {
        model: ObjectModel {
            schema: MODEL_SCHEMA.into(),
            object: name.into(),
            reference_frame: ReferenceFrame::at_camera(0.0),
            parts: vec![Part::new(0, "base", 1)],
            joints: Vec::new(),
            demonstrations,
            profile: "default".into(),
            version: "0".into(),
        },
        appearance: Appearance::default(),
        provenance: (0..400)
            .map(|i| Provenance { source: format!("tum:{name}/{i:050}"), learned_utime: i })
            .collect(),
    }
}

fn number_of(variable: &str, default: usize) -> usize {
    std::env::var(variable).ok().and_then(|n| n.parse().ok()).unwrap_or(default)
}

/// What a child process does: see [`child`].
const ROLE: &str = "LINKAGE_STORE_TEST_ROLE";
const STORE: &str = "LINKAGE_STORE_TEST_FILE";

/// Not a test of its own: what the child processes of the others run.
#[test]
fn child() {
    let (Ok(role), Ok(path)) = (std::env::var(ROLE), std::env::var(STORE)) else { return };
    let path = PathBuf::from(path);
    let (work, own) = role.split_once(' ').unwrap();
    match work {
        "put" => put_objects(&path, own),
        "change" => change_for_ever(&path, own.parse().unwrap()),
        _ => panic!("{role}"),
    }
}

fn start(role: &str, store: &Path) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "child", "--nocapture", "--test-threads=1"])
        .env(ROLE, role)
        .env(STORE, store)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap()
}

const PUTS: usize = 20;

fn put_objects(path: &Path, own: &str) {
    for i in 0..PUTS {
        // Each time as a command does it: it opens the store, writes and goes.
        let mut store = Store::open_or_create(path).unwrap();
        store.put(&object(&format!("{own} {i}"), 1)).unwrap();
    }
}

#[test]
fn ten_processes_that_write_at_once_all_succeed() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("s.linkage");
    let writers: Vec<Child> = (0..10).map(|i| start(&format!("put writer{i}"), &path)).collect();
    let failed = writers.into_iter().filter_map(|w| {
        let output = w.wait_with_output().unwrap();
        (!output.status.success()).then(|| String::from_utf8_lossy(&output.stdout).into_owned())
    });
    let failed: Vec<String> = failed.collect();
    assert!(failed.is_empty(), "{}", failed.join("\n"));
    assert_eq!(Store::open(&path).unwrap().names().unwrap().len(), 10 * PUTS);
}

#[test]
fn of_many_who_add_to_one_object_none_is_lost() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("s.linkage");
    std::thread::scope(|scope| {
        for _ in 0..6 {
            scope.spawn(|| {
                let mut store = Store::open_or_create(&path).unwrap();
                for _ in 0..5 {
                    let more = |known: Option<&StoredObject>| {
                        let before = known.map_or(0, |k| k.model.demonstrations);
                        Ok::<_, StoreError>(object("door", before + 1))
                    };
                    store.update("door", more).unwrap();
                }
            });
        }
    });
    let door = Store::open(&path).unwrap().get("door").unwrap();
    assert_eq!(door.model.demonstrations, 30);
}

#[test]
fn what_was_changed_or_removed_meanwhile_is_not_overwritten() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("s.linkage");
    let [mut mine, mut other] = [0, 1].map(|_| Store::open_or_create(&path).unwrap());
    let change = |store: &mut Store, before| {
        store.put_unchanged(&[object("door", 7)], &[before]).map_err(|e| e.to_string())
    };
    other.put(&object("door", 1)).unwrap();
    assert!(change(&mut mine, None).unwrap_err().contains("changed by another program"));
    let before = mine.revision("door").unwrap();
    other.put(&object("door", 2)).unwrap();
    assert!(change(&mut mine, before).is_err());
    let before = mine.revision("door").unwrap();
    other.remove("door").unwrap();
    assert!(change(&mut mine, before).is_err());
    assert!(matches!(mine.remove("door"), Err(StoreError::UnknownObject { .. })));
    assert_eq!(change(&mut mine, None), Ok(()));
    let before = mine.revision("door").unwrap();
    assert_eq!(change(&mut mine, before), Ok(()));
}

/// Puts, adds, replaces and removes objects one after the other, and says after each what is there
/// now; with this seed.
fn change_for_ever(path: &Path, seed: usize) {
    let mut store = Store::open_or_create(path).unwrap();
    println!("\nopen");
    for i in seed.. {
        let name = format!("thing {}", i % 7);
        if i % 5 == 4 && store.find(&name).unwrap().is_some() {
            println!("begin {name} 0");
            store.remove(&name).unwrap();
            println!("done {name} 0");
        } else {
            println!("begin {name} {i}");
            store.put(&object(&name, i)).unwrap();
            println!("done {name} {i}");
        }
    }
}

#[test]
fn what_was_acknowledged_is_there_after_a_kill_at_any_moment() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("s.linkage");
    // What each object must be; 0: not there.
    let mut known: BTreeMap<String, usize> = BTreeMap::new();
    let mut seed = 1;
    let kills = number_of("LINKAGE_KILLS", 20);
    for kill in 0..kills {
        let mut child = start(&format!("change {seed}"), &path);
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        while lines.next().unwrap().unwrap() != "open" {}
        std::thread::sleep(Duration::from_micros((kill * 7_919 % 60_000) as u64));
        child.kill().unwrap();
        child.wait().unwrap();
        let mut begun = None;
        for line in lines.map_while(Result::ok) {
            let said = line.split_once(' ').and_then(|(what, rest)| {
                let (name, state) = rest.rsplit_once(' ')?;
                Some((what.to_owned(), name.to_owned(), state.parse::<usize>().ok()?))
            });
            match said {
                Some((what, name, state)) if what == "begin" => begun = Some((name, state)),
                Some((what, name, state)) if what == "done" => {
                    known.insert(name, state);
                    begun = None;
                }
                _ => {}
            }
        }
        let store = Store::open(&path).unwrap();
        let mut found: BTreeMap<String, usize> = BTreeMap::new();
        for name in store.names().unwrap() {
            let stored = store.get(&name).unwrap();
            assert_eq!(stored, object(&name, stored.model.demonstrations));
            found.insert(name, stored.model.demonstrations);
        }
        // What was begun and not acknowledged may be there or not.
        if let Some((name, state)) = begun
            && found.get(&name).copied().unwrap_or(0) == state
        {
            known.insert(name, state);
        }
        known.retain(|_, state| *state != 0);
        assert_eq!(found, known, "kill {kill}");
        seed += 1 + known.values().max().copied().unwrap_or(0);
    }
    println!("{kills} kills, nothing lost");
}
