//! The whole pipeline on simulated recordings: learn, recognise, predict, publish. The messages are
//! decoded by an independent subscriber, and recorded by LCM's own logger.

use linkage_skill::SkillConfig;
use linkage_skill::config::RecogniseConfig;
use linkage_skill::internals::{distance_to_line, line_angle};
use linkage_skill::recognise::{Follower, Recognition, Scene};
use linkage_skill::store::{Library, Store};
use linkage_tests::{failure, linkage, program, python_with_lcm, shared_data, simulated};
use nalgebra::{Point3, Vector3};
use serde_json::Value;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::time::Duration;

const URL: &str = "udpm://239.255.76.67:7693?ttl=0";

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn vector(value: &Value) -> Vector3<f64> {
    Vector3::from_iterator(value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()))
}

fn text(path: &Path) -> String {
    path.display().to_string()
}

/// A drawer learned into a store, once for all tests.
fn learned() -> &'static (tempfile::TempDir, PathBuf) {
    static LEARNED: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    LEARNED.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let recording = simulated("drawer", false, 1);
        let output = linkage(&[
            "learn",
            &text(&recording),
            "--object",
            "drawer",
            "--store",
            &text(&dir.path().join("objects.linkage")),
            "--json",
            &text(&dir.path().join("model.json")),
            "--poses",
            &text(&dir.path().join("poses.csv")),
            "--report",
            &text(&dir.path().join("report.html")),
            "--quiet",
        ]);
        assert!(output.status.success(), "{}", failure(&output).1);
        (dir, recording)
    })
}

#[test]
fn a_drawer_is_learned_with_its_axis_and_range() {
    let (dir, recording) = learned();
    let model = json(&dir.path().join("model.json"));
    let truth = json(&recording.join("truth.json"));
    assert_eq!(model["schema"], "linkage.model/1");
    assert_eq!(model["joints"].as_array().unwrap().len(), 1);
    let (joint, expected) = (&model["joints"][0], &truth["joints"][0]);
    assert_eq!(joint["type"], "prismatic");
    assert!(line_angle(&vector(&joint["axis"]), &vector(&expected["axis"])).to_degrees() < 2.0);
    let range = joint["range"][1].as_f64().unwrap() - joint["range"][0].as_f64().unwrap();
    assert!((range - 0.30).abs() < 0.03, "range {range}");
    let poses = std::fs::read_to_string(dir.path().join("poses.csv")).unwrap();
    assert!(poses.starts_with("t,part,x,y,z,qx,qy,qz,qw\n") && poses.lines().count() > 200);
    let page = std::fs::read_to_string(dir.path().join("report.html")).unwrap();
    assert!(page.contains("data:image/jpeg;base64,") && page.contains("<svg"));
}

#[test]
fn learning_twice_gives_the_same_model() {
    let (dir, recording) = learned();
    let again = dir.path().join("again.json");
    let output = linkage(&[
        "learn",
        &text(recording),
        "--object",
        "drawer",
        "--no-store",
        "--json",
        &text(&again),
        "--quiet",
    ]);
    assert!(output.status.success());
    assert_eq!(json(&again), json(&dir.path().join("model.json")));
}

#[test]
fn the_paper_profile_learns_it_too() {
    let (dir, recording) = learned();
    let out = dir.path().join("paper.json");
    let output = linkage(&[
        "learn",
        &text(recording),
        "--object",
        "drawer",
        "--profile",
        "paper",
        "--no-store",
        "--json",
        &text(&out),
        "--quiet",
    ]);
    let model = json(&out);
    assert_eq!(model["profile"], "paper", "{}", failure(&output).1);
}

/// The first joint that is learned of a scene, and the true one.
fn learned_joint(scene: &str, seed: u64) -> (Value, Value) {
    let recording = simulated(scene, false, seed);
    let out = recording.join("model.json");
    let arguments = ["learn", &text(&recording), "--object", scene, "--quiet"];
    let store = recording.join("objects.linkage");
    // One that an earlier run left holds the object already.
    let _ = std::fs::remove_file(&store);
    let more = ["--json", &text(&out), "--store", &text(&store)];
    let output = linkage(&[&arguments[..], &more].concat());
    assert!(output.status.success(), "{}", failure(&output).1);
    let first = |path: &Path| json(path)["joints"][0].clone();
    (first(&out), first(&recording.join("truth.json")))
}

#[test]
fn a_fridge_without_texture_is_learned_from_its_depth() {
    let (joint, expected) = learned_joint("fridge_2", 4315);
    assert_eq!(joint["type"], "revolute");
    assert!(line_angle(&vector(&joint["axis"]), &vector(&expected["axis"])).to_degrees() < 1.0);
    let store = Store::open(&simulated("fridge_2", false, 4315).join("objects.linkage")).unwrap();
    let appearance = store.get("fridge_2").unwrap().appearance;
    let of_the_door = appearance.surfels.iter().filter(|s| s.part == 1).count();
    assert!(of_the_door > 100 && !appearance.features.is_empty(), "{of_the_door} surfels");
}

#[test]
fn a_door_that_rises_as_it_opens_is_learned_as_a_screw() {
    let (joint, expected) = learned_joint("rising_door", 1);
    assert_eq!(joint["type"], "helical");
    assert!(line_angle(&vector(&joint["axis"]), &vector(&expected["axis"])).to_degrees() < 1.0);
    let pitch = |joint: &Value| joint["pitch"].as_f64().unwrap();
    assert!((pitch(&joint) - pitch(&expected)).abs() < 0.2 * pitch(&expected).abs(), "{joint}");
}

#[test]
fn a_hand_that_moves_nothing_gives_no_joint_and_status_1() {
    let recording = simulated("hand_only", false, 1);
    let output = linkage(&["learn", &text(&recording), "--object", "thing", "--quiet"]);
    let (status, message) = failure(&output);
    assert_eq!(status, 1, "{message}");
    assert!(message.contains("nothing articulated moves"), "{message}");
}

#[test]
fn it_is_recognised_and_its_motion_predicted() {
    let (dir, _) = learned();
    let store = text(&dir.path().join("objects.linkage"));
    // The room of the demonstration, seen from elsewhere.
    let encounter = simulated("drawer", true, 1);
    let truth = json(&encounter.join("truth.json"));
    let out = dir.path().join("recognition.json");
    let output = linkage(&[
        "recognise",
        &text(&encounter),
        "--store",
        &store,
        "--json",
        &text(&out),
        "--quiet",
    ]);
    assert!(output.status.success(), "{}", failure(&output).1);
    let found = &json(&out)["matches"][0];
    assert_eq!(found["object"], "drawer");
    let q = found["joints"][0]["configuration"].as_f64().expect("the drawer is seen");
    let expected = truth["joints"][0]["configuration"][0].as_f64().unwrap();
    assert!((q - expected).abs() < 0.02, "{q} instead of {expected}");

    let out = dir.path().join("prediction.json");
    let output = linkage(&[
        "predict",
        &text(&encounter),
        "--store",
        &store,
        "--to",
        "closed",
        "--json",
        &text(&out),
        "--quiet",
    ]);
    assert!(output.status.success(), "{}", failure(&output).1);
    let prediction = json(&out);
    assert_eq!(prediction["schema"], "linkage.prediction/1");
    let trajectory = prediction["joints"][0]["trajectory"].as_array().unwrap();
    assert!(trajectory.len() >= 2);
    assert!(trajectory.last().unwrap()[1].as_f64().unwrap().abs() < 1e-6);
    assert_eq!(prediction["parts"][0]["poses"].as_array().unwrap().len(), trajectory.len());

    for (arguments, status, words) in
        [(["--to", "0.9"], 2, "lies outside"), (["--joint", "lid"], 2, "no joint \"lid\"")]
    {
        let mut all = vec!["predict", encounter.to_str().unwrap(), "--store", &store];
        all.extend(arguments);
        let (found, message) = failure(&linkage(&all));
        assert_eq!(found, status, "{message}");
        assert!(message.contains(words), "{message}");
    }
}

#[test]
fn of_what_is_not_believed_the_best_is_named_with_its_score() {
    let (dir, recording) = learned();
    let library = Store::open(&dir.path().join("objects.linkage")).unwrap().load().unwrap();
    let mut frames = linkage_driver::open(&text(recording)).unwrap();
    let scene = Scene::new(&frames.next_frame().unwrap().unwrap()).unwrap();
    let mut doubtful = RecogniseConfig::default();
    doubtful.min_score = 1.0;
    let found = library.recognise(&scene, &doubtful, 1).unwrap();
    assert!(found.matches.is_empty());
    assert!(found.best_refused > 0.5, "{}", found.best_refused);
    assert_eq!(found.best_refused_object.as_deref(), Some("drawer"));
}

#[test]
fn what_is_not_in_the_first_shortlist_is_found_in_the_next() {
    let (dir, recording) = learned();
    let drawer = Store::open(&dir.path().join("objects.linkage")).unwrap().get("drawer").unwrap();
    let mut decoy = drawer.clone();
    decoy.model.object = "decoy".into();
    decoy.appearance.surfels.iter_mut().for_each(|s| s.point[0] += 1.0);
    let library = Library::new(vec![decoy, drawer]);
    let mut config = RecogniseConfig::default();
    (config.shortlist, config.shortlists) = (1, 2);
    let mut frames = linkage_driver::open(&text(recording)).unwrap();
    let scene = Scene::new(&frames.next_frame().unwrap().unwrap()).unwrap();
    let names = |found: Recognition| -> Vec<String> {
        found.matches.into_iter().map(|m| m.object).collect()
    };
    assert_eq!(names(library.recognise(&scene, &config, 1).unwrap()), ["drawer"]);
    let in_turn = |turn| names(library.recognise_in_turn(&scene, &config, 1, turn).unwrap());
    assert!(in_turn(0).is_empty());
    assert_eq!(in_turn(1), ["drawer"]);
    assert!(in_turn(2).is_empty());
}

#[test]
fn two_of_one_make_are_told_apart() {
    let dir = tempfile::tempdir().unwrap();
    let [store, found] = ["laptop.linkage", "found.json"].map(|name| text(&dir.path().join(name)));
    let demonstration = simulated("laptop", false, 1);
    let arguments = ["learn", &text(&demonstration), "--object", "laptop", "--store", &store];
    let output = linkage(&[&arguments[..], &["--quiet"]].concat());
    assert!(output.status.success(), "{}", failure(&output).1);
    let encounter = simulated("two_laptops", true, 2);
    let arguments = ["recognise", &text(&encounter), "--store", &store, "--json", &found];
    let output = linkage(&[&arguments[..], &["--quiet"]].concat());
    assert!(output.status.success(), "{}", failure(&output).1);
    let (found, truth) = (json(Path::new(&found)), json(&encounter.join("truth.json")));
    let matches = found["matches"].as_array().unwrap();
    assert_eq!(matches.len(), 2, "{found}");
    let mut met = Vec::new();
    for expected in truth["joints"].as_array().unwrap() {
        let place = Point3::from(vector(&expected["origin_last"]));
        let is_there = |m: &Value| {
            let joint = &m["joints"][0];
            let (origin, axis) = (Point3::from(vector(&joint["origin"])), vector(&joint["axis"]));
            // Both hinges are on one line.
            let beside = (origin - place).norm();
            distance_to_line(&origin, &axis.normalize(), &place) < 0.02 && beside < 0.1
        };
        met.extend(matches.iter().position(is_there));
    }
    met.sort_unstable();
    assert_eq!(met, [0, 1], "{truth}");
}

#[test]
fn it_is_followed_while_it_moves_and_its_loss_is_said() {
    let (dir, recording) = learned();
    let config = SkillConfig::default();
    let store = Store::open(&dir.path().join("objects.linkage")).unwrap();
    let library = store.load().unwrap();
    let mut frames = linkage_driver::open(&text(recording)).unwrap();
    let first = frames.next_frame().unwrap().unwrap();
    let found = library
        .recognise(&Scene::new(&first).unwrap(), &config.recognise, config.seed)
        .unwrap()
        .matches
        .remove(0);
    let object = library.object(0).unwrap();
    let mut follower = Follower::new(object, &found).unwrap();
    let truth = json(&recording.join("truth.json"));
    let truly = truth["joints"][0]["configuration"].as_array().unwrap();
    let (mut at, mut worst) = (1, 0.0_f64);
    while let Some(frame) = frames.next_frame().unwrap() {
        let followed = follower.follow(&frame).unwrap();
        let q = followed.recognised.joints[0].configuration.unwrap();
        let change = truly[at].as_f64().unwrap() - truly[0].as_f64().unwrap();
        worst = worst.max((q.abs() - change.abs()).abs());
        at += 1;
    }
    assert!(worst < 0.01, "off by {worst} m");
    // The robot turns away: frames of a room without it.
    let elsewhere = simulated("hand_only", false, 1);
    let mut frames = linkage_driver::open(&text(&elsewhere)).unwrap();
    let lost = std::iter::from_fn(|| frames.next_frame().unwrap())
        .take(Follower::PATIENCE + 1)
        .find_map(|frame| follower.follow(&frame).err());
    assert!(lost.unwrap().to_string().contains("drawer has not been seen"));
}

#[test]
fn nothing_is_recognised_in_a_room_without_it() {
    let (dir, _) = learned();
    let store = text(&dir.path().join("objects.linkage"));
    let encounter = simulated("microwave", true, 5);
    let (status, message) = failure(&linkage(&["recognise", &text(&encounter), "--store", &store]));
    assert_eq!(status, 1, "{message}");
    assert!(message.contains("nothing is recognised"), "{message}");
}

#[test]
fn a_python_subscriber_and_the_logger_receive_model_prediction_and_plan() {
    let Some(python) = python_with_lcm() else { return };
    let (dir, _) = learned();
    let encounter = simulated("drawer", true, 1);
    let scratch = tempfile::tempdir().unwrap();
    let types = Path::new(env!("CARGO_MANIFEST_DIR")).join("../planner_bridge/lcm/types");
    let files: Vec<PathBuf> =
        std::fs::read_dir(types).unwrap().map(|e| e.unwrap().path()).collect();
    let generated = Command::new("lcm-gen")
        .args(["--python", "--ppath"])
        .arg(scratch.path())
        .args(&files)
        .stdout(Stdio::null())
        .status()
        .unwrap();
    assert!(generated.success());
    let script = scratch.path().join("subscribe.py");
    std::fs::write(&script, SUBSCRIBER).unwrap();
    let mut subscriber = Command::new(python)
        .arg(&script)
        .arg(URL)
        .current_dir(scratch.path())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let log = scratch.path().join("log.lcm");
    let mut logger = Command::new("lcm-logger")
        .arg(format!("--lcm-url={URL}"))
        .arg("--force")
        .arg(&log)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    std::thread::sleep(Duration::from_secs(2));
    let output = linkage(&[
        "predict",
        &text(&encounter),
        "--store",
        &text(&dir.path().join("objects.linkage")),
        "--to",
        "closed",
        "--publish",
        URL,
        "--quiet",
    ]);
    assert!(output.status.success(), "{}", failure(&output).1);
    let mut said = String::new();
    subscriber.stdout.take().unwrap().read_to_string(&mut said).unwrap();
    assert!(subscriber.wait().unwrap().success(), "{said}");
    assert!(said.contains("model drawer prismatic"), "{said}");
    assert!(said.contains("plan drawer/joint1 increasing True"), "{said}");
    Command::new("kill").args(["-INT", &logger.id().to_string()]).status().unwrap();
    logger.wait().unwrap();
    let bytes = std::fs::read(&log).unwrap();
    for channel in ["LINKAGE_MODEL", "LINKAGE_PREDICTION", "LINKAGE_PLAN"] {
        let there = bytes.windows(channel.len()).any(|w| w == channel.as_bytes());
        assert!(there, "{channel} is not in the log");
    }
}

const SUBSCRIBER: &str = r#"
import sys, lcm, linkage, drake
seen = {}
def on(channel, data):
    if channel == "LINKAGE_MODEL":
        m = linkage.model_t.decode(data)
        seen[channel] = "model %s %s" % (m.object, m.joints[0].kind)
    elif channel == "LINKAGE_PREDICTION":
        p = linkage.prediction_t.decode(data)
        t = p.trajectories[0]
        assert t.num_points == len(t.position) == len(t.velocity)
        seen[channel] = "prediction %s %d points" % (p.recognition.object, t.num_points)
    elif channel == "LINKAGE_PLAN":
        p = drake.lcmt_robot_plan.decode(data)
        times = [s.utime for s in p.plan]
        rising = times[0] == 0 and all(b > a for a, b in zip(times, times[1:]))
        seen[channel] = "plan %s increasing %s" % (p.plan[0].joint_name[0], rising)
net = lcm.LCM(sys.argv[1])
net.subscribe("LINKAGE_.*", on)
import time
end = time.time() + 300
while len(seen) < 3 and time.time() < end:
    net.handle_timeout(500)
print("\n".join(seen.values()))
sys.exit(0 if len(seen) == 3 else 1)
"#;

/// A network of its own, without any route: none where the system refuses one.
fn without_a_route() -> Option<Command> {
    let isolated = ["--map-root-user", "--net", "--"];
    let allowed = Command::new("unshare")
        .args(isolated)
        .arg("true")
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|s| s.success());
    if !allowed {
        eprintln!("ignored: this system gives tests no network of their own");
        return None;
    }
    let mut command = Command::new("unshare");
    command.args(isolated).arg(program());
    Some(command)
}

#[test]
fn without_a_multicast_route_publishing_says_what_to_do_and_the_prediction_is_kept() {
    let (dir, _) = learned();
    let Some(mut isolated) = without_a_route() else { return };
    let out = dir.path().join("unpublished.json");
    let output = isolated
        .arg("predict")
        .arg(simulated("drawer", true, 1))
        .args(["--to", "closed", "--quiet", "--publish", URL, "--store"])
        .arg(dir.path().join("objects.linkage"))
        .arg("--json")
        .arg(&out)
        .output()
        .unwrap();
    let (status, message) = failure(&output);
    assert_eq!(status, 2, "{message}");
    assert!(message.contains(URL) && message.contains("ip route add 224.0.0.0/4"), "{message}");
    assert_eq!(json(&out)["schema"], "linkage.prediction/1");
}

#[test]
fn real_recordings_open() {
    for recording in ["rgbd/desk5", "rgbd/box1", "demos/microwave_enc1"] {
        let Some(path) = shared_data(recording) else { continue };
        let mut source = linkage_driver::open(&text(&path)).unwrap();
        let frame = source.next_frame().unwrap().expect("a frame");
        assert!(frame.depth.invalid_share() < 0.9, "{recording}");
    }
}

#[test]
fn a_rendered_microwave_of_another_program_is_learned_within_a_degree() {
    let Some(demos) = shared_data("demos/microwave_demo1") else { return };
    let out = tempfile::NamedTempFile::new().unwrap();
    let output = linkage(&[
        "learn",
        &text(&demos),
        "--object",
        "microwave",
        "--no-store",
        "--json",
        &text(out.path()),
        "--quiet",
    ]);
    assert!(output.status.success(), "{}", failure(&output).1);
    let (model, truth) = (json(out.path()), json(&demos.join("truth.json")));
    let (found, expected) = (&model["joints"][0], &truth["joints"][0]);
    assert_eq!(found["type"], "revolute");
    let axis = vector(&expected["axis"]).normalize();
    assert!(line_angle(&vector(&found["axis"]), &axis).to_degrees() < 1.0);
    let origin = Point3::from(vector(&expected["origin"]));
    assert!(distance_to_line(&origin, &axis, &Point3::from(vector(&found["origin"]))) < 0.02);
}
