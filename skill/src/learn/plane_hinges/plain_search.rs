//! Searches for plain parts that turn: the best supported line is followed, the planes of the part that is found are
//! removed, and the search continues with the others.
//!
//! In: the recording.
//! Out: parts with their hinges, parts whose line is not known, and planes that turned without a part; base frame.

use super::hinge::candidates;
use super::plain_part::{Followed, PlainPart, follow_candidate};
use super::plane_segments::{PlanePatch, Sampling, moving_patches};
use crate::learn::learned_joint::TurningPlane;
use crate::learn::recording::Recording;

/// Most lines that are followed in the depth images, the best supported first.
const MOST_FOLLOWED: usize = 10;

/// Plain parts that turn, and planes of which no part was made.
#[derive(Default)]
pub struct PlainParts {
    /// Parts whose hinge is known.
    pub parts: Vec<PlainPart>,
    /// Parts that turned too little to determine their hinge.
    pub unknown_lines: Vec<PlainPart>,
    /// Planes that turned and of which no part was made, the best supported first.
    pub turning: Vec<TurningPlane>,
}

/// Finds plain parts that turn, including those that tracks showed: planes that these explain must not suggest other
/// parts.
pub fn search(recording: &Recording) -> PlainParts {
    let mut patches = moving_patches(recording, Sampling::Coarse, None);
    let samples: usize = patches.iter().map(|patch| patch.points.len()).sum();
    tracing::debug!(patches = patches.len(), samples, "planes that move");
    let mut found = PlainParts::default();
    let mut followed = 0;
    'next: while followed < MOST_FOLLOWED {
        for candidate in candidates(&patches, MOST_FOLLOWED - followed) {
            followed += 1;
            let (part, of_its_kind) = match follow_candidate(&candidate, &patches, recording) {
                Followed::Part(part) => (part, &mut found.parts),
                Followed::LineUnknown(part) => (part, &mut found.unknown_lines),
                Followed::Nothing => {
                    found.turning.extend(candidate.turning_plane(&patches));
                    continue;
                }
            };
            // Planes that one part explains must not support another joint.
            patches = without(patches, &part.explained);
            if !part.jumps() {
                of_its_kind.push(part);
            }
            continue 'next;
        }
        break;
    }
    found
}

/// The patches without those at the given indices.
fn without(patches: Vec<PlanePatch>, places: &[usize]) -> Vec<PlanePatch> {
    let kept = patches.into_iter().enumerate().filter(|(i, _)| !places.contains(i));
    kept.map(|(_, patch)| patch).collect()
}
