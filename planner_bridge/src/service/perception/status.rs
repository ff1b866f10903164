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

#[cfg(test)]
mod tests {
    use super::super::state::Watching;
    use super::super::test_data::{notes, perception};
    use super::*;
    use linkage_driver::live::LatestReader;
    use linkage_skill::object::{
        Joint, JointGeometry, JointKind, MODEL_SCHEMA, ObjectModel, ReferenceFrame,
    };
    use nalgebra::{Point3, Vector3};

    fn watching(object: &str) -> State {
        State::Watching(Watching::new(Some(object.to_owned()), None))
    }

    /// States and objects that were told.
    fn told(noted: &LatestReader<Note>) -> Vec<(&'static str, String)> {
        let situation = |note| if let Note::Situation(told) = note { Some(told) } else { None };
        let told = notes(noted).into_iter().filter_map(situation);
        told.map(|situation| (situation.state, situation.object)).collect()
    }

    #[test]
    fn a_change_is_told_at_once_and_the_same_state_only_now_and_then() {
        let (mut perception, noted) = perception();
        (0..5).for_each(|_| perception.publish_status());
        assert_eq!(told(&noted), [("idle", String::new())]);
        perception.state = watching("door");
        (0..5).for_each(|_| perception.publish_status());
        perception.state = watching("drawer");
        perception.publish_status();
        let expected = [("watching", "door".to_owned()), ("watching", "drawer".to_owned())];
        assert_eq!(told(&noted), expected);
        perception.told = perception.told.map(|(at, told)| (at - TELL_EVERY, told));
        perception.publish_status();
        assert_eq!(told(&noted).len(), 1);
    }

    #[test]
    fn frames_a_second_are_those_of_the_last_arrivals() {
        let (mut perception, _noted) = perception();
        assert_eq!(perception.frame_rate(), 0.0, "none came");
        let now = Instant::now();
        let ago = |ms: u64| now.checked_sub(Duration::from_millis(ms)).expect("it runs for longer");
        perception.arrivals = [ago(0)].into();
        assert_eq!(perception.frame_rate(), 0.0, "one tells no rate");
        perception.arrivals = (0..=10).rev().map(|i| ago(40 * i)).collect();
        assert!((perception.frame_rate() - 25.0).abs() < 1e-6);
        perception.arrivals = (0..=10).rev().map(|i| ago(4000 + 40 * i)).collect();
        assert_eq!(perception.frame_rate(), 0.0, "the camera has stopped");
    }

    #[test]
    fn a_joint_is_as_certain_as_its_type_and_certain_where_none_was_computed() {
        let hinge = JointGeometry::hinge(Vector3::y_axis(), Point3::origin());
        let computed = Joint {
            type_probabilities: [(JointKind::Revolute, 0.7), (JointKind::Prismatic, 0.3)].into(),
            ..Joint::of(&hinge)
        };
        let model = ObjectModel {
            schema: MODEL_SCHEMA.into(),
            object: "door".into(),
            reference_frame: ReferenceFrame::at_camera(0.0),
            parts: Vec::new(),
            joints: vec![computed, Joint::of(&hinge)],
            demonstrations: 1,
            profile: "default".into(),
            version: "0".into(),
        };
        assert_eq!(certainties(&model), [("revolute", 0.7), ("revolute", 1.0)]);
    }
}
