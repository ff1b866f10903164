//! The live skill, over LCM alone: a demonstration is watched, learned, met again and planned; what
//! is published is read by clients that nobody here wrote; nothing that is sent to it harms it.

use linkage_lcm::messages::linkage::{
    Command as Order, Model, Prediction, Recognition, Setpoint, Status,
};
use linkage_lcm::{Lcm, decode, encode};
use linkage_planner_bridge::client::addressed;
use linkage_tests::service::{Listener, Service};
use linkage_tests::{failure, learned, linkage, python_with, simulated};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A network a test: they run side by side.
fn network(port: u16) -> String {
    format!("udpm://239.255.76.67:{port}?ttl=0")
}

fn text(path: &Path) -> String {
    path.display().to_string()
}

fn replay(recording: &Path, url: &str, rate: &str) {
    let output = linkage(&[
        "replay",
        &text(recording),
        "--publish",
        url,
        "--rate",
        rate,
        "--jpeg",
        "--quiet",
    ]);
    assert!(output.status.success(), "{}", failure(&output).1);
}

/// LCM's own logger, beside a service.
fn logger(url: &str, log: &Path) -> Child {
    Command::new("lcm-logger")
        .arg(format!("--lcm-url={url}"))
        .arg("--force")
        .arg(log)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("lcm-logger, which tools/setup installs")
}

/// A subscriber in Python, with types that lcm-gen made and Drake's own plan.
fn subscriber(python: &Path, scratch: &Path, url: &str) -> Child {
    let types = Path::new(env!("CARGO_MANIFEST_DIR")).join("../planner_bridge/lcm/types");
    // The plan is decoded with the type that Drake brings itself.
    let ours = |path: &PathBuf| !text(path).contains("lcmt_");
    let files = std::fs::read_dir(types).unwrap().map(|e| e.unwrap().path()).filter(ours);
    let generated = Command::new("lcm-gen")
        .args(["--python", "--ppath"])
        .arg(scratch)
        .args(files)
        .stdout(Stdio::null())
        .status()
        .unwrap();
    assert!(generated.success());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/check_service.py");
    Command::new(python)
        .arg(script)
        .arg(url)
        .env("PYTHONPATH", scratch)
        .current_dir(scratch)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap()
}

#[test]
fn over_lcm_alone_a_drawer_is_learned_met_again_and_planned() {
    let url = network(7711);
    let dir = tempfile::tempdir().unwrap();
    let python = python_with(&["lcm", "drake"]);
    let mut checker = python.map(|python| subscriber(&python, dir.path(), &url));
    let log = dir.path().join("log.lcm");
    let mut logger = logger(&url, &log);
    let (demonstration, encounter) = (simulated("drawer", false, 1), simulated("drawer", true, 1));
    let camera = text(&demonstration.join("camera.toml"));
    let options = ["--camera", &camera, "--stream-hz", "200"];
    let source = format!("lcm:{url}#KINECT_FRAME");
    let service = Service::start(&url, &source, &dir.path().join("s.linkage"), &options);

    let mut models = Listener::new(&url, "LINKAGE_MODEL");
    assert!(service.done(&["start", "drawer"]).contains("watching how drawer is moved"));
    replay(&demonstration, &url, "0.5");
    assert!(service.done(&["finish"]).contains("learned drawer: prismatic, 1 demonstration"));
    let mut guesses = 0;
    let model = models.wait::<Model>("LINKAGE_MODEL", Duration::from_secs(5), |m| {
        guesses += usize::from(m.demonstrations == 0);
        m.demonstrations == 1
    });
    // The demonstration is replayed for ten seconds.
    assert!(guesses >= 10, "{guesses} guesses were published while it ran");
    assert_eq!((model.object.as_str(), model.joints[0].kind.as_str()), ("drawer", "prismatic"));

    let mut predictions = Listener::new(&url, "LINKAGE_PREDICTION|LINKAGE_SETPOINT");
    let answer = std::thread::scope(|scope| {
        scope.spawn(|| replay(&encounter, &url, "0.5"));
        std::thread::sleep(Duration::from_millis(300));
        service.done(&["predict", "drawer", "--to", "closed"])
    });
    assert!(answer.contains("planned drawer"), "{answer}");
    let wait = Duration::from_secs(5);
    let prediction = predictions.wait::<Prediction>("LINKAGE_PREDICTION", wait, |_| true);
    assert_eq!(prediction.trajectories[0].position.last(), Some(&0.0));
    let last = predictions.wait::<Setpoint>("LINKAGE_SETPOINT", wait, |s| s.last);
    let rest = (last.position.as_slice(), last.velocity.as_slice());
    assert_eq!(rest, (&[0.0][..], &[0.0][..]), "it ends because of: {}", last.reason);

    if let Some(mut checker) = checker.take() {
        // It says what it misses if it has not seen all of it by now.
        let output = checker.wait().map(|_| checker.wait_with_output()).unwrap().unwrap();
        let said = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success(), "{said}");
    }
    let _ = Command::new("kill").args(["-INT", &logger.id().to_string()]).status();
    logger.wait().unwrap();
    let bytes = std::fs::read(&log).unwrap();
    for channel in ["LINKAGE_STATUS", "LINKAGE_MODEL", "LINKAGE_PLAN", "ARTICULATED_OBJECT"] {
        let there = bytes.windows(channel.len()).any(|w| w == channel.as_bytes());
        assert!(there, "{channel} is not in the log");
    }
    assert!(service.terminate().0.success());
}

#[test]
fn a_drawer_that_moves_is_seen_moving_and_its_loss_is_said() {
    let url = network(7712);
    let dir = tempfile::tempdir().unwrap();
    let store = learned("drawer", dir.path());
    let recording = simulated("drawer", false, 1);
    let service = Service::start(&url, &text(&recording), &store, &["--rate", "0.5"]);
    let mut listener = Listener::new(&url, "LINKAGE_RECOGNITION|LINKAGE_STATUS");
    service.done(&["recognise", "drawer"]);
    let packets = listener.gather(Duration::from_secs(11));
    let configurations: Vec<f64> = packets
        .iter()
        .filter(|p| p.channel == "LINKAGE_RECOGNITION")
        .map(|p| decode::<Recognition>(&p.bytes).unwrap())
        .filter_map(|r| r.matches.first().map(|m| m.joints[0].configuration))
        .collect();
    assert!(configurations.len() > 50, "followed in {} frames", configurations.len());
    let furthest = configurations.iter().copied().fold(0.0, f64::max);
    assert!(furthest > 0.25, "seen to open by {furthest:.2} m");
    // The recording is over: no frame comes any more, and the service says so and goes on.
    let over = |s: &Status| s.last_error.contains("it is over");
    listener.wait("LINKAGE_STATUS", Duration::from_secs(10), over);
    std::thread::sleep(Duration::from_secs(1));
    let refused = service.command(&["predict"]);
    assert_eq!(refused.status.code(), Some(1));
    let reason = failure(&refused).1;
    assert!(reason.contains("s old: is the camera still there?"), "{reason}");
}

#[test]
fn what_cannot_be_done_is_refused_with_its_reason() {
    let url = network(7713);
    let dir = tempfile::tempdir().unwrap();
    let store = learned("drawer", dir.path());
    let encounter = simulated("drawer", true, 1);
    let service = Service::start(&url, &text(&encounter), &store, &["--repeat"]);
    let refusal = |words: &[&str]| {
        let output = service.command(words);
        assert_eq!(output.status.code(), Some(1), "{words:?}");
        failure(&output).1
    };
    assert!(refusal(&["finish"]).contains("no demonstration runs"));
    assert!(refusal(&["recognise", "sofa"]).contains("no object \"sofa\""));
    assert!(refusal(&["predict", "drawer", "--to", "3"]).contains("lies outside"));
    assert!(refusal(&["predict", "--joint", "lid"]).contains("no joint \"lid\""));
    let far = ["predict", "--to", "3", "--outside-range"];
    assert!(refusal(&far).contains("lies more than 1.00 m outside"));
    assert!(service.done(&["predict", "--to", "0.6", "--outside-range"]).contains("planned"));
    service.done(&["start", "cupboard"]);
    assert!(refusal(&["predict"]).contains("cupboard is being demonstrated"));
    assert!(refusal(&["start", "other"]).contains("finish or cancel first"));
    // Nothing moves in an encounter.
    assert!(refusal(&["finish"]).contains("cupboard: "));
    assert!(service.done(&["cancel"]).contains("cancelled"));
    let (status, took) = service.terminate();
    assert!(status.success() && took < Duration::from_secs(1), "{took:?}");
}

#[test]
fn a_command_that_comes_again_is_answered_and_not_done_again() {
    let url = network(7714);
    let dir = tempfile::tempdir().unwrap();
    let store = learned("drawer", dir.path());
    let service = Service::start(&url, &text(&simulated("drawer", true, 1)), &store, &["--repeat"]);
    let mut listener = Listener::new(&url, "LINKAGE_STATUS|LINKAGE_PREDICTION");
    let lcm = Lcm::new(&url).unwrap();
    let status: Status = listener.wait("LINKAGE_STATUS", Duration::from_secs(5), |_| true);
    let predict = Order { action: Order::PREDICT, target: "open".into(), ..Default::default() };
    let order = addressed(&predict, status.session);
    for _ in 0..5 {
        lcm.publish("LINKAGE_COMMAND", &order).unwrap();
        std::thread::sleep(Duration::from_millis(300));
    }
    let packets = listener.gather(Duration::from_secs(3));
    let count = packets.iter().filter(|p| p.channel == "LINKAGE_PREDICTION").count();
    assert_eq!(count, 1);
    let newer = Order { action: Order::CANCEL, ..Default::default() };
    let newer = addressed(&newer, status.session);
    lcm.publish("LINKAGE_COMMAND", &newer).unwrap();
    let answered = |utime: i64| move |s: &Status| s.command_utime == utime && s.command_accepted;
    let wait = Duration::from_secs(5);
    listener.wait("LINKAGE_STATUS", wait, answered(newer.utime));
    lcm.publish("LINKAGE_COMMAND", &order).unwrap();
    let again: Status = listener.wait("LINKAGE_STATUS", wait, answered(order.utime));
    assert!(again.command_answer.contains("planned drawer"), "{}", again.command_answer);
    // Frames that came in between do not make it move: cancelled it stays.
    assert_eq!(again.state, "ready");
    drop(service);
}

/// Bytes that nobody chose.
fn noise(seed: &mut u64, length: usize) -> Vec<u8> {
    (0..length)
        .map(|_| {
            *seed = seed
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (*seed >> 33) as u8
        })
        .collect()
}

/// Sends what no command is: noise, commands that are cut off, another message, targets that are no
/// numbers, and datagrams that are not LCM's.
fn send_malformed(lcm: &Lcm, order: &Order, seed: &mut u64) {
    let whole = encode(order).unwrap();
    for length in [0, 1, 7, 8, 9, 100, 60_000, 250_000] {
        lcm.publish_bytes("LINKAGE_COMMAND", &noise(seed, length)).unwrap();
    }
    // The kernel's buffer is full by now, and what comes too soon is lost.
    let breath = || std::thread::sleep(Duration::from_millis(20));
    for cut in 1..whole.len() {
        breath();
        lcm.publish_bytes("LINKAGE_COMMAND", &whole[..cut]).unwrap();
    }
    let huge = [&whole[..21], &i32::MAX.to_be_bytes()[..], &whole[25..]].concat();
    lcm.publish_bytes("LINKAGE_COMMAND", &huge).unwrap();
    lcm.publish("LINKAGE_COMMAND", &Status::default()).unwrap();
    for target in ["NaN", "inf", "-inf", "1e999", ""] {
        breath();
        let nan = Order { action: Order::PREDICT, target: target.into(), ..order.clone() };
        lcm.publish("LINKAGE_COMMAND", &nan).unwrap();
    }
    // Datagrams that are not LCM's.
    let socket = std::net::UdpSocket::bind("0.0.0.0:0").unwrap();
    for length in [1, 8, 20, 1400] {
        let _ = socket.send_to(&noise(seed, length), "239.255.76.67:7715");
    }
}

#[test]
fn hostile_traffic_harms_nothing_and_is_counted() {
    let url = network(7715);
    let dir = tempfile::tempdir().unwrap();
    let store = learned("drawer", dir.path());
    let service = Service::start(&url, &text(&simulated("drawer", true, 1)), &store, &["--repeat"]);
    let lcm = Lcm::new(&url).unwrap();
    let mut seed = 9;
    let mut statuses = Listener::new(&url, "LINKAGE_STATUS");
    let status: Status = statuses.wait("LINKAGE_STATUS", Duration::from_secs(5), |_| true);
    let order = Order { action: Order::RECOGNISE, ..Default::default() };
    let order = addressed(&order, status.session);
    send_malformed(&lcm, &order, &mut seed);
    let wait = Duration::from_secs(10);
    // A network may lose some of them.
    let told: Status = statuses.wait("LINKAGE_STATUS", wait, |s: &Status| s.refused > 30);
    assert!(!told.last_error.is_empty());

    // Ten thousand commands a second, each another one; twice, for what is used once is no growth.
    let mut sent = 0;
    let mut flood = || {
        let (start, before) = (Instant::now(), sent);
        while start.elapsed() < Duration::from_secs(2) {
            if f64::from(sent - before) < start.elapsed().as_secs_f64() * 10_000.0 {
                sent += 1;
                let (object, action) = ("drawer".to_owned(), (sent % 5) as i8);
                let order = addressed(&Order { object, action, ..order.clone() }, status.session);
                lcm.publish("LINKAGE_COMMAND", &order).unwrap();
            }
        }
        assert!(sent - before > 15_000, "{} commands were sent", sent - before);
        // A frame that is being searched takes a hundred MiB for a moment.
        let sample = |_| {
            std::thread::sleep(Duration::from_millis(100));
            service.resident_mib()
        };
        (0..20).map(sample).fold(f64::INFINITY, f64::min)
    };
    let (first, second) = (flood(), flood());
    let told: Status = statuses.wait("LINKAGE_STATUS", wait, |s: &Status| s.refused > 1000);
    let refused = told.refused;
    assert!(second < first + 100.0, "{first:.0} MiB, then {second:.0}; {refused} refused");
    service.done(&["cancel"]);
    assert!(service.done(&["predict", "drawer"]).contains("planned drawer"));
    assert!(service.terminate().0.success());
}

#[test]
fn a_service_outlives_who_reads_its_log_and_ends_in_order_when_its_terminal_closes() {
    let url = network(7716);
    let dir = tempfile::tempdir().unwrap();
    let store = dir.path().join("objects.linkage");
    let source = text(&simulated("drawer", true, 1));
    let (reader, log) = std::io::pipe().unwrap();
    let service = Service::start_logging(&url, &source, &store, &["--repeat"], log);
    drop(reader);
    let lcm = Lcm::new(&url).unwrap();
    // Each is worth a line in the log.
    for refused in 1..=3 {
        lcm.publish_bytes("LINKAGE_COMMAND", b"no command").unwrap();
        let mut statuses = Listener::new(&url, "LINKAGE_STATUS");
        let is_counted = |status: &Status| status.refused >= refused;
        statuses.wait("LINKAGE_STATUS", Duration::from_secs(10), is_counted);
    }
    // What is started with nohup ignores it, as it should.
    let ignored = std::fs::read_to_string("/proc/self/status").unwrap();
    let ignored = ignored.lines().find_map(|line| line.strip_prefix("SigIgn:")).unwrap();
    let ignores_hangup = u64::from_str_radix(ignored.trim(), 16).unwrap() & 1 == 1;
    let (status, took) = service.end(if ignores_hangup { "-TERM" } else { "-HUP" });
    assert!(status.success() && took < Duration::from_secs(10), "{status}, {took:?}");
}

#[test]
fn without_multicast_the_service_says_what_to_do() {
    let dir = tempfile::tempdir().unwrap();
    let recording = text(&simulated("drawer", true, 1));
    let store = text(&dir.path().join("s.linkage"));
    // A network of the host where nothing comes back: unicast to a port where nobody listens.
    let url = "udpm://127.0.0.1:7716?ttl=0";
    let output = linkage(&["serve", "--source", &recording, "--store", &store, "--publish", url]);
    let (status, message) = failure(&output);
    assert_eq!(status, 2, "{message}");
    assert!(message.contains("multicast"), "{message}");
}
