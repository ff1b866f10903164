//! Sending and receiving through liblcm.

#[allow(unsafe_code)]
mod sys;

use crate::codec::{Message, encode};
use std::time::Duration;

/// What can go wrong on the network.
#[derive(Debug, thiserror::Error)]
pub enum LcmError {
    /// The network cannot be joined.
    #[error(
        "{url}: LCM cannot join; check the URL, and that multicast has a route: \"ip route add 224.0.0.0/4 dev lo\" for this host only"
    )]
    Join {
        /// As asked.
        url: String,
    },
    /// A packet was not sent.
    #[error("{channel}: {bytes} bytes could not be published")]
    Publish {
        /// Channel.
        channel: String,
        /// Size.
        bytes: usize,
    },
    /// A channel name with a NUL, or a subscription that liblcm refuses.
    #[error("\"{channel}\" is no channel")]
    Channel {
        /// As given.
        channel: String,
    },
    /// Receiving failed.
    #[error("LCM cannot receive any more")]
    Receive,
    /// A message has no encoding.
    #[error("{channel}: {source}")]
    Encode {
        /// Channel.
        channel: String,
        /// Why.
        source: crate::codec::EncodeError,
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

/// A received packet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Packet {
    /// Channel.
    pub channel: String,
    /// Bytes, the fingerprint first.
    pub bytes: Vec<u8>,
    /// When it was received, microseconds.
    pub received_utime: i64,
}

/// A connection to an LCM network.
pub struct Lcm {
    url: String,
    handle: sys::Handle,
}

/// What [`Lcm::subscribe`] gives; packets are read from the connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Subscription(usize);

impl Lcm {
    /// Joins the network of a URL: `udpm://…`, `memq://`, `file://…`.
    ///
    /// # Errors
    /// [`LcmError::Join`].
    pub fn new(url: &str) -> Result<Self, LcmError> {
        let handle =
            sys::Handle::create(url).ok_or_else(|| LcmError::Join { url: url.to_owned() })?;
        Ok(Self { url: url.to_owned(), handle })
    }

    /// The network's URL.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Sends bytes.
    ///
    /// # Errors
    /// [`LcmError::Publish`], [`LcmError::Channel`].
    pub fn publish_bytes(&self, channel: &str, bytes: &[u8]) -> Result<(), LcmError> {
        let name = channel_name(channel)?;
        if self.handle.publish(&name, bytes) {
            Ok(())
        } else {
            Err(LcmError::Publish { channel: channel.to_owned(), bytes: bytes.len() })
        }
    }

    /// Sends a message.
    ///
    /// # Errors
    /// [`LcmError::Encode`], and those of [`Self::publish_bytes`].
    pub fn publish<M: Message>(&self, channel: &str, message: &M) -> Result<(), LcmError> {
        let bytes = encode(message)
            .map_err(|source| LcmError::Encode { channel: channel.to_owned(), source })?;
        self.publish_bytes(channel, &bytes)
    }

    /// Receives from now on what is sent on channels matching a regular expression.
    ///
    /// # Errors
    /// [`LcmError::Channel`].
    pub fn subscribe(&mut self, channel: &str) -> Result<Subscription, LcmError> {
        let name = channel_name(channel)?;
        self.handle
            .subscribe(&name)
            .map(Subscription)
            .ok_or_else(|| LcmError::Channel { channel: channel.to_owned() })
    }

    /// The next packet of any subscription; `None` when none comes in time.
    ///
    /// # Errors
    /// [`LcmError::Receive`].
    pub fn receive(&mut self, timeout: Duration) -> Result<Option<Packet>, LcmError> {
        self.handle.receive(timeout).map_err(|()| LcmError::Receive)
    }

    /// Sends a packet to itself: proof that the network carries anything at all.
    ///
    /// # Errors
    /// [`LcmError::NoLoopback`] with what to do.
    pub fn self_test(&self, wait: Duration) -> Result<(), LcmError> {
        let channel = format!("LINKAGE_SELF_TEST_{}", std::process::id());
        let mut listener = Self::new(&self.url)?;
        listener.subscribe(&channel)?;
        let start = std::time::Instant::now();
        while start.elapsed() < wait {
            self.publish_bytes(&channel, b"are you there")?;
            if listener.receive(Duration::from_millis(100))?.is_some() {
                return Ok(());
            }
        }
        Err(LcmError::NoLoopback { url: self.url.clone(), waited: wait })
    }
}

fn channel_name(channel: &str) -> Result<std::ffi::CString, LcmError> {
    std::ffi::CString::new(channel)
        .ok()
        .filter(|_| !channel.is_empty() && channel.len() < 64)
        .ok_or_else(|| LcmError::Channel { channel: channel.to_owned() })
}
