//! The live skill under the clock: from a frame to its prediction on the wire, with few and with
//! many objects known; and how well the stream of setpoints keeps its time while perception works.

use super::recognise::made_up;
use crate::cli::{BenchArgs, Common};
use crate::commands::{
    Outcome, demonstrate, describe_stream, film, remember, skill_config, write_json,
};
use crate::simulate::Take;
use anyhow::{Context, anyhow};
use linkage_driver::{RgbdFrame, RgbdSource, SourceError, SourceStatistics};
use linkage_lcm::messages::linkage::{Command, Prediction};
use linkage_lcm::{Lcm, decode};
use linkage_planner_bridge::service::{Playback, ServiceConfig, ServiceReport, serve};
use linkage_planner_bridge::{Rig, channel};
use linkage_skill::SkillConfig;
use linkage_skill::appearance::ModelFeature;
use linkage_skill::geometry::median;
use linkage_skill::store::{Store, StoredObject};
use serde::Serialize;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// What is learned and met again.
const SCENE: &str = "drawer";
const SEED: u64 = 1;
/// A network of its own.
const URL: &str = "udpm://239.255.76.67:7697?ttl=0";
/// Objects that are known.
const SIZES: [usize; 3] = [1, 100, 1000];
/// Predictions a size.
const TRIES: usize = 30;
/// Frames a second.
const FRAME_RATE: f64 = 30.0;
/// Setpoints a second, and for how long.
const STREAM_HZ: f64 = 200.0;
const STREAM_FOR: Duration = Duration::from_secs(60);
/// Longest wait for a prediction.
const PATIENCE: Duration = Duration::from_secs(8);

/// Milliseconds from a frame to its prediction on the wire.
#[derive(Serialize)]
struct Latency {
    objects: usize,
    /// The object is not followed yet: it is recognised in the frame.
    recognised: [f64; 2],
    /// It is followed: the prediction starts from the newest frame.
    followed: [f64; 2],
    unanswered: usize,
}

/// How the stream kept its time.
#[derive(Serialize)]
struct Streaming {
    setpoints: u64,
    missed_deadlines: u64,
    late_us: [u64; 3],
    cpu_share: f64,
    frames_a_second: f64,
}

pub fn run(args: &BenchArgs, common: &Common) -> Outcome {
    let config = skill_config(common)?;
    let work = args.dir.clone().unwrap_or_else(|| PathBuf::from("out/serve"));
    let (watched, met) = (work.join("demonstration"), work.join("encounter"));
    for (take, dir) in [(Take::Demonstration, &watched), (Take::Encounter, &met)] {
        if !dir.join("truth.json").exists() {
            film(SCENE, take, false, SEED, dir, common.quiet)?;
        }
    }
    let source = watched.display().to_string();
    let demonstration = demonstrate(&source, SCENE, &config, common.quiet)?;
    let object = remember(None, &demonstration, &source, &config)?;

    println!("from a frame to its prediction on the wire, milliseconds");
    println!("objects   recognised: median   p99   followed: median   p99   unanswered");
    let mut latencies = Vec::new();
    for objects in SIZES {
        let store = store_of(&work, &object, objects)?;
        let running = Running::start(&met, &store, &config, None)?;
        let (running, row) = running.latency(objects)?;
        running.stop()?;
        println!(
            "{:>7} {:>20.0} {:>5.0} {:>18.0} {:>5.0} {:>12}",
            row.objects,
            row.recognised[0],
            row.recognised[1],
            row.followed[0],
            row.followed[1],
            row.unanswered
        );
        latencies.push(row);
    }
    let store = store_of(&work, &object, 1)?;
    let streaming = stream(&watched, &store, &config)?;
    if let Some(path) = &args.json {
        let report = serde_json::json!({ "latency": latencies, "stream": streaming });
        write_json(path, &report)?;
    }
    Ok(())
}

/// After so long an object that was recognised is followed.
const SETTLED: Duration = Duration::from_millis(400);

/// A store of the learned object among made-up ones.
fn store_of(work: &Path, object: &StoredObject, objects: usize) -> Outcome<PathBuf> {
    let path = work.join(format!("objects-{objects}.linkage"));
    if path.exists() {
        std::fs::remove_file(&path).with_context(|| path.display().to_string())?;
    }
    let features: Vec<&ModelFeature> = object.appearance.features.iter().collect();
    let mut all = vec![object.clone()];
    all.extend((1..objects).map(|seed| {
        let mut other = object.clone();
        other.model.object = format!("made up {seed}");
        other.appearance = made_up(&features, seed as u64);
        other
    }));
    Store::open_or_create(&path)?.put_all(&all)?;
    Ok(path)
}

/// A recording as a camera that never ends, with the instants at which it handed out its frames.
struct Camera {
    frames: Arc<Vec<RgbdFrame>>,
    given: u64,
    start: Instant,
    handed: Arc<Mutex<HashMap<i64, Instant>>>,
}

impl RgbdSource for Camera {
    fn next_frame(&mut self) -> Result<Option<RgbdFrame>, SourceError> {
        let due = Duration::from_secs_f64(self.given as f64 / FRAME_RATE);
        std::thread::sleep(due.saturating_sub(self.start.elapsed()));
        // There and back again, so that nothing jumps.
        let around = 2 * self.frames.len() as u64;
        let i = (self.given % around).min(around - 1 - self.given % around) as usize;
        let mut frame = self.frames[i].clone();
        frame.utime = 1 + due.as_micros() as i64;
        self.given += 1;
        let mut handed = self.handed.lock().unwrap_or_else(PoisonError::into_inner);
        handed.insert(frame.utime, Instant::now());
        Ok(Some(frame))
    }

    fn frame_count(&self) -> Option<usize> {
        None
    }

    fn name(&self) -> &str {
        "bench"
    }

    fn is_live(&self) -> bool {
        true
    }

    fn statistics(&self) -> SourceStatistics {
        SourceStatistics { delivered: self.given, ..SourceStatistics::default() }
    }
}

/// A service in this process.
struct Running {
    stop: Arc<AtomicBool>,
    thread: std::thread::JoinHandle<anyhow::Result<ServiceReport>>,
    handed: Arc<Mutex<HashMap<i64, Instant>>>,
    lcm: Lcm,
    commands: std::cell::Cell<i64>,
}

impl Running {
    fn start(
        recording: &Path,
        store: &Path,
        skill: &SkillConfig,
        stream_hz: Option<f64>,
    ) -> Outcome<Self> {
        let mut source = linkage_driver::open(&recording.display().to_string())?;
        let mut frames = Vec::new();
        while let Some(frame) = source.next_frame()? {
            frames.push(frame);
        }
        let frames = Arc::new(frames);
        let handed = Arc::new(Mutex::new(HashMap::new()));
        let (camera_frames, camera_handed) = (Arc::clone(&frames), Arc::clone(&handed));
        let open = move || {
            Ok(Box::new(Camera {
                frames: Arc::clone(&camera_frames),
                given: 0,
                start: Instant::now(),
                handed: Arc::clone(&camera_handed),
            }) as Box<dyn RgbdSource>)
        };
        let config = ServiceConfig {
            skill: skill.clone(),
            rig: Rig::default(),
            store: store.to_owned(),
            url: URL.to_owned(),
            stream_hz,
            playback: Playback::default(),
        };
        let mut lcm = Lcm::new(URL)?;
        lcm.subscribe(channel::PREDICTION)?;
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = std::thread::spawn(move || Ok(serve(Box::new(open), &config, &stopped)?));
        std::thread::sleep(Duration::from_secs(1));
        Ok(Self { stop, thread, handed, lcm, commands: std::cell::Cell::new(1) })
    }

    fn stop(self) -> Outcome<ServiceReport> {
        self.stop.store(true, Ordering::Relaxed);
        let report = self.thread.join().map_err(|_| anyhow!("the service failed"))?;
        Ok(report?)
    }

    fn tell(&self, action: i8, target: &str) -> Outcome {
        let utime = self.commands.get();
        self.commands.set(utime + 1);
        let target = target.to_owned();
        let command = Command { utime, schema: 1, action, target, ..Default::default() };
        self.lcm.publish(channel::COMMAND, &command)?;
        Ok(())
    }

    /// Waits for a prediction: milliseconds since its frame was handed out.
    fn prediction(&mut self) -> Outcome<Option<f64>> {
        let start = Instant::now();
        while start.elapsed() < PATIENCE {
            let Some(packet) = self.lcm.receive(Duration::from_millis(100))? else { continue };
            let received = Instant::now();
            let prediction: Prediction = decode(&packet.bytes)?;
            let handed = self.handed.lock().unwrap_or_else(PoisonError::into_inner);
            let since = handed.get(&prediction.utime).map(|at| received.duration_since(*at));
            return Ok(since.map(|d| d.as_secs_f64() * 1e3));
        }
        Ok(None)
    }

    fn latency(mut self, objects: usize) -> Outcome<(Self, Latency)> {
        let (mut recognised, mut followed, mut unanswered) = (Vec::new(), Vec::new(), 0);
        for _ in 0..TRIES {
            self.tell(Command::PREDICT, "open")?;
            match self.prediction()? {
                Some(ms) => recognised.push(ms),
                None => unanswered += 1,
            }
            // Until it is followed, the newest frame is the one that it was recognised in.
            std::thread::sleep(SETTLED);
            self.tell(Command::PREDICT, "closed")?;
            match self.prediction()? {
                Some(ms) => followed.push(ms),
                None => unanswered += 1,
            }
            self.tell(Command::CANCEL, "")?;
            std::thread::sleep(Duration::from_millis(100));
        }
        let row = Latency {
            objects,
            recognised: middle_and_end(&mut recognised),
            followed: middle_and_end(&mut followed),
            unanswered,
        };
        Ok((self, row))
    }
}

/// Median and 99th percentile.
fn middle_and_end(values: &mut [f64]) -> [f64; 2] {
    values.sort_by(f64::total_cmp);
    let end = values.len().saturating_sub(1) * 99 / 100;
    [median(&mut values.to_vec()).unwrap_or(0.0), values.get(end).copied().unwrap_or(0.0)]
}

/// Streams while perception follows the object.
fn stream(watched: &Path, store: &Path, config: &SkillConfig) -> Outcome<Streaming> {
    let mut running = Running::start(watched, store, config, Some(STREAM_HZ))?;
    let (start, before) = (Instant::now(), stream_cpu_seconds());
    let mut open = true;
    while start.elapsed() < STREAM_FOR {
        open = !open;
        running.tell(Command::PREDICT, if open { "open" } else { "closed" })?;
        running.prediction()?;
        std::thread::sleep(Duration::from_millis(400));
    }
    let (seconds, cpu) = (start.elapsed().as_secs_f64(), stream_cpu_seconds() - before);
    let report = running.stop()?;
    let kept = report.stream.ok_or_else(|| anyhow!("nothing was streamed"))?;
    let streaming = Streaming {
        setpoints: kept.sent,
        missed_deadlines: kept.lateness.missed(),
        late_us: [
            kept.lateness.quantile_us(0.5),
            kept.lateness.quantile_us(0.99),
            kept.lateness.longest_us(),
        ],
        cpu_share: cpu / seconds,
        frames_a_second: report.frames as f64 / seconds,
    };
    println!(
        "\nstreamed at {STREAM_HZ} Hz for {seconds:.0} s while {:.1} frames a second were followed: {}its thread took {:.2} % of a core",
        streaming.frames_a_second,
        describe_stream(&kept),
        100.0 * streaming.cpu_share
    );
    Ok(streaming)
}

/// Processor time of the thread that streams, seconds, in steps of ten milliseconds.
fn stream_cpu_seconds() -> f64 {
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else { return 0.0 };
    let of = |task: std::fs::DirEntry| {
        let stat = std::fs::read_to_string(task.path().join("stat")).ok()?;
        let (name, rest) = stat.split_once(") ")?;
        let fields: Vec<&str> = rest.split(' ').collect();
        let ticks = |i: usize| fields.get(i)?.parse::<f64>().ok();
        name.ends_with("(stream").then_some((ticks(11)? + ticks(12)?) / 100.0)
    };
    tasks.filter_map(|t| of(t.ok()?)).sum()
}
