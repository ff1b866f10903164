//! `linkage doctor`: does this machine have what is needed, and what does a source deliver?

use crate::cli::{DoctorArgs, SourceArgs};
use crate::console::answer;
use crate::outcome::{Failure, Outcome};
use crate::source::{losses, open, repairs};
use anyhow::{Context, bail};
use linkage_driver::plain_text::harmless;
use linkage_driver::{RgbdSource, freenect, openni2, v4l};
use linkage_lcm::{Lcm, Reception};
use linkage_planner_bridge::Rig;
use std::path::Path;
use std::time::{Duration, Instant};

/// How long a source is measured.
const MEASURED_S: f64 = 5.0;
/// The kernel's driver that takes a Kinect for a webcam.
const KINECT_MODULE: &str = "gspca_kinect";
/// A Kinect's frame as a message: raw, and with JPEG and zlib, bytes.
const RAW_FRAME: usize = 640 * 480 * 5;
const PACKED_FRAME: usize = 150_000;

/// What a check found.
enum Finding {
    Fine(String),
    /// Something that only some need.
    Absent(String),
    Broken(String),
}

use Finding::{Absent, Broken, Fine};

impl From<anyhow::Result<String>> for Finding {
    fn from(result: anyhow::Result<String>) -> Self {
        result.map_or_else(|e| Broken(format!("{e:#}")), Fine)
    }
}

pub fn run(args: &DoctorArgs) -> Outcome {
    let rig = Rig::default();
    let url = args.url.as_deref().unwrap_or(&rig.lcm_url);
    let mut checks = vec![
        ("vision library", vision().into()),
        ("processors", processors().into()),
        ("scratch space", scratch().into()),
        ("LCM network", lcm(url).into()),
        ("LCM receive buffer", receive_buffer(url)),
        ("Kinect (libfreenect)", kinect()),
        ("OpenNI2", openni2_devices()),
        ("V4L2", v4l2_devices()),
        ("USB", usb()),
    ];
    if let Some(source) = &args.source {
        checks.push(("source", measure(source, &args.take).into()));
    }
    // What is found may quote a device or a recording.
    let shown = |text: &str| harmless(text, usize::MAX);
    let mut broken = 0;
    for (what, finding) in checks {
        match finding {
            Fine(found) => answer(format!("ok    {what}: {}", shown(&found)))?,
            Absent(hint) => answer(format!("-     {what}: {hint}"))?,
            Broken(problem) => {
                broken += 1;
                answer(format!("FAIL  {what}: {}", shown(&problem)))?;
            }
        }
    }
    if broken > 0 {
        return Err(Failure::no_answer(format!("{broken} of the checks failed")));
    }
    Ok(())
}

fn vision() -> anyhow::Result<String> {
    Ok(format!("OpenCV {}", opencv::core::get_version_string()?))
}

fn processors() -> anyhow::Result<String> {
    Ok(format!("{} cores", std::thread::available_parallelism()?))
}

fn scratch() -> anyhow::Result<String> {
    let dir = tempfile::tempdir()?;
    std::fs::write(dir.path().join("probe"), [0_u8; 4096])?;
    Ok(format!("{} can be written", std::env::temp_dir().display()))
}

fn lcm(url: &str) -> anyhow::Result<String> {
    Lcm::new(url)?.self_test(Duration::from_secs(2)).with_context(routes)?;
    Ok(format!("{url} carries messages"))
}

/// What the routing table says of multicast.
fn routes() -> String {
    let table = std::fs::read_to_string("/proc/net/route").unwrap_or_default();
    // Destination, little-endian hex: 224.0.0.0 is 000000E0, the default route 00000000.
    let has =
        |destination: &str| table.lines().any(|l| l.split_whitespace().nth(1) == Some(destination));
    if has("000000E0") || has("00000000") {
        "there is a route for multicast".to_owned()
    } else {
        "no route for multicast: as root, \"ip route add 224.0.0.0/4 dev lo\"".to_owned()
    }
}

/// Frames over LCM are larger than the kernel's usual buffer: what does a socket really get?
fn receive_buffer(url: &str) -> Finding {
    let listened = Lcm::new(url).and_then(|mut lcm| {
        lcm.subscribe("LINKAGE_DOCTOR")?;
        Ok(lcm.reception())
    });
    match listened {
        Ok(reception) => room_for_frames(&reception),
        Err(e) => Broken(e.to_string()),
    }
}

fn room_for_frames(reception: &Reception) -> Finding {
    let Reception { granted_buffer: granted, requested_buffer: wanted, .. } = *reception;
    if granted == 0 {
        return Absent("this kind of network has none".to_owned());
    }
    let room = format!(
        "room for {} raw frames, or {} of JPEG and zlib",
        granted / RAW_FRAME,
        granted / PACKED_FRAME
    );
    if granted >= wanted {
        return Fine(format!("{granted} bytes granted: {room}"));
    }
    Absent(format!(
        "{granted} of {wanted} bytes granted: {room}; to receive frames over LCM without loss, as root: \"sysctl -w net.core.rmem_max={wanted}\", and the same line in /etc/sysctl.d/ to keep it"
    ))
}

fn kinect() -> Finding {
    let held = std::fs::read_to_string("/proc/modules")
        .is_ok_and(|m| m.lines().any(|l| l.starts_with(KINECT_MODULE)));
    if held {
        return Broken(format!(
            "the kernel's {KINECT_MODULE} holds it: \"sudo modprobe -r {KINECT_MODULE}\", and put \"blacklist {KINECT_MODULE}\" into /etc/modprobe.d/kinect.conf"
        ));
    }
    match freenect::device_count() {
        Ok(0) => Absent(
            "none found; a Kinect needs its own power supply besides USB, and the udev rules of package libfreenect0.5"
                .to_owned(),
        ),
        Ok(count) => Fine(format!("{count} found: freenect:0 is the first")),
        Err(e) => Broken(e),
    }
}

fn openni2_devices() -> Finding {
    match openni2::list_devices() {
        Ok(devices) if devices.is_empty() => Absent(
            "none found; check USB, and the udev rules of package libopenni2-0 (then plug it in again)"
                .to_owned(),
        ),
        Ok(devices) => Fine(named("openni2:", &devices)),
        Err(e) => Broken(e),
    }
}

fn v4l2_devices() -> Finding {
    let devices = v4l::list_devices();
    if devices.is_empty() {
        return Absent("no /dev/video*; load the camera's kernel driver (uvcvideo)".to_owned());
    }
    let refused: Vec<&str> = devices
        .iter()
        .map(|(path, _)| path.as_str())
        .filter(|path| std::fs::File::open(path).is_err())
        .collect();
    if refused.is_empty() {
        Fine(named("v4l:", &devices))
    } else {
        Broken(format!(
            "{} cannot be opened: add yourself to the group video and log in again",
            refused.join(", ")
        ))
    }
}

fn named(kind: &str, devices: &[(String, String)]) -> String {
    devices
        .iter()
        .map(|(name, what)| format!("{kind}{name} ({what})"))
        .collect::<Vec<_>>()
        .join(", ")
}

/// The fastest ports there are: a depth camera wants a USB 2 bus for itself, or USB 3.
fn usb() -> Finding {
    let Ok(entries) = std::fs::read_dir(Path::new("/sys/bus/usb/devices")) else {
        return Absent("no USB on this machine".to_owned());
    };
    let speeds: Vec<u32> = entries
        .flatten()
        .filter(|e| e.file_name().to_string_lossy().starts_with("usb"))
        .filter_map(|e| std::fs::read_to_string(e.path().join("speed")).ok()?.trim().parse().ok())
        .collect();
    match speeds.iter().max() {
        None => Absent("no USB bus; in a virtual machine, pass one through".to_owned()),
        Some(speed) if *speed < 480 => {
            Broken(format!("the fastest bus has {speed} Mbit/s; a depth camera needs 480 (USB 2)"))
        }
        Some(speed) => Fine(format!("{} buses, the fastest with {speed} Mbit/s", speeds.len())),
    }
}

/// Watches a source for five seconds.
fn measure(name: &str, take: &SourceArgs) -> anyhow::Result<String> {
    let mut take = take.clone();
    take.seconds.get_or_insert(MEASURED_S);
    let mut source = open(name, &take).map_err(|f| f.cause)?;
    let start = Instant::now();
    let mut frames = 0;
    let mut first: Option<(usize, usize)> = None;
    while let Some(frame) = source.next_frame()? {
        first.get_or_insert((frame.color.width(), frame.color.height()));
        frames += 1;
    }
    let s = source.statistics();
    let Some((width, height)) = first else {
        bail!(
            "{}",
            [format!("{name}: no frame")]
                .into_iter()
                .chain(losses(&s))
                .collect::<Vec<_>>()
                .join("; ")
        );
    };
    Ok(format!(
        "{name}: {frames} frames of {width}x{height} in {:.1} s, {:.1} a second by their stamps, {:.0} % of depth invalid, colour and depth at most {:.1} ms apart, {}",
        start.elapsed().as_secs_f64(),
        s.rate_hz,
        100.0 * s.invalid_depth,
        s.largest_pair_gap_us as f64 * 1e-3,
        [losses(&s).unwrap_or_else(|| "nothing lost".to_owned())]
            .into_iter()
            .chain(repairs(&s))
            .collect::<Vec<_>>()
            .join("; "),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_buffer_that_was_granted_is_told_in_frames_with_what_to_do() {
        let reception = Reception {
            requested_buffer: 8_388_608,
            granted_buffer: 212_992,
            ..Reception::default()
        };
        let Absent(told) = room_for_frames(&reception) else { panic!("it is too small") };
        assert!(told.contains("212992 of 8388608 bytes"), "{told}");
        assert!(told.contains("room for 0 raw frames, or 1 of JPEG"), "{told}");
        assert!(told.contains("sysctl -w net.core.rmem_max=8388608"), "{told}");
        let enough = Reception { granted_buffer: 8_388_608, ..reception };
        assert!(matches!(room_for_frames(&enough), Fine(told) if told.contains("5 raw frames")));
        assert!(matches!(room_for_frames(&Reception::default()), Absent(_)));
    }
}
