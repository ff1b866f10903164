//! The thread that perceives: takes frames and commands, and is always in one of the states that
//! the status tells.
//!
//! In: the newest frames, with when they arrived, and commands that were let through. Out: what is
//! learned, recognised and planned, as messages to publish (camera frame, metres, radians) and as
//! orders to the stream of setpoints. Here is its loop, and what does not depend on frames; each of
//! the other files has one part of its work.

mod commands;
mod frames;
mod perceiver;
mod state;
mod status;
#[cfg(test)]
mod test_data;
mod waiting;

pub use perceiver::{Inbox, Perception};

use super::learning::Learned;
use super::losses::Losses;
use super::publisher::Note;
use linkage_driver::live::RecvError;
use state::State;
use std::sync::Arc;
use std::time::Duration;

/// Longest wait for a frame before commands are read.
const POLL: Duration = Duration::from_millis(20);
/// Time over which losses of frames are counted.
const LOSSES_OVER: Duration = Duration::from_secs(3);

impl Perception<'_> {
    /// Perceives until it is stopped; frames that were looked at, and that were dropped.
    pub fn run(mut self, is_stopped: &(dyn Fn() -> bool + Sync)) -> (u64, u64) {
        self.watchdog.ready();
        while !is_stopped() {
            if !self.inbox.lost.camera_hangs() {
                self.watchdog.alive();
            }
            while let Ok(command) = self.inbox.commands.try_recv() {
                self.handle_command(command);
            }
            match self.inbox.frames.pop(POLL) {
                Ok(arrived) => self.look(arrived),
                Err(RecvError::Timeout) => {}
                // The source is over, commands are not.
                Err(RecvError::Closed) => std::thread::sleep(POLL),
            }
            self.tick();
            self.publish_status();
        }
        self.watchdog.stopping();
        (self.looked_at, self.dropped_frames())
    }

    /// Does the work that does not depend on frames.
    fn tick(&mut self) {
        if self.losses.age() >= LOSSES_OVER {
            // Frames that are skipped because a newer one is there are no loss while nothing is learned.
            let lost = self.inbox.lost.count();
            if let Some(lost) = self.losses.many(lost, self.looked_at) {
                self.out.note(Note::Error(lost));
            }
            self.losses = Losses::begin(lost, self.looked_at);
        }
        self.hear_of_motions();
        if let State::Learning { learning, command } = &self.state
            && let Some(result) = learning.poll()
        {
            let (command, object) = (*command, learning.object.clone());
            self.state = State::Resting;
            self.take_learned(&object, result, command);
        }
        self.take_cancelled();
        self.take_found();
        self.time_out_pending();
    }

    /// Takes over what was learned, and answers the command that asked for it.
    fn take_learned(
        &mut self,
        object: &str,
        result: Result<Learned, String>,
        command: Option<i64>,
    ) {
        let result = match result {
            Ok(Learned { summary, library }) => {
                if let Some((reading, library)) = library
                    && reading > self.library_reading
                {
                    (self.library_reading, self.library) = (reading, Arc::new(library));
                }
                Ok(summary)
            }
            Err(reason) => {
                let reason = format!("{object}: {reason}");
                self.out.note(Note::Error(reason.clone()));
                Err(reason)
            }
        };
        self.publish_status();
        if let Some(command) = command {
            self.answer(command, result);
        }
    }

    /// What was cancelled too late is stored: it is known from now on, and its answer says so.
    fn take_cancelled(&mut self) {
        let mut i = 0;
        while let Some((learning, _)) = self.cancelled.get(i) {
            let Some(result) = learning.poll() else {
                i += 1;
                continue;
            };
            let (learning, command) = self.cancelled.remove(i);
            match result {
                Ok(learned) => {
                    let summary = format!("{}; it was cancelled too late", learned.summary);
                    let learned = Ok(Learned { summary, ..learned });
                    self.take_learned(&learning.object, learned, command);
                }
                Err(_) => {
                    if let Some(command) = command {
                        self.answer(command, Err("cancelled".to_owned()));
                    }
                }
            }
        }
    }
}
