//! The other end of the service: sends a command and waits for its result.

use crate::channel;
use crate::service::{COMMAND_SCHEMA, CommandKey};
use linkage_driver::live::host_utime;
use linkage_driver::plain_text::harmless;
use linkage_lcm::messages::linkage;
use linkage_lcm::{Lcm, LcmError, decode};
use std::time::{Duration, Instant};

/// A command that was not done.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClientError {
    /// The network.
    #[error(transparent)]
    Lcm(#[from] LcmError),
    /// No service tells its status.
    #[error(
        "{url}: no service answers within {waited:.1} s; is \"linkage serve\" running on this network?"
    )]
    NoService {
        /// The network.
        url: String,
        /// Seconds.
        waited: f64,
    },
    /// The service refuses.
    #[error("{0}")]
    Refused(String),
    /// The answer did not come in time.
    #[error("{url}: after {waited:.1} s: {progress}; wait longer")]
    NotDone {
        /// The network.
        url: String,
        /// Seconds.
        waited: f64,
        /// What the service has said so far.
        progress: String,
    },
}

/// Time after which a command is sent again: it is not done twice.
const AGAIN_AFTER: Duration = Duration::from_millis(400);
/// Time without any answer after which a command is sent under a new name: the service takes the
/// old one no more by then.
const ANEW_AFTER: Duration = Duration::from_millis(1500);

/// Longest answer that is shown, bytes.
const TEXT_LENGTH: usize = 2000;

/// Speaks to a service.
pub struct Client {
    lcm: Lcm,
    key: Option<CommandKey>,
}

impl Client {
    /// Joins the network of a service; `key` signs commands where its rig asks for that.
    ///
    /// # Errors
    /// [`LcmError`].
    pub fn new(url: &str, key: Option<CommandKey>) -> Result<Self, LcmError> {
        let mut lcm = Lcm::new(url)?;
        lcm.subscribe(channel::STATUS)?;
        Ok(Self { lcm, key })
    }

    /// Has a command done; what the service says of it when it is. The command's name, session
    /// and signature are filled in here.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn done(
        &mut self,
        command: &linkage::Command,
        timeout: Duration,
    ) -> Result<String, ClientError> {
        let start = Instant::now();
        let session = self.session(timeout)?;
        let mut sent_as = SentAs { now: self.addressed(command, session), before: Vec::new() };
        let (mut named_at, mut sent, mut progress) = (Instant::now(), None::<Instant>, None);
        while start.elapsed() < timeout {
            if progress.is_none() && named_at.elapsed() > ANEW_AFTER {
                sent_as.rename(self.addressed(command, session));
                (named_at, sent) = (Instant::now(), None);
            }
            if sent.is_none_or(|at| at.elapsed() > AGAIN_AFTER) {
                self.lcm.publish(channel::COMMAND, &sent_as.now)?;
                sent = Some(Instant::now());
            }
            let Some(status) = self.status(AGAIN_AFTER)? else { continue };
            match sent_as.answer(&status) {
                None => {}
                Some((false, _)) => return Err(ClientError::Refused(status.command_answer)),
                Some((true, true)) => return Ok(status.command_answer),
                Some((true, false)) => progress = Some(status.command_answer),
            }
        }
        let (url, waited) = (self.lcm.url().to_owned(), timeout.as_secs_f64());
        let progress = progress.unwrap_or_else(|| "the command is not answered".to_owned());
        Err(ClientError::NotDone { url, waited, progress })
    }

    fn session(&mut self, timeout: Duration) -> Result<i64, ClientError> {
        let start = Instant::now();
        while start.elapsed() < timeout {
            if let Some(status) = self.status(AGAIN_AFTER)? {
                return Ok(status.session);
            }
        }
        let (url, waited) = (self.lcm.url().to_owned(), timeout.as_secs_f64());
        Err(ClientError::NoService { url, waited })
    }

    fn status(&mut self, wait: Duration) -> Result<Option<linkage::Status>, LcmError> {
        let packet = self.lcm.receive(wait)?;
        let status = packet.and_then(|p| decode::<linkage::Status>(&p.bytes).ok());
        // Anybody may publish a status: its words are shown to people.
        Ok(status.map(|status| {
            let command_answer = harmless(&status.command_answer, TEXT_LENGTH);
            linkage::Status { command_answer, ..status }
        }))
    }

    fn addressed(&self, command: &linkage::Command, session: i64) -> linkage::Command {
        let mut order = addressed(command, session);
        if let Some(key) = &self.key {
            key.sign(&mut order);
        }
        order
    }
}

/// A command under each of the names with which it was sent.
struct SentAs {
    now: linkage::Command,
    before: Vec<linkage::Command>,
}

impl SentAs {
    fn rename(&mut self, renamed: linkage::Command) {
        self.before.push(std::mem::replace(&mut self.now, renamed));
    }

    /// What a status says of the command: accepted, and done. A busy service may begin it in time and
    /// say so late; it is the same command, and its newer name is refused then. That it came too late
    /// under an earlier name says nothing.
    fn answer(&mut self, status: &linkage::Status) -> Option<(bool, bool)> {
        let name = status.command_utime;
        if status.command_accepted
            && let Some(before) = self.before.iter_mut().find(|before| before.utime == name)
        {
            std::mem::swap(&mut self.now, before);
        }
        (name == self.now.utime).then_some((status.command_accepted, status.command_done))
    }
}

/// A command as it is sent now to a session of the service, unsigned.
pub fn addressed(command: &linkage::Command, session: i64) -> linkage::Command {
    let utime = host_utime();
    linkage::Command { utime, schema: COMMAND_SCHEMA, session, ..command.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What was asked for, with what the client fills in left open.
    fn command() -> linkage::Command {
        linkage::Command { utime: 5, session: 6, ..linkage::Command::default() }
    }

    #[test]
    fn a_command_is_sent_under_the_present_time_to_the_session_that_answers() {
        let before = host_utime();
        let order = addressed(&command(), 1234);
        assert!((before..=host_utime()).contains(&order.utime));
        assert_eq!((order.session, order.schema), (1234, COMMAND_SCHEMA));
        assert!(order.signature.is_empty());
    }

    #[test]
    fn a_key_signs_what_is_sent_and_another_key_otherwise() {
        let dir = tempfile::tempdir().unwrap();
        let signature = |key: &str| {
            let path = dir.path().join(key);
            std::fs::write(&path, key.repeat(8)).unwrap();
            let mut order = linkage::Command { utime: 1, ..command() };
            CommandKey::read(&path).unwrap().sign(&mut order);
            order.signature
        };
        assert_eq!(signature("first").len(), 32);
        assert_ne!(signature("first"), signature("other"));
        let key = CommandKey::read(&dir.path().join("first")).unwrap();
        let client = Client::new("memq://", Some(key)).unwrap();
        assert_eq!(client.addressed(&command(), 1).signature.len(), 32);
        let unsigned = Client::new("memq://", None).unwrap();
        assert!(unsigned.addressed(&command(), 1).signature.is_empty());
    }

    #[test]
    fn an_answer_that_came_late_to_an_earlier_name_counts_where_it_was_accepted() {
        let status = |command_utime, command_accepted, command_done| linkage::Status {
            command_utime,
            command_accepted,
            command_done,
            ..linkage::Status::default()
        };
        let named = |utime| linkage::Command { utime, ..command() };
        let twice = || SentAs { now: named(2), before: vec![named(1)] };
        let mut names = twice();
        assert_eq!(names.answer(&status(1, false, true)), None, "it came too late");
        assert_eq!(names.answer(&status(7, true, true)), None, "another command");
        assert_eq!(names.answer(&status(1, true, false)), Some((true, false)));
        assert_eq!(names.answer(&status(2, false, true)), None, "it is already being done");
        assert_eq!(names.now.utime, 1, "it is asked for under the name that is known");
        assert_eq!(names.answer(&status(1, true, true)), Some((true, true)));
        assert_eq!(twice().answer(&status(2, false, true)), Some((false, true)));
    }

    #[test]
    fn where_no_service_answers_that_is_told_with_the_network() {
        let mut client = Client::new("memq://", None).unwrap();
        let error = client.done(&command(), Duration::from_millis(10)).unwrap_err();
        assert!(matches!(error, ClientError::NoService { .. }));
        assert!(error.to_string().starts_with("memq://: no service answers"), "{error}");
    }
}
