//! What the thread that perceives tells about itself: its state, what it follows, the frame rate.
//!
//! In: the state. Out: a [`Situation`] for the thread that publishes, when it changes and now and
//! then; frames a second.

use super::perceiver::Perception;
use super::state::State;
use crate::service::publisher::{Note, Situation};
use crate::service::stream::Orders;
use linkage_skill::ObjectModel;
use std::time::{Duration, Instant};

/// Time between two reports of the current estimate while a demonstration runs, and of the
/// situation where it changes in figures alone.
pub const TELL_EVERY: Duration = Duration::from_millis(450);
/// Arrivals that the frame rate is taken over, and how old they may be.
pub const RATE_FRAMES: usize = 30;
const RATE_WINDOW: Duration = Duration::from_secs(3);

impl Perception<'_> {
    /// Tells the situation when it changes, and now and then.
    pub fn publish_status(&mut self) {
        let now = self.situation();
        let due = self.told.as_ref().is_none_or(|(at, told)| {
            told.state != now.state || told.object != now.object || at.elapsed() >= TELL_EVERY / 2
        });
        if due {
            self.out.note(Note::Situation(now.clone()));
            self.told = Some((Instant::now(), now));
        }
    }

    fn situation(&self) -> Situation {
        let (mut tracks, mut joints) = (0, Vec::new());
        let (state, object) = match &self.state {
            State::Resting if self.library.is_empty() => ("idle", ""),
            State::Resting => ("ready", ""),
            State::Demonstrating(d) => {
                tracks = d.learner.tracker().live_count();
                joints = certainties(&d.current_estimate);
                ("demonstrating", d.object.as_str())
            }
            State::Learning { learning, .. } => ("learning", learning.object.as_str()),
            State::Watching(w) => ("watching", w.object.as_deref().unwrap_or("")),
            State::Tracking(t) => {
                joints = certainties(&t.object.model);
                let moves = self.orders.as_ref().is_some_and(Orders::is_running);
                let state = if moves || t.pending.is_some() { "predicting" } else { "tracking" };
                (state, t.object.model.object.as_str())
            }
        };
        Situation {
            state,
            object: object.to_owned(),
            frame_rate: self.frame_rate(),
            frames: self.looked_at,
            dropped_frames: self.dropped_frames(),
            tracks,
            joints,
        }
    }

    fn frame_rate(&self) -> f64 {
        let (Some(first), Some(last)) = (self.arrivals.front(), self.arrivals.back()) else {
            return 0.0;
        };
        let span = last.duration_since(*first).as_secs_f64();
        if last.elapsed() > RATE_WINDOW || span <= 0.0 {
            return 0.0;
        }
        (self.arrivals.len() - 1) as f64 / span
    }
}

/// Kind and certainty of each joint.
fn certainties(model: &ObjectModel) -> Vec<(&'static str, f64)> {
    let certainty = |j: &linkage_skill::Joint| j.type_probabilities.get(&j.kind).copied();
    model.joints.iter().map(|j| (j.kind.name(), certainty(j).unwrap_or(1.0))).collect()
}
