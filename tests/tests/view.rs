//! Frames and results as other programs read them: an MCAP file with the library of the format's
//! authors, a running service with a WebSocket client.
//!
//! They need the program with the feature `view` (`cargo test -p linkage-tests --features view --test
//! view`); without it, a test checks that `--mcap` and `--view` say how to build it.

#[cfg(not(feature = "view"))]
mod without {
    use linkage_tests::{failure, linkage};

    #[test]
    fn who_asks_for_a_view_is_told_how_to_build_it() {
        for arguments in [
            &["learn", "x", "--object", "x", "--no-store", "--mcap", "x.mcap"][..],
            &["recognise", "x", "--mcap", "x.mcap"],
            &["serve", "--source", "x", "--view"],
        ] {
            let (status, said) = failure(&linkage(arguments));
            assert_eq!(status, 2, "{said}");
            assert!(said.contains("--features view"), "{said}");
        }
    }
}

#[cfg(feature = "view")]
mod with {
    use linkage_lcm::messages::linkage::Status;
    use linkage_tests::service::{Listener, Service};
    use linkage_tests::{failure, learned, linkage, python_with, simulated};
    use serde_json::Value;
    use std::io::{BufRead, BufReader};
    use std::net::TcpListener;
    use std::path::{Path, PathBuf};
    use std::process::{Command, Stdio};
    use std::time::Duration;

    /// Frames that a service looks at while a viewer reads nothing: far more than the queues and the
    /// network between the two can hold.
    const FRAMES_UNSEEN: i64 = 300;

    fn text(path: &Path) -> String {
        path.display().to_string()
    }

    fn checker(python: &Path, arguments: &[&str]) -> Command {
        let mut command = Command::new(python);
        command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/check_view.py"));
        command.args(arguments);
        command
    }

    /// What a Python program says.
    fn said(python: &Path, arguments: &[&str]) -> Value {
        let output = checker(python, arguments).output().expect("the Python of the tests starts");
        assert!(output.status.success(), "{}", failure(&output).1);
        serde_json::from_slice(&output.stdout).expect("it prints JSON")
    }

    /// Frames of a recording, and the times of the first and the last of them in nanoseconds.
    fn frames_of(recording: &Path) -> (usize, [f64; 2]) {
        let list = std::fs::read_to_string(recording.join("rgb.txt")).expect("a recording");
        let rows = list.lines().filter(|line| !line.starts_with('#'));
        let stamps: Vec<f64> = rows
            .map(|row| row.split(' ').next().and_then(|t| t.parse().ok()).expect("a time stamp"))
            .collect();
        (stamps.len(), [stamps[0] * 1e9, stamps[stamps.len() - 1] * 1e9])
    }

    #[test]
    fn a_demonstration_is_read_by_the_library_of_mcaps_makers() {
        let Some(python) = python_with(&["mcap"]) else { return };
        let dir = tempfile::tempdir().unwrap();
        let (recording, file) = (simulated("drawer", false, 1), dir.path().join("drawer.mcap"));
        let arguments = ["learn", &text(&recording), "--object", "drawer", "--no-store", "--quiet"];
        let output = linkage(&[&arguments[..], &["--mcap", &text(&file)]].concat());
        assert!(output.status.success(), "{}", failure(&output).1);
        let topics = said(&python, &["file", &text(&file)]);
        let (frames, [first, last]) = frames_of(&recording);
        for (topic, schema) in [
            ("/camera/color", "foxglove.CompressedImage"),
            ("/camera/depth", "foxglove.RawImage"),
            ("/camera/calibration", "foxglove.CameraCalibration"),
            ("/tf_static", "foxglove.FrameTransforms"),
            ("/tf", "foxglove.FrameTransforms"),
            ("/tracks", "foxglove.PointCloud"),
            ("/joints", "foxglove.SceneUpdate"),
            ("/joint_states", "foxglove.JointStates"),
        ] {
            let told = &topics[topic];
            assert_eq!(told["schema"], schema, "{topic}");
            assert_eq!(told["encoding"], "protobuf", "{topic}");
            assert_eq!(told["count"], frames, "{topic}");
            for (key, time) in [("first", first), ("last", last)] {
                let off = told[key].as_f64().expect("a time") - time;
                assert!(off.abs() < 1e3, "{topic}: {key} is {off} ns off");
            }
        }
        assert_eq!(topics["/ghost"]["schema"], "foxglove.PointCloud");
        assert_eq!(topics["/log"]["schema"], "foxglove.Log");
        for (topic, told) in topics.as_object().expect("topics") {
            assert_eq!(told["ordered"], true, "{topic}: time runs backwards");
        }
    }

    #[test]
    fn a_recognition_is_one_moment_with_the_surface_where_it_is() {
        let Some(python) = python_with(&["mcap"]) else { return };
        let dir = tempfile::tempdir().unwrap();
        let (store, file) = (learned("drawer", dir.path()), dir.path().join("met.mcap"));
        let met = text(&simulated("drawer", true, 3));
        let arguments = ["recognise", &met, "--store", &text(&store), "--mcap", &text(&file)];
        let output = linkage(&arguments);
        assert!(output.status.success(), "{}", failure(&output).1);
        let topics = said(&python, &["file", &text(&file)]);
        for topic in ["/camera/color", "/surface", "/joints", "/ghost", "/object_pose", "/log"] {
            assert_eq!(topics[topic]["count"], 1, "{topic}");
            assert_eq!(topics[topic]["first"], topics["/camera/color"]["first"], "{topic}");
        }
        // A command that fails leaves none.
        let failed = dir.path().join("failed.mcap");
        let arguments = ["recognise", "/no/recording", "--store", &text(&store)];
        let (status, _) =
            failure(&linkage(&[&arguments[..], &["--mcap", &text(&failed)]].concat()));
        assert_eq!((status, failed.exists()), (2, false));
        // A file that is there is not written over.
        let arguments = ["recognise", &met, "--store", &text(&store), "--mcap", &text(&file)];
        let (status, refused) = failure(&linkage(&arguments));
        assert_eq!(status, 2);
        assert!(refused.contains("met.mcap: exists already"), "{refused}");
    }

    /// A service that looks at a drawer, with a view.
    fn service(network: &str, dir: &Path) -> (Service, String) {
        let free = TcpListener::bind("127.0.0.1:0").and_then(|l| l.local_addr());
        let address = free.expect("a port is free").to_string();
        let met: PathBuf = simulated("drawer", true, 3);
        let options = ["--repeat", "--view", &address];
        let service = Service::start(network, &text(&met), &learned("drawer", dir), &options);
        (service, format!("ws://{address}"))
    }

    #[test]
    fn a_viewer_gets_the_topics_and_sees_a_recognition_and_a_prediction() {
        let Some(python) = python_with(&["websockets"]) else { return };
        let dir = tempfile::tempdir().unwrap();
        let (service, url) = service("udpm://239.255.76.67:7761?ttl=0", dir.path());
        service.done(&["recognise", "drawer"]);
        service.done(&["predict", "drawer"]);
        let wanted = [
            "/camera/color",
            "/camera/depth",
            "/tf",
            "/surface",
            "/joints",
            "/object_pose",
            "/ghost",
        ];
        let answer = said(&python, &[&["live", &url], &wanted[..]].concat());
        assert_eq!(answer["advertised"]["/camera/color"], "foxglove.CompressedImage");
        assert_eq!(answer["advertised"]["/joint_readings"], "jointreadings.JointReadings");
        assert_eq!(answer["seen"]["/camera/color"]["jpeg"], true);
        let depth_bytes = answer["seen"]["/camera/depth"]["bytes"].as_u64();
        assert!(depth_bytes.is_some_and(|n| n > 640 * 480 * 2), "{answer}");
        // A thousand points of the drawer, 16 bytes each.
        let ghost_bytes = answer["seen"]["/ghost"]["bytes"].as_u64();
        assert!(ghost_bytes.is_some_and(|n| n > 5_000), "{answer}");
    }

    #[test]
    fn a_stranger_s_page_sees_nothing() {
        let Some(python) = python_with(&["websockets"]) else { return };
        let dir = tempfile::tempdir().unwrap();
        let (_service, url) = service("udpm://239.255.76.67:7763?ttl=0", dir.path());
        for (origin, answer) in [
            ("https://example.org", "HTTP 403"),
            ("null", "HTTP 403"),
            ("http://localhost:8080", "connected"),
            ("https://app.foxglove.dev", "connected"),
        ] {
            assert_eq!(said(&python, &["page", &url, origin])["answer"], answer, "{origin}");
        }
    }

    #[test]
    fn a_viewer_that_reads_nothing_holds_nothing_up() {
        let Some(python) = python_with(&["websockets"]) else { return };
        let dir = tempfile::tempdir().unwrap();
        let network = "udpm://239.255.76.67:7762?ttl=0";
        let (service, url) = service(network, dir.path());
        let mut viewer = checker(&python, &["silent", &url])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("the Python of the tests starts");
        let mut line = String::new();
        BufReader::new(viewer.stdout.take().expect("it is piped")).read_line(&mut line).unwrap();
        assert_eq!(line.trim(), "subscribed");
        let mut listener = Listener::new(network, "LINKAGE_STATUS");
        let timeout = Duration::from_secs(90);
        let begun: Status = listener.wait("LINKAGE_STATUS", timeout, |_| true);
        let is_later = |s: &Status| s.frames >= begun.frames + FRAMES_UNSEEN;
        listener.wait::<Status>("LINKAGE_STATUS", timeout, is_later);
        service.done(&["recognise", "drawer"]);
        assert!(service.resident_mib() < 600.0, "{} MiB", service.resident_mib());
        viewer.kill().and_then(|()| viewer.wait()).expect("it ran until now");
        let (ended, took) = service.terminate();
        assert!(ended.success() || ended.code() == Some(143), "{ended}");
        assert!(took < Duration::from_secs(10), "{took:?}");
    }
}
