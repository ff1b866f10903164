//! The thread that perceives: takes frames and commands, and is always in one of the states that
//! the status tells.

use super::capture::{Arrived, Lost};
use super::command::{Action, Command};
use super::config::ServiceConfig;
use super::learning::{Learning, LearningWorker};
use super::losses::Losses;
use super::observer::EventKind;
use super::publisher::{Answer, Note, Outbox, Situation};
use super::reacquire::Reacquisition;
use super::stream::Orders;
use super::watchdog::Watchdog;
use crate::channel;
use crate::messages::{self, Stamps};
use crate::plan::{PlanError, Request, predict};
use crossbeam_channel::Receiver;
use linkage_driver::RgbdFrame;
use linkage_driver::live::{LatestReader, RecvError, host_utime};
use linkage_realtime::{Notice, Reason};
use linkage_skill::predict::{PredictError, Target};
use linkage_skill::recognise::{Follower, KnownObject, Recognised, Recognition, Scene};
use linkage_skill::store::Library;
use linkage_skill::{Learner, ObjectModel, SkillConfig};
use nalgebra::Point3;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// What comes to the thread that perceives.
pub struct Inbox {
    pub frames: LatestReader<Arrived>,
    pub lost: Lost,
    pub commands: Receiver<Command>,
}

pub struct Perception<'q> {
    config: ServiceConfig,
    learning_worker: LearningWorker,
    inbox: Inbox,
    losses: Losses,
    watchdog: Watchdog,
    out: Outbox,
    orders: Option<Orders<'q>>,
    library: Library,
    state: State,
    looked_at: u64,
    arrivals: VecDeque<Instant>,
    told: Option<(Instant, Situation)>,
}

enum State {
    /// Idle, or ready where something is known.
    Resting,
    Demonstrating(Box<Demonstrating>),
    Learning {
        learning: Learning,
        /// That asked for it, if one did.
        command: Option<i64>,
    },
    Watching(Watching),
    Tracking(Box<Tracking>),
}

struct Demonstrating {
    object: String,
    learner: Learner,
    current_estimate: ObjectModel,
    told: Instant,
    losses: Losses,
}

struct Watching {
    /// Any where none is named.
    object: Option<String>,
    pending: Option<Pending>,
    /// Best score so far of what was not accepted.
    best_refused: f64,
    /// Frames that were searched.
    searched: usize,
}

impl Watching {
    fn new(object: Option<String>, pending: Option<Pending>) -> Self {
        Self { object, pending, best_refused: 0.0, searched: 0 }
    }
}

struct Tracking {
    object: Arc<KnownObject>,
    follower: Follower,
    recognised: Recognised,
    /// The newest frame shows it.
    seen: bool,
    utime: i64,
    arrived: Instant,
    pending: Option<Pending>,
    reacquisition: Reacquisition,
}

/// A prediction that waits for its object to be found.
struct Pending {
    command: i64,
    joint: Option<String>,
    target: Target,
    grasp: Option<Point3<f64>>,
    since: Instant,
}

/// Longest wait for a frame before commands are read.
const POLL: Duration = Duration::from_millis(20);
/// Time between two reports of the current estimate while a demonstration runs, and of the
/// situation where it changes in figures alone.
const TELL_EVERY: Duration = Duration::from_millis(450);
/// A prediction whose object is not found for this long is refused.
const TIMEOUT: Duration = Duration::from_secs(5);
/// A prediction whose joint is not known for this long is refused: recognition is asked meanwhile.
const JOINT_TIMEOUT: Duration = Duration::from_secs(2);
/// Time over which losses of frames are counted.
const LOSSES_OVER: Duration = Duration::from_secs(3);
/// Arrivals that the frame rate is taken over, and how old they may be.
const RATE_FRAMES: usize = 30;
const RATE_WINDOW: Duration = Duration::from_secs(3);

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
            learning_worker: LearningWorker { config: skill, store, out: out.clone() },
            losses: Losses::begin(&inbox.lost, 0),
            inbox,
            watchdog: Watchdog::from_environment(),
            out,
            orders,
            library,
            state: State::Resting,
            looked_at: 0,
            arrivals: VecDeque::new(),
            told: None,
        }
    }

    /// Perceives until it is stopped; frames that were looked at, and that were dropped.
    pub fn run(mut self, is_stopped: &(dyn Fn() -> bool + Sync)) -> (u64, u64) {
        self.watchdog.ready();
        while !is_stopped() {
            self.watchdog.alive();
            while let Ok(command) = self.inbox.commands.try_recv() {
                self.handle_command(command);
            }
            match self.inbox.frames.pop(POLL) {
                Ok(arrived) => self.look(arrived),
                Err(RecvError::Timeout) => {}
                // The source is over, commands are not.
                Err(RecvError::Closed) => std::thread::sleep(POLL),
            }
            self.tick();
            self.publish_status();
        }
        self.watchdog.stopping();
        (self.looked_at, self.dropped_frames())
    }

    fn dropped_frames(&self) -> u64 {
        self.inbox.frames.dropped() + self.inbox.lost.count()
    }

    /// Tells the result of a command.
    fn answer(&self, command: i64, result: Result<String, String>) {
        let accepted = result.is_ok();
        let text = result.unwrap_or_else(|reason| reason);
        self.out.note(Note::Answer(Answer { utime: command, accepted, done: true, text }));
    }

    /// Tells that a command is being done.
    fn acknowledge(&self, command: i64, text: String) {
        let answer = Answer { utime: command, accepted: true, done: false, text };
        self.out.note(Note::Answer(answer));
    }

    fn handle_command(&mut self, Command { utime, valid_until, action }: Command) {
        // A command that expired while this thread was busy is not executed.
        if host_utime() > valid_until {
            let reason = "it came too late to be begun: send it again".to_owned();
            return self.answer(utime, Err(reason));
        }
        let begun = match action {
            Action::StartDemonstration { object } => {
                return self.answer_with(utime, |it| it.start_demonstration(object));
            }
            Action::Recognise { object } => {
                return self.answer_with(utime, |it| it.watch(object, None));
            }
            Action::Cancel => return self.answer_with(utime, |it| Ok(it.cancel())),
            Action::FinishDemonstration => self.finish_demonstration(Some(utime)),
            Action::Predict { object, joint, target, grasp } => {
                let since = Instant::now();
                let pending = Pending { command: utime, joint, target, grasp, since };
                self.predict(object, pending)
            }
        };
        match begun {
            Ok(text) => {
                self.publish_status();
                self.acknowledge(utime, text);
                self.execute_pending();
            }
            Err(reason) => self.answer(utime, Err(reason)),
        }
    }

    fn answer_with(
        &mut self,
        command: i64,
        work: impl FnOnce(&mut Self) -> Result<String, String>,
    ) {
        let result = work(self);
        // The state is published first, so that a reader of the answer finds it.
        self.publish_status();
        self.answer(command, result);
    }

    /// Refuses what must not interrupt a demonstration.
    fn interruptible(&self) -> Result<(), String> {
        match &self.state {
            State::Demonstrating(d) => {
                Err(format!("{} is being demonstrated; finish or cancel first", d.object))
            }
            State::Learning { learning, .. } => {
                Err(format!("{} is being learned; wait, or cancel", learning.object))
            }
            _ => Ok(()),
        }
    }

    fn start_demonstration(&mut self, object: String) -> Result<String, String> {
        self.interruptible()?;
        self.become_idle(Reason::Replaced);
        let learner = Learner::live(&self.config.skill);
        let current_estimate = learner.current_estimate(&object);
        let answer = format!("watching how {object} is moved");
        let losses = Losses::begin(&self.inbox.lost, 0);
        let demonstrating =
            Demonstrating { object, learner, current_estimate, told: Instant::now(), losses };
        self.state = State::Demonstrating(Box::new(demonstrating));
        Ok(answer)
    }

    fn finish_demonstration(&mut self, command: Option<i64>) -> Result<String, String> {
        match std::mem::replace(&mut self.state, State::Resting) {
            State::Demonstrating(d) => {
                let Demonstrating { object, learner, losses, .. } = *d;
                let frames = learner.tracker().frames();
                let lost = losses.many(&self.inbox.lost, frames as u64);
                if let Some(lost) = &lost {
                    self.out.note(Note::Error(lost.clone()));
                }
                let learning = self
                    .learning_worker
                    .learn(learner, object.clone(), lost)
                    .map_err(|e| e.to_string())?;
                self.state = State::Learning { learning, command };
                Ok(format!("learning {object} from {frames} frames"))
            }
            other => {
                self.state = other;
                Err("no demonstration runs; start one first".to_owned())
            }
        }
    }

    fn watch(
        &mut self,
        object: Option<String>,
        pending: Option<Pending>,
    ) -> Result<String, String> {
        self.interruptible()?;
        if self.library.is_empty() {
            return Err("nothing is known yet; demonstrate something first".to_owned());
        }
        if let Some(name) = &object
            && self.library.number(name).is_none()
        {
            return Err(format!("no object \"{name}\" is known"));
        }
        self.become_idle(Reason::Replaced);
        let answer = match &object {
            Some(name) => format!("looking for {name}"),
            None => "looking for anything known".to_owned(),
        };
        self.state = State::Watching(Watching::new(object, pending));
        Ok(answer)
    }

    fn predict(&mut self, object: Option<String>, pending: Pending) -> Result<String, String> {
        if let State::Tracking(t) = &mut self.state {
            let name = &t.object.model.object;
            if object.as_ref().is_none_or(|wanted| wanted == name) {
                let answer = format!("predicting {name}");
                if t.arrived.elapsed().as_secs_f64() > self.config.rig.safety.frame_age {
                    return Err(stale(t.arrived.elapsed()));
                }
                t.pending = Some(pending);
                return Ok(answer);
            }
        }
        self.watch(object, Some(pending))
    }

    fn cancel(&mut self) -> String {
        if let State::Learning { learning, command } = &self.state {
            learning.cancel();
            if let Some(command) = *command {
                self.answer(command, Err("cancelled".to_owned()));
            }
        }
        self.become_idle(Reason::Cancelled);
        "cancelled".to_owned()
    }

    /// Nothing is looked for, what moves is braked.
    fn become_idle(&mut self, why: Reason) {
        let pending = match &mut self.state {
            State::Watching(w) => w.pending.take(),
            State::Tracking(t) => t.pending.take(),
            _ => None,
        };
        if let Some(pending) = pending {
            let reason = "another command came before it was planned".to_owned();
            self.answer(pending.command, Err(reason));
        }
        self.brake(why);
        self.state = State::Resting;
    }

    fn brake(&mut self, why: Reason) {
        if let Some(orders) = &mut self.orders {
            orders.brake(why);
        }
    }

    fn look(&mut self, Arrived { frame, at }: Arrived) {
        self.looked_at += 1;
        if self.arrivals.len() == RATE_FRAMES {
            self.arrivals.pop_front();
        }
        self.arrivals.push_back(at);
        match &mut self.state {
            State::Resting | State::Learning { .. } => self.out.observer.frame(frame),
            State::Demonstrating(_) => {
                self.demonstrate(&frame);
                self.out.observer.frame(frame);
            }
            State::Watching(_) => {
                let newest = self.newest(Arrived { frame, at });
                self.search(&newest);
                self.out.observer.frame(newest.frame);
            }
            State::Tracking(_) => {
                let newest = self.newest(Arrived { frame, at });
                self.follow(&newest);
                self.out.observer.frame(newest.frame);
            }
        }
    }

    /// The newest frame that waits; older ones are skipped.
    fn newest(&mut self, oldest: Arrived) -> Arrived {
        let mut newest = oldest;
        while let Ok(newer) = self.inbox.frames.pop(Duration::ZERO) {
            self.looked_at += 1;
            newest = newer;
        }
        newest
    }

    fn demonstrate(&mut self, frame: &RgbdFrame) {
        let State::Demonstrating(d) = &mut self.state else { return };
        match d.learner.push(frame) {
            Ok(()) => {}
            Err(e) => self.out.note(Note::Error(format!("{}: {e}", d.object))),
        }
        let tracked = || d.learner.tracker().lifted().into_iter().map(|(_, p)| p).collect();
        self.out.observer.event(frame.utime, || EventKind::Tracked(tracked()));
        if d.told.elapsed() >= TELL_EVERY {
            d.told = Instant::now();
            d.current_estimate = d.learner.current_estimate(&d.object);
            self.out.send(channel::MODEL, &messages::model(&d.current_estimate, frame.utime));
            if let Some(camera_from_object) = d.learner.camera_from_object() {
                let model = || d.current_estimate.clone();
                let estimated = || EventKind::Estimated { model: model(), camera_from_object };
                self.out.observer.event(frame.utime, estimated);
            }
        }
    }

    /// Looks for objects in a frame.
    fn search(&mut self, Arrived { frame, at }: &Arrived) {
        let State::Watching(w) = &mut self.state else { return };
        let skill = &self.config.skill;
        let believed = match search(&self.library, frame, w, skill) {
            Ok(found) => found,
            Err(reason) => return self.out.note(Note::Error(reason)),
        };
        w.searched += 1;
        w.best_refused = w.best_refused.max(believed.best_refused);
        let numbers = believed.matches.iter().filter_map(|m| self.library.number(&m.object));
        let known: Vec<Arc<KnownObject>> =
            numbers.filter_map(|n| self.library.object(n).ok()).collect();
        let model_of = |name: &str| known.iter().map(|k| &k.model).find(|m| m.object == name);
        let message = messages::recognition(&believed, model_of, frame.utime);
        self.out.send(channel::RECOGNITION, &message);
        self.out.observer.event(frame.utime, || EventKind::Recognised(believed.clone()));
        let Some(best) = believed.matches.into_iter().next() else { return };
        let Some(object) = known.iter().find(|k| k.model.object == best.object) else { return };
        if let Some(follower) = Follower::new(Arc::clone(object), &best) {
            if let Some(orders) = &mut self.orders {
                orders.frame_seen(&best, frame.utime, *at);
            }
            let pending = w.pending.take();
            self.state = State::Tracking(Box::new(Tracking {
                object: Arc::clone(object),
                follower,
                recognised: best,
                seen: true,
                utime: frame.utime,
                arrived: *at,
                pending,
                reacquisition: Reacquisition::begun_now(),
            }));
            self.execute_pending();
        }
    }

    /// Follows the object that was found.
    fn follow(&mut self, Arrived { frame, at }: &Arrived) {
        let State::Tracking(t) = &mut self.state else { return };
        t.reacquisition.answer(&mut t.follower);
        match t.follower.follow(frame) {
            Ok(followed) => {
                (t.seen, t.utime, t.arrived) = (followed.seen, frame.utime, *at);
                if followed.seen {
                    t.recognised = followed.recognised;
                    let now = Recognition::new(vec![t.recognised.clone()]);
                    let model = &t.object.model;
                    let message = messages::recognition(&now, |_| Some(model), frame.utime);
                    self.out.send(channel::RECOGNITION, &message);
                    self.out.observer.event(frame.utime, || EventKind::Recognised(now));
                }
                let Tracking { reacquisition, follower, object, recognised, .. } = &mut **t;
                let skill = &self.config.skill;
                if let Err(e) = reacquisition.ask(follower, object, recognised, frame, skill) {
                    self.out.note(Note::Error(format!("recognition cannot be asked again: {e}")));
                }
                match &mut self.orders {
                    Some(orders) if t.seen => orders.frame_seen(&t.recognised, t.utime, t.arrived),
                    Some(orders) => orders.frame_missed_it(),
                    None => {}
                }
                self.execute_pending();
            }
            Err(lost) => {
                self.out.note(Note::Error(lost.to_string()));
                // Its configuration may be any by now: it is looked for again.
                let object = Some(t.object.model.object.clone());
                let pending = t.pending.take();
                self.state = State::Watching(Watching::new(object, pending));
                self.brake(Reason::ObjectLost);
            }
        }
    }

    /// Plans what was asked for, if the newest frame is fresh and shows the object.
    fn execute_pending(&mut self) {
        let State::Tracking(t) = &mut self.state else { return };
        let fresh = t.arrived.elapsed().as_secs_f64() <= self.config.rig.safety.frame_age;
        if !(t.seen && fresh) {
            return;
        }
        if t.pending.is_none() {
            return;
        }
        // What moves is braked first, or just about to arrive.
        let commanded = self.orders.as_ref().map_or(Ok(None), Orders::commanded);
        let Ok(commanded) = commanded else { return };
        let Some(pending) = t.pending.take() else { return };
        let request = Request {
            joint: pending.joint.as_deref(),
            target: pending.target,
            grasp: pending.grasp,
            moving: commanded.as_ref(),
        };
        let model = &t.object.model;
        let stamps = Stamps { captured: t.utime, made: host_utime() };
        let planned = predict(model, &t.recognised, &request, &self.config.rig);
        let is_unclear = matches!(
            &planned,
            Err(PlanError::Predict(PredictError::Unseen { .. }) | PlanError::Unclear { .. })
        );
        if is_unclear && pending.since.elapsed() < JOINT_TIMEOUT {
            t.pending = Some(pending);
            return;
        }
        let planned = planned.map_err(|e: PlanError| e.to_string()).and_then(|plan| {
            let robot_plan = messages::robot_plan(&plan, stamps).map_err(|e| e.to_string())?;
            Ok((plan, robot_plan))
        });
        let (plan, robot_plan) = match planned {
            Ok(planned) => planned,
            Err(reason) => return self.answer(pending.command, Err(reason)),
        };
        let message = messages::prediction(&plan.prediction, model, stamps);
        self.out.send(channel::PREDICTION, &message);
        self.out.send(channel::PLAN, &robot_plan);
        self.out.observer.event(t.utime, || EventKind::Predicted(plan.prediction.clone()));
        let knots = robot_plan.plan.len();
        let streamed = self.orders.as_mut().map(|orders| match plan.motion() {
            Err(_) => "; not streamed: too many joints",
            Ok(motion) => match orders.run(&motion, plan.start_us) {
                Ok(()) => ", which are streamed",
                Err(_) => "; not streamed: orders come too fast",
            },
        });
        let text = format!("planned {} in {knots} knots{}", model.object, streamed.unwrap_or(""));
        self.answer(pending.command, Ok(text));
    }

    /// Does the work that does not depend on frames.
    fn tick(&mut self) {
        if self.losses.age() >= LOSSES_OVER {
            if let Some(lost) = self.losses.many(&self.inbox.lost, self.looked_at) {
                self.out.note(Note::Error(lost));
            }
            self.losses = Losses::begin(&self.inbox.lost, self.looked_at);
        }
        match self.orders.as_mut().and_then(Orders::poll) {
            Some(Notice::Ended(Some(why))) => {
                self.out.note(Note::Error(format!("the motion was braked: {why}")));
            }
            Some(Notice::Refused(why)) => {
                self.out.note(Note::Error(format!("the motion was not executed: {why}")));
            }
            Some(Notice::Ended(None)) | None => {}
        }
        if let State::Learning { learning, command } = &self.state
            && let Some(result) = learning.poll()
        {
            let (command, object) = (*command, learning.object.clone());
            self.state = State::Resting;
            let result = match result {
                Ok(learned) => {
                    self.library = learned.library;
                    Ok(learned.summary)
                }
                Err(reason) => {
                    let reason = format!("{object}: {reason}");
                    self.out.note(Note::Error(reason.clone()));
                    Err(reason)
                }
            };
            self.publish_status();
            if let Some(command) = command {
                self.answer(command, result);
            }
        }
        self.time_out_pending();
    }

    /// Refuses a prediction that has waited too long.
    fn time_out_pending(&mut self) {
        let threshold = self.config.skill.recognise.min_score;
        let since = self.arrivals.back().map(Instant::elapsed);
        let (pending, reason) = match &mut self.state {
            State::Watching(w) => {
                let what = w.object.as_deref().unwrap_or("anything known");
                let reason = match since {
                    Some(since) if since < TIMEOUT => format!(
                        "{what} is not recognised: the best score is {:.2}, {threshold:.2} is needed",
                        w.best_refused
                    ),
                    Some(since) => stale(since),
                    None => "no frame has come yet".to_owned(),
                };
                (&mut w.pending, reason)
            }
            State::Tracking(t) => {
                let reason = match t.seen {
                    true => stale(t.arrived.elapsed()),
                    false => format!("{} is not seen now", t.object.model.object),
                };
                (&mut t.pending, reason)
            }
            _ => return,
        };
        if pending.as_ref().is_some_and(|p| p.since.elapsed() > TIMEOUT)
            && let Some(refused) = pending.take()
        {
            self.answer(refused.command, Err(reason));
        }
    }

    /// Tells the situation when it changes, and now and then.
    fn publish_status(&mut self) {
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

/// Looks for what is watched for; for anything known, in one shortlist a frame.
fn search(
    library: &Library,
    frame: &RgbdFrame,
    watching: &Watching,
    skill: &SkillConfig,
) -> Result<Recognition, String> {
    let scene = Scene::new(frame).map_err(|e| e.to_string())?;
    let config = &skill.recognise;
    let listed = watching.object.as_deref().and_then(|name| library.number(name));
    let found = match listed {
        Some(number) => library.recognise_listed(&scene, &[number], config, skill.seed),
        None => library.recognise_in_turn(&scene, config, skill.seed, watching.searched),
    };
    found.map_err(|e| e.to_string())
}

/// Kind and certainty of each joint.
fn certainties(model: &ObjectModel) -> Vec<(&'static str, f64)> {
    let certainty = |j: &linkage_skill::Joint| j.type_probabilities.get(&j.kind).copied();
    model.joints.iter().map(|j| (j.kind.name(), certainty(j).unwrap_or(1.0))).collect()
}

fn stale(age: Duration) -> String {
    format!("the newest frame is {:.1} s old: is the camera still there?", age.as_secs_f64())
}
