//! A demonstration that is over, learned and stored on a thread of its own, so that frames and
//! commands are taken meanwhile and the service can stop at any moment.

use crate::service::observer::EventKind;
use crate::service::publisher::Outbox;
use crate::{channel as on, messages};
use linkage_driver::live::host_utime;
use linkage_skill::internals::Track;
use linkage_skill::object::Provenance;
use linkage_skill::remember::{CombineError, add_demonstration};
use linkage_skill::store::{Library, Store, StoreError};
use linkage_skill::{Demonstration, Learner, ObjectModel, SkillConfig};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError, channel};

/// What a demonstration is learned with.
#[derive(Clone)]
pub struct LearningWorker {
    pub config: SkillConfig,
    pub store: PathBuf,
    pub out: Outbox,
    /// Times at which the store was read again so far.
    pub loads: Arc<AtomicU64>,
}

/// Demonstrations that may be learned at a time: one whose result is wanted, and one that was cancelled and comes to
/// its end. Each holds the pictures of a whole demonstration.
pub const MOST_AT_ONCE: usize = 2;

/// A demonstration that is being learned.
pub struct Learning {
    pub object: String,
    result: Receiver<Result<Learned, String>>,
    cancelled: Arc<AtomicBool>,
}

/// What was learned and stored.
pub struct Learned {
    pub summary: String,
    /// All that is known now, with the number of its reading: a later reading knows what an earlier one does. `None`
    /// where the store could not be read again.
    pub library: Option<(u64, Library)>,
}

/// Why nothing was stored.
#[derive(Debug, thiserror::Error)]
enum NotStored {
    #[error("cancelled")]
    Cancelled,
    #[error(transparent)]
    Combine(#[from] CombineError),
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl LearningWorker {
    /// Starts to learn.
    ///
    /// `lost` says how many of its frames were lost, where they were many: so does the answer.
    pub fn learn(
        &self,
        learner: Learner,
        object: String,
        lost: Option<String>,
    ) -> std::io::Result<Learning> {
        let (sender, result) = channel();
        let cancelled = Arc::new(AtomicBool::new(false));
        let learning =
            Learning { object: object.clone(), result, cancelled: Arc::clone(&cancelled) };
        let worker = self.clone();
        std::thread::Builder::new().name("learn".to_owned()).spawn(move || {
            // Nobody waits for a demonstration that was cancelled.
            let learned = worker.learned(learner, &object, &cancelled);
            let _ = sender.send(with_losses(learned, lost));
        })?;
        Ok(learning)
    }

    fn learned(
        &self,
        learner: Learner,
        object: &str,
        cancelled: &AtomicBool,
    ) -> Result<Learned, String> {
        let demonstration = learner.finish(object).map_err(|e| e.to_string())?;
        if demonstration.model.joints.is_empty() {
            return Err(demonstration.why_nothing());
        }
        let mut store = Store::open_or_create(&self.store).map_err(|e| e.to_string())?;
        let is_cancelled = || cancelled.load(Ordering::Relaxed);
        let provenance =
            Provenance { source: "demonstrated live".to_owned(), learned_utime: host_utime() };
        let mut is_told = false;
        let combined = store.update(object, |known| {
            // A new object's model is told before it is stored, which takes longer than to learn
            // it.
            is_told = known.is_none() && !is_cancelled();
            if is_told {
                self.publish(&demonstration, &demonstration.model);
            }
            let stored =
                add_demonstration(known, &demonstration, provenance.clone(), &self.config)?;
            if is_cancelled() { Err(NotStored::Cancelled) } else { Ok(stored) }
        });
        let stored = combined.map_err(|e| e.to_string())?;
        if !is_told {
            self.publish(&demonstration, &stored.model);
        }
        let reading = 1 + self.loads.fetch_add(1, Ordering::Relaxed);
        let library = store.load();
        let kinds: Vec<&str> = stored.model.joints.iter().map(|j| j.kind.name()).collect();
        let mut summary = format!(
            "learned {object}: {}, {} demonstration(s)",
            kinds.join(", "),
            stored.model.demonstrations
        );
        if let Err(e) = &library {
            summary += &format!("; it is stored, but the store cannot be read again: {e}");
        }
        Ok(Learned { summary, library: library.ok().map(|library| (reading, library)) })
    }

    fn publish(&self, demonstration: &Demonstration, model: &ObjectModel) {
        let utime = demonstration.frame_utimes.last().copied().unwrap_or_default();
        self.out.send(on::MODEL, &messages::model(model, utime));
        self.out.send(on::ARTICULATED_OBJECT, &messages::articulated_object(demonstration));
        self.out.observer.event(utime, || learned_event(demonstration));
    }
}

/// What was learned, as the newest frame of the demonstration shows it.
fn learned_event(demonstration: &Demonstration) -> EventKind {
    let newest = demonstration.frame_utimes.len().saturating_sub(1);
    let tracks = demonstration.tracks.tracks.iter().zip(&demonstration.track_parts);
    let point =
        |(track, part): (&Track, &Option<usize>)| Some((*part, track.at(newest)?.point_in_camera?));
    let poses = demonstration.camera_from_part.iter();
    EventKind::Learned {
        model: demonstration.model.clone(),
        camera_from_part: poses.map(|p| p.get(newest).copied().flatten()).collect(),
        points: tracks.filter_map(point).collect(),
    }
}

/// What was learned, or why nothing was, with how much of the demonstration is missing.
fn with_losses(learned: Result<Learned, String>, lost: Option<String>) -> Result<Learned, String> {
    let Some(lost) = lost else { return learned };
    match learned {
        Ok(learned) => Ok(Learned { summary: format!("{}; {lost}", learned.summary), ..learned }),
        Err(reason) => Err(format!("{reason}; {lost}")),
    }
}

#[cfg(test)]
impl Learning {
    /// One whose result a test gives.
    pub fn awaited(object: &str) -> (std::sync::mpsc::Sender<Result<Learned, String>>, Self) {
        let (sender, result) = channel();
        (sender, Self { object: object.to_owned(), result, cancelled: Arc::default() })
    }
}

impl Learning {
    /// Its result, once it is over.
    pub fn poll(&self) -> Option<Result<Learned, String>> {
        match self.result.try_recv() {
            Ok(result) => Some(result),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => Some(Err("learning failed".to_owned())),
        }
    }

    /// Its result is not wanted any more.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::observer::Observer;
    use linkage_driver::live::latest;

    fn known() -> Learned {
        Learned { summary: "learned door".to_owned(), library: Some((1, Library::new(Vec::new()))) }
    }

    fn told(result: Result<Learned, String>) -> String {
        result.map_or_else(|reason| reason, |learned| learned.summary)
    }

    #[test]
    fn frames_that_were_lost_are_told_with_what_was_learned_and_with_why_nothing_was() {
        let lost = || Some("9 of 20 frames were lost".to_owned());
        assert_eq!(
            told(with_losses(Ok(known()), lost())),
            "learned door; 9 of 20 frames were lost"
        );
        let nothing = || Err("nothing moves".to_owned());
        assert_eq!(told(with_losses(nothing(), lost())), "nothing moves; 9 of 20 frames were lost");
        assert_eq!(told(with_losses(nothing(), None)), "nothing moves");
        assert_eq!(told(with_losses(Ok(known()), None)), "learned door");
    }

    #[test]
    fn a_result_is_there_once_and_a_thread_that_failed_is_told() {
        let (sender, result) = channel();
        let learning = Learning { object: "door".to_owned(), result, cancelled: Arc::default() };
        assert!(learning.poll().is_none(), "it is still being learned");
        sender.send(Ok(known())).expect("it is waited for");
        assert_eq!(told(learning.poll().expect("a result")), "learned door");
        drop(sender);
        assert_eq!(told(learning.poll().expect("a result")), "learning failed");
    }

    #[test]
    fn nothing_is_stored_of_a_demonstration_that_shows_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let store = dir.path().join("s.linkage");
        let ((packets, _), (notes, _)) = (latest(4), latest(4));
        let out = Outbox { packets, notes, observer: Observer::default() };
        let worker = LearningWorker {
            config: SkillConfig::default(),
            store: store.clone(),
            out,
            loads: Arc::default(),
        };
        let learner = Learner::live(&worker.config);
        let learning = worker.learn(learner, "door".to_owned(), None).unwrap();
        let result = learning.result.recv().expect("the thread answers");
        assert!(result.is_err());
        assert!(!store.exists());
    }
}
