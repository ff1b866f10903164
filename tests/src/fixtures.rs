//! Simulated devices: what replaces hardware in front of the real libraries.

use linkage_driver::RgbdFrame;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The library that stands for libfreenect and plays dumps.
const FAKENECT: &str = "/usr/lib/x86_64-linux-gnu/fakenect/libfreenect.so";
/// Where Debian keeps OpenNI2.
const OPENNI2: &str = "/usr/lib/x86_64-linux-gnu";

/// Settings under which libfreenect plays a dump once.
pub fn fakenect(dump: &Path) -> [(&'static str, PathBuf); 3] {
    [
        ("LD_PRELOAD", FAKENECT.into()),
        ("FAKENECT_PATH", dump.to_owned()),
        ("FAKENECT_LOOP", "0".into()),
    ]
}

/// A copy of OpenNI2 that finds one device: it plays frames.
pub struct OpenNi {
    /// The library with its drivers.
    root: PathBuf,
    frames: PathBuf,
    /// What the device is told of itself; openni2_device.cpp lists it.
    settings: Vec<&'static str>,
}

impl OpenNi {
    /// Builds the device's driver and writes its frames; `None`, with a message, where OpenNI2 is
    /// not installed.
    pub fn with_frames(scratch: &Path, frames: &[RgbdFrame]) -> Option<Self> {
        let library = Path::new(OPENNI2).join("libOpenNI2.so.0");
        if !library.exists() {
            eprintln!("ignored: no OpenNI2; run tools/setup");
            return None;
        }
        let root = scratch.join("openni2");
        let drivers = root.join("OpenNI2/Drivers");
        fs::create_dir_all(&drivers).expect("a scratch folder can be made");
        fs::copy(&library, root.join("libOpenNI2.so.0")).expect("the library can be copied");
        let file_driver = Path::new(OPENNI2).join("OpenNI2/Drivers/libOniFile.so.0");
        fs::copy(file_driver, drivers.join("libOniFile.so.0")).expect("its driver can be copied");
        compile("openni2_device.cpp", &drivers.join("libFrames.so.0"), &["-shared", "-fPIC"], &[]);
        let path = scratch.join("frames.bin");
        fs::write(&path, packed(frames)).expect("frames can be written");
        Some(Self { root, frames: path, settings: Vec::new() })
    }

    /// The same device with another setting.
    pub fn with(mut self, setting: &'static str) -> Self {
        self.settings.push(setting);
        self
    }

    /// A program that sees the device.
    pub fn command(&self, program: &Path) -> Command {
        let mut command = Command::new(program);
        command.env("LD_LIBRARY_PATH", &self.root).env("LINKAGE_FRAMES", &self.frames);
        command.envs(self.settings.iter().map(|setting| (setting, "1")));
        command
    }

    /// Records the device through the library itself.
    pub fn record(&self, oni: &Path, frames: usize) {
        let recorder = self.root.join("oni_recorder");
        compile("oni_recorder.cpp", &recorder, &[], &["-lOpenNI2"]);
        let output = self.command(&recorder).arg(oni).arg(frames.to_string()).output();
        let output = output.expect("the recorder starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
}

/// The library that stands for two V4L2 devices, [`V4L2_DEVICES`], which play frames.
pub fn v4l2_devices(scratch: &Path, frames: &[RgbdFrame]) -> [(&'static str, PathBuf); 2] {
    let library = scratch.join("v4l2_devices.so");
    compile("v4l2_devices.c", &library, &["-shared", "-fPIC", "-x", "c"], &["-ldl"]);
    let path = scratch.join("frames.bin");
    fs::write(&path, packed(frames)).expect("frames can be written");
    [("LD_PRELOAD", library), ("LINKAGE_FRAMES", path)]
}

/// Source name of the two devices.
pub const V4L2_DEVICES: &str = "v4l:/dev/linkage-colour,/dev/linkage-depth";

fn compile(source: &str, out: &Path, flags: &[&str], libraries: &[&str]) {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(source);
    let status = Command::new("c++")
        .args(["-O1", "-w", "-I/usr/include/openni2"])
        .args(flags)
        .arg("-o")
        .arg(out)
        .arg(&source)
        .args(libraries)
        .status()
        .expect("a C++ compiler, which tools/setup installs");
    assert!(status.success(), "{} must compile", source.display());
}

/// The layout that `openni2_device.cpp` reads.
fn packed(frames: &[RgbdFrame]) -> Vec<u8> {
    let first = &frames[0].color;
    let mut bytes = Vec::new();
    for number in [first.width(), first.height(), frames.len()] {
        bytes.extend((number as i32).to_le_bytes());
    }
    for frame in frames {
        bytes.extend((frame.utime as u64).to_le_bytes());
        bytes.extend(frame.color.as_rgb());
        bytes.extend(frame.depth.to_raw(1000.0).iter().flat_map(|mm| mm.to_le_bytes()));
    }
    bytes
}
