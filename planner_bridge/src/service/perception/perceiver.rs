//! The thread that perceives, as it stands between two frames; what it answers to commands.
//!
//! In: its configuration, what is known, the queues of frames and commands. Out: notes to the thread
//! that publishes, orders to the one that streams.

use super::state::{Ordered, State};
use crate::service::capture::{Arrived, Lost};
use crate::service::command::Command;
use crate::service::config::ServiceConfig;
use crate::service::learning::{Learning, LearningWorker};
use crate::service::losses::Losses;
use crate::service::publisher::{Answer, Note, Outbox, Situation};
use crate::service::searching::Searching;
use crate::service::stream::Orders;
use crate::service::watchdog::Watchdog;
use crossbeam_channel::Receiver;
use linkage_driver::live::LatestReader;
use linkage_realtime::Reason;
use linkage_skill::store::Library;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;

/// What comes to the thread that perceives.
pub struct Inbox {
    pub frames: LatestReader<Arrived>,
    pub lost: Lost,
    pub commands: Receiver<Command>,
}

pub struct Perception<'q> {
    pub(super) config: ServiceConfig,
    pub(super) learning_worker: LearningWorker,
    pub(super) inbox: Inbox,
    pub(super) losses: Losses,
    pub(super) watchdog: Watchdog,
    pub(super) out: Outbox,
    pub(super) orders: Option<Orders<'q>>,
    pub(super) library: Arc<Library>,
    /// Number of the reading that `library` is of.
    pub(super) library_reading: u64,
    pub(super) state: State,
    /// The search for an object that runs.
    pub(super) searching: Option<Searching>,
    /// What the stream has not decided on yet.
    pub(super) ordered: Option<Ordered>,
    /// What was cancelled while it was learned, with the command that asked for it: it may be stored already.
    pub(super) cancelled: Vec<(Learning, Option<i64>)>,
    pub(super) looked_at: u64,
    /// A digest of the newest frame's depth.
    pub(super) newest_depth: Option<u64>,
    pub(super) arrivals: VecDeque<Instant>,
    pub(super) told: Option<(Instant, Situation)>,
}

impl<'q> Perception<'q> {
    pub fn new(
        config: &ServiceConfig,
        library: Library,
        inbox: Inbox,
        out: Outbox,
        orders: Option<Orders<'q>>,
    ) -> Self {
        let (skill, store) = (config.skill.clone(), config.store.clone());
        Self {
            config: config.clone(),
            learning_worker: LearningWorker {
                config: skill,
                store,
                out: out.clone(),
                loads: Arc::default(),
            },
            library_reading: 0,
            losses: Losses::begin(inbox.lost.count(), 0),
            inbox,
            watchdog: Watchdog::from_environment(),
            out,
            orders,
            library: Arc::new(library),
            state: State::Resting,
            searching: None,
            ordered: None,
            cancelled: Vec::new(),
            looked_at: 0,
            newest_depth: None,
            arrivals: VecDeque::new(),
            told: None,
        }
    }

    pub fn dropped_frames(&self) -> u64 {
        self.inbox.frames.dropped() + self.inbox.lost.count()
    }

    /// Tells the result of a command.
    pub fn answer(&self, command: i64, result: Result<String, String>) {
        let accepted = result.is_ok();
        let text = result.unwrap_or_else(|reason| reason);
        self.out.note(Note::Answer(Answer { utime: command, accepted, done: true, text }));
    }

    /// Tells that a command is being done.
    pub fn acknowledge(&self, command: i64, text: String) {
        let answer = Answer { utime: command, accepted: true, done: false, text };
        self.out.note(Note::Answer(answer));
    }

    pub fn brake(&mut self, why: Reason) {
        if let Some(orders) = &mut self.orders {
            orders.brake(why);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_data::{answers, frame, perception, perception_with_frames};

    #[test]
    fn a_result_is_the_last_word_on_a_command_and_an_acknowledgement_is_not() {
        let (perception, noted) = perception();
        perception.acknowledge(3, "learning".to_owned());
        perception.answer(3, Ok("learned".to_owned()));
        perception.answer(4, Err("nothing moves".to_owned()));
        let told: Vec<_> = answers(&noted)
            .into_iter()
            .map(|answer| (answer.utime, answer.accepted, answer.done, answer.text))
            .collect();
        assert_eq!(told[0], (3, true, false, "learning".to_owned()));
        assert_eq!(told[1], (3, true, true, "learned".to_owned()));
        assert_eq!(told[2], (4, false, true, "nothing moves".to_owned()));
    }

    #[test]
    fn frames_that_found_no_room_are_counted_as_dropped() {
        let (perception, _noted, frames) = perception_with_frames();
        (0..8).for_each(|utime| frames.push(frame(utime)));
        assert_eq!(perception.dropped_frames(), 0);
        (8..11).for_each(|utime| frames.push(frame(utime)));
        assert_eq!(perception.dropped_frames(), 3);
    }
}
