//! Sending and receiving: `udpm://` in safe Rust, the other kinds of networks through liblcm.

#[allow(unsafe_code)]
mod sys;
mod tcpq;

use crate::codec::{Message, encode};
use crate::error::LcmError;
use crate::packet::{Packet, Reception};
use crate::udpm::{MAX_CHANNEL, Network, Publisher, Receiver};
use std::ffi::CStr;
use std::time::{Duration, Instant};

/// Largest message that is received where a subscription says nothing else, bytes: an image of
/// 8K is half of it.
pub const DEFAULT_MAX_BYTES: usize = 64 << 20;

/// A connection to an LCM network.
pub struct Lcm {
    url: String,
    backend: Backend,
    subscriptions: usize,
}

/// What carries the messages.
enum Backend {
    Multicast { network: Network, publisher: Publisher, receiver: Option<Receiver> },
    Liblcm(sys::Handle),
}

/// What [`Lcm::subscribe`] gives; packets are read from the connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Subscription(usize);

impl Lcm {
    /// Joins the network of a URL: `udpm://…`, `tcpq://…`, `memq://`, `file://…`.
    ///
    /// # Errors
    /// [`LcmError::Join`].
    pub fn new(url: &str) -> Result<Self, LcmError> {
        let failed = |reason: String| LcmError::Join { url: url.to_owned(), reason };
        let backend = match url.split_once("://") {
            Some(("udpm", _)) => {
                let network = Network::parse(url).map_err(|e| failed(e.to_string()))?;
                let sender = network.sender().map_err(|e| LcmError::join(url, e.to_string()))?;
                Backend::Multicast { network, publisher: Publisher::new(sender), receiver: None }
            }
            Some(("tcpq" | "memq" | "file", _)) => {
                server_answers(url).map_err(failed)?;
                let handle = sys::Handle::create(url)
                    .ok_or_else(|| failed("liblcm cannot open it".to_owned()))?;
                limit_waits(url, &handle).map_err(failed)?;
                Backend::Liblcm(handle)
            }
            _ => {
                let kinds = "there are udpm://GROUP:PORT?ttl=N, tcpq://ADDRESS:PORT, file://PATH and memq://";
                return Err(failed(kinds.to_owned()));
            }
        };
        Ok(Self { url: url.to_owned(), backend, subscriptions: 0 })
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
        let failed = |reason: String| LcmError::Publish {
            channel: channel.to_owned(),
            bytes: bytes.len(),
            reason,
        };
        match &self.backend {
            Backend::Multicast { publisher, .. } => {
                publisher.publish(channel, bytes).map_err(|e| failed(e.to_string()))
            }
            Backend::Liblcm(handle) => {
                connect_again(&self.url, handle).map_err(failed)?;
                let sent = handle.publish(&name, bytes).then_some(());
                sent.ok_or_else(|| failed("the connection is gone".to_owned()))
            }
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

    /// Receives from now on what is sent on channels that match a regular expression as a whole,
    /// up to [`DEFAULT_MAX_BYTES`] a message.
    ///
    /// # Errors
    /// [`LcmError::Channel`], [`LcmError::Join`].
    pub fn subscribe(&mut self, channel: &str) -> Result<Subscription, LcmError> {
        self.subscribe_up_to(channel, DEFAULT_MAX_BYTES)
    }

    /// The same with messages of at most `max_bytes`. A larger one is counted and takes no
    /// memory.
    ///
    /// # Errors
    /// [`LcmError::Channel`], [`LcmError::Join`].
    pub fn subscribe_up_to(
        &mut self,
        channel: &str,
        max_bytes: usize,
    ) -> Result<Subscription, LcmError> {
        let failed = |reason: String| LcmError::Channel { channel: channel.to_owned(), reason };
        match &mut self.backend {
            Backend::Multicast { network, receiver, .. } => {
                let receiver = match receiver {
                    Some(receiver) => receiver,
                    None => receiver.insert(
                        Receiver::start(network)
                            .map_err(|e| LcmError::join(&self.url, e.to_string()))?,
                    ),
                };
                receiver.subscribe(channel, max_bytes).map_err(|e| failed(e.to_string()))?;
            }
            Backend::Liblcm(handle) => {
                connect_again(&self.url, handle).map_err(failed)?;
                handle.subscribe(channel, max_bytes).map_err(failed)?;
            }
        }
        self.subscriptions += 1;
        Ok(Subscription(self.subscriptions))
    }

    /// The next packet of any subscription; `None` when none comes in time.
    ///
    /// # Errors
    /// [`LcmError::Receive`].
    pub fn receive(&mut self, timeout: Duration) -> Result<Option<Packet>, LcmError> {
        let received = match &mut self.backend {
            Backend::Multicast { receiver: Some(receiver), .. } => receiver.receive(timeout),
            Backend::Multicast { receiver: None, .. } => {
                std::thread::sleep(timeout);
                Ok(None)
            }
            Backend::Liblcm(handle) => handle.receive(timeout),
        };
        received.map_err(|reason| LcmError::Receive { url: self.url.clone(), reason })
    }

    /// What was received and what was not, since the first subscription.
    pub fn reception(&self) -> Reception {
        match &self.backend {
            Backend::Multicast { network, receiver: Some(receiver), .. } => {
                receiver.reception(network)
            }
            Backend::Multicast { network, receiver: None, .. } => {
                Reception { requested_buffer: network.receive_buffer, ..Reception::default() }
            }
            Backend::Liblcm(handle) => {
                let [received, pushed_out, oversized, refused] = handle.counts();
                Reception { received, pushed_out, oversized, refused, ..Reception::default() }
            }
        }
    }

    /// Sends a packet to itself: proof that the network carries anything at all.
    ///
    /// # Errors
    /// [`LcmError::NoLoopback`] with what to do.
    pub fn self_test(&self, wait: Duration) -> Result<(), LcmError> {
        if let Backend::Multicast { network, publisher, .. } = &self.backend {
            return network.self_test(publisher.socket(), wait);
        }
        let channel = format!("LINKAGE_SELF_TEST_{}", std::process::id());
        let mut listener = Self::new(&self.url)?;
        listener.subscribe(&channel)?;
        let start = Instant::now();
        while start.elapsed() < wait {
            self.publish_bytes(&channel, b"are you there")?;
            if listener.receive(Duration::from_millis(100))?.is_some() {
                return Ok(());
            }
        }
        Err(LcmError::NoLoopback { url: self.url.clone(), waited: wait })
    }
}

/// Whether there is a server at the address of `tcpq://ADDRESS`; other kinds have none.
fn server_answers(url: &str) -> Result<(), String> {
    match url.strip_prefix("tcpq://") {
        Some(rest) => tcpq::handshake(rest.split('?').next().unwrap_or_default()),
        None => Ok(()),
    }
}

/// Channel of the empty message by which a connection is made again.
const CONNECTED_AGAIN: &CStr = c"LINKAGE_CONNECTED_AGAIN";

/// Makes a connection again that was lost. liblcm does that by itself as it sends a message, and waits without end for
/// the server's answer and until it takes the message: so the server is asked first, and the message is empty.
fn connect_again(url: &str, handle: &sys::Handle) -> Result<(), String> {
    if handle.is_connected() {
        return Ok(());
    }
    server_answers(url)?;
    if handle.publish(CONNECTED_AGAIN, &[]) {
        limit_waits(url, handle)
    } else {
        Err("the connection is gone".to_owned())
    }
}

/// liblcm would wait without end for a server that takes no bytes, or that sends a part of a message.
fn limit_waits(url: &str, handle: &sys::Handle) -> Result<(), String> {
    if !url.starts_with("tcpq://") {
        return Ok(());
    }
    handle
        .limit_waits(tcpq::TIMEOUT)
        .map_err(|e| format!("the wait for its server cannot be limited: {e}"))
}

fn channel_name(channel: &str) -> Result<std::ffi::CString, LcmError> {
    std::ffi::CString::new(channel)
        .ok()
        .filter(|_| !channel.is_empty() && channel.len() <= MAX_CHANNEL)
        .ok_or_else(|| LcmError::Channel {
            channel: channel.to_owned(),
            reason: format!("a channel has 1 to {MAX_CHANNEL} bytes, none of them NUL"),
        })
}
