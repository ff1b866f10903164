//! Part poses from AprilTags (family 36h11), the paper's ground truth (section IV), and the
//! tags' pixels taken out of what is learned from, as the paper does.
//!
//! `tags.toml` beside a recording says which tag sits on which part.

mod detector;
mod mask;
mod places;

pub use detector::bit_pattern;
pub use places::{FILE, TagPlace, TagPlaces};

use detector::{TagDetector, TagSighting};
use linkage_driver::RgbdFrame;
use linkage_skill::Pose;
use mask::masked;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::Path;

/// What the tags told, frame by frame.
pub struct TagLog {
    places: TagPlaces,
    detector: TagDetector,
    /// By time, microseconds.
    frames: BTreeMap<i64, Noted>,
}

/// The tags of a frame.
struct Noted {
    sightings: Vec<TagSighting>,
    /// By number, of those that are placed on a part.
    camera_from_tag: BTreeMap<u32, Pose>,
}

impl TagLog {
    /// A log of the recording's tags, empty yet.
    ///
    /// # Errors
    /// See [`TagPlaces::read`].
    pub fn of(recording: &Path) -> anyhow::Result<Self> {
        let places = TagPlaces::read(recording)?;
        Ok(Self { places, detector: TagDetector::new()?, frames: BTreeMap::new() })
    }

    /// Notes a frame's tags, unless they are noted already, and gives the frame back without
    /// them.
    ///
    /// # Errors
    /// When the vision library fails.
    pub fn note(&mut self, frame: &RgbdFrame) -> anyhow::Result<RgbdFrame> {
        let noted = match self.frames.entry(frame.utime) {
            Entry::Occupied(noted) => noted.into_mut(),
            Entry::Vacant(place) => place.insert(look(&self.detector, &self.places, frame)?),
        };
        Ok(masked(frame, &noted.sightings)?)
    }

    /// A part's poses up to one unknown placement on it, by time; from the tag of the part
    /// that was seen most often.
    pub fn part_poses(&self, part: &str) -> Vec<(i64, Pose)> {
        let of = |id: u32| -> Vec<(i64, Pose)> {
            self.frames
                .iter()
                .filter_map(|(t, f)| Some((*t, *f.camera_from_tag.get(&id)?)))
                .collect()
        };
        self.places
            .tag
            .iter()
            .filter(|p| p.part == part)
            .map(|p| of(p.id))
            .max_by_key(Vec::len)
            .unwrap_or_default()
    }

    /// Share of frames in which each tag was seen.
    pub fn seen(&self) -> Vec<(&TagPlace, f64)> {
        let share = |id: u32| {
            let sees = |f: &&Noted| f.camera_from_tag.contains_key(&id);
            let count = self.frames.values().filter(sees).count();
            count as f64 / self.frames.len().max(1) as f64
        };
        self.places.tag.iter().map(|p| (p, share(p.id))).collect()
    }
}

/// The tags of a frame, and where those are that sit on a part.
fn look(detector: &TagDetector, places: &TagPlaces, frame: &RgbdFrame) -> anyhow::Result<Noted> {
    let sightings = detector.detect(frame)?;
    let camera_from_tag = sightings
        .iter()
        .filter_map(|s| {
            let place = places.tag.iter().find(|p| p.id == s.id)?;
            Some((s.id, s.camera_from_tag(frame, place.size_m)?))
        })
        .collect();
    Ok(Noted { sightings, camera_from_tag })
}
