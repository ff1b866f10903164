//! Latencies of the live skill: from the end of a demonstration to its model on the wire; from a
//! frame to its prediction there, with few and with many objects known; and how well the stream of
//! setpoints keeps its time while perception works.

use super::live::{Live, Playing, SCENE, STREAM_HZ, filmed, new_store, service};
use super::recognise::scale::made_up;
use crate::cli::{BenchArgs, Common};
use crate::outcome::Outcome;
use crate::output::write_json;
use crate::report::describe_stream;
use crate::simulate::Take;
use crate::steps::{demonstrate, remember, skill_config};
use anyhow::anyhow;
use linkage_lcm::messages::linkage::{Command, Model, Prediction};
use linkage_planner_bridge::channel;
use linkage_planner_bridge::service::ServiceConfig;
use linkage_skill::SkillConfig;
use linkage_skill::internals::{ModelFeature, median};
use linkage_skill::object::StoredObject;
use linkage_skill::store::Store;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Things of one, two and three joints, learned live.
const DEMONSTRATED: [&str; 3] = [SCENE, "office_chair", "bicycle"];
/// Objects that are known.
const SIZES: [usize; 3] = [1, 100, 1000];
/// Predictions a size.
const TRIES: usize = 30;
/// Time for which setpoints are streamed.
const STREAM_FOR: Duration = Duration::from_secs(60);
/// Longest wait for an answer.
const TIMEOUT: Duration = Duration::from_secs(8);

/// A demonstration that was learned while it went on.
#[derive(Serialize)]
struct Learning {
    object: String,
    joints: usize,
    /// Best models so far, a second.
    guesses_a_second: f64,
    /// From the command to finish until the model was on the wire.
    finish_s: f64,
}

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
    let demonstrated =
        |scene: &str| filmed(scene, Take::Demonstration, work.join(scene), common.quiet);
    println!(
        "a demonstration at 30 Hz: joints, guesses a second, from the command to finish it to its model on the wire"
    );
    let mut learnings = Vec::new();
    for scene in DEMONSTRATED {
        let row = learn(scene, &demonstrated(scene)?, &work, &config)?;
        println!(
            "{:<12} {} {:>10.1} {:>10.2} s",
            row.object, row.joints, row.guesses_a_second, row.finish_s
        );
        learnings.push(row);
    }

    let watched = demonstrated(SCENE)?;
    let source = watched.display().to_string();
    let demonstration = demonstrate(&source, SCENE, &config, common.quiet)?;
    let object = remember(None, &demonstration, &source, &config)?;
    let met =
        Playing::read(&filmed(SCENE, Take::Encounter, work.join("encounter"), common.quiet)?)?;
    println!("\nfrom a frame to its prediction on the wire, milliseconds");
    println!("objects   recognised: median   p99   followed: median   p99   unanswered");
    let mut latencies = Vec::new();
    for objects in SIZES {
        let row = latency(&met, service(&store_of(&work, &object, objects)?, &config), objects)?;
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
    let streaming =
        stream(&Playing::read(&watched)?, service(&store_of(&work, &object, 1)?, &config))?;
    if let Some(path) = &args.json {
        let report = serde_json::json!({
            "learning": learnings, "latency": latencies, "stream": streaming
        });
        write_json(path, &report)?;
    }
    Ok(())
}

fn learn(scene: &str, take: &Path, work: &Path, config: &SkillConfig) -> Outcome<Learning> {
    let playing = Playing::read(take)?;
    let store = new_store(work.join(format!("learned-{scene}.linkage")))?;
    let start = Instant::now();
    let mut live = Live::start(playing.opener(), service(&store, config), &[channel::MODEL])?;
    live.tell(Command::START_DEMONSTRATION, scene, "")?;
    let mut guesses = 0;
    let rest = playing.length().saturating_sub(start.elapsed());
    live.receive(channel::MODEL, rest, |_: &Model| {
        guesses += 1;
        false
    })?;
    let finish = Instant::now();
    live.tell(Command::FINISH_DEMONSTRATION, "", "")?;
    let model = live.receive(channel::MODEL, TIMEOUT, |m: &Model| m.demonstrations > 0)?;
    let finish_s = finish.elapsed().as_secs_f64();
    live.stop()?;
    let model = model.ok_or_else(|| anyhow!("{scene} was not learned"))?;
    let guesses_a_second = f64::from(guesses) / rest.as_secs_f64();
    Ok(Learning { object: model.object, joints: model.joints.len(), guesses_a_second, finish_s })
}

/// Time after which an object that was recognised is followed.
const SETTLED: Duration = Duration::from_millis(400);

/// A store of the learned object among synthetic ones.
fn store_of(work: &Path, object: &StoredObject, objects: usize) -> Outcome<PathBuf> {
    let path = new_store(work.join(format!("objects-{objects}.linkage")))?;
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

/// Waits for a prediction: milliseconds since its frame was handed out.
fn prediction(live: &mut Live, playing: &Playing) -> Outcome<Option<f64>> {
    let prediction = live.receive(channel::PREDICTION, TIMEOUT, |_: &Prediction| true)?;
    let handed_out = prediction.and_then(|p| playing.handed_out(p.utime));
    Ok(handed_out.map(|at| at.elapsed().as_secs_f64() * 1e3))
}

fn latency(met: &Playing, config: ServiceConfig, objects: usize) -> Outcome<Latency> {
    let mut live = Live::start(met.opener(), config, &[channel::PREDICTION])?;
    let (mut recognised, mut followed, mut unanswered) = (Vec::new(), Vec::new(), 0);
    for _ in 0..TRIES {
        live.tell(Command::PREDICT, "", "open")?;
        match prediction(&mut live, met)? {
            Some(ms) => recognised.push(ms),
            None => unanswered += 1,
        }
        // Until it is followed, the newest frame is the one that it was recognised in.
        std::thread::sleep(SETTLED);
        live.tell(Command::PREDICT, "", "closed")?;
        match prediction(&mut live, met)? {
            Some(ms) => followed.push(ms),
            None => unanswered += 1,
        }
        live.tell(Command::CANCEL, "", "")?;
        std::thread::sleep(Duration::from_millis(100));
    }
    live.stop()?;
    Ok(Latency {
        objects,
        recognised: middle_and_end(&mut recognised),
        followed: middle_and_end(&mut followed),
        unanswered,
    })
}

/// Median and 99th percentile.
fn middle_and_end(values: &mut [f64]) -> [f64; 2] {
    values.sort_by(f64::total_cmp);
    let end = values.len().saturating_sub(1) * 99 / 100;
    [median(&mut values.to_vec()).unwrap_or(0.0), values.get(end).copied().unwrap_or(0.0)]
}

/// Streams while perception follows the object.
fn stream(watched: &Playing, config: ServiceConfig) -> Outcome<Streaming> {
    let config = ServiceConfig { stream_hz: Some(STREAM_HZ), ..config };
    let mut live = Live::start(watched.opener(), config, &[channel::PREDICTION])?;
    let (start, before) = (Instant::now(), stream_cpu_seconds());
    let mut open = true;
    while start.elapsed() < STREAM_FOR {
        open = !open;
        live.tell(Command::PREDICT, "", if open { "open" } else { "closed" })?;
        prediction(&mut live, watched)?;
        std::thread::sleep(Duration::from_millis(400));
    }
    let (seconds, cpu) = (start.elapsed().as_secs_f64(), stream_cpu_seconds() - before);
    let report = live.stop()?;
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
