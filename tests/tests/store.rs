//! A store never lies: nothing is put in it that was cut short, nothing that was acknowledged goes
//! from it, it is read where it cannot be written, and what it cannot be is refused with words.

use linkage_skill::object::StoredObject;
use linkage_skill::store::Store;
use linkage_tests::service::Service;
use linkage_tests::{build, failure, linkage, program, simulated};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

fn text(path: &Path) -> String {
    path.display().to_string()
}

/// Where a drawer was learned, once for all tests.
fn learned() -> &'static Path {
    static LEARNED: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    let (_, store) = LEARNED.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let store = dir.path().join("objects.linkage");
        let recording = text(&simulated("drawer", false, 1));
        let output =
            linkage(&["learn", &recording, "--object", "drawer", "--store", &text(&store)]);
        assert!(output.status.success(), "{}", failure(&output).1);
        assert!(failure(&output).1.contains("drawer is saved in"), "{}", failure(&output).1);
        (dir, store)
    });
    store
}

/// A folder with a copy of that store.
fn with_drawer() -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let store = dir.path().join("objects.linkage");
    std::fs::copy(learned(), &store).unwrap();
    (dir, store)
}

fn drawer(store: &Path) -> StoredObject {
    Store::open(store).unwrap().get("drawer").unwrap()
}

fn run_in(dir: &Path, arguments: &[&str]) -> Output {
    build();
    Command::new(program()).args(arguments).current_dir(dir).output().unwrap()
}

fn assert_refused(output: &Output, words: &[&str]) {
    let (status, said) = failure(output);
    assert_eq!(status, 2, "{said}");
    words.iter().for_each(|word| assert!(said.contains(word), "\"{word}\" is missing in: {said}"));
}

/// Waits until a program takes signals, sends it one a little later, and waits for its end.
fn stopped(child: Child, signal: &str, after: Duration) -> Output {
    let catches = |status: &str| {
        let mask = status.lines().find_map(|l| l.strip_prefix("SigCgt:"));
        mask.and_then(|m| u64::from_str_radix(m.trim(), 16).ok()).is_some_and(|m| m >> 1 & 1 == 1)
    };
    let start = Instant::now();
    let status = format!("/proc/{}/status", child.id());
    while !std::fs::read_to_string(&status).is_ok_and(|s| catches(&s)) {
        assert!(start.elapsed() < Duration::from_secs(60), "it takes no signals");
        std::thread::sleep(Duration::from_millis(5));
    }
    std::thread::sleep(after);
    Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap();
    child.wait_with_output().unwrap()
}

fn start(arguments: &[&str]) -> Child {
    build();
    let mut command = Command::new(program());
    command.args(arguments).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

#[test]
fn a_recording_that_a_signal_cuts_short_is_not_learned_from() {
    let (_dir, store) = with_drawer();
    let before = drawer(&store);
    let recording = text(&simulated("drawer", false, 1));
    for (signal, status) in [("-INT", 130), ("-TERM", 143)] {
        for after_ms in [20, 400] {
            for way in ["--replace", "--add"] {
                let learn = ["learn", &recording, "--object", "drawer", way, "--store"];
                let child = start(&[&learn[..], &[&text(&store), "--quiet"]].concat());
                let output = stopped(child, signal, Duration::from_millis(after_ms));
                assert_eq!(failure(&output).0, status, "{}", failure(&output).1);
                assert!(failure(&output).1.contains("stopped by"), "{}", failure(&output).1);
                assert!(drawer(&store) == before, "{signal} {way}");
            }
        }
    }
}

#[test]
fn a_recording_that_a_signal_cuts_short_is_neither_recognised_nor_called_a_whole_copy() {
    let (dir, store) = with_drawer();
    let recording = text(&simulated("drawer", false, 1));
    let (json, copy) = (text(&dir.path().join("found.json")), text(&dir.path().join("copy")));
    let store = text(&store);
    let recognise = ["recognise", &recording, "--store", &store, "--json", &json];
    let predict = ["predict", &recording, "--store", &store, "--to", "closed", "--json", &json];
    let record = ["record", "--source", &recording, "--out", &copy];
    for (signal, status) in [("-INT", 130), ("-TERM", 143)] {
        for command in [&recognise[..], &predict[..], &record[..]] {
            let output = stopped(start(command), signal, Duration::from_millis(50));
            assert_eq!(failure(&output).0, status, "{}", failure(&output).1);
            assert!(!Path::new(&json).exists());
            let _ = std::fs::remove_dir_all(&copy);
        }
    }
}

#[test]
fn a_name_that_is_taken_is_refused_before_the_work_begins() {
    let (dir, store) = with_drawer();
    let before = drawer(&store);
    // The source is not even looked at.
    let learn = ["learn", "/nowhere", "--object", "drawer"];
    let named = linkage(&[&learn[..], &["--store", &text(&store)]].concat());
    assert_refused(&named, &["\"drawer\"", "--replace", "--add", "objects.linkage"]);
    let default = run_in(dir.path(), &learn);
    assert_refused(&default, &["\"drawer\"", "--replace", "--add", "objects.linkage"]);
    let both = [&learn[..], &["--replace", "--add"]].concat();
    assert_refused(&run_in(dir.path(), &both), &["--add"]);
    let no_name = ["learn", "/nowhere", "--object", " "];
    assert_refused(&run_in(dir.path(), &no_name), &["--object", "a name is needed"]);
    assert!(drawer(&store) == before);
}

#[test]
fn a_demonstration_is_added_or_takes_the_place_of_what_is_known() {
    let (dir, store) = with_drawer();
    let recording = text(&simulated("drawer", false, 1));
    let learn = |way: &[&str]| {
        let arguments = ["learn", &recording, "--object", "drawer"];
        let output = run_in(dir.path(), &[&arguments[..], way].concat());
        assert!(output.status.success(), "{}", failure(&output).1);
        (drawer(&store).model.demonstrations, failure(&output).1)
    };
    assert_eq!(learn(&["--add"]).0, 2);
    assert_eq!(learn(&["--replace"]).0, 1);
    // Where only files are asked for, what is known stays, and that is said.
    let (demonstrations, said) = learn(&["--json", "model.json"]);
    assert!(dir.path().join("model.json").exists() && demonstrations == 1);
    assert!(said.contains("nothing is stored") && said.contains("--replace"), "{said}");
}

#[test]
fn without_a_store_it_is_saved_where_recognise_looks() {
    let dir = tempfile::tempdir().unwrap();
    let (recording, met) = (simulated("drawer", false, 1), simulated("drawer", true, 1));
    let learn = ["learn", &text(&recording), "--object", "drawer", "--no-store"];
    assert!(run_in(dir.path(), &learn).status.success());
    assert!(std::fs::read_dir(dir.path()).unwrap().next().is_none(), "nothing is stored");
    let output = run_in(dir.path(), &learn[..4]);
    assert!(output.status.success());
    let said = failure(&output).1;
    assert!(said.contains("drawer is saved in objects.linkage"), "{said}");
    let found = run_in(dir.path(), &["recognise", &text(&met)]);
    assert!(found.status.success(), "{}", failure(&found).1);
}

#[test]
fn merging_replaces_nothing_unless_it_is_told_to() {
    let (dir, store) = with_drawer();
    let recording = text(&simulated("drawer", false, 1));
    let other = dir.path().join("other.linkage");
    let learn = ["learn", &recording, "--object", "drawer", "--seed", "5", "--store"];
    assert!(linkage(&[&learn[..], &[&text(&other)]].concat()).status.success());
    let merge = ["store", "merge", &text(&other), "--store", &text(&store)];
    let before = drawer(&store);
    assert_refused(&linkage(&merge), &["drawer", "--replace"]);
    assert!(drawer(&store) == before);
    assert!(linkage(&[&merge[..], &["--replace"]].concat()).status.success());
    assert!(drawer(&store) == drawer(&other));
    assert!(linkage(&merge).status.success(), "what is there already does no harm");
}

#[test]
fn what_is_no_name_of_a_file_is_refused_with_words() {
    let (dir, store) = with_drawer();
    let fifo = dir.path().join("fifo");
    assert!(Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    std::fs::write(dir.path().join("empty.linkage"), "").unwrap();
    let cases: [(&str, &str); 7] = [
        (":memory:", "lies in memory"),
        ("file:objects.linkage?mode=memory", "a URI"),
        ("", "a value is required"),
        (".", "a folder"),
        ("fifo", "a device or a pipe"),
        ("/dev/null", "a device or a pipe"),
        ("objects.linkage/objects.linkage", "objects.linkage/objects.linkage"),
    ];
    for (name, words) in cases {
        for arguments in [
            vec!["learn", "/nowhere", "--object", "x", "--store", name],
            vec!["store", "list", "--store", name],
            vec!["recognise", "/nowhere", "--store", name],
            vec!["store", "merge", "objects.linkage", "--store", name],
            vec!["serve", "--source", "/nowhere", "--store", name],
        ] {
            assert_refused(&run_in(dir.path(), &arguments), &[words]);
        }
    }
    let empty = run_in(dir.path(), &["store", "list", "--store", "empty.linkage"]);
    assert_refused(&empty, &["empty.linkage", "not a Linkage store"]);
    let nowhere = ["learn", "/nowhere", "--object", "x", "--store", "no/folder/o.linkage"];
    assert_refused(&run_in(dir.path(), &nowhere), &["no/folder"]);
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 3, "nothing was made");
    assert_eq!(Store::open(&store).unwrap().names().unwrap(), ["drawer"]);
}

#[test]
fn a_link_is_the_store_that_it_leads_to() {
    let (dir, store) = with_drawer();
    let link = dir.path().join("link.linkage");
    std::os::unix::fs::symlink(&store, &link).unwrap();
    let mut by_link = Store::open(&link).unwrap();
    let direct = Store::open(&store).unwrap();
    by_link.remove("drawer").unwrap();
    assert!(direct.names().unwrap().is_empty());
    assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());
}

/// Runs a script as root of file systems of its own: none where the system refuses them.
fn with_own_mounts(dir: &Path, script: &str) -> Option<Output> {
    build();
    let isolated = ["--map-root-user", "--mount", "--", "sh", "-e", "-c"];
    let allowed = Command::new("unshare").args(isolated).arg("mount -t tmpfs none /mnt").output();
    if !allowed.is_ok_and(|o| o.status.success()) {
        eprintln!("ignored: this system gives tests no mounts of their own");
        return None;
    }
    let mut command = Command::new("unshare");
    command.args(isolated).arg(script).env("LINKAGE", program()).current_dir(dir);
    Some(command.output().unwrap())
}

/// Where the drawer is met, and how it is looked for in a store.
fn recognise_in(store: &str) -> String {
    let met = simulated("drawer", true, 1);
    format!("\"$LINKAGE\" recognise '{}' --store {store}", met.display())
}

#[test]
fn a_store_on_read_only_media_is_read_and_says_that_it_cannot_be_written() {
    let (dir, store) = with_drawer();
    // What a killed process left: the last change lies in the journal alone.
    let crashed = dir.path().join("crashed.linkage");
    let mut open = Store::open(&store).unwrap();
    let other = StoredObject { model: drawer(&store).model, ..drawer(&store) };
    let mut renamed = other.clone();
    renamed.model.object = "another".to_owned();
    open.put(&renamed).unwrap();
    std::fs::copy(&store, &crashed).unwrap();
    std::fs::copy(text(&store) + "-wal", text(&crashed) + "-wal").unwrap();
    drop(open);
    let script = format!(
        "mount --bind . . && mount -o remount,ro,bind . && cd \"$PWD\"
         if touch here 2>/dev/null; then exit 9; fi
         \"$LINKAGE\" store list --store objects.linkage
         \"$LINKAGE\" store list --store crashed.linkage
         \"$LINKAGE\" store show another --store crashed.linkage | grep -c camera_from_object
         {}
         if \"$LINKAGE\" store remove drawer --store objects.linkage; then exit 9; fi
         if \"$LINKAGE\" learn /nowhere --object drawer --replace --store objects.linkage
         then exit 9; fi",
        recognise_in("objects.linkage")
    );
    let Some(output) = with_own_mounts(dir.path(), &script) else { return };
    let (status, said) = failure(&output);
    assert_eq!(status, 0, "{said}");
    assert_eq!(said.matches("this store can only be read").count(), 2, "{said}");
    let listed = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(listed, "another\ndrawer\nanother\ndrawer\n1\n", "{said}");
}

#[test]
fn on_a_full_disk_a_store_keeps_what_it_has_and_is_read() {
    let (dir, store) = with_drawer();
    let size = std::fs::metadata(&store).unwrap().len() / 1024;
    let mut big = Store::open(&store).unwrap();
    let mut other = drawer(&store);
    other.model.object = "another".to_owned();
    big.put(&other).unwrap();
    drop(big);
    std::fs::create_dir(dir.path().join("small")).unwrap();
    let script = format!(
        "mount -t tmpfs -o size={}k none small
         cp '{}' small/o.linkage
         if \"$LINKAGE\" store merge objects.linkage --store small/o.linkage; then exit 9; fi
         cat /dev/zero > small/filler 2>/dev/null || true
         if \"$LINKAGE\" store merge objects.linkage --store small/o.linkage; then exit 9; fi
         if \"$LINKAGE\" store merge objects.linkage --store small/new.linkage; then exit 9; fi
         \"$LINKAGE\" store list --store small/o.linkage
         {}",
        size + 100,
        learned().display(),
        recognise_in("small/o.linkage")
    );
    let Some(output) = with_own_mounts(dir.path(), &script) else { return };
    let (status, said) = failure(&output);
    assert_eq!(status, 0, "{said}");
    for file in ["o.linkage", "new.linkage"] {
        let is_told =
            |line: &str| line.contains(&format!("small/{file}: ")) && line.contains("full");
        assert!(said.lines().any(is_told), "{file}: {said}");
    }
    assert_eq!(String::from_utf8_lossy(&output.stdout), "drawer\n", "{said}");
}

#[test]
fn a_file_that_one_may_not_read_is_told_as_such() {
    use std::os::unix::fs::PermissionsExt;
    let (dir, store) = with_drawer();
    let locked = dir.path().join("locked");
    std::fs::create_dir(&locked).unwrap();
    std::fs::copy(&store, locked.join("objects.linkage")).unwrap();
    let allow = |path: &Path, mode| {
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap();
    };
    allow(dir.path(), 0o755);
    allow(&store, 0o000);
    allow(&locked, 0o000);
    for file in [&store, &locked.join("objects.linkage")] {
        build();
        let mut list = Command::new(program());
        list.args(["store", "list", "--store", &text(file)]);
        if std::fs::File::open(&store).is_ok() {
            // Nothing is locked for root: somebody else asks.
            list.uid(65_534).gid(65_534);
        }
        match list.output() {
            Ok(output) => assert_refused(&output, &["objects.linkage", "Permission denied"]),
            Err(_) => eprintln!("ignored: others may not start the program"),
        }
    }
    allow(&locked, 0o755);
}

/// What a process was killed in the middle of.
#[derive(Clone, Copy, Debug)]
enum Work {
    Learn,
    Merge,
    Remove,
    Serve,
}

/// Starts some work on a store and kills it at some moment. `true` if it was acknowledged before,
/// and how long it had.
fn killed(work: Work, store: &Path, other: &Path, after: Duration, port: u16) -> (bool, Duration) {
    let recording = text(&simulated("drawer", false, 1));
    let (store_text, other) = (text(store), text(other));
    let arguments: Vec<&str> = match work {
        Work::Learn => vec!["learn", &recording, "--object", "drawer", "--replace"],
        Work::Merge => vec!["store", "merge", &other, "--replace"],
        Work::Remove => vec!["store", "remove", "another"],
        Work::Serve => return killed_service(store, after, port),
    };
    let mut child = start(&[&arguments[..], &["--store", &store_text]].concat());
    let begun = Instant::now();
    while begun.elapsed() < after {
        if let Some(status) = child.try_wait().unwrap() {
            return (status.success(), begun.elapsed());
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    (child.wait().unwrap().success(), after)
}

/// A service that watches, learns and is killed. `true` if it said that it had learned, and how
/// long it had for that.
fn killed_service(store: &Path, after: Duration, port: u16) -> (bool, Duration) {
    let url = format!("udpm://239.255.76.67:{port}?ttl=0");
    let recording = text(&simulated("drawer", false, 1));
    let service = Service::start(&url, &recording, store, &["--repeat", "--rate", "4"]);
    service.done(&["start", "live"]);
    std::thread::sleep(Duration::from_millis(1200));
    let mut finish = start(&["command", "--publish", &url, "--wait", "30", "finish"]);
    let begun = Instant::now();
    while begun.elapsed() < after && finish.try_wait().unwrap().is_none() {
        std::thread::sleep(Duration::from_millis(5));
    }
    let had = begun.elapsed();
    service.kill();
    // An answer that was sent is on its way no longer than this.
    std::thread::sleep(Duration::from_millis(300));
    let answer = finish.try_wait().unwrap();
    let _ = finish.kill();
    let _ = finish.wait();
    (answer.is_some_and(|status| status.success()), had)
}

#[test]
fn a_kill_at_any_moment_of_learn_merge_remove_and_serve_loses_nothing_that_was_acknowledged() {
    let (dir, store) = with_drawer();
    let other = dir.path().join("other.linkage");
    let mut another = drawer(&store);
    another.model.object = "another".to_owned();
    Store::open_or_create(&other).unwrap().put(&another).unwrap();
    let kept = drawer(&store);
    let kills: u32 = std::env::var("LINKAGE_KILLS").ok().and_then(|n| n.parse().ok()).unwrap_or(12);
    let works = [Work::Merge, Work::Remove, Work::Learn, Work::Serve];
    // How long each takes on this machine, so that it is killed at all of its moments, and soon after.
    let (_scratch, untouched) = with_drawer();
    let taken = works.map(|work| {
        let (done, took) = killed(work, &untouched, &other, Duration::from_secs(120), 7710);
        assert!(done, "{work:?} is done where nothing kills it");
        took
    });
    let (mut is_there, mut is_live, mut acknowledged) = (false, 0, 0);
    let learned_at = |o: &StoredObject| o.provenance.last().map_or(0, |p| p.learned_utime);
    let mut learned = learned_at(&kept);
    for kill in 0..kills {
        let work = works[kill as usize % 4];
        let longest_us = taken[kill as usize % 4].as_micros() as u64 * 3 / 2;
        let after = Duration::from_micros((u64::from(kill) * 7_919_000) % longest_us.max(1));
        let (done, _) = killed(work, &store, &other, after, 7710);
        acknowledged += u32::from(done);
        let store = Store::open(&store).unwrap();
        let names = store.names().unwrap();
        let objects: Vec<StoredObject> = names.iter().map(|n| store.get(n).unwrap()).collect();
        let same = objects.iter().find(|o| o.model == kept.model);
        // It is learned from the same recording each time: the same model, but for its time.
        let now = learned_at(same.unwrap_or_else(|| panic!("{work:?} {after:?}: {names:?}")));
        let least = learned + i64::from(done && matches!(work, Work::Learn));
        assert!(now >= least, "{work:?} {after:?}: it is that of {now}, not of {least} or later");
        learned = now;
        let has_another = objects.contains(&another);
        assert_eq!(has_another, names.contains(&"another".to_owned()));
        match work {
            Work::Merge if done => assert!(has_another),
            Work::Remove if done => assert!(!has_another),
            Work::Merge | Work::Remove => {}
            Work::Learn | Work::Serve => assert_eq!(has_another, is_there, "{work:?}"),
        }
        is_there = has_another;
        let live = objects.iter().find(|o| o.model.object == "live");
        let live = live.map_or(0, |o| o.model.demonstrations);
        let least = is_live + usize::from(done && matches!(work, Work::Serve));
        assert!(live >= least, "{work:?} {after:?}: {live} demonstrations of {least}");
        is_live = live;
    }
    println!("{kills} kills, {acknowledged} acknowledged, nothing lost");
    assert!(
        acknowledged >= kills / 12,
        "{acknowledged} of {kills} were acknowledged: too few to lose"
    );
}
