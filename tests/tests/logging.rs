//! What the program logs, and the unit that systemd runs it by.

use linkage_tests::{build, program};
use std::path::Path;
use std::process::Command;

/// What a program that fails says, with every event logged.
fn said(options: &[&str]) -> String {
    build();
    let output = Command::new(program())
        .args(["learn", "/nowhere/at/all", "--object", "x", "--quiet"])
        .args(options)
        .env("RUST_LOG", "trace")
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    String::from_utf8(output.stderr).unwrap()
}

#[test]
fn a_log_that_is_no_terminal_holds_no_colour_codes() {
    for options in [&[][..], &["--log-format", "text"], &["--log-format", "json"]] {
        let text = said(options);
        assert!(text.contains("/nowhere/at/all"), "{text}");
        assert!(!text.contains('\u{1b}'), "{text}");
    }
}

#[test]
fn what_cannot_be_printed_is_told_and_is_no_panic() {
    build();
    let full = || std::fs::OpenOptions::new().write(true).open("/dev/full");
    if full().is_err() {
        eprintln!("ignored: this system has no /dev/full");
        return;
    }
    let run = |command: &[&str]| {
        let mut program = Command::new(program());
        program.args(command);
        program
    };
    for command in [&["config", "dump"][..], &["simulate", "--scene", "list"]] {
        let output = run(command).stdout(full().unwrap()).output().unwrap();
        let told = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{told}");
        assert!(told.contains("standard output: cannot be written: No space left"), "{told}");
        // What was asked for is done, whether or not anybody hears of it.
        let silent = run(command).stderr(full().unwrap()).output().unwrap();
        assert!(silent.status.success() && !silent.stdout.is_empty());
    }
    let log = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(log.path(), "0 0 0\n0.1 0 0\n0.2 0 0\n0.3 0 0\n0.4 0 0\n0.5 0 0\n").unwrap();
    let fit = run(&["fit", log.path().to_str().unwrap(), "--json", "-"])
        .stderr(full().unwrap())
        .output()
        .unwrap();
    assert!(fit.status.success() && fit.stdout.starts_with(b"{"), "{fit:?}");
}

#[test]
fn a_log_of_json_is_an_object_a_line() {
    let text = said(&["--log-format", "json"]);
    let events: Vec<serde_json::Value> =
        text.lines().map(|line| serde_json::from_str(line).expect(line)).collect();
    let failure = events.last().unwrap();
    assert_eq!(failure["level"], "ERROR");
    assert!(failure["fields"]["message"].as_str().unwrap().contains("/nowhere/at/all"));
    assert!(failure["timestamp"].is_string());
}

#[test]
fn the_systemd_unit_starts_the_service_with_options_that_it_knows() {
    build();
    let unit = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config/systemd/linkage.service");
    let text = std::fs::read_to_string(&unit).unwrap();
    for line in ["Type=notify", "Restart=on-failure", "AmbientCapabilities=CAP_SYS_NICE"] {
        assert!(text.lines().any(|l| l == line), "{line}");
    }
    assert!(text.lines().any(|l| l.starts_with("WatchdogSec=")));
    let start = text.lines().find_map(|l| l.strip_prefix("ExecStart=")).unwrap();
    let mut words = start.split(' ').skip(1);
    let command = words.next().unwrap();
    let help = Command::new(program()).args([command, "--help"]).output().unwrap();
    let help = String::from_utf8(help.stdout).unwrap();
    for option in words.filter(|w| w.starts_with("--")) {
        assert!(help.contains(option), "{option} is unknown to {command}");
    }
    // Where systemd is available, it checks the rest; that the program is not installed is no
    // fault.
    if let Ok(output) = Command::new("systemd-analyze").arg("verify").arg(&unit).output() {
        let complaints = String::from_utf8_lossy(&output.stderr).into_owned();
        let of_the_unit = |l: &&str| l.contains("linkage.service") && !l.contains("not executable");
        let found: Vec<&str> = complaints.lines().filter(of_the_unit).collect();
        assert!(found.is_empty(), "{found:?}");
    }
}
