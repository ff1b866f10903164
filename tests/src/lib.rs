//! What the whole-skill specifications share: the program under test, scratch folders, simulated
//! recordings, and the third-party data where it is available.

pub mod fixtures;
pub mod joint;
pub mod service;

use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::UNIX_EPOCH;

/// The name of a store in a scratch folder.
const STORE: &str = "objects.linkage";

static BUILT: OnceLock<()> = OnceLock::new();

/// The built program.
pub fn program() -> PathBuf {
    // Test binaries lie in target/<profile>/deps; the program two levels up.
    let mut path = std::env::current_exe().expect("a running test has a path");
    path.pop();
    path.pop();
    path.join("linkage")
}

/// Runs the program; standard error says why it failed.
pub fn linkage(arguments: &[&str]) -> Output {
    BUILT.get_or_init(build);
    Command::new(program()).args(arguments).output().expect("the built program starts")
}

/// Builds the program, unless `LINKAGE_PROGRAM_IS_BUILT` says that it is. `cargo test` builds it only
/// where a test of its own crate is among those that run, and alone it is built with other features
/// of its dependencies than with all tests.
pub fn build() {
    if std::env::var_os("LINKAGE_PROGRAM_IS_BUILT").is_some() {
        return;
    }
    let profile = program();
    let release = profile.components().any(|c| c.as_os_str() == "release");
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args(["build", "--quiet", "--package", "linkage"]);
    if release {
        cargo.arg("--release");
    }
    if cfg!(feature = "view") {
        cargo.args(["--features", "view"]);
    }
    let status = cargo.status().expect("cargo starts");
    assert!(status.success(), "the program must build");
}

/// Exit status and standard error.
pub fn failure(output: &Output) -> (i32, String) {
    (output.status.code().unwrap_or(-1), String::from_utf8_lossy(&output.stderr).into_owned())
}

/// A simulated take, rendered once for all tests until the simulator changes.
pub fn simulated(scene: &str, encounter: bool, seed: u64) -> PathBuf {
    let take = if encounter { "encounter" } else { "demonstration" };
    made_once(&shared().takes, &format!("{scene}-{take}-{seed}"), |out| {
        let (out, seed) = (out.display().to_string(), seed.to_string());
        let arguments = ["simulate", "--quiet", "--scene", scene, "--out", &out, "--seed", &seed];
        let output =
            linkage(&[&arguments[..], if encounter { &["--encounter"] } else { &[] }].concat());
        assert!(output.status.success(), "{}", failure(&output).1);
    })
}

/// A copy in `dir` of the store that knows a scene's object, which is called after the scene. It is
/// learned from the first demonstration, once for all tests of this build of the program.
pub fn learned(scene: &str, dir: &Path) -> PathBuf {
    let recording = simulated(scene, false, 1).display().to_string();
    let made = made_once(&shared().learned, scene, |out| {
        let store = out.join(STORE).display().to_string();
        let arguments = ["learn", &recording, "--object", scene, "--quiet", "--store", &store];
        let output = linkage(&arguments);
        assert!(output.status.success(), "{}", failure(&output).1);
    });
    std::fs::create_dir_all(dir).expect("a scratch folder can be made");
    let store = dir.join(STORE);
    std::fs::copy(made.join(STORE), &store).expect("a scratch file can be written");
    store
}

/// A folder below `all` that `make` fills, if no test has done so.
fn made_once(all: &Path, name: &str, make: impl FnOnce(&Path)) -> PathBuf {
    // Tests of one binary run side by side and share what is made.
    static MAKING: Mutex<()> = Mutex::new(());
    let _one_at_a_time = MAKING.lock().unwrap_or_else(PoisonError::into_inner);
    let dir = all.join(name);
    if dir.exists() {
        return dir;
    }
    // And those of two binaries.
    let lock = std::fs::File::create(all.join("lock")).expect("a scratch file can be written");
    lock.lock().expect("the file system knows locks");
    if dir.exists() {
        return dir;
    }
    let unfinished = tempfile::tempdir_in(all).expect("a scratch folder can be made");
    make(unfinished.path());
    std::fs::rename(unfinished.path(), &dir).expect("a finished folder can be renamed");
    dir
}

/// Folders of what tests share, beside the program.
struct Shared {
    /// What this simulator rendered.
    takes: PathBuf,
    /// What this build of the program learned.
    learned: PathBuf,
}

/// These folders; those of other simulators and earlier builds are removed.
fn shared() -> &'static Shared {
    static SHARED: OnceLock<Shared> = OnceLock::new();
    SHARED.get_or_init(|| {
        BUILT.get_or_init(build);
        let built = std::fs::metadata(program()).and_then(|m| m.modified());
        let since = built.expect("the program lies on a file system that knows times");
        let age = since.duration_since(UNIX_EPOCH).expect("the program was built after 1970");
        let all = program().with_file_name("shared-by-tests");
        let folder = |name: String| all.join(name);
        let shared = Shared {
            takes: folder(format!("takes-{:016x}", simulator())),
            learned: folder(format!("learned-{}", age.as_nanos())),
        };
        for old in std::fs::read_dir(&all).into_iter().flatten().flatten() {
            if old.path() != shared.takes && old.path() != shared.learned {
                // One that cannot be removed is tried again by the next run.
                let _ = std::fs::remove_dir_all(old.path());
            }
        }
        for folder in [&shared.takes, &shared.learned] {
            std::fs::create_dir_all(folder).expect("a scratch folder can be made");
        }
        shared
    })
}

/// What a rendered picture depends on: the simulator, cameras and files of pictures, motions of joints,
/// and the libraries below.
const SIMULATOR: [&str; 9] = [
    "tools/src/simulate",
    "tools/src/tags",
    "tools/src/truth.rs",
    "tools/src/steps.rs",
    "driver/frames/src",
    "driver/src/image_file.rs",
    "skill/src/object/joint_geometry.rs",
    "skill/src/math/rigid.rs",
    "Cargo.lock",
];

/// A digest of the simulator's sources.
fn simulator() -> u64 {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut hasher = DefaultHasher::new();
    SIMULATOR.iter().for_each(|source| add_to_digest(&root.join(source), &mut hasher));
    hasher.finish()
}

/// Adds the name and the bytes of a file, or all files of a folder.
fn add_to_digest(path: &Path, hasher: &mut DefaultHasher) {
    if let Ok(entries) = std::fs::read_dir(path) {
        let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
        files.sort();
        files.iter().for_each(|file| add_to_digest(file, hasher));
        return;
    }
    path.file_name().hash(hasher);
    std::fs::read(path).expect("the simulator's sources are there").hash(hasher);
}

/// Third-party recordings and logs; `None`, with a message, where they are missing.
pub fn shared_data(what: &str) -> Option<PathBuf> {
    let data = std::env::var("LINKAGE_DATA").map_or_else(
        |_| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    let path = data.join(what);
    if path.exists() {
        return Some(path);
    }
    eprintln!("ignored: {what} is not under $LINKAGE_DATA");
    None
}

/// The Python that tools/setup made, if it carries LCM.
pub fn python_with_lcm() -> Option<PathBuf> {
    python_with(&["lcm"])
}

/// The Python that tools/setup made, if it carries these packages.
pub fn python_with(packages: &[&str]) -> Option<PathBuf> {
    // tools/setup makes it beside the build, which CARGO_TARGET_DIR may have elsewhere.
    let target = program().ancestors().nth(2).map(|target| target.join("python/bin/python"));
    let python = target.filter(|python| python.exists()).unwrap_or_else(|| {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/python/bin/python")
    });
    let import = format!("import {}", packages.join(", "));
    let works = Command::new(&python).args(["-c", &import]).status().is_ok_and(|s| s.success());
    if works {
        return Some(python);
    }
    eprintln!("ignored: no Python with {}; run tools/setup", packages.join(" and "));
    None
}

/// A recording of a few tiny frames, for tests that break it.
pub fn tiny_recording(dir: &Path) {
    use linkage_driver::{ColorImage, image_file};
    for folder in ["rgb", "depth"] {
        std::fs::create_dir_all(dir.join(folder)).expect("a scratch folder can be made");
    }
    let (mut rgb, mut depth) = (String::new(), String::new());
    for i in 0..12_u32 {
        let pixels = (0..64 * 48 * 3_u32).map(|k| ((k * 37 + i * 11) % 251) as u8).collect();
        let color = ColorImage::new(64, 48, pixels).expect("the buffer fits the size");
        image_file::write_color(&dir.join(format!("rgb/{i}.png")), &color).expect("can be written");
        image_file::write_depth(&dir.join(format!("depth/{i}.png")), 64, 48, &[5000; 64 * 48])
            .expect("can be written");
        rgb += &format!("{}.0 rgb/{i}.png\n", 10 + i);
        depth += &format!("{}.0 depth/{i}.png\n", 10 + i);
    }
    let camera = "width = 64\nheight = 48\nfx = 52.5\nfy = 52.5\ncx = 31.5\ncy = 23.5\ndepth_units_per_metre = 5000.0\n";
    for (name, text) in [("rgb.txt", rgb.as_str()), ("depth.txt", &depth), ("camera.toml", camera)]
    {
        std::fs::write(dir.join(name), text).expect("can be written");
    }
}
