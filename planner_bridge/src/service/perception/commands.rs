//! What commands do to the state: they begin and end demonstrations, look for objects, ask for
//! predictions, cancel.
//!
//! In: a command, checked and authorised, with the time until which it may begin (microseconds of the
//! host's clock). Out: the next state, and an answer or an acknowledgement to who sent it.

use super::perceiver::Perception;
use super::state::{Demonstrating, Pending, State, Watching};
use crate::service::command::{Action, Command};
use crate::service::learning::MOST_AT_ONCE;
use crate::service::losses::Losses;
use crate::service::publisher::Note;
use linkage_driver::live::host_utime;
use linkage_realtime::Reason;
use linkage_skill::Learner;
use std::time::Instant;

impl Perception<'_> {
    pub fn handle_command(&mut self, command: Command) {
        let Command { utime, valid_until, expires, action } = command;
        // A command that expired while this thread was busy is not executed. It is never too late to
        // cancel: what moves is braked already.
        if host_utime() > valid_until && action != Action::Cancel {
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
                let pending = Pending { command: utime, joint, target, grasp, since, expires };
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
        if self.cancelled.len() >= MOST_AT_ONCE {
            return Err("demonstrations that were cancelled are not over yet: send it again in some seconds".to_owned());
        }
        self.become_idle(Reason::Replaced);
        let learner = Learner::live(&self.config.skill);
        let current_estimate = learner.current_estimate(&object);
        let answer = format!("watching how {object} is moved");
        // Every frame of a demonstration counts, also one that found no room before it was looked at.
        let losses = Losses::begin(self.dropped_frames(), 0);
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
                let lost = losses.many(self.dropped_frames(), frames as u64);
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
        let answer = match &object {
            Some(name) => format!("looking for {name}"),
            None => "looking for anything known".to_owned(),
        };
        // A search for the same goes on.
        if let State::Watching(w) = &mut self.state
            && w.object == object
        {
            if let Some(before) = std::mem::replace(&mut w.pending, pending) {
                self.refuse_replaced(&before);
            }
            return Ok(answer);
        }
        self.become_idle(Reason::Replaced);
        self.state = State::Watching(Watching::new(object, pending));
        Ok(answer)
    }

    fn predict(&mut self, object: Option<String>, pending: Pending) -> Result<String, String> {
        if let State::Tracking(t) = &mut self.state {
            let name = &t.object.model.object;
            if object.as_ref().is_none_or(|wanted| wanted == name) {
                let answer = format!("predicting {name}");
                if let Some(before) = t.pending.replace(pending) {
                    self.refuse_replaced(&before);
                }
                return Ok(answer);
            }
        }
        self.watch(object, Some(pending))
    }

    fn cancel(&mut self) -> String {
        match std::mem::replace(&mut self.state, State::Resting) {
            // Whether it was stored already is known, and answered, once its thread is over.
            State::Learning { learning, command } => {
                learning.cancel();
                self.cancelled.push((learning, command));
            }
            other => self.state = other,
        }
        self.become_idle(Reason::Cancelled);
        "cancelled".to_owned()
    }

    /// Answers a prediction that waited when another command took its place.
    fn refuse_replaced(&self, before: &Pending) {
        let reason = "another command came before it was planned".to_owned();
        self.answer(before.command, Err(reason));
    }

    /// Nothing is looked for, what moves is braked.
    fn become_idle(&mut self, why: Reason) {
        let pending = match &mut self.state {
            State::Watching(w) => w.pending.take(),
            State::Tracking(t) => t.pending.take(),
            _ => None,
        };
        if let Some(pending) = pending {
            self.refuse_replaced(&pending);
        }
        self.brake(why);
        self.state = State::Resting;
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_data::{
        answers, asked_for, frame, perception, perception_with_frames, tracked,
    };
    use super::*;
    use crate::plan::test_data::fridge;
    use crate::service::learning::{Learned, Learning};
    use linkage_driver::live::LatestReader;
    use linkage_skill::object::{Appearance, StoredObject};
    use linkage_skill::predict::Target;
    use linkage_skill::store::Library;

    /// A command that may begin for a second still.
    fn command(utime: i64, action: Action) -> Command {
        Command { utime, valid_until: host_utime() + 1_000_000, expires: None, action }
    }

    fn start(object: &str) -> Action {
        Action::StartDemonstration { object: object.to_owned() }
    }

    fn recognise() -> Action {
        Action::Recognise { object: None }
    }

    /// What is answered to the last of some commands: whether it was accepted, and the text.
    fn answer_to_last(actions: &[Action]) -> (bool, String) {
        let (mut perception, noted) = perception();
        for (utime, action) in (1..).zip(actions) {
            perception.handle_command(command(utime, action.clone()));
        }
        let answers = answers(&noted);
        assert_eq!(answers.len(), actions.len(), "one answer each");
        let last = answers.last().expect("there is a command");
        assert_eq!((last.utime, last.done), (actions.len() as i64, true));
        (last.accepted, last.text.clone())
    }

    #[test]
    fn a_command_that_comes_too_late_is_not_begun() {
        let (mut perception, noted) = perception();
        let late = Command { valid_until: host_utime() - 1, ..command(3, start("door")) };
        perception.handle_command(late);
        let answers = answers(&noted);
        assert!(!answers[0].accepted && answers[0].text.contains("too late"));
        assert!(matches!(perception.state, State::Resting));
    }

    #[test]
    fn it_is_never_too_late_to_cancel() {
        let (mut perception, noted) = perception();
        perception.handle_command(command(1, start("door")));
        let late = Command { valid_until: host_utime() - 1, ..command(2, Action::Cancel) };
        perception.handle_command(late);
        assert!(answers(&noted).last().is_some_and(|a| a.utime == 2 && a.accepted));
        assert!(matches!(perception.state, State::Resting));
    }

    #[test]
    fn nothing_is_looked_for_or_predicted_where_nothing_is_known() {
        let (object, joint, grasp) = (None, None, None);
        let predict = Action::Predict { object, joint, target: Target::Open, grasp };
        for action in [recognise(), predict] {
            let (accepted, text) = answer_to_last(&[action]);
            assert!(!accepted && text.contains("nothing is known yet"), "{text}");
        }
    }

    #[test]
    fn a_demonstration_is_interrupted_by_no_other_command_than_cancel() {
        for action in [recognise(), start("drawer")] {
            let (accepted, text) = answer_to_last(&[start("door"), action]);
            assert!(!accepted && text.contains("door is being demonstrated"), "{text}");
        }
        assert!(answer_to_last(&[start("door"), Action::Cancel]).0);
        assert!(answer_to_last(&[start("door"), Action::Cancel, start("drawer")]).0);
    }

    #[test]
    fn what_was_not_begun_cannot_be_finished() {
        let (accepted, text) = answer_to_last(&[Action::FinishDemonstration]);
        assert!(!accepted && text.contains("no demonstration runs"), "{text}");
    }

    #[test]
    fn a_demonstration_that_is_finished_is_learned_from() {
        let (mut perception, noted) = perception();
        perception.handle_command(command(1, start("door")));
        perception.handle_command(command(2, Action::FinishDemonstration));
        assert!(matches!(perception.state, State::Learning { command: Some(2), .. }));
        let last = answers(&noted).pop().expect("an answer");
        assert!(last.accepted && !last.done, "it is acknowledged, and answered once it is learned");
    }

    /// A perception that follows an object which is in sight.
    fn following() -> (Perception<'static>, LatestReader<Note>) {
        let (mut perception, noted) = perception();
        perception.state = State::Tracking(Box::new(tracked()));
        (perception, noted)
    }

    #[test]
    fn a_prediction_that_takes_the_place_of_another_one_lets_it_be_answered() {
        let (mut perception, noted) = following();
        let predict = |target| Action::Predict { object: None, joint: None, target, grasp: None };
        let State::Tracking(t) = &mut perception.state else { panic!("it follows") };
        t.seen = false;
        for utime in 1..=3 {
            perception.handle_command(command(utime, predict(Target::Open)));
        }
        let done: Vec<i64> = answers(&noted).iter().filter(|a| a.done).map(|a| a.utime).collect();
        assert_eq!(done, [1, 2], "the third one waits");
    }

    #[test]
    fn a_prediction_of_what_is_looked_for_already_lets_the_search_go_on() {
        let (mut perception, noted) = perception();
        let appearance = Appearance::default();
        let fridge = StoredObject { model: fridge().0, appearance, provenance: Vec::new() };
        perception.library = Library::new(vec![fridge]).into();
        let mut watching = Watching::new(None, None);
        for _ in 0..3 {
            watching.turns.begin();
            watching.turns.end();
        }
        perception.state = State::Watching(watching);
        let predict = |joint: &str| Action::Predict {
            object: None,
            joint: Some(joint.to_owned()),
            target: Target::Open,
            grasp: None,
        };
        perception.handle_command(command(1, predict("left")));
        perception.handle_command(command(2, predict("right")));
        let State::Watching(w) = &perception.state else { panic!("it is looked for") };
        assert_eq!((w.turns.ended(), w.pending.as_ref().map(|p| p.command)), (3, Some(2)));
        let done: Vec<i64> = answers(&noted).iter().filter(|a| a.done).map(|a| a.utime).collect();
        assert_eq!(done, [1], "the second one takes the place of the first");
    }

    #[test]
    fn a_demonstration_that_is_cancelled_is_answered_once_its_thread_is_over() {
        let stored = Learned { summary: "learned door".to_owned(), library: None };
        for (result, accepted) in [(Err("cancelled".to_owned()), false), (Ok(stored), true)] {
            let (mut perception, noted) = perception();
            let (thread, learning) = Learning::awaited("door");
            perception.state = State::Learning { learning, command: Some(2) };
            perception.handle_command(command(3, Action::Cancel));
            perception.tick();
            let told: Vec<i64> = answers(&noted).iter().map(|a| a.utime).collect();
            assert_eq!(told, [3], "whether it was stored is not known yet");
            thread.send(result).unwrap();
            perception.tick();
            let last = answers(&noted).pop().expect("an answer");
            assert_eq!((last.utime, last.accepted, last.done), (2, accepted, true));
            assert!(last.text.contains("cancelled"), "{}", last.text);
        }
    }

    #[test]
    fn so_many_demonstrations_are_learned_at_once_and_no_more() {
        let (mut perception, noted) = perception();
        let threads = (0..MOST_AT_ONCE).map(|_| Learning::awaited("door"));
        let (mut threads, learning): (Vec<_>, Vec<_>) = threads.unzip();
        perception.cancelled = learning.into_iter().map(|l| (l, None)).collect();
        perception.handle_command(command(1, start("door")));
        let refused = answers(&noted).pop().expect("an answer");
        assert!(!refused.accepted && refused.text.contains("not over yet"), "{}", refused.text);
        drop(threads.pop());
        perception.tick();
        perception.handle_command(command(2, start("door")));
        assert!(answers(&noted).pop().is_some_and(|a| a.accepted));
    }

    #[test]
    fn frames_that_found_no_room_are_told_with_what_was_learned() {
        let (mut perception, _noted, frames) = perception_with_frames();
        perception.handle_command(command(1, start("door")));
        (0..20).for_each(|utime| frames.push(frame(utime)));
        let State::Demonstrating(d) = &perception.state else { panic!("it is demonstrated") };
        let told = d.losses.many(perception.dropped_frames(), 8);
        assert!(told.is_some_and(|t| t.contains("12 of 20 frames")));
    }

    #[test]
    fn a_prediction_that_waits_is_refused_when_another_command_comes() {
        let (mut perception, noted) = perception();
        perception.state = State::Watching(Watching::new(None, Some(asked_for(0))));
        perception.handle_command(command(8, Action::Cancel));
        let answers = answers(&noted);
        assert_eq!(
            answers.iter().map(|a| (a.utime, a.accepted)).collect::<Vec<_>>(),
            [(7, false), (8, true)]
        );
        assert!(answers[0].text.contains("another command came"));
        assert!(matches!(perception.state, State::Resting));
    }
}
