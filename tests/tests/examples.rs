//! Each example does what its head says: a drawer is learned, recognised and predicted, a log of poses is
//! fitted, and a running service answers a planner.

use linkage_tests::service::Service;
use linkage_tests::{build, failure, learned, program, simulated};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

/// The built example. `cargo test --workspace` builds all of them; alone, this test builds them itself.
fn example(name: &str) -> PathBuf {
    static BUILT: OnceLock<()> = OnceLock::new();
    let program = program();
    BUILT.get_or_init(|| {
        if std::env::var_os("LINKAGE_PROGRAM_IS_BUILT").is_some() {
            return;
        }
        let mut cargo = Command::new(env!("CARGO"));
        cargo.args(["build", "--quiet", "--examples", "--workspace"]);
        if program.components().any(|c| c.as_os_str() == "release") {
            cargo.arg("--release");
        }
        assert!(cargo.status().expect("cargo starts").success(), "the examples must build");
    });
    program.with_file_name("examples").join(name)
}

fn run(name: &str, arguments: &[&str]) -> Output {
    Command::new(example(name)).args(arguments).output().expect("a built example starts")
}

/// What an example prints, which must end well.
fn printed(name: &str, arguments: &[&str]) -> String {
    let output = run(name, arguments);
    assert!(output.status.success(), "{name}: {}", failure(&output).1);
    String::from_utf8(output.stdout).expect("it prints text")
}

/// The first number after some words.
fn number_after(text: &str, words: &str) -> f64 {
    let (_, rest) = text.split_once(words).unwrap_or_else(|| panic!("no \"{words}\" in: {text}"));
    let is_part = |c: char| c.is_ascii_digit() || "+-.".contains(c);
    let number: String = rest.trim_start().chars().take_while(|&c| is_part(c)).collect();
    number.parse().unwrap_or_else(|_| panic!("no number after \"{words}\" in: {text}"))
}

fn text(path: &Path) -> String {
    path.display().to_string()
}

#[test]
fn a_drawer_is_learned_and_then_recognised_and_predicted_elsewhere() {
    let dir = tempfile::tempdir().unwrap();
    let store = text(&dir.path().join("objects.linkage"));
    let demonstration = text(&simulated("drawer", false, 1));
    let told = printed("01_learn", &[&store, &demonstration, "drawer"]);
    assert!(told.contains("joint1: prismatic") && told.contains("to 0.300 m\n"), "{told}");
    assert!(told.contains(&format!("\"drawer\" is in {store}, which holds: drawer")), "{told}");
    // A second object of that name would take the first one's place.
    let (_, refused) = failure(&run("01_learn", &[&store, &demonstration, "drawer"]));
    assert!(refused.contains("give another name"), "{refused}");

    let encounter = text(&simulated("drawer", true, 1));
    let seen = printed("02_recognise", &[&store, &encounter]);
    assert!(seen.contains("drawer, score"), "{seen}");
    let configuration = number_after(&seen, "joint1: at");

    let way = printed("03_predict", &[&store, &encounter, "0.05"]);
    assert!(way.contains("drawer/joint1 (prismatic):"), "{way}");
    assert!((number_after(&way, "at ") - configuration).abs() < 0.03, "{seen}\n{way}");
    assert!(way.contains("  at 0.050 "), "it ends at its target: {way}");
    assert!(way.contains("held at ("), "{way}");
}

#[test]
fn a_door_is_fitted_to_its_poses() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("door.log");
    // A door whose hinge is the z axis through (1, 2); its poses are at a handle 0.8 m from it.
    let mut log = String::new();
    for step in 0..40 {
        let q = 0.03 * f64::from(step);
        let (x, y) = (1.0 + 0.8 * q.cos(), 2.0 + 0.8 * q.sin());
        let (half_sin, half_cos) = (q / 2.0).sin_cos();
        writeln!(log, "{} {x} {y} 0.9 0 0 {half_sin} {half_cos}", 0.1 * f64::from(step)).unwrap();
    }
    std::fs::write(&path, log).unwrap();
    let told = printed("04_fit_poses", &[&text(&path)]);
    assert!(told.starts_with("40 poses\nrevolute: probability 1.000"), "{told}");
    assert!((number_after(&told, "through (") - 1.0).abs() < 0.01, "{told}");
    let turn = number_after(&told, " to ") - number_after(&told, "seen from ");
    assert!((turn - 39.0 * 0.03).abs() < 0.01, "{told}");
}

#[test]
fn a_planner_in_a_page_gets_the_way_of_a_drawer() {
    build();
    let dir = tempfile::tempdir().unwrap();
    let store = learned("drawer", dir.path());
    let encounter = text(&simulated("drawer", true, 1));
    let url = "udpm://239.255.76.67:7734?ttl=0";
    let _service = Service::start(url, &encounter, &store, &["--repeat", "--rate", "1"]);
    let told = printed("05_live_lcm", &["drawer", url]);
    assert!(told.contains("joint1 is at "), "{told}");
    assert!(number_after(&told, "arrives at ") > 0.1 && told.contains(" after "), "{told}");
}
