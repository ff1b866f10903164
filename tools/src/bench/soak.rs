//! A service that is used for long: a recording is played before it again and again while it is
//! told to learn, to recognise, to predict, to stream, and to another target in the middle of that.
//! Meanwhile a thread sends invalid datagrams. Its memory must not grow, no setpoint may jump, and
//! every command is answered.

use super::disturb::Disturbing;
use super::live::{Live, SCENE, STREAM_HZ, URL, filmed, new_store, service};
use crate::cli::{BenchArgs, Common};
use crate::outcome::Outcome;
use crate::output::write_json;
use crate::simulate::Take;
use crate::steps::skill_config;
use anyhow::{Context, anyhow};
use linkage_lcm::messages::linkage::{Command, Status};
use linkage_planner_bridge::service::{Playback, ServiceConfig};
use linkage_planner_bridge::{Rig, channel};
use serde::Serialize;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Recordings of the simulator have 15 frames a second; a camera has 30.
const SPEED: f64 = 2.0;
/// Rows of the table.
const ROWS: u32 = 12;
/// A demonstration takes so long.
const DEMONSTRATION: Duration = Duration::from_secs(6);
/// Longest wait for what a command leads to.
const TIMEOUT: Duration = Duration::from_secs(8);

/// Up to an instant.
#[derive(Serialize)]
struct Row {
    minutes: f64,
    resident_mib: f64,
    /// Most since the row before, looked at after each command.
    peak_mib: f64,
    frames: i64,
    dropped_frames: i64,
    /// Rounds of demonstrating, learning, recognising, predicting.
    rounds: u64,
    /// Commands and packets that were refused: hostile ones, or when a round ends before the drawer
    /// was moved.
    refused: i64,
    /// Commands that were not answered in time.
    unanswered: u64,
    hostile_datagrams: u64,
    setpoints: u64,
    /// Setpoints farther from the one before than the joint may go.
    jumps: u64,
}

pub fn run(args: &BenchArgs, common: &Common) -> Outcome {
    let time = Duration::try_from_secs_f64(60.0 * args.minutes).context("--minutes")?;
    let work = args.dir.clone().unwrap_or_else(|| PathBuf::from("out/soak"));
    let watched = filmed(SCENE, Take::Demonstration, work.join(SCENE), common.quiet)?;
    let config = ServiceConfig {
        stream_hz: Some(STREAM_HZ),
        playback: Playback { rate: SPEED, repeat: true },
        ..service(&new_store(work.join("objects.linkage"))?, &skill_config(common)?)
    };
    let source = watched.display().to_string();
    let open = Box::new(move || linkage_driver::open(&source));
    let rows = soak(Live::start(open, config, &[])?, time)?;
    if let Some(path) = &args.json {
        write_json(path, &rows)?;
    }
    Ok(())
}

fn soak(mut live: Live, time: Duration) -> Outcome<Vec<Row>> {
    println!(
        "minutes  resident MiB   peak   frames  dropped  rounds  refused  unanswered  hostile  setpoints  jumps"
    );
    let disturbing = Disturbing::start(URL, Rig::default().prismatic.velocity)?;
    let mut unanswered = 0;
    let start = Instant::now();
    let (mut rows, mut rounds, mut peak) = (Vec::<Row>::new(), 0, 0.0_f64);
    while start.elapsed() < time {
        let status = round(&mut live, &mut peak, &mut unanswered)?;
        rounds += 1;
        if start.elapsed() < time * (rows.len() as u32) / (ROWS - 1) {
            continue;
        }
        let [hostile_datagrams, setpoints, jumps] = disturbing.counts();
        let row = Row {
            minutes: start.elapsed().as_secs_f64() / 60.0,
            resident_mib: resident_mib()?,
            peak_mib: std::mem::take(&mut peak),
            frames: status.frames,
            dropped_frames: status.dropped_frames,
            rounds,
            refused: status.refused,
            unanswered,
            hostile_datagrams,
            setpoints,
            jumps,
        };
        println!(
            "{:>7.1} {:>13.0} {:>6.0} {:>8} {:>8} {:>7} {:>8} {:>11} {:>8} {:>10} {:>6}",
            row.minutes,
            row.resident_mib,
            row.peak_mib,
            row.frames,
            row.dropped_frames,
            row.rounds,
            row.refused,
            row.unanswered,
            row.hostile_datagrams,
            row.setpoints,
            row.jumps
        );
        rows.push(row);
    }
    live.stop()?;
    Ok(rows)
}

/// Everything that a service is told to do, once; its last status.
fn round(live: &mut Live, peak: &mut f64, unanswered: &mut u64) -> Outcome<Status> {
    live.tell(Command::START_DEMONSTRATION, SCENE, "")?;
    live.receive(channel::STATUS, DEMONSTRATION, |_: &Status| false)?;
    let mut last = None;
    for (action, target) in [
        (Command::FINISH_DEMONSTRATION, ""),
        (Command::RECOGNISE, ""),
        (Command::PREDICT, "open"),
        (Command::PREDICT, "closed"),
        (Command::CANCEL, ""),
    ] {
        let command = live.tell(action, "", target)?;
        let done = live.done(command, TIMEOUT)?;
        *unanswered += u64::from(done.is_none());
        last = done.or(last);
        *peak = peak.max(resident_mib()?);
    }
    last.ok_or_else(|| anyhow!("the service answers no more").into())
}

/// Resident memory of this process, MiB.
fn resident_mib() -> Outcome<f64> {
    let path = "/proc/self/status";
    let status = std::fs::read_to_string(path).context(path)?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"));
    let kib: Option<f64> = line.and_then(|l| l.split_whitespace().next()?.parse().ok());
    Ok(kib.with_context(|| format!("{path} tells no VmRSS"))? / 1024.0)
}
