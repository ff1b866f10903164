//! Shows a running service in a view: its frames and its events.

use super::enabled::View;
use super::shown::Shown;
use linkage_driver::live::RecvError;
use linkage_planner_bridge::Prediction;
use linkage_planner_bridge::service::{Event, EventKind, Observation, Observations};
use linkage_skill::object::StoredObject;
use linkage_skill::store::Store;
use linkage_skill::{Pose, pose_from_array};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Longest wait for an event before `is_over` is read again.
const POLL: Duration = Duration::from_millis(100);
/// Objects of the store that are kept in memory.
const KEPT_OBJECTS: usize = 16;
/// Time after which a predicted part is shown again, for viewers that connect later, microseconds.
const REPEAT_US: i64 = 500_000;

impl View {
    /// Shows the frames and events of a service until `is_over` is set or the service has dropped its
    /// end of the queues. `store`: the store that the service uses.
    pub fn follow(&self, observations: &Observations, store: &Path, is_over: &AtomicBool) {
        let mut objects = Objects { store, kept: BTreeMap::new() };
        let mut target = None;
        loop {
            match observations.next(POLL) {
                Ok(Observation::Frame(frame)) => self.frame(&frame),
                Ok(Observation::Event(event)) => self.show(event, &mut objects, &mut target),
                // A thread that learns may hold the other end for longer than the service runs.
                Err(RecvError::Timeout) if is_over.load(Ordering::Relaxed) => break,
                Err(RecvError::Timeout) => {}
                Err(RecvError::Closed) => break,
            }
        }
        if observations.dropped() > 0 {
            tracing::warn!(
                "the view was too slow for {} frames and events",
                observations.dropped()
            );
        }
    }

    fn show(&self, Event { utime, kind }: Event, objects: &mut Objects, at: &mut Option<Ghost>) {
        match kind {
            EventKind::Tracked(points) => self.tracks(utime, points.into_iter().map(|p| (None, p))),
            EventKind::Estimated { model, camera_from_object } => {
                let shown = Shown::learned(&model, vec![Some(camera_from_object)], None);
                self.objects(utime, &[shown]);
            }
            EventKind::Learned { model, camera_from_part, points } => {
                objects.kept.clear();
                self.tracks(utime, points);
                self.objects(utime, &[Shown::learned(&model, camera_from_part, None)]);
            }
            EventKind::Recognised(recognition) => {
                let is_gone =
                    |ghost: &Ghost| recognition.matches.iter().all(|m| m.object != ghost.object);
                if at.as_ref().is_some_and(is_gone) {
                    *at = None;
                }
                for m in &recognition.matches {
                    objects.keep(&m.object);
                }
                self.recognised(utime, &recognition, |name| objects.known(name));
                if let Some(ghost) = at
                    && (utime - ghost.shown_utime).abs() >= REPEAT_US
                {
                    self.ghost_again(utime, ghost, objects);
                }
            }
            EventKind::Predicted(prediction) => {
                objects.keep(&prediction.object);
                let ghost = at.insert(Ghost::of(&prediction));
                self.ghost_again(utime, ghost, objects);
            }
            EventKind::Message { is_warning, text } => self.say(utime, is_warning, &text),
        }
    }

    fn ghost_again(&self, utime: i64, ghost: &mut Ghost, objects: &Objects) {
        ghost.shown_utime = utime;
        if let Some(object) = objects.known(&ghost.object) {
            self.ghost(utime, &ghost.object, &object.appearance, &ghost.object_from_part);
        }
    }
}

/// The parts at their target, which viewers draw transparent.
struct Ghost {
    object: String,
    object_from_part: Vec<Option<Pose>>,
    shown_utime: i64,
}

impl Ghost {
    /// The end of a predicted motion.
    fn of(prediction: &Prediction) -> Self {
        let mut object_from_part = Vec::new();
        let camera_from_object = pose_from_array(&prediction.camera_from_object);
        for part in &prediction.parts {
            let last = part.poses.last().and_then(|[_, pose @ ..]| pose_from_array(pose));
            let pose = camera_from_object.zip(last).map(|(object, part)| object.inverse() * part);
            // Parts are numbered as the model has them; a model has fewer than u16 can count.
            if part.part <= usize::from(u16::MAX) {
                object_from_part.resize(object_from_part.len().max(part.part + 1), None);
                object_from_part[part.part] = pose;
            }
        }
        Self { object: prediction.object.clone(), object_from_part, shown_utime: 0 }
    }
}

/// Objects of the store that are shown.
struct Objects<'s> {
    store: &'s Path,
    /// `None`: the store has none of that name.
    kept: BTreeMap<String, Option<StoredObject>>,
}

impl Objects<'_> {
    /// Reads an object unless it is in memory.
    fn keep(&mut self, name: &str) {
        if self.kept.contains_key(name) {
            return;
        }
        if self.kept.len() >= KEPT_OBJECTS {
            self.kept.clear();
        }
        let read = Store::open(self.store).and_then(|store| store.get(name));
        let read = read.inspect_err(|e| tracing::warn!("{name} is not shown: {e}"));
        self.kept.insert(name.to_owned(), read.ok());
    }

    fn known(&self, name: &str) -> Option<&StoredObject> {
        self.kept.get(name)?.as_ref()
    }
}
