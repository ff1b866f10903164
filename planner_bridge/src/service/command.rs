//! Commands: `linkage.command_t` as it is received, checked, and never done twice.

use super::authority::{Authority, Unauthorised};
use super::publisher::{Answer, Note, Outbox};
use super::stream::Pulse;
use crate::channel;
use crossbeam_channel::{Sender, TrySendError};
use linkage_driver::live::host_utime;
use linkage_driver::plain_text::is_control;
use linkage_lcm::messages::linkage;
use linkage_lcm::{DecodeError, Lcm, LcmError, Message, Packet, decode};
use linkage_skill::predict::{PredictError, Target};
use nalgebra::Point3;
use std::collections::VecDeque;
use std::net::IpAddr;
use std::time::{Duration, Instant};

/// A command that is understood.
#[derive(Debug, Clone, PartialEq)]
pub struct Command {
    /// Its name: one that comes again is the same command.
    pub utime: i64,
    /// It is not begun after this time, microseconds since 1970.
    pub valid_until: i64,
    /// The expiry that its sender gave, microseconds since 1970: what has been begun and waits is given up then.
    pub expires: Option<i64>,
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

/// Why a packet or a command is refused.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum Refusal {
    /// Not a message of this type, or damaged.
    #[error("a packet on LINKAGE_COMMAND is no command: {0}")]
    Packet(#[from] DecodeError),
    /// Messages that are longer than any command: they were dropped unread.
    #[error(
        "{0} packets on LINKAGE_COMMAND were longer than {MAX_PACKET} bytes, and no command is"
    )]
    TooLong(u64),
    /// A command that cannot be obeyed.
    #[error("command {utime}: {fault}")]
    Command {
        /// Its name.
        utime: i64,
        /// What is wrong with it.
        fault: Fault,
    },
}

/// What is wrong with a command.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum Fault {
    /// A version that is not known.
    #[error("it has schema {0}; this service knows {SCHEMA}")]
    Schema(i32),
    /// An action that is not known.
    #[error("it has action {0}, which is none")]
    Action(i8),
    /// A name that cannot be.
    #[error("its {0} must have 1 to {MAX_NAME} bytes and no control characters")]
    Name(&'static str),
    /// A target that is not valid.
    #[error(transparent)]
    Target(#[from] PredictError),
    /// A grasp that is not a point, or one that no camera sees.
    #[error("its grasp must be a point within {FARTHEST_GRASP_M} m of the camera")]
    Grasp,
    /// The sender may not command, or not any more.
    #[error(transparent)]
    Unauthorised(#[from] Unauthorised),
    /// Its text or its lists cannot be read.
    #[error("it cannot be read: {0}")]
    Damaged(DecodeError),
    /// More than can be done.
    #[error("too many commands came at once; send it again")]
    TooMany,
}

/// Version of the commands that are understood.
pub const SCHEMA: i32 = 2;
/// Bytes of a name: those that the real-time half has room for.
const MAX_NAME: usize = 63;
/// Places of the queue of commands that are kept free for CANCEL: a flood of other commands must not
/// cause it to be refused.
pub const PLACES_FOR_CANCEL: usize = 4;
/// Distance of a grasp from the camera at most, metres: depth cameras see up to about 10 m.
const FARTHEST_GRASP_M: f64 = 20.0;
/// Bytes of a packet on the channel of commands; the longest command has some 400.
const MAX_PACKET: usize = 4096;

impl Action {
    /// What a command asks for.
    ///
    /// # Errors
    /// [`Fault`] says what is wrong with it.
    pub fn read(message: &linkage::Command) -> Result<Self, Fault> {
        if message.schema != SCHEMA {
            return Err(Fault::Schema(message.schema));
        }
        Ok(match message.action {
            linkage::Command::START_DEMONSTRATION => {
                Self::StartDemonstration { object: named("object", &message.object)? }
            }
            linkage::Command::FINISH_DEMONSTRATION => Self::FinishDemonstration,
            linkage::Command::RECOGNISE => {
                Self::Recognise { object: optional("object", &message.object)? }
            }
            linkage::Command::PREDICT => Self::Predict {
                target: target(message)?,
                grasp: grasp(message)?,
                object: optional("object", &message.object)?,
                joint: optional("joint", &message.joint)?,
            },
            linkage::Command::CANCEL => Self::Cancel,
            action => return Err(Fault::Action(action)),
        })
    }
}

fn named(what: &'static str, name: &str) -> Result<String, Fault> {
    let fits = !name.is_empty() && name.len() <= MAX_NAME && !name.contains(is_control);
    if fits { Ok(name.to_owned()) } else { Err(Fault::Name(what)) }
}

fn optional(what: &'static str, name: &str) -> Result<Option<String>, Fault> {
    if name.is_empty() { Ok(None) } else { named(what, name).map(Some) }
}

fn target(message: &linkage::Command) -> Result<Target, Fault> {
    let target: Target = named("target", &message.target)?.parse()?;
    Ok(match target {
        Target::Value(q) if message.outside_range => Target::Unseen(q),
        within => within,
    })
}

fn grasp(message: &linkage::Command) -> Result<Option<Point3<f64>>, Fault> {
    if !message.has_grasp {
        return Ok(None);
    }
    let grasp = Point3::from(message.grasp);
    if grasp.coords.norm() <= FARTHEST_GRASP_M { Ok(Some(grasp)) } else { Err(Fault::Grasp) }
}

/// The thread that listens.
pub struct Listener<'q> {
    lcm: Lcm,
    dispatcher: Dispatcher<'q>,
}

/// Longest wait for a packet before the thread checks whether it is to stop.
const POLL: Duration = Duration::from_millis(50);

impl<'q> Listener<'q> {
    pub fn new(
        url: &str,
        authority: Authority,
        commands: Sender<Command>,
        pulse: Option<Pulse<'q>>,
        out: Outbox,
    ) -> Result<Self, LcmError> {
        let mut lcm = Lcm::new(url)?;
        lcm.subscribe_up_to(channel::COMMAND, MAX_PACKET)?;
        Ok(Self { lcm, dispatcher: Dispatcher::new(authority, commands, pulse, out) })
    }

    pub fn run(mut self, is_stopped: &(dyn Fn() -> bool + Sync)) {
        let mut too_long = 0;
        while !is_stopped() {
            let received = self.lcm.receive(POLL);
            let all = self.lcm.reception().oversized;
            if all > too_long {
                self.dispatcher
                    .refusals
                    .add_many(all - too_long, &Refusal::TooLong(all - too_long));
                too_long = all;
            }
            match received {
                Ok(Some(Packet { bytes, sender, .. })) => {
                    self.dispatcher.take(&bytes, sender.map(|s| s.ip()), host_utime());
                }
                Ok(None) => {}
                Err(e) => {
                    self.dispatcher.out.note(Note::Error(e.to_string()));
                    std::thread::sleep(POLL);
                }
            }
            self.dispatcher.report();
        }
    }
}

/// Takes commands in: each is passed on once, or refused with its reason.
struct Dispatcher<'q> {
    authority: Authority,
    commands: Sender<Command>,
    /// Brakes what moves, where setpoints are streamed.
    pulse: Option<Pulse<'q>>,
    out: Outbox,
    /// Names of the commands that were passed on last.
    known: VecDeque<i64>,
    /// Hosts of the commands that were passed on last, the newest last: those of the queue, and some that have left it.
    waiting_senders: VecDeque<Option<IpAddr>>,
    refusals: Refusals,
    repeats: Repeats,
}

/// The name of a command that cannot be decoded: its first field, behind the fingerprint of its type.
fn name_of(packet: &[u8]) -> Option<i64> {
    let (fingerprint, rest) = packet.split_first_chunk::<8>()?;
    let (utime, _) = rest.split_first_chunk::<8>()?;
    let is_command = u64::from_be_bytes(*fingerprint) == linkage::Command::fingerprint();
    is_command.then(|| i64::from_be_bytes(*utime))
}

/// Commands that are known again.
const REMEMBERED: usize = 256;

impl<'q> Dispatcher<'q> {
    fn new(
        authority: Authority,
        commands: Sender<Command>,
        pulse: Option<Pulse<'q>>,
        out: Outbox,
    ) -> Self {
        let (refusals, repeats) = (Refusals::default(), Repeats::default());
        let (known, waiting_senders) = (VecDeque::new(), VecDeque::new());
        Self { authority, commands, pulse, out, known, waiting_senders, refusals, repeats }
    }

    /// A packet that came from somewhere, `now` in microseconds since 1970.
    fn take(&mut self, packet: &[u8], sender: Option<IpAddr>, now: i64) {
        let message: linkage::Command = match decode(packet) {
            Ok(message) => message,
            Err(e) => return self.refuse_damaged(packet, sender, e),
        };
        let utime = message.utime;
        if let Err(fault) = self.pass_on(&message, sender, now) {
            self.refusals.add(Refusal::Command { utime, fault }, sender);
        }
    }

    /// Refuses what cannot be decoded; under its name, where it begins as a command does.
    fn refuse_damaged(&mut self, packet: &[u8], sender: Option<IpAddr>, error: DecodeError) {
        let may_be_told = self.authority.may_be_told_unsigned(sender);
        let refusal = match name_of(packet).filter(|_| may_be_told) {
            Some(utime) => Refusal::Command { utime, fault: Fault::Damaged(error) },
            None => Refusal::Packet(error),
        };
        self.refusals.add(refusal, sender);
    }

    fn pass_on(
        &mut self,
        message: &linkage::Command,
        sender: Option<IpAddr>,
        now: i64,
    ) -> Result<(), Fault> {
        self.authority.identify(message, sender)?;
        let utime = message.utime;
        // One that was passed on is answered again for as long as anybody asks.
        if self.known.contains(&utime) {
            self.repeats.add(utime, sender);
            return Ok(());
        }
        let action = Action::read(message)?;
        // It is never too late to stop, whatever the clocks say: an old CANCEL that is played back harms nobody.
        let valid_until = match action {
            Action::Cancel => self.authority.is_of_session(message).map(|()| i64::MAX)?,
            _ => self.authority.valid_until(message, now)?,
        };
        // Whoever perceives may be busy with a frame, and braking waits for nobody.
        if let (Action::Cancel, Some(pulse)) = (&action, &self.pulse) {
            pulse.halt();
        }
        if !self.has_room_for(sender, action == Action::Cancel) {
            return Err(Fault::TooMany);
        }
        let expires = (message.expiry_utime != 0).then_some(message.expiry_utime);
        match self.commands.try_send(Command { utime, valid_until, expires, action }) {
            Ok(()) => {
                if self.known.len() == REMEMBERED {
                    self.known.pop_front();
                }
                self.known.push_back(utime);
                self.waiting_senders.push_back(sender);
                self.forget_senders_that_left_the_queue();
                Ok(())
            }
            Err(TrySendError::Full(_)) => Err(Fault::TooMany),
            // Perception is gone, and this thread is about to go.
            Err(TrySendError::Disconnected(_)) => Ok(()),
        }
    }

    /// Whether the queue has a place for a further command of this host. A single host gets half of the places, and
    /// half of those that are kept for CANCEL: its flood leaves the others to other hosts.
    fn has_room_for(&mut self, sender: Option<IpAddr>, is_cancel: bool) -> bool {
        let Some(places) = self.commands.capacity() else { return true };
        self.forget_senders_that_left_the_queue();
        let kept = if is_cancel { PLACES_FOR_CANCEL } else { 0 };
        let places = places.saturating_sub(PLACES_FOR_CANCEL);
        let own = self.waiting_senders.iter().filter(|s| **s == sender).count();
        self.commands.len() < places + kept && own < places.div_ceil(2) + kept / 2
    }

    fn forget_senders_that_left_the_queue(&mut self) {
        let gone = self.waiting_senders.len().saturating_sub(self.commands.len());
        self.waiting_senders.drain(..gone);
    }

    fn report(&mut self) {
        self.refusals.report(&self.out);
        self.repeats.report(&self.out);
    }
}

/// Time between two reports of refusals, or of repeats: a flood of them is a few notes.
const TELL_EVERY: Duration = Duration::from_millis(50);
/// Commands that one report names.
const TOLD_BY_NAME: usize = 8;

/// What the next report tells by name, with the host that it came from. If there is no room, the host with the most
/// makes room for one with fewer: a single host that floods this service does not keep it from answering another one.
#[derive(Debug, Default)]
struct FairList<T> {
    told: Vec<(Option<IpAddr>, T)>,
}

impl<T> FairList<T> {
    fn add(&mut self, sender: Option<IpAddr>, item: T) {
        let count = |of: &Option<IpAddr>| self.told.iter().filter(|(s, _)| s == of).count();
        if self.told.len() >= TOLD_BY_NAME {
            let places = self.told.iter().enumerate();
            let Some((place, most)) =
                places.map(|(i, (s, _))| (i, count(s))).max_by_key(|(_, count)| *count)
            else {
                return;
            };
            if most <= count(&sender) + 1 {
                return;
            }
            self.told.remove(place);
        }
        self.told.push((sender, item));
    }

    fn take(&mut self) -> impl Iterator<Item = T> + '_ {
        self.told.drain(..).map(|(_, item)| item)
    }
}

/// Refusals since they were told last.
#[derive(Debug, Default)]
struct Refusals {
    count: u64,
    latest: String,
    /// Those whose senders may know: name and reason.
    answers: FairList<(i64, String)>,
    told: Option<Instant>,
}

impl Refusals {
    /// Several of which none can be answered.
    fn add_many(&mut self, count: u64, refusal: &Refusal) {
        self.count += count;
        self.latest = refusal.to_string();
    }

    fn add(&mut self, refusal: Refusal, sender: Option<IpAddr>) {
        self.count += 1;
        self.latest = refusal.to_string();
        let Refusal::Command { utime, fault } = refusal else { return };
        let is_answered = !matches!(&fault, Fault::Unauthorised(u) if !u.is_answered());
        if is_answered {
            self.answers.add(sender, (utime, fault.to_string()));
        }
    }

    fn report(&mut self, out: &Outbox) {
        if self.count == 0 || self.told.is_some_and(|t| t.elapsed() < TELL_EVERY) {
            return;
        }
        let reason = std::mem::take(&mut self.latest);
        out.note(Note::Refused { count: std::mem::take(&mut self.count), reason });
        for (utime, text) in self.answers.take() {
            out.note(Note::NotTaken(Answer { utime, accepted: false, done: true, text }));
        }
        self.told = Some(Instant::now());
    }
}

/// Commands that came again since they were told last.
#[derive(Debug, Default)]
struct Repeats {
    utimes: FairList<i64>,
    told: Option<Instant>,
}

impl Repeats {
    fn add(&mut self, utime: i64, sender: Option<IpAddr>) {
        if !self.utimes.told.contains(&(sender, utime)) {
            self.utimes.add(sender, utime);
        }
    }

    fn report(&mut self, out: &Outbox) {
        let is_due = self.told.is_none_or(|t| t.elapsed() >= TELL_EVERY);
        if is_due && !self.utimes.told.is_empty() {
            self.utimes.take().for_each(|utime| out.note(Note::Again(utime)));
            self.told = Some(Instant::now());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::observer::Observer;
    use super::*;
    use crate::limits::Access;
    use crossbeam_channel::Receiver;
    use linkage_driver::live::{LatestReader, latest};
    use linkage_lcm::encode;
    use proptest::prelude::*;

    const SESSION: i64 = 1_000_000_000_000;
    const NOW: i64 = SESSION + 60_000_000;

    fn message(action: i8) -> linkage::Command {
        linkage::Command {
            utime: NOW,
            schema: SCHEMA,
            action,
            object: "fridge".into(),
            target: "open".into(),
            session: SESSION,
            ..Default::default()
        }
    }

    struct Bench {
        dispatcher: Dispatcher<'static>,
        commands: Receiver<Command>,
        notes: LatestReader<Note>,
    }

    fn bench(room: usize) -> Bench {
        let (sender, commands) = crossbeam_channel::bounded(room);
        let (packets, _unread) = latest(4);
        let (writer, notes) = latest(64);
        let authority = Authority::new(SESSION, 1.0, &Access::default()).unwrap();
        let out = Outbox { packets, notes: writer, observer: Observer::default() };
        Bench { dispatcher: Dispatcher::new(authority, sender, None, out), commands, notes }
    }

    impl Bench {
        /// What becomes of a packet: the notes that tell of it.
        fn take(&mut self, packet: &[u8]) -> Vec<Note> {
            self.dispatcher.take(packet, None, NOW);
            self.dispatcher.refusals.told = None;
            self.dispatcher.report();
            std::iter::from_fn(|| self.notes.pop(Duration::ZERO).ok()).collect()
        }

        fn refusal(&mut self, change: impl FnOnce(&mut linkage::Command)) -> (i64, String) {
            let mut wrong = message(linkage::Command::PREDICT);
            change(&mut wrong);
            let notes = self.take(&encode(&wrong).unwrap());
            assert!(self.commands.try_recv().is_err(), "it was passed on");
            let answer = notes.into_iter().find_map(|n| match n {
                Note::NotTaken(answer) => Some(answer),
                _ => None,
            });
            let Answer { utime, accepted, done, text } = answer.expect("an answer");
            assert!(!accepted && done);
            (utime, text)
        }
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
            assert_eq!(Action::read(&message(code)), Ok(action));
        }
    }

    #[test]
    fn a_command_that_is_refused_while_it_is_read_is_answered_under_its_name() {
        let mut bench = bench(4);
        let mut refusal = |change: fn(&mut linkage::Command)| {
            let (utime, text) = bench.refusal(change);
            assert_eq!(utime, NOW);
            text
        };
        assert!(refusal(|m| m.schema = 9).contains("schema 9"));
        assert!(refusal(|m| m.action = 17).contains("action 17"));
        assert!(refusal(|m| m.target = "NaN".into()).contains("\"NaN\" is no target"));
        assert!(refusal(|m| m.target = "inf".into()).contains("\"inf\" is no target"));
        assert!(refusal(|m| m.target = "x".repeat(100)).contains("target must have"));
        assert!(refusal(|m| m.object = "x".repeat(64)).contains("63 bytes"));
        assert!(refusal(|m| m.object = "a\nb".into()).contains("control characters"));
        assert!(refusal(|m| m.joint = "a\u{7}".into()).contains("its joint"));
        assert!(refusal(|m| (m.has_grasp, m.grasp[1]) = (true, f64::NAN)).contains("grasp"));
        assert!(refusal(|m| (m.has_grasp, m.grasp[2]) = (true, 1e308)).contains("within 20 m"));
        assert!(refusal(|m| m.session = 3).contains("session 3"));
        assert!(refusal(|m| m.expiry_utime = NOW - 1).contains("holds for"));
    }

    #[test]
    fn one_that_finds_no_room_is_answered_too() {
        let mut bench = bench(1 + PLACES_FOR_CANCEL);
        bench.take(&encode(&message(2)).unwrap());
        let second = linkage::Command { utime: NOW + 1, ..message(2) };
        let notes = bench.take(&encode(&second).unwrap());
        let answered = |n: &Note| matches!(n, Note::NotTaken(a) if a.utime == NOW + 1);
        assert!(notes.iter().any(answered));
        // It was not done, so it may come again.
        bench.commands.try_recv().unwrap();
        bench.take(&encode(&second).unwrap());
        assert_eq!(bench.commands.try_recv().map(|c| c.utime), Ok(NOW + 1));
    }

    #[test]
    fn a_flood_of_commands_leaves_room_for_cancel() {
        let mut bench = bench(8 + PLACES_FOR_CANCEL);
        for i in 0..100 {
            let utime = NOW + i;
            bench.take(&encode(&linkage::Command { utime, ..message(2) }).unwrap());
        }
        assert_eq!(bench.commands.len(), 4, "a host gets half of the places");
        let cancel = linkage::Command { utime: NOW + 100, ..message(4) };
        let notes = bench.take(&encode(&cancel).unwrap());
        assert!(!notes.iter().any(|n| matches!(n, Note::NotTaken(_))), "CANCEL was refused");
        let last = bench.commands.try_iter().last().map(|c| (c.utime, c.action));
        assert_eq!(last, Some((NOW + 100, Action::Cancel)));
    }

    #[test]
    fn a_flood_of_one_host_leaves_half_of_the_queue_to_others() {
        let mut bench = bench(8 + PLACES_FOR_CANCEL);
        let from = |host: &str| Some(host.parse().unwrap());
        let mut send = |utime: i64, host: &str| {
            let order = encode(&linkage::Command { utime, ..message(2) }).unwrap();
            bench.dispatcher.take(&order, from(host), NOW);
            bench.commands.len()
        };
        for i in 0..100 {
            send(NOW + i, "10.0.0.1");
        }
        assert_eq!(send(NOW + 100, "10.0.0.2"), 5);
        let mut cancel = |utime: i64, host: &str| {
            let order = encode(&linkage::Command { utime, ..message(4) }).unwrap();
            bench.dispatcher.take(&order, from(host), NOW);
            bench.commands.len()
        };
        (200..300).for_each(|i| {
            cancel(NOW + i, "10.0.0.1");
        });
        assert_eq!(cancel(NOW + 300, "10.0.0.2"), 8, "two of each host");
        // What has left the queue counts no more.
        let taken: Vec<i64> = bench.commands.try_iter().map(|c| c.utime).collect();
        assert!(taken.contains(&(NOW + 100)) && taken.contains(&(NOW + 300)));
        let order = encode(&linkage::Command { utime: NOW + 101, ..message(2) }).unwrap();
        bench.dispatcher.take(&order, from("10.0.0.1"), NOW);
        assert_eq!(bench.commands.len(), 1);
    }

    #[test]
    fn an_old_cancel_of_this_session_cancels_and_that_of_another_one_does_not() {
        let mut bench = bench(8);
        let hour = 3_600_000_000;
        for utime in [NOW - hour, NOW + hour, SESSION - 1] {
            bench.take(&encode(&linkage::Command { utime, ..message(4) }).unwrap());
            assert_eq!(bench.commands.try_recv().map(|c| c.action), Ok(Action::Cancel));
        }
        let (_, text) = bench.refusal(|m| (m.action, m.session) = (4, SESSION + 1));
        assert!(text.contains("session"), "{text}");
    }

    #[test]
    fn a_command_whose_text_cannot_be_read_is_answered_under_its_name() {
        let mut bench = bench(4);
        let name = b"fridge\0";
        let mut packet = encode(&message(linkage::Command::PREDICT)).unwrap();
        let at = packet.windows(name.len()).position(|bytes| bytes == name).unwrap();
        packet[at + 2] = 0;
        let notes = bench.take(&packet);
        let answers = notes.iter().filter_map(|n| match n {
            Note::NotTaken(answer) => Some(answer),
            _ => None,
        });
        let answers: Vec<&Answer> = answers.collect();
        assert_eq!((answers.len(), answers[0].utime), (1, NOW));
        assert!(answers[0].text.contains("a string is damaged"), "{}", answers[0].text);
        // What is no command has no name.
        packet[0] ^= 1;
        assert!(!bench.take(&packet).iter().any(|n| matches!(n, Note::NotTaken(_))));
    }

    #[test]
    fn packets_that_are_too_long_are_counted_and_told() {
        let mut bench = bench(4);
        bench.dispatcher.refusals.add_many(3, &Refusal::TooLong(3));
        bench.dispatcher.report();
        let Ok(Note::Refused { count, reason }) = bench.notes.pop(Duration::ZERO) else {
            panic!("it is not told")
        };
        assert_eq!(count, 3);
        assert!(reason.contains("longer than 4096 bytes"), "{reason}");
    }

    #[test]
    fn what_comes_again_is_not_done_again_however_late() {
        let mut bench = bench(4);
        let packet = encode(&message(4)).unwrap();
        bench.take(&packet);
        assert!(bench.commands.try_recv().is_ok());
        bench.dispatcher.take(&packet, None, NOW + 3_600_000_000);
        bench.dispatcher.report();
        assert!(matches!(bench.notes.pop(Duration::ZERO), Ok(Note::Again(NOW))));
        assert!(bench.commands.try_recv().is_err());
    }

    #[test]
    fn a_host_that_floods_does_not_keep_another_one_from_being_answered() {
        let [loud, quiet] = [1, 2].map(|k| Some(IpAddr::from([10, 0, 0, k])));
        let mut bench = bench(64);
        let known = encode(&message(2)).unwrap();
        bench.dispatcher.take(&known, quiet, NOW);
        let bad = |utime: i64| encode(&linkage::Command { utime, ..message(77) }).unwrap();
        let again = |utime: i64| encode(&linkage::Command { utime, ..message(2) }).unwrap();
        (1..30).for_each(|i| bench.dispatcher.take(&again(NOW + i), loud, NOW));
        for i in 1..200 {
            bench.dispatcher.take(&bad(NOW + 1000 + i), loud, NOW);
            bench.dispatcher.take(&again(NOW + 1 + i % 29), loud, NOW);
            if i == 100 {
                bench.dispatcher.take(&bad(NOW + 5000), quiet, NOW);
                bench.dispatcher.take(&known, loud, NOW);
                bench.dispatcher.take(&known, quiet, NOW);
            }
        }
        bench.dispatcher.report();
        let notes: Vec<Note> =
            std::iter::from_fn(|| bench.notes.pop(Duration::ZERO).ok()).collect();
        let is_answered = |n: &Note| matches!(n, Note::NotTaken(a) if a.utime == NOW + 5000);
        assert!(notes.iter().any(is_answered));
        assert!(notes.iter().any(|n| matches!(n, Note::Again(NOW))));
        let named = notes.iter().filter(|n| !matches!(n, Note::Refused { .. })).count();
        assert_eq!(named, 2 * TOLD_BY_NAME);
    }

    #[test]
    fn a_flood_is_a_few_notes() {
        let mut bench = bench(4 + PLACES_FOR_CANCEL);
        for i in 0..10_000 {
            let utime = NOW + i % 100;
            let order = linkage::Command { utime, ..message((i % 7) as i8) };
            bench.dispatcher.take(&encode(&order).unwrap(), None, NOW);
            bench.dispatcher.report();
        }
        assert_eq!(bench.notes.dropped(), 0);
    }

    #[test]
    fn a_target_outside_the_range_must_be_allowed() {
        let mut wide = linkage::Command { target: "2.5".into(), ..message(3) };
        let target_of = |m: &linkage::Command| match Action::read(m).unwrap() {
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
            let mut bench = bench(4 + PLACES_FOR_CANCEL);
            bench.take(&bytes);
            let whole = encode(&message(3)).unwrap();
            bench.take(&whole[..cut.min(whole.len() - 1)]);
            prop_assert!(bench.commands.try_recv().is_err());
        }
    }
}
