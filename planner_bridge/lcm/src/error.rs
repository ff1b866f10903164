//! What can go wrong on a network.

use crate::codec::EncodeError;
use std::time::Duration;

/// What can go wrong on the network.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LcmError {
    /// The network cannot be joined.
    #[error("{url}: LCM cannot join: {reason}")]
    Join {
        /// As asked.
        url: String,
        /// Why not, and what to do.
        reason: String,
    },
    /// A packet was not sent.
    #[error("{channel}: {bytes} bytes could not be published: {reason}")]
    Publish {
        /// Channel.
        channel: String,
        /// Size.
        bytes: usize,
        /// The error of the operating system.
        reason: String,
    },
    /// A channel name that none can have, or a subscription that is no regular expression.
    #[error("\"{channel}\" is no channel: {reason}")]
    Channel {
        /// As given.
        channel: String,
        /// Why not.
        reason: String,
    },
    /// Receiving failed.
    #[error("{url}: LCM cannot receive: {reason}")]
    Receive {
        /// The network.
        url: String,
        /// Why not.
        reason: String,
    },
    /// A message has no encoding.
    #[error("{channel}: {source}")]
    Encode {
        /// Channel.
        channel: String,
        /// Why.
        source: EncodeError,
    },
    /// Nothing that was sent came back.
    #[error(
        "{url}: what is sent does not come back within {waited:?}; multicast does not work on this host: try \"ip link set lo multicast on\" and \"ip route add 224.0.0.0/4 dev lo\""
    )]
    NoLoopback {
        /// The network.
        url: String,
        /// How long it was waited.
        waited: Duration,
    },
}

impl LcmError {
    /// A multicast network that cannot be joined for a reason of the system.
    pub(crate) fn join(url: &str, reason: String) -> Self {
        let reason = format!(
            "{reason}; does multicast have a route? \"ip route add 224.0.0.0/4 dev lo\" gives it one for this host only"
        );
        Self::Join { url: url.to_owned(), reason }
    }
}
