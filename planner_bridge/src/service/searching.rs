//! Looks for objects on a thread of its own: a search takes longer than a frame, and commands do not wait for it.
//!
//! In: a frame, what is known and what of it is wanted. Out: what was found (camera frame, metres).

use super::capture::Arrived;
use linkage_skill::SkillConfig;
use linkage_skill::recognise::{KnownObject, Recognition, Scene, StillFrames};
use linkage_skill::store::Library;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::Instant;

/// What is looked for.
pub struct Wanted {
    /// Any object where none is named.
    pub object: Option<String>,
    /// Searches of this kind before this one: where anything is wanted, each looks for the next part of the library.
    pub turn: usize,
    /// Frames of a camera that stands still. Where they are given, objects without features are searched by shape too,
    /// in all of these frames together; that takes 0.1 to 0.4 s for each object.
    pub still: Option<StillFrames>,
}

/// What was found in a frame.
pub struct Found {
    pub recognition: Recognition,
    /// The objects of its matches.
    pub objects: Vec<Arc<KnownObject>>,
    /// The frame's time stamp, microseconds.
    pub utime: i64,
    /// When the frame arrived.
    pub arrived: Instant,
}

/// A search that runs.
pub struct Searching(Receiver<Result<Found, String>>);

impl Searching {
    /// Begins to look for something in a frame.
    ///
    /// # Errors
    /// The error of the operating system when a thread cannot be started.
    pub fn begin(
        wanted: Wanted,
        frame: &Arrived,
        library: &Arc<Library>,
        skill: &SkillConfig,
    ) -> std::io::Result<Self> {
        let (sender, found) = channel();
        let (frame, library, skill) = (frame.clone(), Arc::clone(library), skill.clone());
        std::thread::Builder::new().name("search".to_owned()).spawn(move || {
            // Nobody waits for it when the service ends meanwhile.
            let _ = sender.send(search(&wanted, &frame, &library, skill));
        })?;
        Ok(Self(found))
    }

    /// A search that a test ends.
    #[cfg(test)]
    pub fn awaited() -> (std::sync::mpsc::Sender<Result<Found, String>>, Self) {
        let (sender, found) = channel();
        (sender, Self(found))
    }

    /// What was found, once the search is over.
    pub fn poll(&self) -> Option<Result<Found, String>> {
        match self.0.try_recv() {
            Ok(found) => Some(found),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => Some(Err("the search has failed".to_owned())),
        }
    }
}

/// Looks for what is wanted; for anything known, in one shortlist a frame.
fn search(
    wanted: &Wanted,
    Arrived { frame, at }: &Arrived,
    library: &Library,
    mut skill: SkillConfig,
) -> Result<Found, String> {
    let fused =
        wanted.still.as_ref().map(StillFrames::fused).transpose().map_err(|e| e.to_string())?;
    let frame = fused.as_ref().and_then(Option::as_ref).unwrap_or(frame);
    let scene = Scene::new(frame).map_err(|e| e.to_string())?;
    skill.recognise.try_shape |= wanted.still.is_some();
    let config = &skill.recognise;
    let listed = wanted.object.as_deref().and_then(|name| library.number(name));
    let recognition = match listed {
        Some(number) => library.recognise_listed(&scene, &[number], config, skill.seed),
        None => library.recognise_in_turn(&scene, config, skill.seed, wanted.turn),
    };
    let recognition = recognition.map_err(|e| e.to_string())?;
    let numbers = recognition.matches.iter().filter_map(|m| library.number(&m.object));
    let objects = numbers.filter_map(|n| library.object(n).ok()).collect();
    Ok(Found { recognition, objects, utime: frame.utime, arrived: *at })
}
