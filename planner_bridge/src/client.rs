//! The other end of the service: sends a command and waits for its result.

use crate::channel;
use crate::service::{COMMAND_SCHEMA, CommandKey};
use linkage_driver::live::host_utime;
use linkage_lcm::messages::linkage;
use linkage_lcm::{Lcm, LcmError, decode};
use std::time::{Duration, Instant};

/// A command that was not done.
#[derive(Debug, thiserror::Error)]
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
        let mut order = self.addressed(command, session);
        let (mut named_at, mut sent, mut progress) = (Instant::now(), None::<Instant>, None);
        while start.elapsed() < timeout {
            if progress.is_none() && named_at.elapsed() > ANEW_AFTER {
                order = self.addressed(command, session);
                (named_at, sent) = (Instant::now(), None);
            }
            if sent.is_none_or(|at| at.elapsed() > AGAIN_AFTER) {
                self.lcm.publish(channel::COMMAND, &order)?;
                sent = Some(Instant::now());
            }
            let Some(status) = self.status(AGAIN_AFTER)? else { continue };
            if status.command_utime != order.utime {
                continue;
            }
            match (status.command_accepted, status.command_done) {
                (false, _) => return Err(ClientError::Refused(status.command_answer)),
                (true, true) => return Ok(status.command_answer),
                (true, false) => progress = Some(status.command_answer),
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
        Ok(packet.and_then(|p| decode(&p.bytes).ok()))
    }

    fn addressed(&self, command: &linkage::Command, session: i64) -> linkage::Command {
        let mut order = addressed(command, session);
        if let Some(key) = &self.key {
            key.sign(&mut order);
        }
        order
    }
}

/// A command as it is sent now to a session of the service, unsigned.
pub fn addressed(command: &linkage::Command, session: i64) -> linkage::Command {
    let utime = host_utime();
    linkage::Command { utime, schema: COMMAND_SCHEMA, session, ..command.clone() }
}
