//! The thread that publishes: packets as they come, the status at least twice a second and at
//! once when it changes.

use super::log_rate_limit::LogRateLimit;
use super::observer::Observer;
use crate::channel;
use crate::messages::STATUS_MESSAGE_SCHEMA;
use linkage_driver::live::{LatestReader, LatestWriter, RecvError, host_utime};
use linkage_driver::plain_text::harmless;
use linkage_lcm::messages::linkage;
use linkage_lcm::{Lcm, Message, encode};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// What the other threads have to say.
#[derive(Clone)]
pub struct Outbox {
    pub packets: LatestWriter<Packet>,
    pub notes: LatestWriter<Note>,
    pub observer: Observer,
}

/// An encoded message.
pub struct Packet {
    channel: &'static str,
    bytes: Vec<u8>,
}

/// What the status is made of.
pub enum Note {
    /// What perception is doing.
    Situation(Situation),
    /// The result of a command.
    Answer(Answer),
    /// A command came again: its answer is given again.
    Again(i64),
    /// Packets or commands that were refused when they came in, and why the last of them.
    Refused { count: u64, reason: String },
    /// Why one of them was refused. It is not remembered: the same command may come again.
    NotTaken(Answer),
    /// Something went wrong.
    Error(String),
}

/// What perception is doing.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Situation {
    pub state: &'static str,
    pub frame_rate: f64,
    pub frames: u64,
    pub dropped_frames: u64,
    pub tracks: usize,
    pub object: String,
    /// Kind and certainty of each joint.
    pub joints: Vec<(&'static str, f64)>,
}

/// The result of a command.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Answer {
    pub utime: i64,
    pub accepted: bool,
    /// It is finished.
    pub done: bool,
    pub text: String,
}

impl Outbox {
    /// Sends a message.
    pub fn send<M: Message>(&self, channel: &'static str, message: &M) {
        match encode(message) {
            Ok(bytes) => self.packets.push(Packet { channel, bytes }),
            Err(e) => self.note(Note::Error(format!("{channel}: {e}"))),
        }
    }

    /// Hands over something for the status.
    pub fn note(&self, note: Note) {
        match &note {
            Note::Answer(answer) => {
                self.observer.message(!answer.accepted, || sanitised(&answer.text))
            }
            Note::Error(reason) | Note::Refused { reason, .. } => {
                self.observer.message(true, || sanitised(reason));
            }
            Note::Situation(_) | Note::Again(_) | Note::NotTaken(_) => {}
        }
        self.notes.push(note);
    }
}

/// Answers that wait for a status, the oldest first.
#[derive(Default)]
struct Untold(VecDeque<Answer>);

impl Untold {
    /// Of one command only the newest is needed, in the place of the one before: who asks again and
    /// again must not wait ever longer.
    fn add(&mut self, answer: Answer) {
        if let Some(waiting) = self.0.iter_mut().find(|a| a.utime == answer.utime) {
            *waiting = answer;
            return;
        }
        if self.0.len() == UNTOLD {
            self.0.pop_front();
        }
        self.0.push_back(answer);
    }

    fn next(&mut self) -> Option<Answer> {
        self.0.pop_front()
    }
}

pub struct Publisher {
    lcm: Lcm,
    packets: LatestReader<Packet>,
    notes: LatestReader<Note>,
    session: i64,
    situation: Situation,
    /// The newest answer to each command.
    answers: VecDeque<Answer>,
    /// Answers that no status has contained yet.
    untold: Untold,
    /// The same of what was not taken: told when no answer waits, so that a flood of it keeps none back.
    untold_refusals: Untold,
    /// The one that the status tells.
    answer: Answer,
    refused: u64,
    last_error: String,
    /// Which refusals of packets are logged.
    refusal_log: LogRateLimit,
    /// Which errors of the service itself are logged: a flood of refusals must not hide them.
    error_log: LogRateLimit,
    told: Option<Instant>,
    changed: bool,
}

/// Answers that are remembered.
const REMEMBERED: usize = 256;
/// Answers that wait for a status; when more come, the oldest are dropped, and their senders ask
/// again.
const UNTOLD: usize = 64;
/// Longest wait for a packet, so for a change to be told.
const POLL: Duration = Duration::from_millis(5);
/// Longest time between two statuses.
const STATUS_EVERY: Duration = Duration::from_millis(400);
/// Shortest time between two statuses, however often things change.
const STATUS_AT_MOST: Duration = Duration::from_millis(10);
/// Characters of a text of the status at most: a text may quote what somebody sent.
const TEXT_LENGTH: usize = 400;

impl Publisher {
    pub fn new(
        lcm: Lcm,
        session: i64,
        packets: LatestReader<Packet>,
        notes: LatestReader<Note>,
    ) -> Self {
        Self {
            lcm,
            packets,
            notes,
            session,
            situation: Situation { state: "idle", ..Situation::default() },
            answers: VecDeque::new(),
            untold: Untold::default(),
            untold_refusals: Untold::default(),
            answer: Answer::default(),
            refused: 0,
            last_error: String::new(),
            refusal_log: LogRateLimit::default(),
            error_log: LogRateLimit::default(),
            told: None,
            changed: false,
        }
    }

    /// Publishes until it is stopped; how much was refused.
    pub fn run(mut self, is_stopped: &(dyn Fn() -> bool + Sync)) -> u64 {
        loop {
            match self.packets.pop(POLL) {
                Ok(packet) => self.publish(packet.channel, &packet.bytes),
                Err(RecvError::Timeout) => {}
                Err(RecvError::Closed) => std::thread::sleep(POLL),
            }
            while let Ok(note) = self.notes.pop(Duration::ZERO) {
                self.take(note);
            }
            let since = self.told.map_or(Duration::MAX, |t| t.elapsed());
            if since >= STATUS_EVERY || (self.changed && since >= STATUS_AT_MOST) {
                self.publish_status();
            }
            if is_stopped() {
                return self.refused;
            }
        }
    }

    fn publish(&mut self, channel: &str, bytes: &[u8]) {
        if let Err(e) = self.lcm.publish_bytes(channel, bytes) {
            self.error(e.to_string(), false);
        }
    }

    fn take(&mut self, note: Note) {
        match note {
            Note::Situation(now) => {
                let as_before =
                    now.state == self.situation.state && now.object == self.situation.object;
                self.changed |= !as_before;
                self.situation = now;
            }
            Note::Answer(answer) => {
                self.answers.retain(|a| a.utime != answer.utime);
                if self.answers.len() == REMEMBERED {
                    self.answers.pop_front();
                }
                self.answers.push_back(answer.clone());
                if !answer.accepted {
                    self.refused += 1;
                }
                self.say(answer);
            }
            Note::Again(utime) => {
                if let Some(answer) = self.answers.iter().find(|a| a.utime == utime) {
                    self.say(answer.clone());
                }
            }
            Note::Refused { count, reason } => {
                self.refused += count;
                self.error(reason, true);
            }
            Note::NotTaken(answer) => {
                // Whoever repeats a command's name does not speak for that command.
                if self.answers.iter().all(|a| a.utime != answer.utime) {
                    self.untold_refusals.add(answer);
                    self.changed = true;
                }
            }
            Note::Error(reason) => self.error(reason, false),
        }
    }

    /// Each answer is published in a status of its own.
    fn say(&mut self, answer: Answer) {
        self.untold.add(answer);
        self.changed = true;
    }

    fn error(&mut self, reason: String, is_refusal: bool) {
        let reason = sanitised(&reason);
        if self.last_error != reason {
            let log = if is_refusal { &mut self.refusal_log } else { &mut self.error_log };
            match log.admit(Instant::now()) {
                Some(0) => tracing::warn!("{reason}"),
                Some(left_out) => tracing::warn!(left_out, "{reason}"),
                None => {}
            }
            self.last_error = reason;
            self.changed = true;
        }
    }

    fn publish_status(&mut self) {
        self.told = Some(Instant::now());
        if let Some(answer) = self.untold.next().or_else(|| self.untold_refusals.next()) {
            self.answer = answer;
        }
        self.changed = !(self.untold.0.is_empty() && self.untold_refusals.0.is_empty());
        let status = self.status();
        match encode(&status) {
            Ok(bytes) => self.publish(channel::STATUS, &bytes),
            Err(e) => self.last_error = e.to_string(),
        }
    }

    fn status(&self) -> linkage::Status {
        let now = &self.situation;
        let number = |n: u64| i64::try_from(n).unwrap_or(i64::MAX);
        linkage::Status {
            utime: host_utime(),
            schema: STATUS_MESSAGE_SCHEMA,
            state: now.state.to_owned(),
            frame_rate: now.frame_rate,
            frames: number(now.frames),
            dropped_frames: number(now.dropped_frames),
            tracks: i32::try_from(now.tracks).unwrap_or(i32::MAX),
            object: sanitised(&now.object),
            joint_kind: now.joints.iter().map(|j| j.0.to_owned()).collect(),
            joint_certainty: now.joints.iter().map(|j| j.1).collect(),
            command_utime: self.answer.utime,
            command_accepted: self.answer.accepted,
            command_done: self.answer.done,
            command_answer: sanitised(&self.answer.text),
            refused: number(self.refused),
            last_error: self.last_error.clone(),
            session: self.session,
        }
    }
}

/// A text that may be sent and shown, whatever it quotes.
fn sanitised(text: &str) -> String {
    harmless(text, TEXT_LENGTH)
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_driver::live::latest;
    use linkage_driver::plain_text::is_control;

    fn publisher() -> Publisher {
        let (_, packets) = latest(4);
        let (_, notes) = latest(4);
        Publisher::new(Lcm::new("memq://").unwrap(), 7, packets, notes)
    }

    fn answer(utime: i64, accepted: bool) -> Answer {
        Answer { utime, accepted, done: true, text: "so".to_owned() }
    }

    #[test]
    fn whatever_was_quoted_every_status_can_be_sent() {
        let mut publisher = publisher();
        for hostile in
            ["\0", "a\0b\u{1b}[31m", "\r\n", "\u{202e}", "\u{2028}", &"x".repeat(100_000)]
        {
            publisher.take(Note::Error(format!("{hostile} is no channel")));
            publisher.take(Note::Answer(Answer { text: hostile.to_owned(), ..answer(1, false) }));
            publisher.take(Note::Situation(Situation {
                object: hostile.to_owned(),
                ..Situation::default()
            }));
            publisher.publish_status();
            let status = publisher.status();
            assert!(encode(&status).unwrap().len() < 4096);
            let told = [&status.last_error, &status.command_answer, &status.object];
            assert!(told.into_iter().all(|t| !t.is_empty() && !t.contains(is_control)));
        }
    }

    #[test]
    fn a_flood_of_refusals_does_not_keep_an_answer_from_being_told() {
        let mut publisher = publisher();
        // More comes than can be told, and who waits asks again faster than that is told.
        publisher.take(Note::Answer(answer(1, true)));
        let mut refusals = 1000..;
        let told = (0..3).map(|_| {
            for utime in refusals.by_ref().take(200) {
                publisher.take(Note::NotTaken(answer(utime, false)));
            }
            publisher.take(Note::Again(1));
            publisher.publish_status();
            publisher.status().command_utime
        });
        assert_eq!(told.collect::<Vec<_>>(), [1; 3]);
    }

    #[test]
    fn a_refusal_that_is_asked_for_again_keeps_its_place() {
        let mut publisher = publisher();
        let mut told = (0..5).map(|round| {
            for utime in [100 + round, 200 + round, 300 + round, 5] {
                publisher.take(Note::NotTaken(answer(utime, false)));
            }
            publisher.publish_status();
            publisher.status().command_utime
        });
        assert!(told.any(|utime| utime == 5));
    }

    #[test]
    fn answers_that_come_at_once_are_told_one_after_the_other() {
        let mut publisher = publisher();
        (1..=5).for_each(|utime| publisher.take(Note::Answer(answer(utime, true))));
        let mut told = Vec::new();
        while publisher.changed {
            publisher.publish_status();
            told.push(publisher.status().command_utime);
        }
        assert_eq!(told, [1, 2, 3, 4, 5]);
    }

    #[test]
    fn a_refusal_of_the_same_name_does_not_speak_for_a_command_that_was_done() {
        let mut publisher = publisher();
        publisher.take(Note::Answer(answer(5, true)));
        publisher.take(Note::NotTaken(answer(5, false)));
        publisher.publish_status();
        assert!(publisher.status().command_accepted);
        assert!(publisher.untold_refusals.0.is_empty());
    }
}
