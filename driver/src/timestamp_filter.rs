//! Corrects the time stamps of frames so that they increase.
//!
//! A stamp is compared with those of the frames before it and with the times at which the frames
//! arrived. One wrong stamp must not block the frames after it, and a sender's clock that restarts must
//! not end a source.

use crate::statistics::SourceStatistics;
use linkage_frames::frame::RgbdFrame;

/// How stamps continue after the sender's clock has restarted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Timeline {
    /// Stamps stay as they are sent: time may step back once.
    AsSent,
    /// Stamps keep increasing: those after the restart are shifted.
    Continuous,
}

/// A step back in time this long is no wrong order but a restart of the clock, microseconds.
const CLOCK_RESTART_US: i64 = 1_000_000;
/// A step ahead up to this long is accepted whenever the frames arrived, microseconds.
const PAUSE_US: i64 = 3_000_000;
/// Arrivals up to this far apart are accepted, microseconds.
const LONG_PAUSE_US: i64 = 10_000_000;
/// Largest difference between a long pause by the stamps and by the arrivals, in addition to a tenth of
/// the pause, microseconds.
const DISAGREEMENT_US: i64 = 1_000_000;
/// Stamps that advance this many times slower or faster than the frames arrive are in another unit.
const OTHER_UNIT: i64 = 200;
/// Arrivals at least this far apart tell how fast stamps must advance, microseconds. A recording that is
/// sent as fast as it can be has shorter pauses.
const SHORTEST_PAUSE_US: i64 = 5_000;
/// This many frames in a row whose stamps advance in another unit are believed. A single one happens where
/// a network was held up.
const OTHER_UNIT_IN_A_ROW: usize = 3;
/// This many frames in a row that are earlier than the last one, but in order among themselves, mean a
/// restart of the clock too.
const BEHIND_IN_A_ROW: usize = 3;
/// Time between frames where the stamps give none, microseconds.
const DEFAULT_PERIOD_US: i64 = 33_333;
/// Stamps that can be times: above 0, which means no time, and before the year 2096.
const TIMES_US: std::ops::Range<i64> = 1..4_000_000_000_000_000;

/// Corrects stamps and counts what was corrected.
#[derive(Debug, Clone)]
pub struct TimestampFilter {
    timeline: Timeline,
    /// Added to stamps.
    shift_us: i64,
    last: Option<Last>,
    /// The frame before, if its stamp jumped: the first after a restart, or a single wrong stamp.
    jumped: Option<Stamped>,
    behind: Behind,
    pace: Pace,
    first_utime: i64,
    passed: u64,
    /// The counts.
    pub statistics: SourceStatistics,
}

/// The last frame that passed.
#[derive(Debug, Clone, Copy)]
struct Last {
    utime: i64,
    arrival: i64,
    /// Time from the frame before.
    period: i64,
}

/// A stamp, and the time that its frame was given.
#[derive(Debug, Clone, Copy)]
struct Stamped {
    stamp: i64,
    utime: i64,
}

/// Frames in a row that lie a little behind the last one.
#[derive(Debug, Clone, Copy, Default)]
struct Behind {
    stamp: i64,
    count: usize,
}

/// How fast the stamps advance beside the arrivals.
#[derive(Debug, Clone, Copy, Default)]
struct Pace {
    stamp: i64,
    arrival: i64,
    /// Frames in a row whose stamp advanced in another unit.
    wrong_in_a_row: usize,
}

impl Pace {
    /// Looks at a stamp: whether it and those before it advance in another unit than microseconds.
    fn is_wrong(&mut self, stamp: i64, arrival: i64) -> bool {
        let step = stamp.saturating_sub(self.stamp);
        let pause = arrival.saturating_sub(self.arrival);
        let comparable = step > 0 && (SHORTEST_PAUSE_US..=LONG_PAUSE_US).contains(&pause);
        let differs = step.saturating_mul(OTHER_UNIT) < pause || step / OTHER_UNIT > pause;
        let wrong_in_a_row = if comparable && differs { self.wrong_in_a_row + 1 } else { 0 };
        if wrong_in_a_row == OTHER_UNIT_IN_A_ROW {
            tracing::warn!(
                "the stamps advance by {step} from frame to frame while the frames arrive {pause} µs apart: \
                 stamps must be microseconds; the times of arrival are used"
            );
        }
        *self = Self { stamp, arrival, wrong_in_a_row };
        wrong_in_a_row >= OTHER_UNIT_IN_A_ROW
    }
}

impl TimestampFilter {
    /// A filter that has seen no frame.
    pub fn new(timeline: Timeline) -> Self {
        Self {
            timeline,
            shift_us: 0,
            last: None,
            jumped: None,
            behind: Behind::default(),
            pace: Pace::default(),
            first_utime: 0,
            passed: 0,
            statistics: SourceStatistics::default(),
        }
    }

    /// A frame that is later than the one before it, with its corrected time; `None` for others.
    /// `arrival` is when it was received, microseconds of a clock that never restarts.
    pub fn pass(&mut self, mut frame: RgbdFrame, arrival: i64) -> Option<RgbdFrame> {
        let utime = self.time(frame.utime, arrival);
        let Some(utime) = utime else {
            self.statistics.out_of_order += 1;
            return None;
        };
        let period = self.last.map_or(DEFAULT_PERIOD_US, |last| {
            let step = utime.saturating_sub(last.utime);
            if (1..=LONG_PAUSE_US).contains(&step) { step } else { last.period }
        });
        self.last = Some(Last { utime, arrival, period });
        if self.passed == 0 {
            self.first_utime = utime;
        }
        self.passed += 1;
        if utime > self.first_utime {
            let seconds = utime.saturating_sub(self.first_utime) as f64 * 1e-6;
            self.statistics.rate_hz = (self.passed - 1) as f64 / seconds;
        }
        self.statistics.invalid_depth = frame.depth.invalid_share();
        frame.utime = utime;
        Some(frame)
    }

    /// The time of a frame; `None` for one that is repeated or out of order.
    fn time(&mut self, stamp: i64, arrival: i64) -> Option<i64> {
        let in_another_unit = self.pace.is_wrong(stamp, arrival);
        let Some(last) = self.last else { return Some(self.first_time(stamp, arrival)) };
        if in_another_unit || !TIMES_US.contains(&stamp) {
            self.statistics.restamped += 1;
            self.jumped = None;
            return Some(last.utime.saturating_add(last.since(arrival)));
        }
        let time = stamp.saturating_add(self.shift_us);
        let step = time.saturating_sub(last.utime);
        if step <= 0 && step > -CLOCK_RESTART_US {
            return self.a_little_behind(stamp, last, arrival);
        }
        self.behind = Behind::default();
        let pause = arrival.saturating_sub(last.arrival);
        let agrees = step.saturating_sub(pause).saturating_abs() < DISAGREEMENT_US + step / 10;
        if step > 0 && (step <= PAUSE_US || agrees) {
            self.jumped = None;
            return Some(time);
        }
        Some(self.jump(stamp, last, arrival))
    }

    /// The first frame's time: its stamp, or where that is none its arrival.
    fn first_time(&mut self, stamp: i64, arrival: i64) -> i64 {
        if TIMES_US.contains(&stamp) || !TIMES_US.contains(&arrival) {
            return stamp.clamp(0, TIMES_US.end);
        }
        self.statistics.restamped += 1;
        arrival
    }

    /// A frame not later than the last one is left out, unless those before it were so too and
    /// it goes on from them.
    fn a_little_behind(&mut self, stamp: i64, last: Last, arrival: i64) -> Option<i64> {
        let goes_on = self.behind.count > 0 && stamp > self.behind.stamp;
        let count = if goes_on { self.behind.count + 1 } else { 1 };
        self.behind = Behind { stamp, count };
        if count < BEHIND_IN_A_ROW {
            return None;
        }
        self.behind = Behind::default();
        let utime = last.utime.saturating_add(last.since(arrival));
        Some(self.restart_clock(stamp, Stamped { stamp, utime }))
    }

    /// A stamp far from those before it: the frame's time is computed from its arrival, and if the
    /// next stamp continues from this one, the clock has restarted.
    fn jump(&mut self, stamp: i64, last: Last, arrival: i64) -> i64 {
        let goes_on = |before: &Stamped| (1..=LONG_PAUSE_US).contains(&(stamp - before.stamp));
        if let Some(before) = self.jumped.take().filter(goes_on) {
            return self.restart_clock(stamp, before);
        }
        self.statistics.restamped += 1;
        let utime = last.utime.saturating_add(last.since(arrival));
        self.jumped = Some(Stamped { stamp, utime });
        utime
    }

    /// Continues with a clock that has restarted, by one of its stamps and the corrected time of that
    /// stamp.
    fn restart_clock(&mut self, stamp: i64, known: Stamped) -> i64 {
        self.statistics.reconnections += 1;
        self.jumped = None;
        self.shift_us = match self.timeline {
            Timeline::AsSent => 0,
            Timeline::Continuous => known.utime.saturating_sub(known.stamp),
        };
        if self.timeline == Timeline::AsSent {
            // The rate is measured anew.
            self.passed = 0;
        }
        stamp.saturating_add(self.shift_us)
    }
}

impl Last {
    /// Time from the last frame to an arrival; a period where that is not plausible.
    fn since(&self, arrival: i64) -> i64 {
        let pause = arrival.saturating_sub(self.arrival);
        if (1..=LONG_PAUSE_US).contains(&pause) { pause } else { self.period }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_frames::camera::PinholeCamera;
    use linkage_frames::frame::{ColorImage, DepthImage};
    use proptest::prelude::*;
    use std::sync::Arc;

    const PERIOD: i64 = 33_333;

    fn frame(utime: i64) -> RgbdFrame {
        let camera =
            PinholeCamera { width: 1, height: 1, cx: 0.5, cy: 0.5, ..PinholeCamera::kinect() };
        let color = ColorImage::new(1, 1, vec![7; 3]).unwrap();
        let depth = DepthImage::from_metres(1, 1, vec![1.0]).unwrap();
        RgbdFrame::new(utime, Arc::new(camera), color, depth).unwrap()
    }

    /// Times that frames of these stamps are given; they arrive a period apart.
    fn times(timeline: Timeline, stamps: &[i64]) -> (Vec<i64>, SourceStatistics) {
        let arrival = |i: usize| 1_700_000_000_000_000 + i as i64 * PERIOD;
        let mut filter = TimestampFilter::new(timeline);
        let passed = stamps
            .iter()
            .enumerate()
            .filter_map(|(i, &stamp)| filter.pass(frame(stamp), arrival(i)))
            .map(|f| f.utime)
            .collect();
        (passed, filter.statistics)
    }

    /// Stamps a period apart.
    fn clock(start: i64, count: i64) -> Vec<i64> {
        (0..count).map(|i| start + i * PERIOD).collect()
    }

    #[test]
    fn one_stamp_far_away_costs_nothing_and_blocks_nothing() {
        for wrong in
            [1_000_000_000_000_000_000, i64::MAX, i64::MIN, -1, 0, 1, 60_000_000, 3_600_000_000]
        {
            for timeline in [Timeline::AsSent, Timeline::Continuous] {
                let expected = clock(50_000_000, 20);
                let mut stamps = expected.clone();
                stamps[7] = wrong;
                let (found, statistics) = times(timeline, &stamps);
                assert_eq!(found, expected, "{wrong}");
                assert_eq!((statistics.restamped, statistics.lost()), (1, 0), "{wrong}");
            }
        }
    }

    #[test]
    fn a_clock_that_begins_again_loses_no_frame() {
        for start in [5, 1_000, 900_000_000, 1_600_000_000_000_000] {
            let stamps = [clock(50_000_000, 20), clock(start, 20)].concat();
            let (found, statistics) = times(Timeline::Continuous, &stamps);
            assert_eq!(found, clock(50_000_000, 40), "{start}");
            assert_eq!((statistics.reconnections, statistics.lost()), (1, 0));
            let (found, statistics) = times(Timeline::AsSent, &stamps);
            assert_eq!(found.len(), 40);
            assert_eq!(found[21..], stamps[21..], "later stamps stay as they are sent");
            assert_eq!((statistics.reconnections, statistics.lost()), (1, 0));
        }
    }

    #[test]
    fn a_clock_that_begins_again_after_less_than_a_second_loses_two_frames() {
        let stamps = [clock(1_000_000, 15), clock(1_000_000, 40)].concat();
        let (found, statistics) = times(Timeline::Continuous, &stamps);
        assert_eq!((found.len(), statistics.lost()), (53, 2));
        assert!(found.is_sorted_by(|a, b| a < b));
    }

    #[test]
    fn stamps_of_zero_are_replaced_by_arrivals() {
        for timeline in [Timeline::AsSent, Timeline::Continuous] {
            let (found, statistics) = times(timeline, &[0; 10]);
            assert_eq!(found, clock(1_700_000_000_000_000, 10));
            assert_eq!((statistics.restamped, statistics.lost()), (10, 0));
        }
    }

    #[test]
    fn stamps_in_another_unit_are_replaced_by_arrivals() {
        for timeline in [Timeline::AsSent, Timeline::Continuous] {
            for (period, start) in [(33, 1_700_000_000_000), (33_333_333, 1_700_000_000_000_000)] {
                let stamps: Vec<i64> = (0..60).map(|i| start + i * period).collect();
                let (found, statistics) = times(timeline, &stamps);
                assert_eq!((found.len(), statistics.lost()), (60, 0), "{period}");
                let steps: Vec<i64> = found.windows(2).map(|t| t[1] - t[0]).collect();
                assert_eq!(steps[OTHER_UNIT_IN_A_ROW..], [PERIOD; 60 - 1 - OTHER_UNIT_IN_A_ROW]);
                assert!(statistics.restamped >= 60 - 1 - OTHER_UNIT_IN_A_ROW as u64, "{period}");
            }
        }
    }

    #[test]
    fn a_recording_that_is_sent_faster_than_it_was_made_keeps_its_stamps() {
        for pause in [1, 300, 3_333] {
            let mut filter = TimestampFilter::new(Timeline::AsSent);
            let stamps = clock(50_000_000, 40);
            let arrivals = (0..).map(|i| 1_700_000_000_000_000 + i * pause);
            let sent = stamps.iter().zip(arrivals);
            let found: Vec<i64> = sent
                .filter_map(|(&stamp, arrival)| filter.pass(frame(stamp), arrival))
                .map(|f| f.utime)
                .collect();
            assert_eq!(found, stamps, "{pause} µs apart");
            assert_eq!(filter.statistics.restamped, 0);
        }
    }

    #[test]
    fn without_a_stamp_or_an_arrival_frames_are_a_thirtieth_of_a_second_apart() {
        let mut filter = TimestampFilter::new(Timeline::Continuous);
        let found: Vec<i64> =
            (0..5).filter_map(|_| filter.pass(frame(0), 0)).map(|f| f.utime).collect();
        assert_eq!(found, clock(0, 5));
    }

    #[test]
    fn a_repeated_frame_stays_out_however_often_it_comes() {
        // A camera that is stuck sends its last picture again: that is no new frame.
        let stamps = [&[1_000_000, 1_033_333][..], &[1_033_333; 30]].concat();
        let (found, statistics) = times(Timeline::AsSent, &stamps);
        assert_eq!((found.len(), statistics.out_of_order), (2, 30));
    }

    #[test]
    fn a_long_pause_is_kept_where_the_arrivals_tell_it_too() {
        let mut filter = TimestampFilter::new(Timeline::Continuous);
        let hour = 3_600_000_000;
        let found: Vec<i64> = [(1_000_000, 5), (1_000_000 + hour, 5 + hour + 20_000)]
            .into_iter()
            .filter_map(|(stamp, arrival)| filter.pass(frame(stamp), arrival))
            .map(|f| f.utime)
            .collect();
        assert_eq!(found, [1_000_000, 1_000_000 + hour]);
        assert_eq!(filter.statistics.restamped, 0);
    }

    proptest! {
        #[test]
        fn time_goes_on_whatever_the_stamps_and_arrivals_are(
            frames in proptest::collection::vec((any::<i64>(), any::<i64>()), 1..60),
            near in proptest::collection::vec((0..3_000_000_i64, 0..3_000_000_i64), 1..60),
        ) {
            let mut filter = TimestampFilter::new(Timeline::Continuous);
            let mut before = i64::MIN;
            for (stamp, arrival) in frames.into_iter().chain(near) {
                if let Some(frame) = filter.pass(frame(stamp), arrival) {
                    prop_assert!(frame.utime > before, "{} after {before}", frame.utime);
                    before = frame.utime;
                }
            }
        }

        #[test]
        fn after_any_stamps_a_clock_that_runs_loses_at_most_two_frames(
            stamps in proptest::collection::vec(any::<i64>(), 0..20),
            near in proptest::collection::vec(0..3_000_000_i64, 0..20),
            start in 1..2_000_000_000_000_000_i64,
            goes_on: bool,
        ) {
            let timeline = if goes_on { Timeline::Continuous } else { Timeline::AsSent };
            let before = [stamps, near].concat();
            let lost = times(timeline, &before).1.lost();
            let all = [before, clock(start, 30)].concat();
            prop_assert!(times(timeline, &all).1.lost() <= lost + 2);
        }
    }
}
