//! Commands: `linkage.command_t` as it is received, checked, and never done twice.

use super::publisher::{Note, Outbox};
use crate::channel;
use crossbeam_channel::{Sender, TrySendError};
use linkage_lcm::messages::linkage;
use linkage_lcm::{DecodeError, Lcm, LcmError, decode};
use linkage_skill::predict::{PredictError, Target};
use nalgebra::Point3;
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// A command that is understood.
#[derive(Debug, Clone, PartialEq)]
pub struct Command {
    /// Its name: one that comes again is the same command.
    pub utime: i64,
    /// What is to be done.
    pub action: Action,
}

/// What a command asks for.
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// Watch how a person moves this object.
    StartDemonstration {
        /// The name that it gets.
        object: String,
    },
    /// The person is done: learn.
    FinishDemonstration,
    /// Look for an object and follow it; any where none is named.
    Recognise {
        /// Its name.
        object: Option<String>,
    },
    /// Plan an object's motion from where it is.
    Predict {
        /// Its name; any where none is named.
        object: Option<String>,
        /// The joint; all that are seen where none is named.
        joint: Option<String>,
        /// Where to.
        target: Target,
        /// What the gripper holds, camera frame.
        grasp: Option<Point3<f64>>,
    },
    /// Stop whatever is being done.
    Cancel,
}

/// A packet that is no command.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum Refusal {
    /// Not a message of this type, or damaged.
    #[error("a packet on LINKAGE_COMMAND is no command: {0}")]
    Packet(#[from] DecodeError),
    /// A version that is not known.
    #[error("command {utime} has schema {schema}; this service knows {SCHEMA}")]
    Schema {
        /// Its name.
        utime: i64,
        /// Its version.
        schema: i32,
    },
    /// An action that is not known.
    #[error("command {utime} has action {action}, which is none")]
    Action {
        /// Its name.
        utime: i64,
        /// As given.
        action: i8,
    },
    /// An object's name that cannot be.
    #[error(
        "command {utime}: an object's name has 1 to {MAX_NAME} bytes and no control characters"
    )]
    Name {
        /// The command's name.
        utime: i64,
    },
    /// A target that is none.
    #[error("command {utime}: {source}")]
    Target {
        /// Its name.
        utime: i64,
        /// Why.
        source: PredictError,
    },
    /// A grasp that is no point.
    #[error("command {utime}: the grasp is not finite")]
    Grasp {
        /// Its name.
        utime: i64,
    },
    /// More than can be done.
    #[error("command {utime}: too many commands at once; send it again")]
    TooMany {
        /// Its name.
        utime: i64,
    },
}

/// Version of the commands that are understood.
const SCHEMA: i32 = 1;
/// Bytes of an object's name: those that the real-time half has room for.
const MAX_NAME: usize = 63;

impl Command {
    /// Reads a packet.
    ///
    /// # Errors
    /// [`Refusal`] says what is wrong with it.
    pub fn read(packet: &[u8]) -> Result<Self, Refusal> {
        let message: linkage::Command = decode(packet)?;
        let utime = message.utime;
        if message.schema != SCHEMA {
            return Err(Refusal::Schema { utime, schema: message.schema });
        }
        let action = match message.action {
            linkage::Command::START_DEMONSTRATION => {
                Action::StartDemonstration { object: named(utime, message.object)? }
            }
            linkage::Command::FINISH_DEMONSTRATION => Action::FinishDemonstration,
            linkage::Command::RECOGNISE => {
                Action::Recognise { object: optional(utime, message.object)? }
            }
            linkage::Command::PREDICT => Action::Predict {
                target: target(&message)?,
                grasp: grasp(&message)?,
                object: optional(utime, message.object)?,
                joint: optional(utime, message.joint)?,
            },
            linkage::Command::CANCEL => Action::Cancel,
            action => return Err(Refusal::Action { utime, action }),
        };
        Ok(Self { utime, action })
    }
}

fn named(utime: i64, name: String) -> Result<String, Refusal> {
    let fits = !name.is_empty() && name.len() <= MAX_NAME && !name.chars().any(char::is_control);
    if fits { Ok(name) } else { Err(Refusal::Name { utime }) }
}

fn optional(utime: i64, name: String) -> Result<Option<String>, Refusal> {
    if name.is_empty() { Ok(None) } else { named(utime, name).map(Some) }
}

fn target(message: &linkage::Command) -> Result<Target, Refusal> {
    let target: Target = message
        .target
        .parse()
        .map_err(|source| Refusal::Target { utime: message.utime, source })?;
    Ok(match target {
        Target::Value(q) if message.outside_range => Target::Unseen(q),
        within => within,
    })
}

fn grasp(message: &linkage::Command) -> Result<Option<Point3<f64>>, Refusal> {
    if !message.has_grasp {
        return Ok(None);
    }
    if !message.grasp.iter().all(|x| x.is_finite()) {
        return Err(Refusal::Grasp { utime: message.utime });
    }
    Ok(Some(Point3::from(message.grasp)))
}

/// The thread that listens.
pub struct Listener {
    lcm: Lcm,
    commands: Sender<Command>,
    out: Outbox,
    /// Names of the commands that came last.
    known: VecDeque<i64>,
    refusals: Refusals,
    repeats: Repeats,
}

/// Commands that are known again.
const REMEMBERED: usize = 256;
/// Longest wait for a packet without a look whether to stop.
const POLL: Duration = Duration::from_millis(50);

impl Listener {
    pub fn new(url: &str, commands: Sender<Command>, out: Outbox) -> Result<Self, LcmError> {
        let mut lcm = Lcm::new(url)?;
        lcm.subscribe(channel::COMMAND)?;
        let (refusals, repeats) = (Refusals::default(), Repeats::default());
        Ok(Self { lcm, commands, out, known: VecDeque::new(), refusals, repeats })
    }

    pub fn run(mut self, is_stopped: &(dyn Fn() -> bool + Sync)) {
        while !is_stopped() {
            match self.lcm.receive(POLL) {
                Ok(Some(packet)) => {
                    if let Err(refusal) = self.take(&packet.bytes) {
                        self.refusals.add(refusal.to_string());
                    }
                }
                Ok(None) => {}
                Err(e) => {
                    self.out.note(Note::Error(e.to_string()));
                    std::thread::sleep(POLL);
                }
            }
            self.refusals.tell(&self.out);
            self.repeats.tell(&self.out);
        }
    }

    fn take(&mut self, packet: &[u8]) -> Result<(), Refusal> {
        let command = Command::read(packet)?;
        let utime = command.utime;
        if self.known.contains(&utime) {
            self.repeats.add(utime);
            return Ok(());
        }
        match self.commands.try_send(command) {
            Ok(()) => {
                if self.known.len() == REMEMBERED {
                    self.known.pop_front();
                }
                self.known.push_back(utime);
                Ok(())
            }
            Err(TrySendError::Full(_)) => Err(Refusal::TooMany { utime }),
            // Perception is gone, and this thread is about to go.
            Err(TrySendError::Disconnected(_)) => Ok(()),
        }
    }
}

/// Refusals since they were told last: a flood of them is one note.
#[derive(Debug, Default)]
struct Refusals {
    count: u64,
    latest: String,
    told: Option<Instant>,
}

/// Commands that came again since they were told last: a flood of them is a few notes.
#[derive(Debug, Default)]
struct Repeats {
    utimes: Vec<i64>,
    told: Option<Instant>,
}

/// Commands that came again of which one telling speaks.
const REPEATS: usize = 8;

impl Repeats {
    fn add(&mut self, utime: i64) {
        if self.utimes.len() < REPEATS && !self.utimes.contains(&utime) {
            self.utimes.push(utime);
        }
    }

    fn tell(&mut self, out: &Outbox) {
        if !self.utimes.is_empty() && self.told.is_none_or(|t| t.elapsed() >= TELL_EVERY) {
            self.utimes.drain(..).for_each(|utime| out.note(Note::Again(utime)));
            self.told = Some(Instant::now());
        }
    }
}

/// Time between two notes of refusals or of repeats.
const TELL_EVERY: Duration = Duration::from_millis(50);

impl Refusals {
    fn add(&mut self, reason: String) {
        self.count += 1;
        self.latest = reason;
    }

    fn tell(&mut self, out: &Outbox) {
        if self.count > 0 && self.told.is_none_or(|t| t.elapsed() >= TELL_EVERY) {
            let reason = std::mem::take(&mut self.latest);
            out.note(Note::Refused { count: std::mem::take(&mut self.count), reason });
            self.told = Some(Instant::now());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_driver::live::latest;
    use linkage_lcm::encode;
    use proptest::prelude::*;

    fn message(action: i8) -> linkage::Command {
        linkage::Command {
            utime: 7,
            schema: SCHEMA,
            action,
            object: "fridge".into(),
            target: "open".into(),
            ..Default::default()
        }
    }

    fn read(message: &linkage::Command) -> Result<Command, Refusal> {
        Command::read(&encode(message).unwrap())
    }

    #[test]
    fn each_action_is_understood() {
        let object = Some("fridge".to_owned());
        let understood = [
            Action::StartDemonstration { object: "fridge".into() },
            Action::FinishDemonstration,
            Action::Recognise { object: object.clone() },
            Action::Predict { object, joint: None, target: Target::Open, grasp: None },
            Action::Cancel,
        ];
        for (code, action) in (0..).zip(understood) {
            assert_eq!(read(&message(code)), Ok(Command { utime: 7, action }));
        }
    }

    #[test]
    fn what_is_wrong_is_said() {
        let refusal = |change: fn(&mut linkage::Command)| {
            let mut wrong = message(linkage::Command::PREDICT);
            change(&mut wrong);
            read(&wrong).unwrap_err().to_string()
        };
        assert!(refusal(|m| m.schema = 9).contains("schema 9"));
        assert!(refusal(|m| m.action = 17).contains("action 17"));
        assert!(refusal(|m| m.target = "NaN".into()).contains("\"NaN\" is no target"));
        assert!(refusal(|m| m.target = "inf".into()).contains("\"inf\" is no target"));
        assert!(refusal(|m| m.object = "x".repeat(64)).contains("63 bytes"));
        assert!(refusal(|m| m.object = "a\nb".into()).contains("control characters"));
        assert!(refusal(|m| (m.has_grasp, m.grasp[1]) = (true, f64::NAN)).contains("grasp"));
    }

    #[test]
    fn a_flood_of_repeats_is_a_few_notes() {
        let (packets, _unread) = latest(4);
        let (notes, told) = latest(64);
        let out = Outbox { packets, notes };
        let mut repeats = Repeats::default();
        for utime in 0..10_000 {
            repeats.add(utime % 100);
            repeats.tell(&out);
        }
        assert_eq!(told.dropped(), 0);
        assert!(matches!(told.pop(Duration::ZERO), Ok(Note::Again(0))));
    }

    #[test]
    fn a_target_outside_the_range_must_be_allowed() {
        let mut wide = linkage::Command { target: "2.5".into(), ..message(3) };
        let target_of = |m: &linkage::Command| match read(m).unwrap().action {
            Action::Predict { target, .. } => target,
            other => panic!("{other:?}"),
        };
        assert_eq!(target_of(&wide), Target::Value(2.5));
        wide.outside_range = true;
        assert_eq!(target_of(&wide), Target::Unseen(2.5));
    }

    proptest! {
        #[test]
        fn no_packet_is_too_strange(bytes in proptest::collection::vec(any::<u8>(), 0..200), cut in 0..80_usize) {
            prop_assert!(Command::read(&bytes).is_err());
            let whole = encode(&message(3)).unwrap();
            prop_assert!(Command::read(&whole[..cut.min(whole.len() - 1)]).is_err());
        }
    }
}
