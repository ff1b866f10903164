//! Every driver through its real library, without hardware: what goes in comes out, and a
//! demonstration teaches the same whichever way it comes.

use linkage_driver::depth::Registration;
use linkage_driver::lcm::{Packing, decode_frame, encode_frame};
use linkage_driver::record::{FakenectRecorder, Recorder};
use linkage_driver::{
    ColorImage, DepthImage, PinholeCamera, RgbdFrame, SourceStatistics, kinect, open,
};
use linkage_lcm::udpm::Network;
use linkage_lcm::{LogWriter, encode};
use linkage_skill::store::Store;
use linkage_tests::joint::{Joint, assert_alike, learned_from, run, text};
use linkage_tests::{
    build, failure, fixtures, linkage, program, shared_data, simulated, tiny_recording,
};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

const SCENE: &str = "drawer";
const SEED: u64 = 1;

/// Cameras do not wait: these tests run one after the other.
fn in_turn() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// All frames of a source and what it lost.
fn frames_of(source: &str) -> (Vec<RgbdFrame>, SourceStatistics) {
    let mut source = open(source).unwrap();
    let mut frames = Vec::new();
    while let Some(frame) = source.next_frame().unwrap() {
        frames.push(frame);
    }
    (frames, source.statistics())
}

/// Equal colour, and depth equal to the millimetre except for this many pixels; says how many
/// differ, and how.
fn assert_same_to_the_millimetre(a: &RgbdFrame, b: &RgbdFrame, but_for: usize) {
    assert!(a.color == b.color, "colour differs at {} us", a.utime);
    let (a_raw, b_raw) = (a.depth.to_raw(1000.0), b.depth.to_raw(1000.0));
    let differ: Vec<(&u16, &u16)> = a_raw.iter().zip(&b_raw).filter(|(a, b)| a != b).collect();
    assert!(differ.len() <= but_for, "{} pixels differ, the first: {:?}", differ.len(), differ[0]);
}

fn demonstration() -> PathBuf {
    simulated(SCENE, false, SEED)
}

/// The joint that it teaches.
fn wanted() -> &'static Joint {
    static WANTED: OnceLock<Joint> = OnceLock::new();
    WANTED.get_or_init(|| {
        let scratch = tempfile::tempdir().unwrap();
        learned_from(text(&demonstration()), scratch.path())
    })
}

/// Records eight frames of a source.
fn record_eight(source: &str, out: &str, format: &str) {
    let how = ["--frames", "8", "--format", format, "--quiet"];
    run(&[&["record", "--source", source, "--out", out], &how[..]].concat());
}

#[test]
fn a_tum_recording_comes_back_bit_for_bit() {
    let _turn = in_turn();
    let scratch = tempfile::tempdir().unwrap();
    let copy = scratch.path().join("copy");
    let source = demonstration();
    run(&["record", "--source", text(&source), "--frames", "5", "--out", text(&copy), "--quiet"]);
    let (original, _) = frames_of(text(&source));
    let (copied, _) = frames_of(text(&copy));
    assert_eq!(copied.len(), 5);
    for (a, b) in original.iter().zip(&copied) {
        assert_eq!((a.utime, &a.camera), (b.utime, &b.camera));
        assert!(a.color == b.color, "colour differs");
        assert!(a.depth.to_raw(5000.0) == b.depth.to_raw(5000.0), "depth differs");
    }
}

#[test]
fn an_lcm_log_holds_colour_exactly_and_depth_to_the_millimetre() {
    let _turn = in_turn();
    let scratch = tempfile::tempdir().unwrap();
    let log = scratch.path().join("drawer.log");
    let source = demonstration();
    run(&[
        "record",
        "--source",
        text(&source),
        "--out",
        text(&log),
        "--format",
        "lcm-log",
        "--quiet",
    ]);
    let name = format!("lcmlog:{}", log.display());
    let (original, _) = frames_of(text(&source));
    let (logged, statistics) = frames_of(&name);
    assert_eq!((logged.len(), statistics.lost()), (original.len(), 0));
    for (a, b) in original.iter().zip(&logged) {
        assert_eq!(a.utime, b.utime);
        assert_same_to_the_millimetre(a, b, 0);
    }
    assert_alike(&learned_from(&name, scratch.path()), wanted(), 0.3, 0.003);
}

/// A frame of 64 x 48 pixels as a message, which goes in one datagram.
fn small_frame(utime: i64, camera: &Arc<PinholeCamera>) -> Vec<u8> {
    let color = ColorImage::new(64, 48, vec![90; 64 * 48 * 3]).unwrap();
    let depth = DepthImage::from_metres(64, 48, vec![1.0; 64 * 48]).unwrap();
    let frame = RgbdFrame::new(utime, Arc::clone(camera), color, depth).unwrap();
    encode(&encode_frame(&frame, Packing::LOSSLESS).unwrap()).unwrap()
}

#[test]
fn frames_that_are_lost_on_their_way_are_counted_and_told() {
    let scratch = tempfile::tempdir().unwrap();
    let toml = scratch.path().join("camera.toml");
    let words = "width = 64\nheight = 48\nfx = 60.0\nfy = 60.0\ncx = 31.5\ncy = 23.5\n\
                 depth_units_per_metre = 1000.0\n";
    fs::write(&toml, words).unwrap();
    let camera = Arc::new(PinholeCamera::parse(words).unwrap());
    let url = "udpm://239.255.76.67:7692?ttl=0";
    let live = format!("lcm:{url}#KINECT_FRAME");
    build();
    let mut recorder = Command::new(program())
        .args(["record", "--source", &live, "--camera", text(&toml), "--frames", "10"])
        .args(["--out", text(&scratch.path().join("out")), "--quiet", "--seconds", "60"])
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let sender = Network::parse(url).unwrap().sender().unwrap();
    // Two of three are lost, until it has ten.
    for number in 0.. {
        let utime = 1_000_000 + i64::from(number) * 33_000;
        let sequence: u32 = 3 * number;
        let head = [b"LC02", &sequence.to_be_bytes()[..], b"KINECT_FRAME\0"].concat();
        sender.send(&[head, small_frame(utime, &camera)].concat()).unwrap();
        std::thread::sleep(Duration::from_millis(33));
        if recorder.try_wait().unwrap().is_some() {
            break;
        }
    }
    let output = recorder.wait_with_output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{told}");
    let count = told.split(" sent and not arrived").next().and_then(|t| t.rsplit(' ').next());
    let count: u64 = count.and_then(|n| n.parse().ok()).unwrap_or(0);
    assert!((18..60).contains(&count), "{told}");
}

#[test]
fn a_server_that_is_not_there_is_told() {
    let scratch = tempfile::tempdir().unwrap();
    let out = scratch.path().join("out");
    let dead = "tcpq://127.0.0.1:1";
    let recorded = linkage(&[
        "record",
        "--source",
        &format!("lcm:{dead}"),
        "--seconds",
        "2",
        "--out",
        text(&out),
    ]);
    let source = demonstration();
    let replayed = linkage(&["replay", text(&source), "--publish", dead]);
    let store = scratch.path().join("s.linkage");
    let served =
        linkage(&["serve", "--source", text(&source), "--store", text(&store), "--publish", dead]);
    for output in [recorded, replayed, served] {
        let (status, told) = failure(&output);
        assert_eq!(status, 2, "{told}");
        assert!(told.contains("LCM cannot join") && told.contains(dead), "{told}");
    }
}

#[test]
fn doctor_tells_the_buffer_that_a_socket_gets() {
    let url = "udpm://239.255.76.67:7693?ttl=0&recv_buf_size=100000";
    let output = linkage(&["doctor", "--url", url]);
    let told = String::from_utf8_lossy(&output.stdout);
    assert!(told.contains("LCM receive buffer: 100000 bytes granted"), "{told}");
}

#[test]
fn frames_over_loopback_are_those_that_were_sent() {
    let _turn = in_turn();
    let scratch = tempfile::tempdir().unwrap();
    let received = scratch.path().join("received.log");
    let source = demonstration();
    let (original, _) = frames_of(text(&source));
    let camera = source.join("camera.toml");
    // A port of its own: other tests speak LCM as well.
    let url = "udpm://239.255.76.67:7691?ttl=0";
    let live = format!("lcm:{url}#KINECT_FRAME");
    let count = original.len().to_string();
    let mut recorder = Command::new(program())
        .args(["record", "--source", &live, "--camera", text(&camera), "--frames", &count])
        .args(["--out", text(&received), "--format", "lcm-log", "--quiet"])
        .spawn()
        .unwrap();
    std::thread::sleep(Duration::from_secs(1));
    run(&["replay", text(&source), "--publish", url, "--rate", "0.4", "--jpeg", "--quiet"]);
    // Where a packet was lost the recorder waits for more: an interrupt ends it cleanly.
    std::thread::sleep(Duration::from_secs(1));
    let _ = Command::new("kill").args(["-INT", &recorder.id().to_string()]).status().unwrap();
    assert!(recorder.wait().unwrap().success());
    let name = format!("lcmlog:{}", received.display());
    let (frames, _) = frames_of(&name);
    // UDP may lose some where the kernel's buffer is smaller than a frame; none is altered.
    assert!(frames.len() * 2 >= original.len(), "{} of {count}", frames.len());
    for frame in &frames {
        let sent = original.iter().find(|o| o.utime == frame.utime).unwrap();
        assert!(sent.depth.to_raw(1000.0) == frame.depth.to_raw(1000.0), "depth differs");
    }
    // Colour is JPEG here.
    assert_alike(&learned_from(&name, scratch.path()), wanted(), 0.5, 0.004);
}

#[test]
fn fakenect_plays_a_dump_to_the_kinect_driver_pixel_for_pixel() {
    let _turn = in_turn();
    let scratch = tempfile::tempdir().unwrap();
    let (dump, played) = (scratch.path().join("dump"), scratch.path().join("played"));
    let source = demonstration();
    let (original, _) = frames_of(text(&source));
    let mut recorder = FakenectRecorder::create(&dump).unwrap();
    for frame in &original {
        recorder.write(frame).unwrap();
    }
    recorder.finish().unwrap();
    // Losing nothing takes a queue that is emptied in time: raw pictures are written fast.
    let output = Command::new(program())
        .args(["record", "--source", "freenect:0", "--out", text(&played)])
        .args(["--format", "fakenect", "--quiet"])
        .envs(fixtures::fakenect(&dump))
        .stderr(Stdio::piped())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let pictures = |dir: &Path| -> Vec<Vec<u8>> {
        let index = fs::read_to_string(dir.join("INDEX.txt")).unwrap();
        index.lines().map(|name| fs::read(dir.join(name)).unwrap()).collect()
    };
    let (written, read) = (pictures(&dump), pictures(&played));
    assert_eq!(written.len(), read.len());
    assert!(written == read, "pictures differ");
}

#[test]
fn an_oni_file_recorded_by_the_library_is_read_as_it_was_written() {
    let _turn = in_turn();
    let scratch = tempfile::tempdir().unwrap();
    let source = demonstration();
    let (original, _) = frames_of(text(&source));
    let Some(openni) = fixtures::OpenNi::with_frames(scratch.path(), &original) else { return };
    let oni = scratch.path().join("drawer.oni");
    openni.record(&oni, original.len());
    let name = format!("oni:{}", oni.display());
    let (frames, statistics) = frames_of(&name);
    assert_eq!((frames.len(), statistics.lost()), (original.len(), 0));
    for (a, b) in original.iter().zip(&frames) {
        // OpenNI2's own codec alters a few of 307 200 by a step of the disparity.
        assert_same_to_the_millimetre(a, b, 30);
    }
    let camera = source.join("camera.toml");
    let copy = scratch.path().join("copy.log");
    run(&[
        "record",
        "--source",
        &name,
        "--camera",
        text(&camera),
        "--out",
        text(&copy),
        "--format",
        "lcm-log",
        "--quiet",
    ]);
    let copied = format!("lcmlog:{}", copy.display());
    assert_alike(&learned_from(&copied, scratch.path()), wanted(), 0.3, 0.003);
}

/// Closing one at its end used to crash the library's player, about once in 25 times.
#[test]
fn an_oni_file_is_played_to_its_end_and_closed_sixty_times() {
    let _turn = in_turn();
    let scratch = tempfile::tempdir().unwrap();
    let (original, _) = frames_of(text(&demonstration()));
    let Some(openni) = fixtures::OpenNi::with_frames(scratch.path(), &original[..10]) else {
        return;
    };
    let oni = scratch.path().join("short.oni");
    openni.record(&oni, 10);
    for _ in 0..60 {
        let (frames, _) = frames_of(&format!("oni:{}", oni.display()));
        assert_eq!(frames.len(), 10);
    }
}

#[test]
fn an_oni_file_that_is_cut_short_is_refused_by_name() {
    let _turn = in_turn();
    let scratch = tempfile::tempdir().unwrap();
    let (original, _) = frames_of(text(&demonstration()));
    let Some(openni) = fixtures::OpenNi::with_frames(scratch.path(), &original[..10]) else {
        return;
    };
    let oni = scratch.path().join("cut.oni");
    openni.record(&oni, 10);
    let bytes = fs::read(&oni).unwrap();
    let learn_from = |kept: usize| {
        fs::write(&oni, &bytes[..kept]).unwrap();
        let source = format!("oni:{}", oni.display());
        let output = linkage(&["learn", &source, "--object", "x", "--quiet"]);
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (status, message) = learn_from(5000);
    assert_eq!(status, Some(2), "{message}");
    assert!(message.contains("cut.oni") && message.contains("cut short"), "{message}");
    // With most of its frames the library may play what is whole.
    let (status, message) = learn_from(bytes.len() / 2);
    assert!(matches!(status, Some(1 | 2)) && message.contains("cut.oni"), "{status:?} {message}");
}

#[test]
fn a_mirrored_oni_file_is_turned_back() {
    let _turn = in_turn();
    let scratch = tempfile::tempdir().unwrap();
    let (original, _) = frames_of(text(&demonstration()));
    let Some(openni) = fixtures::OpenNi::with_frames(scratch.path(), &original[..10]) else {
        return;
    };
    let openni = openni.with("LINKAGE_MIRRORS");
    let oni = scratch.path().join("mirrored.oni");
    openni.record(&oni, 10);
    let (frames, _) = frames_of(&format!("oni:{}", oni.display()));
    assert_eq!(frames.len(), 10);
    for (a, b) in original.iter().zip(&frames) {
        assert_same_to_the_millimetre(a, b, 30);
    }
}

/// The colour of a picture's left and right end, and its depth there in millimetres.
fn ends(frame: &RgbdFrame) -> [([u8; 3], Option<i32>); 2] {
    let v = frame.color.height() / 2;
    [4, frame.color.width() - 5].map(|u| {
        let depth = frame.depth.at(u, v).map(|z| (1000.0 * z).round() as i32);
        (frame.color.at(u, v).unwrap(), depth)
    })
}

#[test]
fn mirrored_and_plain_recordings_of_one_scene_are_the_same() {
    let _turn = in_turn();
    let Some(case) = shared_data("cases/15-oni-mirrored") else { return };
    let expected = [([255, 0, 0], Some(1000)), ([0, 0, 255], Some(2000))];
    for name in ["plain", "mirrored"] {
        let (frames, _) = frames_of(&format!("oni:{}/{name}.oni", case.display()));
        assert!(!frames.is_empty());
        assert!(frames.iter().all(|f| ends(f) == expected), "{name}: {:?}", ends(&frames[0]));
    }
}

/// Records 30 frames of a live OpenNI2 device; the frames, and what the program says.
fn recorded_from_openni2(openni: &fixtures::OpenNi, scratch: &Path) -> (Vec<RgbdFrame>, String) {
    let log = scratch.join("live.log");
    let output = openni
        .command(&program())
        .args(["record", "--source", "openni2:", "--frames", "30", "--out", text(&log)])
        .args(["--format", "lcm-log", "--quiet"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    let (frames, _) = frames_of(&format!("lcmlog:{}", log.display()));
    assert_eq!(frames.len(), 30);
    (frames, said)
}

#[test]
fn a_live_device_that_mirrors_whatever_it_is_asked_is_turned_back() {
    let _turn = in_turn();
    let scratch = tempfile::tempdir().unwrap();
    let (original, _) = frames_of(text(&demonstration()));
    let Some(openni) = fixtures::OpenNi::with_frames(scratch.path(), &original[..40]) else {
        return;
    };
    let openni = openni.with("LINKAGE_MIRRORS");
    let (frames, said) = recorded_from_openni2(&openni, scratch.path());
    assert!(said.contains("mirrored"), "{said}");
    for frame in &frames {
        let played = original.iter().find(|o| o.color == frame.color).expect("it was played");
        assert_same_to_the_millimetre(played, frame, 0);
    }
}

#[test]
fn depth_that_a_live_device_does_not_register_is_registered() {
    let _turn = in_turn();
    let scratch = tempfile::tempdir().unwrap();
    let (original, _) = frames_of(text(&demonstration()));
    let Some(openni) = fixtures::OpenNi::with_frames(scratch.path(), &original[..40]) else {
        return;
    };
    let openni = openni.with("LINKAGE_UNREGISTERED");
    let (frames, said) = recorded_from_openni2(&openni, scratch.path());
    assert!(said.contains("does not register depth"), "{said}");
    let focal = |pixels: f64, angle: f32| pixels / (2.0 * (f64::from(angle) / 2.0).tan());
    let camera = |horizontal, vertical| PinholeCamera {
        fx: focal(640.0, horizontal),
        fy: focal(480.0, vertical),
        ..PinholeCamera::kinect()
    };
    let registration =
        Registration { depth_camera: camera(1.0145, 0.7898), ..kinect::registration() };
    for frame in frames.iter().step_by(10) {
        let played = original.iter().find(|o| o.color == frame.color).expect("it was played");
        let expected = registration.register(&played.depth, &camera(1.0947, 0.8579));
        let expected = RgbdFrame { depth: expected, ..played.clone() };
        // The device tells whole millimetres: a few pixels are rounded to the place beside.
        assert_same_to_the_millimetre(&expected, frame, 600);
    }
}

#[test]
fn a_live_openni2_device_is_recorded() {
    let _turn = in_turn();
    let scratch = tempfile::tempdir().unwrap();
    let (original, _) = frames_of(text(&demonstration()));
    let Some(openni) = fixtures::OpenNi::with_frames(scratch.path(), &original[..40]) else {
        return;
    };
    let (frames, _) = recorded_from_openni2(&openni, scratch.path());
    for frame in &frames {
        assert!(original.iter().any(|o| o.color == frame.color), "a picture that nobody played");
    }
}

/// This many frames of the two V4L2 devices, which play `original`.
fn recorded_from_v4l2(
    original: &[RgbdFrame],
    count: usize,
    settings: &[(&str, &str)],
) -> Vec<RgbdFrame> {
    let scratch = tempfile::tempdir().unwrap();
    let log = scratch.path().join("v4l.log");
    let output = Command::new(program())
        .args(["record", "--source", fixtures::V4L2_DEVICES, "--frames", &count.to_string()])
        .args(["--out", text(&log), "--format", "lcm-log", "--quiet"])
        .envs(fixtures::v4l2_devices(scratch.path(), original))
        .envs(settings.iter().copied())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    frames_of(&format!("lcmlog:{}", log.display())).0
}

#[test]
fn two_v4l2_devices_make_one_camera() {
    let _turn = in_turn();
    let (original, _) = frames_of(text(&demonstration()));
    let original = &original[..20];
    let frames = recorded_from_v4l2(original, original.len(), &[]);
    assert_eq!(frames.len(), original.len());
    for (a, b) in original.iter().zip(&frames) {
        assert!(a.depth.to_raw(1000.0) == b.depth.to_raw(1000.0), "depth differs");
        let grey = |rgb: &[u8]| rgb.iter().map(|c| i32::from(*c)).sum::<i32>() / 3;
        let colours = a.color.as_rgb().chunks_exact(3).zip(b.color.as_rgb().chunks_exact(3));
        let worst = colours.map(|(a, b)| (grey(a) - grey(b)).abs()).max().unwrap();
        assert!(worst <= 2, "grey differs by {worst}");
    }
}

#[test]
fn v4l2_depth_whose_units_cannot_be_millimetres_is_refused() {
    let _turn = in_turn();
    let scratch = tempfile::tempdir().unwrap();
    let (mut frames, _) = frames_of(text(&demonstration()));
    frames.truncate(10);
    for frame in &mut frames {
        // A device with steps of 5 mm: a fifth of the number of millimetres.
        let metres = frame.depth.as_metres().iter().map(|z| z / 5.0).collect();
        frame.depth = DepthImage::from_metres(640, 480, metres).unwrap();
    }
    let log = scratch.path().join("v4l.log");
    let output = Command::new(program())
        .args(["record", "--source", fixtures::V4L2_DEVICES, "--out", text(&log)])
        .args(["--format", "lcm-log", "--quiet"])
        .envs(fixtures::v4l2_devices(scratch.path(), &frames))
        .output()
        .unwrap();
    let (status, said) = failure(&output);
    assert_eq!(status, 2, "{said}");
    assert!(said.contains("1000 units") && said.contains("depth_units_per_metre"), "{said}");
}

#[test]
fn a_v4l2_device_may_pad_its_lines() {
    let _turn = in_turn();
    let (original, _) = frames_of(text(&demonstration()));
    let original = &original[..10];
    let frames = recorded_from_v4l2(original, original.len(), &[("LINKAGE_COLOUR", "RGB3")]);
    assert_eq!(frames.len(), original.len());
    for (a, b) in original.iter().zip(&frames) {
        assert_same_to_the_millimetre(a, b, 0);
    }
}

#[test]
fn a_v4l2_device_may_send_motion_jpeg() {
    let _turn = in_turn();
    let (original, _) = frames_of(text(&demonstration()));
    let scratch = tempfile::tempdir().unwrap();
    let (mut pictures, mut expected) = (Vec::new(), Vec::new());
    for frame in &original[..10] {
        let message = encode_frame(frame, Packing::SMALL).unwrap();
        pictures.extend((message.image.image_data.len() as u32).to_le_bytes());
        pictures.extend(&message.image.image_data);
        expected.push(decode_frame(&encode(&message).unwrap(), &frame.camera).unwrap());
    }
    let path = scratch.path().join("pictures.bin");
    fs::write(&path, pictures).unwrap();
    let settings = [("LINKAGE_COLOUR", "MJPG"), ("LINKAGE_JPEGS", text(&path))];
    let frames = recorded_from_v4l2(&original[..10], expected.len(), &settings);
    assert_eq!(frames.len(), expected.len());
    for (a, b) in expected.iter().zip(&frames) {
        assert_same_to_the_millimetre(a, b, 0);
    }
}

#[test]
fn v4l2_devices_that_vanish_are_opened_again() {
    let _turn = in_turn();
    let (original, _) = frames_of(text(&demonstration()));
    // Pictures that waited in the devices when they went are lost with them.
    let frames = recorded_from_v4l2(&original[..40], 20, &[("LINKAGE_UNPLUG_AFTER", "7")]);
    assert_eq!(frames.len(), 20);
    assert!(frames.is_sorted_by(|a, b| a.utime < b.utime));
}

#[test]
fn a_recording_that_is_cut_short_gives_what_is_whole() {
    let _turn = in_turn();
    let scratch = tempfile::tempdir().unwrap();
    let log = scratch.path().join("cut.log");
    let source = demonstration();
    record_eight(text(&source), text(&log), "lcm-log");
    let bytes = fs::read(&log).unwrap();
    fs::write(&log, &bytes[..bytes.len() - 1000]).unwrap();
    assert_eq!(frames_of(&format!("lcmlog:{}", log.display())).0.len(), 7);
}

#[test]
fn a_full_disk_ends_a_recording_that_stays_readable() {
    let _turn = in_turn();
    let scratch = tempfile::tempdir().unwrap();
    let source = demonstration();
    // A limit on the size of files stands for the disk's end: 6000 blocks of 512 bytes.
    let log = scratch.path().join("full.log");
    let command = format!(
        "trap '' XFSZ; ulimit -f 6000; exec {} record --source {} --out {} --format lcm-log --quiet",
        program().display(),
        source.display(),
        log.display()
    );
    let output = Command::new("sh").args(["-c", &command]).output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(message.contains("full.log"), "{message}");
    let (frames, _) = frames_of(&format!("lcmlog:{}", log.display()));
    assert!(!frames.is_empty() && frames.len() < 20, "{}", frames.len());
}

#[test]
fn damaged_messages_in_a_log_are_passed_over_and_counted() {
    let _turn = in_turn();
    let scratch = tempfile::tempdir().unwrap();
    let log = scratch.path().join("damaged.log");
    let source = demonstration();
    record_eight(text(&source), text(&log), "lcm-log");
    let mut bytes = fs::read(&log).unwrap();
    // The depth of the third frame: near the end of the third event.
    let event = bytes.len() / 8;
    for byte in &mut bytes[3 * event - 20_000..3 * event - 19_000] {
        *byte ^= 0x5a;
    }
    fs::write(&log, &bytes).unwrap();
    let (frames, statistics) = frames_of(&format!("lcmlog:{}", log.display()));
    assert_eq!((frames.len(), statistics.damaged, statistics.lost()), (7, 1, 1));
}

#[test]
fn a_dump_that_is_cut_short_plays_what_is_whole() {
    let _turn = in_turn();
    let scratch = tempfile::tempdir().unwrap();
    let (dump, log) = (scratch.path().join("dump"), scratch.path().join("cut.log"));
    let source = demonstration();
    record_eight(text(&source), text(&dump), "fakenect");
    let index = fs::read_to_string(dump.join("INDEX.txt")).unwrap();
    let kept: Vec<&str> = index.lines().take(11).collect();
    fs::write(dump.join("INDEX.txt"), kept.join("\n") + "\n").unwrap();
    let output = Command::new(program())
        .args(["record", "--source", "freenect:0", "--out", text(&log), "--format", "lcm-log"])
        .envs(fixtures::fakenect(&dump))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(frames_of(&format!("lcmlog:{}", log.display())).0.len(), 5);
}

/// A log of the tiny recording's frames, each at a time of its own and received at another.
fn log_of(scratch: &Path, stamps: &[i64], received: impl Fn(usize) -> i64) -> String {
    let recording = scratch.join("tiny");
    tiny_recording(&recording);
    let (frames, _) = frames_of(text(&recording));
    let path = scratch.join("stamps.lcmlog");
    let mut log = LogWriter::create(&path).unwrap();
    for (i, &stamp) in stamps.iter().enumerate() {
        let frame = RgbdFrame { utime: stamp, ..frames[i % frames.len()].clone() };
        let message = encode(&encode_frame(&frame, Packing::LOSSLESS).unwrap()).unwrap();
        log.write(received(i), "KINECT_FRAME", &message).unwrap();
    }
    log.flush().unwrap();
    fs::copy(recording.join("camera.toml"), scratch.join("camera.toml")).unwrap();
    format!("lcmlog:{}", path.display())
}

#[test]
fn stamps_that_cannot_be_cost_no_frame_of_a_log() {
    let scratch = tempfile::tempdir().unwrap();
    let clock = |start: i64, count: i64| (0..count).map(|i| start + 33_333 * i).collect::<Vec<_>>();
    let received = |i: usize| 1_700_000_000_000_000 + 33_333 * i as i64;
    let far_ahead = [clock(1_000_000, 10), vec![1_000_000_000_000_000_000], clock(1_400_000, 10)];
    let again = [clock(5_000_000, 20), clock(5, 20)];
    for (stamps, expected) in [
        (far_ahead.concat(), 21),
        (again.concat(), 40),
        (vec![0; 25], 25),
        ([clock(1_000_000, 5), vec![0; 5], clock(1_333_330, 5)].concat(), 15),
        ([vec![i64::MAX, i64::MIN, -5], clock(1_000_000, 20)].concat(), 23),
    ] {
        let (frames, statistics) = frames_of(&log_of(scratch.path(), &stamps, received));
        assert_eq!((frames.len(), statistics.lost()), (expected, 0), "{stamps:?}");
        assert!(frames.is_sorted_by(|a, b| a.utime < b.utime), "{stamps:?}");
    }
    // A frame without a stamp counts from when it was received.
    let (frames, _) = frames_of(&log_of(scratch.path(), &[0; 3], received));
    let times: Vec<i64> = frames.iter().map(|f| f.utime).collect();
    assert_eq!(times, [0, 1, 2].map(received));
}

/// Records a log, and counts the frames of what was recorded.
fn recorded_from_log(log: &Path) -> usize {
    let scratch = tempfile::tempdir().unwrap();
    let copy = scratch.path().join("copy");
    let source = format!("lcmlog:{}", log.display());
    run(&["record", "--source", &source, "--out", text(&copy), "--quiet"]);
    frames_of(text(&copy)).0.len()
}

#[test]
fn a_log_goes_on_after_a_wrong_length_and_after_a_cut() {
    let Some(case) = shared_data("cases/09-log-length-word") else { return };
    for (name, expected) in [("whole", 40), ("one-bit", 39), ("cut-then-appended", 39)] {
        assert_eq!(recorded_from_log(&case.join(format!("{name}.lcmlog"))), expected, "{name}");
    }
}

#[test]
fn a_log_of_two_recordings_gives_the_frames_of_both() {
    let Some(case) = shared_data("cases/11-log-begins-again") else { return };
    assert_eq!(recorded_from_log(&case.join("two-in-one.lcmlog")), 40);
}

/// A network that nobody sends on.
const SILENT: &str = "lcm:udpm://239.255.76.67:7696?ttl=0";

#[test]
fn a_command_on_a_silent_network_ends_by_the_clock() {
    let _turn = in_turn();
    let scratch = tempfile::tempdir().unwrap();
    let out = scratch.path().join("out");
    let store = scratch.path().join("objects.linkage");
    Store::open_or_create(&store).unwrap();
    for command in [
        &["record", "--source", SILENT, "--out", text(&out)][..],
        &["learn", SILENT, "--object", "door"],
        &["recognise", SILENT, "--store", text(&store)],
        &["replay", SILENT, "--publish", "udpm://239.255.76.67:7697?ttl=0"],
    ] {
        let start = Instant::now();
        let output = linkage(&[command, &["--seconds", "2", "--quiet"]].concat());
        let (status, said) = failure(&output);
        assert!(start.elapsed() < Duration::from_secs(30), "{command:?}: {:?}", start.elapsed());
        assert!(status == 1 && said.contains("frame"), "{command:?}: {status} {said}");
    }
    let output = linkage(&["doctor", "--source", SILENT]);
    let found = String::from_utf8_lossy(&output.stdout);
    let line = found.lines().find(|l| l.starts_with("FAIL  source")).unwrap_or_default();
    assert!(line.contains("no frame"), "{found}");
    assert_eq!(output.status.code(), Some(1));
}

#[test]
fn whoever_waits_for_a_silent_network_is_told_so() {
    let _turn = in_turn();
    let scratch = tempfile::tempdir().unwrap();
    let out = scratch.path().join("out");
    let output = linkage(&["record", "--source", SILENT, "--out", text(&out), "--seconds", "7"]);
    let said = failure(&output).1;
    assert!(said.contains("no frame for 5 s"), "{said}");
}
