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

use super::losses::Losses;
use super::publisher::Note;
use super::stream::Orders;
use linkage_driver::live::RecvError;
use linkage_realtime::Notice;
use state::State;
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
            self.watchdog.alive();
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
            if let Some(lost) = self.losses.many(&self.inbox.lost, self.looked_at) {
                self.out.note(Note::Error(lost));
            }
            self.losses = Losses::begin(&self.inbox.lost, self.looked_at);
        }
        match self.orders.as_mut().and_then(Orders::poll) {
            Some(Notice::Ended(Some(why))) => {
                self.out.note(Note::Error(format!("the motion was braked: {why}")));
            }
            Some(Notice::Refused(why)) => {
                self.out.note(Note::Error(format!("the motion was not executed: {why}")));
            }
            Some(Notice::Ended(None)) | None => {}
        }
        if let State::Learning { learning, command } = &self.state
            && let Some(result) = learning.poll()
        {
            let (command, object) = (*command, learning.object.clone());
            self.state = State::Resting;
            let result = match result {
                Ok(learned) => {
                    self.library = learned.library;
                    Ok(learned.summary)
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
        self.time_out_pending();
    }
}
