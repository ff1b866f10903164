//! A running service in a view, by the frames and findings that it shows.

use super::present::View;
use super::shown::Shown;
use linkage_driver::live::RecvError;
use linkage_planner_bridge::Prediction;
use linkage_planner_bridge::service::{Finding, Found, Sight, Sights};
use linkage_skill::object::StoredObject;
use linkage_skill::store::Store;
use linkage_skill::{Pose, pose_from_array};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Longest wait without a look whether the service is over.
const POLL: Duration = Duration::from_millis(100);
/// Objects whose surface is kept at hand.
const KEPT_OBJECTS: usize = 16;
/// Time between two showings of a predicted part, for viewers that came later, microseconds.
const AGAIN_US: i64 = 500_000;

impl View {
    /// Shows what a service sees and finds until it is over: `is_over` is set, or nothing more can
    /// come. `store` is where its objects are.
    pub fn follow(&self, sights: &Sights, store: &Path, is_over: &AtomicBool) {
        let mut objects = Objects { store, kept: BTreeMap::new() };
        let mut target = None;
        loop {
            match sights.next(POLL) {
                Ok(Sight::Frame(frame)) => self.frame(&frame),
                Ok(Sight::Finding(finding)) => self.show(finding, &mut objects, &mut target),
                // A thread that learns may hold the other end for longer than the service runs.
                Err(RecvError::Timeout) if is_over.load(Ordering::Relaxed) => break,
                Err(RecvError::Timeout) => {}
                Err(RecvError::Closed) => break,
            }
        }
        if sights.dropped() > 0 {
            tracing::warn!("the view was too slow for {} frames and findings", sights.dropped());
        }
    }

    fn show(
        &self,
        Finding { utime, what }: Finding,
        objects: &mut Objects,
        at: &mut Option<Ghost>,
    ) {
        match what {
            Found::Followed(places) => self.tracks(utime, places.into_iter().map(|p| (None, p))),
            Found::Estimated { model, camera_from_object } => {
                let shown = Shown::learned(&model, vec![Some(camera_from_object)], None);
                self.objects(utime, &[shown]);
            }
            Found::Learned { model, camera_from_part, places } => {
                objects.kept.clear();
                self.tracks(utime, places);
                self.objects(utime, &[Shown::learned(&model, camera_from_part, None)]);
            }
            Found::Recognised(recognition) => {
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
                    && (utime - ghost.told_utime).abs() >= AGAIN_US
                {
                    self.ghost_again(utime, ghost, objects);
                }
            }
            Found::Predicted(prediction) => {
                objects.keep(&prediction.object);
                let ghost = at.insert(Ghost::of(&prediction));
                self.ghost_again(utime, ghost, objects);
            }
            Found::Said { is_warning, text } => self.say(utime, is_warning, &text),
        }
    }

    fn ghost_again(&self, utime: i64, ghost: &mut Ghost, objects: &Objects) {
        ghost.told_utime = utime;
        if let Some(object) = objects.known(&ghost.object) {
            self.ghost(utime, &ghost.object, &object.appearance, &ghost.object_from_part);
        }
    }
}

/// Where parts will be.
struct Ghost {
    object: String,
    object_from_part: Vec<Option<Pose>>,
    told_utime: i64,
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
        Self { object: prediction.object.clone(), object_from_part, told_utime: 0 }
    }
}

/// Objects of the store that are shown.
struct Objects<'s> {
    store: &'s Path,
    /// `None`: the store has none of that name.
    kept: BTreeMap<String, Option<StoredObject>>,
}

impl Objects<'_> {
    /// Reads an object, unless it is at hand.
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
