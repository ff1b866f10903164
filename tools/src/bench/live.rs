//! A live service in this process, the camera in front of it, and what talks to it over LCM.

use crate::outcome::Outcome;
use crate::simulate::Take;
use crate::steps::{FilmOrder, film};
use anyhow::{Context, anyhow};
use linkage_driver::{RgbdFrame, RgbdSource, SourceError, SourceStatistics};
use linkage_lcm::messages::linkage::{Command, Status};
use linkage_lcm::{Lcm, Message, decode};
use linkage_planner_bridge::client::addressed;
use linkage_planner_bridge::service::{
    Playback, ServiceConfig, ServiceReport, SourceOpener, serve,
};
use linkage_planner_bridge::{Rig, channel};
use linkage_skill::SkillConfig;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A network of its own.
pub const URL: &str = "udpm://239.255.76.67:7697?ttl=0";
/// What is learned and met again.
pub const SCENE: &str = "drawer";
/// Setpoints a second.
pub const STREAM_HZ: f64 = 200.0;
const SEED: u64 = 1;
/// Frames a second.
const FRAME_RATE: f64 = 30.0;
/// Number of first frames in which nothing moves, so that a command can be given.
const STILL: u64 = 45;
/// Time after which a command that is not finished is sent again.
const AGAIN_AFTER: Duration = Duration::from_millis(500);
/// Frames whose instants are remembered.
const REMEMBERED: usize = 600;

/// Renders a take of a scene into a folder, unless it is there already.
pub fn filmed(scene: &str, take: Take, dir: PathBuf, is_quiet: bool) -> Outcome<PathBuf> {
    if !dir.join("truth.json").exists() {
        film(&FilmOrder::of(scene, take, SEED), &dir, is_quiet)?;
    }
    Ok(dir)
}

/// A store that is not there yet.
pub fn new_store(path: PathBuf) -> Outcome<PathBuf> {
    if path.exists() {
        std::fs::remove_file(&path).with_context(|| path.display().to_string())?;
    }
    Ok(path)
}

/// A service that knows a store.
pub fn service(store: &Path, skill: &SkillConfig) -> ServiceConfig {
    ServiceConfig {
        skill: skill.clone(),
        rig: Rig::default(),
        store: store.to_owned(),
        url: URL.to_owned(),
        stream_hz: None,
        playback: Playback::default(),
    }
}

/// A recording before a camera that never ends: there and back again, so that nothing jumps.
#[derive(Clone)]
pub struct Playing {
    frames: Arc<Vec<RgbdFrame>>,
    clock: Arc<Clock>,
}

/// The instants at which frames were handed out, by their `utime`.
#[derive(Default)]
struct Clock(Mutex<BTreeMap<i64, Instant>>);

impl Clock {
    fn frames(&self) -> MutexGuard<'_, BTreeMap<i64, Instant>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn handed_out(&self, utime: i64) {
        let mut frames = self.frames();
        frames.insert(utime, Instant::now());
        if frames.len() > REMEMBERED {
            frames.pop_first();
        }
    }
}

impl Playing {
    pub fn read(recording: &Path) -> Outcome<Self> {
        let mut source = linkage_driver::open(&recording.display().to_string())?;
        let mut frames = Vec::new();
        while let Some(frame) = source.next_frame()? {
            frames.push(frame);
        }
        Ok(Self { frames: Arc::new(frames), clock: Arc::default() })
    }

    pub fn opener(&self) -> Box<SourceOpener> {
        let playing = self.clone();
        Box::new(move || {
            // Its time begins anew.
            playing.clock.frames().clear();
            let start = Instant::now();
            Ok(Box::new(Camera { playing: playing.clone(), given: 0, start }) as Box<_>)
        })
    }

    /// Time from the first frame until the last frame of the recording was handed out once.
    pub fn length(&self) -> Duration {
        Duration::from_secs_f64((STILL + self.frames.len() as u64) as f64 / FRAME_RATE)
    }

    /// When a frame was handed out, if it was one of the newest.
    pub fn handed_out(&self, utime: i64) -> Option<Instant> {
        self.clock.frames().get(&utime).copied()
    }
}

struct Camera {
    playing: Playing,
    given: u64,
    start: Instant,
}

impl RgbdSource for Camera {
    fn next_frame(&mut self) -> Result<Option<RgbdFrame>, SourceError> {
        let due = Duration::from_secs_f64(self.given as f64 / FRAME_RATE);
        std::thread::sleep(due.saturating_sub(self.start.elapsed()));
        let frames = &self.playing.frames;
        let around = 2 * frames.len() as u64;
        let played = self.given.saturating_sub(STILL) % around;
        let mut frame = frames[played.min(around - 1 - played) as usize].clone();
        frame.utime = 1 + due.as_micros() as i64;
        self.given += 1;
        self.playing.clock.handed_out(frame.utime);
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

/// A service that runs.
pub struct Live {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<anyhow::Result<ServiceReport>>,
    lcm: Lcm,
    session: i64,
}

impl Live {
    /// Starts one and waits until it tells its status; `channels` can be received from then on.
    pub fn start(
        open: Box<SourceOpener>,
        config: ServiceConfig,
        channels: &[&str],
    ) -> Outcome<Self> {
        let mut lcm = Lcm::new(&config.url)?;
        for channel in channels.iter().chain([&channel::STATUS]) {
            lcm.subscribe(channel)?;
        }
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = std::thread::spawn(move || Ok(serve(open, &config, &stopped)?));
        let mut live = Self { stop, thread, lcm, session: 0 };
        match live.receive::<Status>(channel::STATUS, Duration::from_secs(20), |_| true)? {
            Some(status) => live.session = status.session,
            None => {
                live.stop()?;
                return Err(anyhow!("the service told nothing").into());
            }
        }
        Ok(live)
    }

    pub fn stop(self) -> Outcome<ServiceReport> {
        self.stop.store(true, Ordering::Relaxed);
        let report = self.thread.join().map_err(|_| anyhow!("the service failed"))?;
        Ok(report?)
    }

    /// Sends a command; its name.
    pub fn tell(&mut self, action: i8, object: &str, target: &str) -> Outcome<i64> {
        let command = self.command(action, object, target);
        self.lcm.publish(channel::COMMAND, &command)?;
        Ok(command.utime)
    }

    /// Sends a command until it is finished, as any client does: datagrams may be lost. The status in
    /// which it is.
    pub fn have_done(
        &mut self,
        action: i8,
        target: &str,
        timeout: Duration,
    ) -> Outcome<Option<Status>> {
        let command = self.command(action, "", target);
        let start = Instant::now();
        while start.elapsed() < timeout {
            self.lcm.publish(channel::COMMAND, &command)?;
            let done = self.done(command.utime, AGAIN_AFTER)?;
            if done.is_some() {
                return Ok(done);
            }
        }
        Ok(None)
    }

    fn command(&self, action: i8, object: &str, target: &str) -> Command {
        let (object, target) = (object.to_owned(), target.to_owned());
        addressed(&Command { action, object, target, ..Command::default() }, self.session)
    }

    /// The status in which a command is finished.
    pub fn done(&mut self, command: i64, timeout: Duration) -> Outcome<Option<Status>> {
        self.receive(channel::STATUS, timeout, |s: &Status| {
            s.command_utime == command && s.command_done
        })
    }

    /// The next message of a channel that is as wanted, if one comes in time.
    pub fn receive<M: Message>(
        &mut self,
        channel: &str,
        timeout: Duration,
        mut wanted: impl FnMut(&M) -> bool,
    ) -> Outcome<Option<M>> {
        let start = Instant::now();
        while start.elapsed() < timeout {
            let packet = self.lcm.receive(Duration::from_millis(100))?;
            let Some(packet) = packet.filter(|p| p.channel == channel) else { continue };
            let message: M = decode(&packet.bytes)?;
            if wanted(&message) {
                return Ok(Some(message));
            }
        }
        Ok(None)
    }
}
