//! The thread that publishes: packets as they come, the status at least twice a second and at
//! once when it changes.

use crate::channel;
use crate::messages::MESSAGE_SCHEMA;
use linkage_driver::live::{LatestReader, LatestWriter, Nothing, host_utime};
use linkage_lcm::messages::linkage;
use linkage_lcm::{Lcm, Message, encode};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// What the other threads have to say.
#[derive(Clone)]
pub struct Outbox {
    pub packets: LatestWriter<Packet>,
    pub notes: LatestWriter<Note>,
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
    /// What became of a command.
    Answer(Answer),
    /// A command came again: its answer is given again.
    Again(i64),
    /// Packets or commands that were refused, and why the last of them.
    Refused { count: u64, reason: String },
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

/// What became of a command.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Answer {
    pub utime: i64,
    pub accepted: bool,
    /// Nothing more will become of it.
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

    /// Tells something for the status.
    pub fn note(&self, note: Note) {
        self.notes.push(note);
    }
}

pub struct Publisher {
    lcm: Lcm,
    packets: LatestReader<Packet>,
    notes: LatestReader<Note>,
    situation: Situation,
    answers: VecDeque<Answer>,
    answer: Answer,
    refused: u64,
    last_error: String,
    told: Option<Instant>,
    changed: bool,
}

/// Answers that are remembered.
const REMEMBERED: usize = 256;
/// Longest wait for a packet, so for a change to be told.
const POLL: Duration = Duration::from_millis(5);
/// Longest time between two statuses,
const STATUS_EVERY: Duration = Duration::from_millis(400);
/// and shortest, however often things change.
const STATUS_AT_MOST: Duration = Duration::from_millis(10);

impl Publisher {
    pub fn new(lcm: Lcm, packets: LatestReader<Packet>, notes: LatestReader<Note>) -> Self {
        Self {
            lcm,
            packets,
            notes,
            situation: Situation { state: "idle", ..Situation::default() },
            answers: VecDeque::new(),
            answer: Answer::default(),
            refused: 0,
            last_error: String::new(),
            told: None,
            changed: false,
        }
    }

    /// Publishes until it is stopped; how much was refused.
    pub fn run(mut self, is_stopped: &(dyn Fn() -> bool + Sync)) -> u64 {
        loop {
            match self.packets.pop(POLL) {
                Ok(packet) => self.publish(packet.channel, &packet.bytes),
                Err(Nothing::Yet) => {}
                Err(Nothing::Ever) => std::thread::sleep(POLL),
            }
            while let Ok(note) = self.notes.pop(Duration::ZERO) {
                self.take(note);
            }
            let since = self.told.map_or(Duration::MAX, |t| t.elapsed());
            if since >= STATUS_EVERY || (self.changed && since >= STATUS_AT_MOST) {
                self.tell();
            }
            if is_stopped() {
                return self.refused;
            }
        }
    }

    fn publish(&mut self, channel: &str, bytes: &[u8]) {
        if let Err(e) = self.lcm.publish_bytes(channel, bytes) {
            self.error(e.to_string());
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
                self.answer = answer;
                self.changed = true;
            }
            Note::Again(utime) => {
                if let Some(answer) = self.answers.iter().find(|a| a.utime == utime) {
                    self.answer = answer.clone();
                }
                self.changed = true;
            }
            Note::Refused { count, reason } => {
                self.refused += count;
                self.error(reason);
            }
            Note::Error(reason) => self.error(reason),
        }
    }

    fn error(&mut self, reason: String) {
        if self.last_error != reason {
            tracing::warn!("{reason}");
            self.last_error = reason;
            self.changed = true;
        }
    }

    fn tell(&mut self) {
        self.told = Some(Instant::now());
        self.changed = false;
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
            schema: MESSAGE_SCHEMA,
            state: now.state.to_owned(),
            frame_rate: now.frame_rate,
            frames: number(now.frames),
            dropped_frames: number(now.dropped_frames),
            tracks: i32::try_from(now.tracks).unwrap_or(i32::MAX),
            object: now.object.clone(),
            joint_kind: now.joints.iter().map(|j| j.0.to_owned()).collect(),
            joint_certainty: now.joints.iter().map(|j| j.1).collect(),
            command_utime: self.answer.utime,
            command_accepted: self.answer.accepted,
            command_done: self.answer.done,
            command_answer: self.answer.text.clone(),
            refused: number(self.refused),
            last_error: self.last_error.clone(),
        }
    }
}
