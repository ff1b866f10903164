//! The motion of a live service, over LCM: when its camera dies, when it is cancelled, when it is
//! given another target, and when it is told to end. Setpoints never jump and always come to rest.

use linkage_lcm::decode;
use linkage_lcm::messages::linkage::{Setpoint, Status};
use linkage_tests::service::{Listener, Service};
use linkage_tests::{learned, linkage, simulated};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// A rig that is slow enough for a motion to be met half-way. Metres, seconds.
const RIG: &str = "[prismatic]\nvelocity = 0.02\nacceleration = 0.5\njerk = 2.0\n";
const VELOCITY: f64 = 0.02;
const ACCELERATION: f64 = 0.5;
const JERK: f64 = 2.0;
/// Longest pause that the default rig catches up with, seconds.
const LONGEST_GAP: f64 = 0.05;
/// How well a solver meets its target.
const ROUNDING: f64 = 2e-6;
/// The host's clock is read so long after the monotonic one, where the machine is busy, seconds.
const JITTER: f64 = 1e-3;

/// One service runs at a time: another one that recognises takes both cores for so long that a motion may be braked for
/// want of frames, which was seen in one of five runs.
static ALONE: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A network a test.
fn network(port: u16) -> String {
    format!("udpm://239.255.76.67:{port}?ttl=0")
}

fn text(path: &Path) -> String {
    path.display().to_string()
}

/// A service that knows the drawer and is slow, before a camera.
fn serving(url: &str, dir: &Path, source: &str, options: &[&str]) -> Service {
    let store = learned("drawer", dir);
    let rig = dir.join("slow.toml");
    std::fs::write(&rig, RIG).unwrap();
    let common = ["--stream-hz", "200", "--rig", &text(&rig)];
    Service::start(url, source, &store, &[&common[..], options].concat())
}

/// Setpoints up to the last, each held against the one before.
fn setpoints(listener: &mut Listener) -> Vec<Setpoint> {
    let mut all: Vec<Setpoint> = Vec::new();
    let timeout = Duration::from_secs(10);
    while all.last().is_none_or(|s| !s.last) {
        // The last one of the motion before is sent several times.
        let is_first = all.is_empty();
        let next =
            listener.wait::<Setpoint>("LINKAGE_SETPOINT", timeout, |s| !(is_first && s.last));
        if let Some(before) = all.last() {
            assert!(next.sequence > before.sequence);
            goes_on(before, &next);
        }
        all.push(next);
    }
    let last = &all[all.len() - 1];
    assert_eq!((last.velocity.as_slice(), last.acceleration.as_slice()), (&[0.0][..], &[0.0][..]));
    all
}

/// Position, velocity and acceleration go on, within the limits.
fn goes_on(before: &Setpoint, next: &Setpoint) {
    let gap = (next.utime - before.utime) as f64 * 1e-6;
    // After a longer pause the motion goes on from where it was.
    let t = if gap > LONGEST_GAP { 0.0 } else { gap };
    let (p, v, a) = (before.position[0], before.velocity[0], before.acceleration[0]);
    let off = [
        (next.position[0] - (p + t * (v + t * a / 2.0))).abs()
            - (JERK * t.powi(3) / 6.0 + JITTER * VELOCITY),
        (next.velocity[0] - (v + t * a)).abs() - (JERK * t.powi(2) / 2.0 + JITTER * ACCELERATION),
        (next.acceleration[0] - a).abs() - JERK * (t + JITTER),
        next.velocity[0].abs() - VELOCITY,
        next.acceleration[0].abs() - ACCELERATION,
    ];
    assert!(off.iter().all(|o| *o <= ROUNDING), "{off:?}\n{before:?}\n{next:?}");
}

#[test]
fn a_motion_that_is_cancelled_or_given_another_target_never_jumps() {
    let _alone = alone();
    let url = network(7741);
    let dir = tempfile::tempdir().unwrap();
    let source = text(&simulated("drawer", true, 1));
    let service = serving(&url, dir.path(), &source, &["--repeat", "--rate", "0.5"]);
    let mut listener = Listener::new(&url, "LINKAGE_SETPOINT");
    let moved = |answer: String| assert!(answer.contains("which are streamed"), "{answer}");

    moved(service.done(&["predict", "drawer", "--to", "closed"]));
    moved(service.done(&["predict", "drawer", "--to", "open"]));
    let all = setpoints(&mut listener);
    let last = &all[all.len() - 1];
    assert_eq!(last.reason, "", "it is one motion");
    assert!(last.position[0] > all[0].position[0], "it turned around");
    let least = all.iter().map(|s| s.velocity[0]).fold(0.0, f64::min);
    assert!(least < -0.01, "it had begun to close: {least} m/s");

    moved(service.done(&["predict", "drawer", "--to", "closed"]));
    service.done(&["cancel"]);
    let all = setpoints(&mut listener);
    assert_eq!(all[all.len() - 1].reason, "cancelled");
    let braked = all.iter().filter(|s| s.reason == "cancelled").count();
    assert!(braked > 5, "it stops dead: {braked} setpoints");

    moved(service.done(&["predict", "drawer", "--to", "closed"]));
    assert!(service.terminate().0.success());
    let all = setpoints(&mut listener);
    assert_eq!(all[all.len() - 1].reason, "the service ends");
}

#[test]
fn a_motion_is_braked_when_the_camera_dies_and_the_status_says_so() {
    let _alone = alone();
    let url = network(7742);
    let dir = tempfile::tempdir().unwrap();
    let encounter = simulated("drawer", true, 1);
    let camera = text(&encounter.join("camera.toml"));
    let source = format!("lcm:{url}#KINECT_FRAME");
    let service = serving(&url, dir.path(), &source, &["--camera", &camera]);
    let mut listener = Listener::new(&url, "LINKAGE_SETPOINT|LINKAGE_STATUS");
    // The camera is there until the motion has begun.
    let encounter = text(&encounter);
    let replay = ["replay", &encounter, "--publish", &url, "--rate", "0.5", "--jpeg", "--quiet"];
    std::thread::scope(|scope| {
        scope.spawn(|| linkage(&replay));
        service.done(&["predict", "drawer", "--to", "closed"]);
    });
    let packets = listener.gather(Duration::from_secs(3));
    let of = |channel: &'static str| packets.iter().filter(move |p| p.channel == channel);
    let all: Vec<Setpoint> =
        of("LINKAGE_SETPOINT").map(|p| decode(&p.bytes).expect("a setpoint")).collect();
    all.windows(2).for_each(|pair| goes_on(&pair[0], &pair[1]));
    let last = all.last().expect("it was streamed");
    assert_eq!((last.last, last.reason.as_str()), (true, "no new frame"));
    assert_eq!(last.velocity[0], 0.0);
    let said = of("LINKAGE_STATUS").filter_map(|p| decode::<Status>(&p.bytes).ok());
    let errors: Vec<String> = said.map(|s| s.last_error).collect();
    assert!(errors.iter().any(|e| e.contains("no new frame")), "{errors:?}");
}
