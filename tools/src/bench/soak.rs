//! A service that is used for long: a recording is played before it again and again while it is
//! told to learn, to recognise, to predict, to stream, and to another target in the middle of that.
//! In each second round frames stop coming while a joint moves. Meanwhile threads send what is
//! hostile. Its memory must not grow, no setpoint may jump, what moves is braked when no frame comes,
//! and every command is answered.

use super::disturb::Disturbing;
use super::live::{Live, SCENE, STREAM_HZ, URL, filmed, new_store, service};
use super::stall::Stall;
use crate::cli::{BenchArgs, Common};
use crate::outcome::Outcome;
use crate::output::write_json;
use crate::simulate::Take;
use crate::steps::skill_config;
use anyhow::{Context, anyhow};
use linkage_lcm::messages::linkage::{Command, Status};
use linkage_planner_bridge::service::{Playback, ServiceConfig};
use linkage_planner_bridge::{MotionLimits, Rig, channel};
use serde::Serialize;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Recordings of the simulator have 15 frames a second; a camera has 30.
const SPEED: f64 = 2.0;
/// Rows of the table.
const ROWS: u32 = 12;
/// A demonstration takes so long.
const DEMONSTRATION: Duration = Duration::from_secs(6);
/// Longest wait for what a command leads to. On a machine that does much else, learning takes ten
/// seconds.
const TIMEOUT: Duration = Duration::from_secs(60);
/// A joint moves so long before it is told another target or to stop, or frames stop coming.
const MOVING: Duration = Duration::from_millis(400);
/// Frames stop coming for so long: several times the rig's `frame_age`.
const STALL: Duration = Duration::from_secs(2);

/// Up to an instant.
#[derive(Serialize)]
struct Row {
    minutes: f64,
    resident_mib: f64,
    /// Most since the row before, looked at after each command.
    peak_mib: f64,
    frames: i64,
    dropped_frames: i64,
    /// Commands and packets that were refused: hostile ones, or when a round ends before the drawer
    /// was moved.
    refused: i64,
    hostile_datagrams: u64,
    setpoints: u64,
    /// Setpoints that are farther from the one before than the joint's limits allow.
    jumps: u64,
    /// Motions that were braked, each with its reason.
    braked: u64,
    #[serde(flatten)]
    rounds: Rounds,
}

/// What was done and what became of it.
#[derive(Default, Clone, Copy, Serialize)]
struct Rounds {
    /// Rounds of demonstrating, learning, recognising, predicting.
    rounds: u64,
    /// Commands that were not answered in time.
    unanswered: u64,
    /// Longest time from a command to its answer, seconds.
    slowest_answer: f64,
    /// Predictions that were accepted.
    planned: u64,
    /// Of these, while a joint moved.
    retargets: u64,
    /// Times at which frames stopped coming while a joint moved.
    stalls: u64,
    /// Of these, it still moved when they came again.
    ran_on: u64,
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
    let stall = Stall::default();
    let open = stall.opener(Box::new(move || linkage_driver::open(&source)));
    let live = Live::start(open, config, &[])?;
    let disturbing = Disturbing::start(URL, greatest_limits(&Rig::default()))?;
    let rows = Soak { live, stall, disturbing, rounds: Rounds::default(), peak: 0.0 }.run(time)?;
    if let Some(path) = &args.json {
        write_json(path, &rows)?;
    }
    match faults(&rows).as_slice() {
        [] => Ok(()),
        faults => Err(anyhow!("the service is not fit for long use: {}", faults.join("; ")).into()),
    }
}

/// Memory may grow by so much from the first third of the rows to the last one, MiB: caches fill, and the resident
/// memory of a busy process varies by some MiB.
const MOST_GROWTH_MIB: f64 = 48.0;

/// What must not have happened, in words.
fn faults(rows: &[Row]) -> Vec<String> {
    let Some(last) = rows.last() else { return vec!["no row was measured".to_owned()] };
    let third = (rows.len() / 3).max(1);
    let most = |rows: &[Row]| rows.iter().map(|row| row.resident_mib).fold(0.0, f64::max);
    let growth = most(&rows[rows.len() - third..]) - most(&rows[..third]);
    let counted = [
        (last.jumps, "setpoints jumped"),
        (last.rounds.unanswered, "commands were not answered"),
        (last.rounds.ran_on, "motions ran on without frames"),
    ];
    let counted = counted.iter().filter(|(count, _)| *count > 0);
    let grown = (growth > MOST_GROWTH_MIB).then(|| format!("memory grew by {growth:.0} MiB"));
    counted.map(|(count, what)| format!("{count} {what}")).chain(grown).collect()
}

/// The greater of each limit of hinges and of slides: a setpoint does not tell which a joint is.
fn greatest_limits(rig: &Rig) -> MotionLimits {
    let (hinge, slide) = (rig.revolute, rig.prismatic);
    MotionLimits {
        velocity: hinge.velocity.max(slide.velocity),
        acceleration: hinge.acceleration.max(slide.acceleration),
        jerk: hinge.jerk.max(slide.jerk),
    }
}

struct Soak {
    live: Live,
    stall: Stall,
    disturbing: Disturbing,
    rounds: Rounds,
    /// Most memory since the row before.
    peak: f64,
}

impl Soak {
    fn run(mut self, time: Duration) -> Outcome<Vec<Row>> {
        println!("{}", TABLE_HEAD.map(|(name, width)| format!("{name:>width$}")).join(" "));
        let start = Instant::now();
        let mut rows = Vec::<Row>::new();
        while start.elapsed() < time {
            let status = self.round()?;
            if start.elapsed() < time * (rows.len() as u32) / (ROWS - 1) {
                continue;
            }
            let row = self.row(start.elapsed(), &status)?;
            println!("{}", row.line());
            rows.push(row);
        }
        self.live.stop()?;
        Ok(rows)
    }

    fn row(&mut self, elapsed: Duration, status: &Status) -> Outcome<Row> {
        let [hostile_datagrams, setpoints, jumps, braked] = self.disturbing.counts();
        Ok(Row {
            minutes: elapsed.as_secs_f64() / 60.0,
            resident_mib: resident_mib()?,
            peak_mib: std::mem::take(&mut self.peak),
            frames: status.frames,
            dropped_frames: status.dropped_frames,
            refused: status.refused,
            hostile_datagrams,
            setpoints,
            jumps,
            braked,
            rounds: self.rounds,
        })
    }

    /// Everything that a service is told to do, once; its last status.
    fn round(&mut self) -> Outcome<Status> {
        self.live.tell(Command::START_DEMONSTRATION, SCENE, "")?;
        self.wait(DEMONSTRATION)?;
        self.done(Command::FINISH_DEMONSTRATION, "")?;
        self.done(Command::RECOGNISE, "")?;
        for target in ["open", "closed"] {
            let moved = self.disturbing.is_moving();
            let status = self.done(Command::PREDICT, target)?;
            let is_planned = status.is_some_and(|s| s.command_accepted);
            self.rounds.planned += u64::from(is_planned);
            self.rounds.retargets += u64::from(is_planned && moved);
            self.wait(MOVING)?;
        }
        if self.rounds.rounds % 2 == 1 && self.disturbing.is_moving() {
            self.stall.set(true);
            self.wait(STALL)?;
            self.rounds.stalls += 1;
            self.rounds.ran_on += u64::from(self.disturbing.is_moving());
            self.stall.set(false);
        }
        let last = self.done(Command::CANCEL, "")?;
        self.rounds.rounds += 1;
        last.ok_or_else(|| anyhow!("the service answers no more").into())
    }

    /// Tells the service to do something; the status in which that is done.
    fn done(&mut self, action: i8, target: &str) -> Outcome<Option<Status>> {
        let start = Instant::now();
        let done = self.live.have_done(action, target, TIMEOUT)?;
        if done.is_none() {
            tracing::error!(action, target, "a command was not answered");
        }
        let took = start.elapsed().as_secs_f64();
        self.rounds.slowest_answer = self.rounds.slowest_answer.max(took);
        self.rounds.unanswered += u64::from(done.is_none());
        self.peak = self.peak.max(resident_mib()?);
        Ok(done)
    }

    fn wait(&mut self, time: Duration) -> Outcome {
        self.live.receive(channel::STATUS, time, |_: &Status| false)?;
        Ok(())
    }
}

/// The table's columns and their widths.
const TABLE_HEAD: [(&str, usize); 17] = [
    ("minutes", 7),
    ("resident MiB", 12),
    ("peak", 5),
    ("frames", 7),
    ("dropped", 7),
    ("rounds", 6),
    ("refused", 7),
    ("unanswered", 10),
    ("slowest s", 9),
    ("hostile", 7),
    ("setpoints", 9),
    ("jumps", 5),
    ("planned", 7),
    ("retargets", 9),
    ("braked", 6),
    ("stalls", 6),
    ("ran on", 6),
];

impl Row {
    fn line(&self) -> String {
        let Rounds { rounds, unanswered, slowest_answer, planned, retargets, stalls, ran_on } =
            self.rounds;
        [
            format!("{:.1}", self.minutes),
            format!("{:.0}", self.resident_mib),
            format!("{:.0}", self.peak_mib),
            self.frames.to_string(),
            self.dropped_frames.to_string(),
            rounds.to_string(),
            self.refused.to_string(),
            unanswered.to_string(),
            format!("{slowest_answer:.1}"),
            self.hostile_datagrams.to_string(),
            self.setpoints.to_string(),
            self.jumps.to_string(),
            planned.to_string(),
            retargets.to_string(),
            self.braked.to_string(),
            stalls.to_string(),
            ran_on.to_string(),
        ]
        .iter()
        .zip(TABLE_HEAD)
        .map(|(value, (_, width))| format!("{value:>width$}"))
        .collect::<Vec<_>>()
        .join(" ")
    }
}

/// Resident memory of this process, MiB.
fn resident_mib() -> Outcome<f64> {
    let path = "/proc/self/status";
    let status = std::fs::read_to_string(path).context(path)?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"));
    let kib: Option<f64> = line.and_then(|l| l.split_whitespace().next()?.parse().ok());
    Ok(kib.with_context(|| format!("{path} tells no VmRSS"))? / 1024.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(resident_mib: f64) -> Row {
        Row {
            minutes: 1.0,
            resident_mib,
            peak_mib: resident_mib,
            frames: 9,
            dropped_frames: 0,
            refused: 0,
            hostile_datagrams: 0,
            setpoints: 9,
            jumps: 0,
            braked: 0,
            rounds: Rounds::default(),
        }
    }

    #[test]
    fn a_service_whose_memory_is_flat_and_that_answers_has_no_fault() {
        let rows: Vec<Row> = [90.0, 160.0, 150.0, 170.0, 165.0, 172.0].map(row).into();
        assert_eq!(faults(&rows), Vec::<String>::new());
    }

    #[test]
    fn what_must_not_happen_is_a_fault() {
        let rounds = Rounds { unanswered: 2, ran_on: 1, ..Rounds::default() };
        let rows = [row(100.0), row(150.0), Row { jumps: 3, rounds, ..row(260.0) }];
        let told = faults(&rows);
        assert_eq!(told.len(), 4, "{told:?}");
        assert!(told[0].starts_with("3 setpoints") && told[3].contains("grew by 160"), "{told:?}");
        assert_eq!(faults(&[]).len(), 1);
        // However many rows there are.
        for n in 4..9 {
            let rows: Vec<Row> = (0..n).map(|i| row(100.0 + 100.0 * f64::from(i))).collect();
            assert_eq!(faults(&rows).len(), 1, "{n} rows");
        }
    }
}
