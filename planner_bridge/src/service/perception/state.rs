//! The states of the thread that perceives, with what each of them holds.
//!
//! A demonstration is watched, then learned; an object is looked for, then followed. Times are those
//! of the host's monotonic clock; `utime` is a frame's, microseconds; a grasp is in the camera frame,
//! metres.

use crate::service::learning::Learning;
use crate::service::losses::Losses;
use crate::service::reacquire::Reacquisition;
use crate::service::search_turns::SearchTurns;
use linkage_skill::predict::Target;
use linkage_skill::recognise::{Follower, KnownObject, Recognised};
use linkage_skill::{Learner, ObjectModel};
use nalgebra::Point3;
use std::sync::Arc;
use std::time::Instant;

pub enum State {
    /// Idle, or ready where something is known.
    Resting,
    Demonstrating(Box<Demonstrating>),
    Learning {
        learning: Learning,
        /// That asked for it, if one did.
        command: Option<i64>,
    },
    Watching(Watching),
    Tracking(Box<Tracking>),
}

pub struct Demonstrating {
    pub object: String,
    pub learner: Learner,
    pub current_estimate: ObjectModel,
    pub told: Instant,
    pub losses: Losses,
}

pub struct Watching {
    /// Any where none is named.
    pub object: Option<String>,
    pub pending: Option<Pending>,
    /// Which search comes next.
    pub turns: SearchTurns,
    /// Best score so far of what was not accepted.
    pub best_refused: f64,
    /// True while the running search looks for this object.
    pub awaits_search: bool,
}

impl Watching {
    pub fn new(object: Option<String>, pending: Option<Pending>) -> Self {
        let turns = SearchTurns::default();
        Self { object, pending, turns, best_refused: 0.0, awaits_search: false }
    }
}

pub struct Tracking {
    pub object: Arc<KnownObject>,
    pub follower: Follower,
    pub recognised: Recognised,
    /// The newest frame shows it.
    pub seen: bool,
    pub utime: i64,
    pub arrived: Instant,
    pub pending: Option<Pending>,
    pub reacquisition: Reacquisition,
}

/// A motion that was ordered and that the stream has neither followed nor refused yet.
pub struct Ordered {
    /// The command that asked for it.
    pub command: i64,
    /// What was planned.
    pub text: String,
}

/// A prediction that waits for its object to be found.
pub struct Pending {
    pub command: i64,
    pub joint: Option<String>,
    pub target: Target,
    pub grasp: Option<Point3<f64>>,
    pub since: Instant,
    /// Nothing is planned for it after this time, microseconds since 1970, if its sender gave one.
    pub expires: Option<i64>,
}

impl Pending {
    /// Its sender does not want it any more.
    pub fn is_expired(&self, now: i64) -> bool {
        self.expires.is_some_and(|expires| now > expires)
    }
}
