//! The search for plain parts that turn: the best supported line is followed, the planes of the part that
//! is found are put aside, and the search goes on with the others.

use super::hinge::candidates;
use super::plain_part::{Followed, PlainPart, follow_candidate};
use super::plane_segments::{PlanePatch, Sampling, moving_patches};
use crate::learn::learned_joint::TurningPlane;
use crate::learn::recording::Recording;

/// Lines that are followed in the depth pictures, the best supported first.
const MOST_FOLLOWED: usize = 10;

/// Plain parts that turn.
#[derive(Default)]
pub struct PlainParts {
    /// Those whose hinge is known.
    pub parts: Vec<PlainPart>,
    /// Those that turned too little to tell where their hinge is.
    pub unknown_lines: Vec<PlainPart>,
    /// Planes that turned and of which no part was made, the best supported first.
    pub turning: Vec<TurningPlane>,
}

/// Finds plain parts that turn, those that tracks showed among them: what their planes explain must
/// not suggest other parts.
pub fn search(recording: &Recording) -> PlainParts {
    let mut patches = moving_patches(recording, Sampling::Coarse, None);
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
            // What the plane of one part explains, no other joint needs to explain.
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

/// The patches but for those at some places of the list.
fn without(patches: Vec<PlanePatch>, places: &[usize]) -> Vec<PlanePatch> {
    let kept = patches.into_iter().enumerate().filter(|(i, _)| !places.contains(i));
    kept.map(|(_, patch)| patch).collect()
}
