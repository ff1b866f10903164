//! Predictions that wait for their object: planned once a fresh frame shows it, refused where none
//! does in time.
//!
//! In: the prediction that waits, and where its object is (camera frame, metres). Out: the prediction
//! and the plan as messages, the motion for the stream, the command's answer.

use super::perceiver::Perception;
use super::state::{Ordered, State};
use crate::channel;
use crate::messages::{self, Stamps};
use crate::plan::{PlanError, Request, predict};
use crate::service::observer::EventKind;
use crate::service::publisher::Note;
use crate::service::stream::Orders;
use linkage_driver::live::host_utime;
use linkage_realtime::Notice;
use linkage_skill::predict::PredictError;
use std::time::{Duration, Instant};

/// A prediction whose object is not found for this long is refused.
const TIMEOUT: Duration = Duration::from_secs(5);
/// A prediction is refused where no frame has come for this long.
const FRAME_TIMEOUT: Duration = Duration::from_millis(500);
/// A prediction whose joint is not known for this long is refused: recognition is asked meanwhile.
const JOINT_TIMEOUT: Duration = Duration::from_secs(2);

impl Perception<'_> {
    /// Plans what was asked for, if the newest frame is fresh and shows the object.
    pub fn execute_pending(&mut self) {
        // One after the other: who ordered the motion before is answered first.
        self.hear_of_motions();
        if self.ordered.is_some() {
            return;
        }
        let State::Tracking(t) = &mut self.state else { return };
        let fresh = t.arrived.elapsed().as_secs_f64() <= self.config.rig.safety.frame_age;
        if !(t.seen && fresh) {
            return;
        }
        if t.pending.as_ref().is_none_or(|pending| pending.is_expired(host_utime())) {
            // One that has expired is refused by `time_out_pending`.
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
        let text = format!("planned {} in {knots} knots", model.object);
        let Some(orders) = &mut self.orders else { return self.answer(pending.command, Ok(text)) };
        let ordered = match plan.motion() {
            Err(_) => Err("too many joints"),
            Ok(motion) => orders.run(&motion, plan.start_us).map_err(|_| "orders come too fast"),
        };
        match ordered {
            Ok(()) => self.ordered = Some(Ordered { command: pending.command, text }),
            Err(why) => self.answer(pending.command, Ok(format!("{text}; not streamed: {why}"))),
        }
    }

    /// Tells what became of motions, and answers who ordered one as soon as the stream has decided on it.
    pub fn hear_of_motions(&mut self) {
        // Before it is asked what became of it: a refusal must not be missed.
        let is_decided = self.orders.as_ref().is_none_or(Orders::is_decided);
        while let Some(notice) = self.orders.as_mut().and_then(Orders::poll) {
            match notice {
                Notice::Ended(None) => {}
                Notice::Ended(Some(why)) => {
                    self.out.note(Note::Error(format!("the motion was braked: {why}")));
                }
                Notice::Refused(why) => {
                    let reason = format!("the motion was not executed: {why}");
                    if let Some(Ordered { command, text }) = self.ordered.take() {
                        self.answer(command, Err(format!("{text}; {reason}")));
                    }
                    self.out.note(Note::Error(reason));
                }
            }
        }
        if is_decided && let Some(Ordered { command, text }) = self.ordered.take() {
            self.answer(command, Ok(format!("{text}, which are streamed")));
        }
    }

    /// Refuses a prediction that has waited too long.
    pub fn time_out_pending(&mut self) {
        let threshold = self.config.skill.recognise.min_score;
        let since = self.arrivals.back().map(Instant::elapsed);
        let mut longest = TIMEOUT;
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
                let age = t.arrived.elapsed();
                let is_fresh = age.as_secs_f64() <= self.config.rig.safety.frame_age;
                let reason = match (t.seen, is_fresh) {
                    (false, _) => format!("{} is not seen now", t.object.model.object),
                    (true, false) => {
                        // After a search that took long, the next frame is on its way.
                        if since.is_none_or(|since| since > FRAME_TIMEOUT) {
                            longest = FRAME_TIMEOUT;
                        }
                        stale(age)
                    }
                    (true, true) => {
                        "its joint is not known yet, or what moves is still coming to rest"
                            .to_owned()
                    }
                };
                (&mut t.pending, reason)
            }
            _ => return,
        };
        let is_expired = pending.as_ref().is_some_and(|p| p.is_expired(host_utime()));
        let has_waited = pending.as_ref().is_some_and(|p| p.since.elapsed() > longest);
        if (is_expired || has_waited)
            && let Some(refused) = pending.take()
        {
            let reason =
                if is_expired { format!("it expired while it waited: {reason}") } else { reason };
            self.answer(refused.command, Err(reason));
        }
    }
}

/// Why a frame that is this old is not planned from.
fn stale(age: Duration) -> String {
    format!("the newest frame is {:.1} s old: is the camera still there?", age.as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::super::state::{Pending, Tracking, Watching};
    use super::super::test_data::{answers, asked_for, perception, tracked};
    use super::*;
    use crate::limits::Rig;
    use crate::service::publisher::Answer;
    use crate::service::stream::StreamParts;
    use linkage_driver::live::LatestReader;
    use std::sync::atomic::{AtomicBool, Ordering};

    /// What is answered to a prediction that has waited for so long while this object is looked for.
    fn answer(object: Option<&str>, waited_s: u64, has_frame: bool) -> Option<String> {
        let (mut perception, noted) = perception();
        perception.arrivals.extend(has_frame.then(Instant::now));
        let pending = Some(asked_for(waited_s));
        perception.state = State::Watching(Watching::new(object.map(str::to_owned), pending));
        perception.time_out_pending();
        let answer = answers(&noted).pop()?;
        assert_eq!((answer.utime, answer.accepted, answer.done), (7, false, true));
        perception.time_out_pending();
        assert!(answers(&noted).is_empty(), "it is refused once");
        Some(answer.text)
    }

    #[test]
    fn a_prediction_waits_for_some_seconds_before_it_is_refused() {
        assert_eq!(answer(None, TIMEOUT.as_secs() - 1, true), None);
        assert!(answer(None, TIMEOUT.as_secs() + 1, true).is_some());
    }

    #[test]
    fn a_prediction_after_a_long_search_waits_for_the_next_frame_unless_none_comes() {
        let ago =
            |ms| Instant::now().checked_sub(Duration::from_millis(ms)).expect("it runs for longer");
        for (newest, is_refused) in [(ago(30), false), (ago(900), true)] {
            let (mut perception, noted) = perception();
            perception.arrivals.push_back(newest);
            let old = Tracking { arrived: ago(900), pending: Some(asked_for(2)), ..tracked() };
            perception.state = State::Tracking(Box::new(old));
            perception.execute_pending();
            perception.time_out_pending();
            let told = answers(&noted).pop();
            assert_eq!(told.is_some(), is_refused, "{told:?}");
            assert!(
                told.is_none_or(|a| !a.accepted && a.text.contains("is the camera still there"))
            );
        }
    }

    #[test]
    fn the_refusal_says_whether_frames_or_the_object_are_missing() {
        let late = TIMEOUT.as_secs() + 1;
        assert_eq!(answer(None, late, false).unwrap(), "no frame has come yet");
        let unseen = answer(Some("door"), late, true).unwrap();
        assert_eq!(unseen, "door is not recognised: the best score is 0.00, 0.50 is needed");
        assert!(answer(None, late, true).unwrap().starts_with("anything known is not recognised"));
    }

    #[test]
    fn nothing_is_planned_while_the_object_is_still_looked_for() {
        let (mut perception, noted) = perception();
        perception.state = State::Watching(Watching::new(None, Some(asked_for(0))));
        perception.execute_pending();
        assert!(answers(&noted).is_empty());
        assert!(matches!(&perception.state, State::Watching(w) if w.pending.is_some()));
    }

    #[test]
    fn what_has_expired_while_it_waited_is_not_planned() {
        let (mut perception, noted) = perception();
        let expired = Pending { expires: Some(host_utime() - 1), ..asked_for(0) };
        perception.state =
            State::Tracking(Box::new(Tracking { pending: Some(expired), ..tracked() }));
        perception.execute_pending();
        assert!(answers(&noted).is_empty(), "nothing is planned");
        perception.time_out_pending();
        let answer = answers(&noted).pop().expect("it is refused");
        assert!(!answer.accepted && answer.text.contains("it expired while it waited"));
        // One that holds still is planned at once.
        let holds = Pending { expires: Some(host_utime() + 60_000_000), ..asked_for(0) };
        perception.state =
            State::Tracking(Box::new(Tracking { pending: Some(holds), ..tracked() }));
        perception.execute_pending();
        let answer = answers(&noted).pop().expect("it is planned");
        assert!(answer.accepted && answer.done, "{}", answer.text);
    }

    /// Stops a stream when it is dropped, so that a test that fails does not wait for it.
    struct Stop<'s>(&'s AtomicBool);

    impl Drop for Stop<'_> {
        fn drop(&mut self) {
            self.0.store(true, Ordering::Relaxed);
        }
    }

    /// What is answered to a prediction once the stream has decided on its motion.
    fn decided(perception: &mut Perception, noted: &LatestReader<Note>) -> Answer {
        let pending = Some(asked_for(0));
        perception.state = State::Tracking(Box::new(Tracking { pending, ..tracked() }));
        perception.execute_pending();
        let begun = Instant::now();
        while begun.elapsed() < Duration::from_secs(10) {
            perception.tick();
            if let Some(answer) = answers(noted).pop() {
                return answer;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        panic!("it is not answered")
    }

    /// The commands that are answered where two predictions are asked for at once.
    fn told_of_two(perception: &mut Perception, noted: &LatestReader<Note>) -> Vec<i64> {
        for command in [7, 8] {
            let pending = Some(Pending { command, ..asked_for(0) });
            perception.state = State::Tracking(Box::new(Tracking { pending, ..tracked() }));
            perception.execute_pending();
        }
        let (begun, mut told) = (Instant::now(), Vec::new());
        while begun.elapsed() < Duration::from_secs(10) && told.len() < 2 {
            if let Some(orders) = &mut perception.orders {
                orders.frame_seen(&tracked().recognised, host_utime(), Instant::now());
            }
            if let State::Tracking(t) = &mut perception.state {
                t.arrived = Instant::now();
            }
            perception.execute_pending();
            told.extend(answers(noted).iter().map(|answer| answer.utime));
            std::thread::sleep(Duration::from_millis(1));
        }
        told
    }

    #[test]
    fn a_motion_that_the_stream_refuses_is_not_said_to_be_streamed() {
        let (mut parts, stop) = (StreamParts::default(), AtomicBool::new(false));
        let url = "udpm://239.255.76.71:7698?ttl=0";
        let (streamer, orders) = parts.open(url, 200.0, &Rig::default()).unwrap();
        std::thread::scope(|scope| {
            let _stop = Stop(&stop);
            scope.spawn(|| streamer.run(&|| stop.load(Ordering::Relaxed)));
            let (mut perception, noted) = perception();
            perception.orders = Some(orders);
            let refused = decided(&mut perception, &noted);
            let seen = tracked().recognised;
            if let Some(orders) = &mut perception.orders {
                orders.frame_seen(&seen, host_utime(), Instant::now());
            }
            let streamed = decided(&mut perception, &noted);
            // Another one that comes before the stream has decided waits for it.
            let told = told_of_two(&mut perception, &noted);
            assert_eq!(told, [7, 8], "each is answered, once");
            assert!(!refused.accepted && refused.done, "no frame was seen: {}", refused.text);
            assert!(refused.text.contains("not executed"), "{}", refused.text);
            assert!(streamed.accepted && streamed.text.contains("which are streamed"));
        });
    }

    #[test]
    fn an_old_frame_is_told_with_its_age() {
        assert!(stale(Duration::from_millis(2_340)).contains("2.3 s old"));
    }
}
