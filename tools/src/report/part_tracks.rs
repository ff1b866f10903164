//! The tracked features of a part.

use linkage_skill::Demonstration;
use linkage_skill::internals::Track;

/// The tracks that were found to lie on a part.
pub fn tracks_of(demonstration: &Demonstration, part: usize) -> impl Iterator<Item = &Track> {
    let parts = demonstration.tracks.tracks.iter().zip(&demonstration.track_parts);
    parts.filter(move |(_, p)| **p == Some(part)).map(|(track, _)| track)
}
