//! The C interface as a C programmer meets it: installed, found by pkg-config and CMake, compiled,
//! run, and run again under valgrind.

use linkage_driver::RgbdFrame;
use linkage_tests::{failure, linkage, simulated};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

fn source(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(name)
}

fn run(command: &mut Command) -> Output {
    let output = command.output().expect("a tool that tools/setup installs");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {:?}\n{said}", output.status);
    output
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// The library installed into a folder, once for all tests.
fn installed() -> &'static Path {
    static PREFIX: OnceLock<tempfile::TempDir> = OnceLock::new();
    let dir = PREFIX.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        run(Command::new(source("tools/install-plugin")).arg(dir.path()));
        dir
    });
    dir.path()
}

/// A C program compiled against what pkg-config says.
fn compiled(program: &Path, scratch: &Path) -> PathBuf {
    let prefix = installed();
    let flags = run(Command::new("pkg-config")
        .args(["--cflags", "--libs", "linkage"])
        .env("PKG_CONFIG_PATH", prefix.join("lib/pkgconfig")));
    let out = scratch.join("program");
    let strict = ["-std=c11", "-Wall", "-Wextra", "-Werror", "-g", "-O1"];
    run(Command::new("cc")
        .args(strict)
        .arg(program)
        .args(said(&flags).split_whitespace())
        .arg("-lm")
        .arg("-o")
        .arg(&out));
    out
}

fn program(path: &Path) -> Command {
    let mut command = Command::new(path);
    command.env("LD_LIBRARY_PATH", installed().join("lib"));
    command
}

/// The same under valgrind: an invalid access, a decision by what was never written, or memory
/// that is lost ends it with status 99.
fn watched(path: &Path) -> Command {
    let mut command = Command::new("valgrind");
    command
        .args(["--quiet", "--error-exitcode=99", "--leak-check=full"])
        .args(["--errors-for-leak-kinds=definite", "--show-leak-kinds=definite"])
        .arg(path)
        .env("LD_LIBRARY_PATH", installed().join("lib"));
    command
}

/// Frames as the example reads them, each `every`th pixel of each `every`th row.
fn exported(recording: &Path, every: usize, count: usize, out: &Path) -> usize {
    fs::create_dir_all(out).unwrap();
    let mut source = linkage_driver::open(&recording.display().to_string()).unwrap();
    let mut written = 0;
    while let Some(frame) = source.next_frame().unwrap().filter(|_| written < count) {
        export(&frame, every, &out.join(written.to_string()));
        let c = &frame.camera;
        let size = (c.width / every, c.height / every);
        let scale = |x: f64| x / every as f64;
        let camera = format!(
            "{} {} {} {} {} {}",
            size.0,
            size.1,
            scale(c.fx),
            scale(c.fy),
            scale(c.cx),
            scale(c.cy)
        );
        fs::write(out.join("camera.txt"), camera).unwrap();
        written += 1;
    }
    written
}

fn export(frame: &RgbdFrame, every: usize, path: &Path) {
    let (width, height) = (frame.camera.width / every, frame.camera.height / every);
    let millimetres = frame.depth.to_raw(1000.0);
    let mut color = format!("P6 {width} {height} 255\n").into_bytes();
    let mut depth = format!("P5 {width} {height} 65535\n").into_bytes();
    for v in 0..height {
        for u in 0..width {
            color.extend(frame.color.at(u * every, v * every).unwrap());
            depth.extend(millimetres[v * every * frame.camera.width + u * every].to_be_bytes());
        }
    }
    fs::write(path.with_extension("ppm"), color).unwrap();
    fs::write(path.with_extension("pgm"), depth).unwrap();
}

/// The last frame of a recording alone.
fn last_exported(recording: &Path, out: &Path) {
    fs::create_dir_all(out).unwrap();
    let mut source = linkage_driver::open(&recording.display().to_string()).unwrap();
    let mut last = None;
    while let Some(frame) = source.next_frame().unwrap() {
        last = Some(frame);
    }
    let frame = last.unwrap();
    export(&frame, 1, &out.join("0"));
    let c = &frame.camera;
    let camera = format!("{} {} {} {} {} {}", c.width, c.height, c.fx, c.fy, c.cx, c.cy);
    fs::write(out.join("camera.txt"), camera).unwrap();
}

#[test]
fn the_c_example_learns_recognises_and_plans_with_cmake_and_under_valgrind() {
    let dir = tempfile::tempdir().unwrap();
    let build = dir.path().join("build");
    run(Command::new("cmake")
        .arg("-S")
        .arg(source("skill/plugin/example"))
        .arg("-B")
        .arg(&build)
        .env("PKG_CONFIG_PATH", installed().join("lib/pkgconfig")));
    run(Command::new("cmake").arg("--build").arg(&build));
    let example = build.join("example");

    let recording = simulated("drawer", false, 1);
    let (whole, met) = (dir.path().join("demonstration"), dir.path().join("encounter"));
    let frames = exported(&recording, 1, usize::MAX, &whole);
    last_exported(&simulated("drawer", true, 1), &met);
    let store = dir.path().join("objects.linkage");
    let output = run(program(&example)
        .arg(&store)
        .arg("drawer")
        .arg(&whole)
        .arg(frames.to_string())
        .arg(&met));
    let text = said(&output);
    assert!(text.contains("knows 0 objects"), "{text}");
    assert!(
        text.contains("drawer: score 0.") && text.contains("joint1, prismatic, at 0."),
        "{text}"
    );
    assert!(text.contains("joint1 goes from"), "{text}");

    // The program sees the object as well.
    let store_text = store.display().to_string();
    let listed = linkage(&["store", "list", "--store", &store_text]);
    assert_eq!(said(&listed).trim(), "drawer", "{}", failure(&listed).1);

    // Under valgrind a short demonstration, in which nothing moves yet, and the same encounter.
    let small = dir.path().join("small");
    let frames = exported(&recording, 4, 15, &small);
    let output = run(watched(&example)
        .arg(&store)
        .arg("nothing")
        .arg(&small)
        .arg(frames.to_string())
        .arg(&met));
    let again = said(&output);
    assert!(again.contains("not learned: nothing: "), "{again}");
    assert!(again.contains("joint1 goes from"), "{again}");
}

#[test]
fn what_no_caller_should_do_is_refused_and_nothing_crashes() {
    let dir = tempfile::tempdir().unwrap();
    let abuse = compiled(&source("tests/fixtures/abuse.c"), dir.path());
    let output = run(watched(&abuse).arg(dir.path().join("s.linkage")));
    assert_eq!(said(&output).trim(), "all refused");
}
