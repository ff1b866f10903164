//! What is made of a frame: by the state, it is learned from, searched, or followed in.
//!
//! In: the frames that wait, with when they arrived. Out: the next state, messages with what was
//! learned or recognised (camera frame, metres), orders about what is seen.

use super::perceiver::Perception;
use super::state::{State, Tracking, Watching};
use super::status::{RATE_FRAMES, TELL_EVERY};
use crate::channel;
use crate::messages;
use crate::service::capture::Arrived;
use crate::service::observer::EventKind;
use crate::service::publisher::Note;
use crate::service::reacquire::Reacquisition;
use crate::service::searching::{Found, Searching, Wanted};
use crate::service::stream::Orders;
use linkage_driver::RgbdFrame;
use linkage_realtime::Reason;
use linkage_skill::recognise::{Follower, Recognition};
use std::hash::{DefaultHasher, Hasher};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// What is told where depth does not change while a joint moves.
const FROZEN: &str = "the depth pictures do not change while a joint moves: is the camera frozen?";

impl Perception<'_> {
    pub fn look(&mut self, Arrived { frame, at }: Arrived) {
        self.looked_at += 1;
        if self.arrivals.len() == RATE_FRAMES {
            self.arrivals.pop_front();
        }
        self.arrivals.push_back(at);
        self.take_found();
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

    /// Begins to look for objects in a frame, unless the search in an earlier one still runs.
    fn search(&mut self, newest: &Arrived) {
        let State::Watching(w) = &mut self.state else { return };
        w.turns.frame(&newest.frame);
        if self.searching.is_some() {
            return;
        }
        let (turn, still) = w.turns.begin();
        let wanted = Wanted { object: w.object.clone(), turn, still };
        match Searching::begin(wanted, newest, &self.library, &self.config.skill) {
            Ok(searching) => {
                self.searching = Some(searching);
                w.awaits_search = true;
            }
            Err(e) => self.out.note(Note::Error(format!("a search cannot be begun: {e}"))),
        }
    }

    /// Follows what a search has found, once it is over.
    pub fn take_found(&mut self) {
        let Some(found) = self.searching.as_ref().and_then(Searching::poll) else { return };
        self.searching = None;
        // What is looked for now may be something else than what that search looked for.
        let State::Watching(w) = &mut self.state else { return };
        if !std::mem::take(&mut w.awaits_search) {
            return;
        }
        let Found { recognition, objects, utime, arrived } = match found {
            Ok(found) => found,
            Err(reason) => return self.out.note(Note::Error(reason)),
        };
        w.turns.end();
        w.best_refused = w.best_refused.max(recognition.best_refused);
        let object_of = |name: &str| objects.iter().find(|k| k.model.object == name);
        let model_of = |name: &str| object_of(name).map(|k| &k.model);
        self.out.send(channel::RECOGNITION, &messages::recognition(&recognition, model_of, utime));
        self.out.observer.event(utime, || EventKind::Recognised(recognition.clone()));
        let Some(best) = recognition.matches.into_iter().next() else { return };
        let Some(object) = object_of(&best.object) else { return };
        let Some(follower) = Follower::new(Arc::clone(object), &best) else { return };
        if let Some(orders) = &mut self.orders {
            orders.frame_seen(&best, utime, arrived);
        }
        let pending = w.pending.take();
        self.state = State::Tracking(Box::new(Tracking {
            object: Arc::clone(object),
            follower,
            recognised: best,
            seen: true,
            utime,
            arrived,
            pending,
            reacquisition: Reacquisition::begun_now(),
        }));
        self.execute_pending();
    }

    /// The depth is bit for bit that of the frame before, whatever the stamps are. Real depth has noise; that of a
    /// simulator without noise changes as soon as something moves.
    fn is_frozen(&mut self, frame: &RgbdFrame) -> bool {
        let mut digest = DefaultHasher::new();
        frame.depth.as_metres().iter().for_each(|z| digest.write_u32(z.to_bits()));
        let digest = Some(digest.finish());
        std::mem::replace(&mut self.newest_depth, digest) == digest
    }

    /// Follows the object that was found.
    fn follow(&mut self, Arrived { frame, at }: &Arrived) {
        // It matters while something moves alone, and takes some time.
        let is_moving = self.orders.as_ref().is_some_and(Orders::is_running);
        let is_frozen = is_moving && self.is_frozen(frame);
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
                    // What moves would change the picture: it is braked when none comes that differs.
                    Some(_) if is_frozen => {
                        self.out.note(Note::Error(FROZEN.to_owned()));
                    }
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
}

#[cfg(test)]
mod tests {
    use super::super::test_data::{
        answers, asked_for, frame, notes, perception, perception_with_frames,
    };
    use super::*;
    use crate::service::command::{Action, Command};
    use linkage_driver::DepthImage;
    use linkage_driver::live::host_utime;

    /// Frames that were searched, once no search runs any more.
    fn searched(perception: &mut Perception) -> usize {
        let begun = Instant::now();
        while perception.searching.is_some() && begun.elapsed() < Duration::from_secs(30) {
            perception.tick();
            std::thread::sleep(Duration::from_millis(1));
        }
        assert!(perception.searching.is_none(), "the search does not end");
        if let State::Watching(watching) = &perception.state { watching.turns.ended() } else { 0 }
    }

    #[test]
    fn every_frame_of_a_demonstration_is_learned_from() {
        let (mut perception, noted) = perception();
        let action = Action::StartDemonstration { object: "door".to_owned() };
        let valid_until = host_utime() + 1_000_000;
        perception.handle_command(Command { utime: 1, valid_until, expires: None, action });
        (1..=3).for_each(|utime| perception.look(frame(40_000 * utime)));
        let State::Demonstrating(d) = &perception.state else { panic!("it is demonstrated") };
        assert_eq!(d.learner.tracker().frames(), 3);
        assert!(!notes(&noted).iter().any(|note| matches!(note, Note::Error(_))));
    }

    #[test]
    fn while_something_is_looked_for_frames_that_wait_are_skipped_and_counted() {
        let (mut perception, _noted, frames) = perception_with_frames();
        perception.state = State::Watching(Watching::new(None, None));
        (2..=4).for_each(|utime| frames.push(frame(utime)));
        perception.look(frame(1));
        assert_eq!((perception.looked_at, searched(&mut perception)), (4, 1));
        assert_eq!(perception.newest(frame(9)).frame.utime, 9, "none waits");
    }

    #[test]
    fn what_is_not_found_is_looked_for_in_the_next_frame_again() {
        let (mut perception, noted) = perception();
        perception.state = State::Watching(Watching::new(None, Some(asked_for(0))));
        for utime in 1..=2 {
            perception.look(frame(utime));
            assert_eq!(searched(&mut perception), utime as usize);
        }
        assert!(answers(&noted).is_empty(), "the prediction still waits");
    }

    #[test]
    fn one_frame_is_searched_at_a_time_and_for_what_is_wanted_now() {
        let (mut perception, _noted) = perception();
        perception.state = State::Watching(Watching::new(Some("door".to_owned()), None));
        let (search, searching) = Searching::awaited();
        perception.searching = Some(searching);
        (1..=3).for_each(|utime| perception.look(frame(utime)));
        let State::Watching(watching) = &perception.state else { panic!("it is looked for") };
        assert!(!watching.awaits_search, "none is begun while another one runs");
        drop(search);
        perception.take_found();
        perception.look(frame(4));
        // Something else is wanted now, while that search may still run.
        perception.state = State::Watching(Watching::new(None, None));
        assert_eq!(searched(&mut perception), 0, "that search was not for this");
        perception.look(frame(5));
        assert_eq!(searched(&mut perception), 1);
    }

    #[test]
    fn a_picture_that_comes_again_under_another_stamp_is_that_of_a_frozen_camera() {
        let (mut perception, _noted) = perception();
        let mut is_frozen = |utime: i64, nearest_m: f32| {
            let mut arrived = frame(utime);
            let (width, height) = (arrived.frame.camera.width, arrived.frame.camera.height);
            let mut metres = vec![2.0; width * height];
            metres[0] = nearest_m;
            arrived.frame.depth = DepthImage::from_metres(width, height, metres).unwrap();
            perception.is_frozen(&arrived.frame)
        };
        let told = [(1, 1.0), (2, 1.001), (3, 1.001), (4, 1.001), (5, 1.0)];
        assert_eq!(told.map(|(utime, z)| is_frozen(utime, z)), [false, false, true, true, false]);
    }

    #[test]
    fn arrivals_are_kept_as_far_as_the_rate_needs_them() {
        let (mut perception, _noted) = perception();
        (0..2 * RATE_FRAMES as i64).for_each(|utime| perception.look(frame(utime)));
        assert_eq!(perception.arrivals.len(), RATE_FRAMES);
        assert_eq!(perception.looked_at, 2 * RATE_FRAMES as u64);
    }
}
