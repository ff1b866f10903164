//! What users and other programs rely on changes only where somebody means it to: the help of each
//! command, the configuration with its explanations, and the forms of the JSON that is written.
//!
//! What is kept lies in `tests/kept/`. `LINKAGE_BLESS=1 cargo test --release -p linkage-tests --test
//! kept_texts` writes it anew; the difference is looked at and told in CHANGELOG.md.

use linkage_tests::{failure, learned, linkage, simulated};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;

/// What a command prints.
fn printed(arguments: &[&str]) -> String {
    let output = linkage(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", failure(&output).1);
    String::from_utf8(output.stdout).expect("the program prints UTF-8")
}

/// Compares a text with what is kept under a name, line by line; keeps it where that is asked for.
fn assert_kept(name: &str, text: &str) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("kept").join(name);
    if std::env::var_os("LINKAGE_BLESS").is_some() {
        std::fs::write(&file, text).expect("the repository can be written");
    }
    let kept = std::fs::read_to_string(&file).unwrap_or_default();
    let lines = |text: &str| text.lines().map(str::to_owned).collect::<Vec<_>>();
    let (now, before) = (lines(text), lines(&kept));
    let other = (0..now.len().max(before.len())).find(|i| now.get(*i) != before.get(*i));
    if let Some(i) = other {
        let (now, before) = (now.get(i), before.get(i));
        panic!("{name}, line {}: {now:?} instead of {before:?}; see the head of this test", i + 1);
    }
}

/// The help of a command, then that of each command within it.
fn add_help(command: &[&str], all: &mut String) {
    let help = printed(&[command, &["--help"]].concat());
    all.push_str(&format!("# linkage {}\n{help}\n", command.join(" ")));
    let listed = help.split_once("\nCommands:\n").map_or("", |(_, rest)| rest);
    let rows = listed.lines().take_while(|row| !row.is_empty());
    for name in rows.filter_map(|row| row.split_whitespace().next()).filter(|n| *n != "help") {
        add_help(&[command, &[name]].concat(), all);
    }
}

#[test]
fn the_help_of_each_command_is_as_it_was() {
    let mut all = String::new();
    add_help(&[], &mut all);
    assert!(all.matches("# linkage ").count() > 20, "{all}");
    // No line of it ends in spaces that an editor would take away.
    let trimmed: Vec<&str> = all.lines().map(str::trim_end).collect();
    assert_kept("help.txt", &(trimmed.join("\n") + "\n"));
}

#[test]
fn the_configuration_and_its_explanations_are_as_they_were() {
    assert_kept("config.toml", &printed(&["config", "dump"]));
}

/// A text with `#` in the place of each number, which a better method may change. A number within a name stays.
fn without_numbers(text: &str) -> String {
    let is_of_number = |c: char| c.is_ascii_digit() || matches!(c, '.' | '-' | '+');
    let mut out = String::new();
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let run = rest.len() - rest.trim_start_matches(is_of_number).len();
        let number = rest[..run].trim_end_matches(['.', '-', '+']);
        let is_in_name = out.ends_with(char::is_alphanumeric);
        let taken = match number.len() {
            0 => first.len_utf8(),
            count => count,
        };
        out.push_str(if number.is_empty() || is_in_name { &rest[..taken] } else { "#" });
        rest = &rest[taken..];
    }
    out
}

#[test]
fn what_learn_recognise_predict_fit_and_export_say_is_as_it_was() {
    let dir = tempfile::tempdir().unwrap();
    let [demonstration, met] =
        [false, true].map(|is_met| simulated("drawer", is_met, 1).display().to_string());
    let at = |name: &str| dir.path().join(name).display().to_string();
    let (store, urdf, log) = (at("objects.linkage"), at("drawer.urdf"), at("slide.csv"));
    std::fs::write(&log, poses_of_a_slide()).unwrap();
    let mut all = String::new();
    for command in [
        &["learn", &demonstration, "--object", "drawer", "--store", &store][..],
        &["learn", &demonstration, "--object", "drawer", "--store", &store],
        &["recognise", &met, "--store", &store],
        &["predict", &met, "--store", &store, "--to", "open"],
        &["predict", &met, "--store", &store, "--to", "9.5"],
        &["fit", &log],
        &["export", "drawer", "--store", &store, "--format", "urdf", "--out", &urdf],
        &["export", "door", "--store", &store],
        &["store", "list", "--store", &store],
    ] {
        let output = linkage(command);
        let said = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
        let status = output.status.code().expect("it ends by itself");
        let told = format!("$ linkage {}\n{}{}", command.join(" "), said[0], said[1]);
        let told = told.replace(&demonstration, "DEMONSTRATION").replace(&met, "ENCOUNTER");
        all.push_str(&without_numbers(&told.replace(&at(""), "")));
        all.push_str(&format!("exit status {status}\n\n"));
    }
    assert_kept("answers.txt", all.trim_end());
}

#[test]
fn numbers_alone_are_left_out_of_what_is_kept() {
    let said = without_numbers("joint1: -0.25 to 3.4 m, ±12% of 30. (1.5) a-b.json ...\n");
    assert_eq!(said, "joint1: # to # m, ±#% of #. (#) a-b.json ...\n");
}

/// A pose log of a drawer that is pulled out by 40 cm.
fn poses_of_a_slide() -> String {
    let pose = |i: i32| format!("{},0.0,{},1.0\n", f64::from(i) / 30.0, f64::from(i) * 0.01);
    "t,x,y,z\n".to_owned() + &(0..40).map(pose).collect::<String>()
}

/// Adds each key of a value with the type of what it holds, such as `joints[].axis[]: number`.
fn add_form(at: &str, value: &Value, form: &mut BTreeSet<String>) {
    let name = match value {
        Value::Null => "null",
        Value::Bool(_) => "true or false",
        Value::Number(_) => "number",
        Value::String(_) => "text",
        Value::Array(values) => {
            values.iter().for_each(|value| add_form(&format!("{at}[]"), value, form));
            return;
        }
        Value::Object(values) => {
            values.iter().for_each(|(key, value)| add_form(&format!("{at}.{key}"), value, form));
            return;
        }
    };
    form.insert(format!("{at}: {name}"));
}

#[test]
fn the_forms_of_all_json_are_as_they_were() {
    let dir = tempfile::tempdir().unwrap();
    let store = learned("drawer", dir.path()).display().to_string();
    let met = simulated("drawer", true, 1).display().to_string();
    let log = dir.path().join("slide.csv");
    std::fs::write(&log, poses_of_a_slide()).unwrap();
    let log = log.display().to_string();
    let mut all = String::new();
    for (name, command) in [
        ("model", &["export", "drawer", "--store", &store, "--format", "json"][..]),
        ("recognition", &["recognise", &met, "--store", &store, "--json", "-", "--quiet"]),
        ("prediction", &["predict", &met, "--store", &store, "--json", "-", "--quiet"]),
        ("fit", &["fit", &log, "--json", "-", "--quiet"]),
    ] {
        let json: Value = serde_json::from_str(&printed(command)).expect("it prints JSON alone");
        let mut form = BTreeSet::new();
        add_form(name, &json, &mut form);
        all.extend(form.into_iter().map(|line| line + "\n"));
    }
    assert_kept("json_forms.txt", &all);
}
