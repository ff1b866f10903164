//! Opening a source as the command line asks for it.

use crate::cli::SourceArgs;
use crate::interrupt;
use crate::outcome::{Failure, Outcome};
use linkage_driver::live::host_utime;
use linkage_driver::{
    Awaited, RgbdFrame, RgbdSource, SourceError, SourceOptions, SourceStatistics, Timeline,
    TimestampFilter,
};
use linkage_skill::recognise::StillFrames;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Frames that a live camera gives before its exposure has settled.
const SETTLING: usize = 5;

/// How often it is told that a live camera is silent.
const TOLD_EVERY: Duration = Duration::from_secs(5);
/// Longest wait for a frame before the thread checks whether it is to stop.
const POLL: Duration = Duration::from_millis(100);

/// Opens a source. A signal ends it, as if it were a recording that is over; what that means is
/// told by [`interrupt::stopped`].
pub fn open(name: &str, take: &SourceArgs) -> Outcome<Taken> {
    let camera = take.camera.as_deref().map(linkage_driver::read_camera_file).transpose()?;
    if take.seconds.is_some_and(|s| !(s.is_finite() && s > 0.0)) {
        return Err(anyhow::anyhow!("--seconds must be above 0").into());
    }
    let stop = interrupt::watch();
    let options = SourceOptions { camera, stop: Arc::clone(&stop), ..Default::default() };
    let source = linkage_driver::open_with(name, &options)?;
    // A recording ends by its own stamps, a live camera by the clock too: it may be silent.
    let deadline = take
        .seconds
        .filter(|_| source.is_live())
        .and_then(|s| Instant::now().checked_add(Duration::try_from_secs_f64(s).ok()?));
    Ok(Taken {
        source,
        take: take.clone(),
        stop,
        deadline,
        timestamps: TimestampFilter::new(Timeline::Continuous),
        taken: 0,
        first_utime: None,
    })
}

/// The part of a source that is asked for.
pub struct Taken {
    source: Box<dyn RgbdSource>,
    take: SourceArgs,
    stop: Arc<AtomicBool>,
    /// When no frame is waited for any more.
    deadline: Option<Instant>,
    /// Keeps a live camera's times in order where its clock begins again.
    timestamps: TimestampFilter,
    taken: usize,
    first_utime: Option<i64>,
}

impl Taken {
    /// The last frame of a recording; of a live camera, the first one that is well exposed. Where a
    /// signal cut a recording short, its status is told instead.
    pub fn last_frame(&mut self) -> Outcome<RgbdFrame> {
        let mut last = None;
        self.watch(|frame| last = Some(frame))?;
        last.ok_or_else(|| Failure::no_answer(format!("{}: no frame", self.name())))
    }

    /// The frames up to that frame since the camera last moved; at least one.
    pub fn still_frames(&mut self) -> Outcome<StillFrames> {
        let mut still = StillFrames::default();
        self.watch(|frame| still.push(frame))?;
        if still.is_empty() {
            return Err(Failure::no_answer(format!("{}: no frame", self.name())));
        }
        Ok(still)
    }

    /// Hands on each frame that [`Taken::last_frame`] chooses from.
    fn watch(&mut self, mut take: impl FnMut(RgbdFrame)) -> Outcome<()> {
        if self.source.is_live() && self.take.frames.is_none() && self.take.seconds.is_none() {
            self.take.frames = Some(SETTLING);
        }
        while let Some(frame) = self.next_frame()? {
            take(frame);
        }
        interrupt::stopped(self.name(), self.is_live())
    }

    /// The next frame of the source; `None` at its end, at the deadline, or when interrupted.
    fn await_frame(&mut self) -> Result<Option<RgbdFrame>, SourceError> {
        if !self.source.is_live() {
            return self.source.next_frame();
        }
        let mut silent_since = Instant::now();
        let mut told = silent_since;
        while !self.stop.load(Ordering::Relaxed) {
            let left = self.deadline.map(|d| d.saturating_duration_since(Instant::now()));
            if left.is_some_and(|left| left.is_zero()) {
                return Ok(None);
            }
            match self.source.next_frame_within(left.unwrap_or(POLL).min(POLL))? {
                Awaited::End => return Ok(None),
                Awaited::Frame(frame) => {
                    if let Some(frame) = self.timestamps.pass(frame, host_utime()) {
                        return Ok(Some(frame));
                    }
                    silent_since = Instant::now();
                }
                Awaited::Nothing if told.elapsed() >= TOLD_EVERY => {
                    told = Instant::now();
                    let seconds = silent_since.elapsed().as_secs();
                    let source = self.source.name();
                    let damaged = self.source.statistics().damaged;
                    tracing::warn!(
                        source,
                        damaged,
                        "no frame for {seconds} s: does anything send?"
                    );
                }
                Awaited::Nothing => {}
            }
        }
        Ok(None)
    }
}

impl RgbdSource for Taken {
    fn next_frame(&mut self) -> Result<Option<RgbdFrame>, SourceError> {
        let enough = self.take.frames.is_some_and(|n| self.taken >= n);
        if enough || self.stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let Some(frame) = self.await_frame()? else { return Ok(None) };
        let first = *self.first_utime.get_or_insert(frame.utime);
        if self.take.seconds.is_some_and(|s| (frame.utime - first) as f64 * 1e-6 > s) {
            return Ok(None);
        }
        self.taken += 1;
        Ok(Some(frame))
    }

    fn frame_count(&self) -> Option<usize> {
        match (self.source.frame_count(), self.take.frames) {
            (Some(count), Some(limit)) => Some(count.min(limit)),
            (count, limit) => count.or(limit),
        }
    }

    fn name(&self) -> &str {
        self.source.name()
    }

    fn is_live(&self) -> bool {
        self.source.is_live()
    }

    fn statistics(&self) -> SourceStatistics {
        self.source.statistics()
    }
}

/// What was lost, in words; `None` when nothing was.
pub fn losses(s: &SourceStatistics) -> Option<String> {
    let counts = [
        (s.dropped, "dropped, for they came faster than they were taken"),
        (
            s.missing,
            "sent and not arrived: the network or its receive buffer lost them, or they were too large",
        ),
        (s.unpaired, "pictures without a partner in time, or without a time"),
        (s.damaged, "damaged"),
        (s.out_of_order, "repeated or out of order"),
    ];
    told(&counts, ", ")
}

/// Which time stamps were not used as they are, in words; `None` where all were.
pub fn repairs(s: &SourceStatistics) -> Option<String> {
    let counts = [
        (s.restamped, "frames had a stamp that cannot be and count by their arrival"),
        (s.reconnections, "times the camera was opened again or its clock began again"),
    ];
    told(&counts, "; ")
}

/// What happened at all, with how often; `None` where nothing did.
fn told(counts: &[(u64, &str)], separator: &str) -> Option<String> {
    let words: Vec<String> = counts
        .iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, what)| format!("{count} {what}"))
        .collect();
    (!words.is_empty()).then(|| words.join(separator))
}
