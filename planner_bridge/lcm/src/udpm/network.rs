//! The network that a `udpm://` URL names.

use super::own::OwnAddresses;
use super::sender::DatagramSender;
use socket2::{Domain, Protocol, Socket, Type};
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::{fmt, io};

/// The group and port of a URL that names none, as liblcm has them.
const DEFAULT_GROUP: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(239, 255, 76, 67), 7667);
/// The receive buffer that the system is asked for where the URL names none, bytes: five raw
/// frames of a Kinect.
const DEFAULT_RECEIVE_BUFFER: usize = 8 << 20;

/// A multicast network of LCM: `udpm://GROUP:PORT?ttl=N&recv_buf_size=BYTES`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Network {
    /// The multicast group and its port.
    pub group: SocketAddrV4,
    /// How many routers a datagram may pass; with 0 it does not leave this host.
    pub ttl: u8,
    /// The receive buffer that the system is asked for, bytes. It may grant less.
    pub receive_buffer: usize,
}

/// A URL that names no multicast network.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// It does not begin with `udpm://`.
    #[error("it does not begin with udpm://; try udpm://239.255.76.67:7667?ttl=0")]
    Scheme,
    /// The part before the options is no address.
    #[error("\"{0}\" is no address; try udpm://239.255.76.67:7667?ttl=0")]
    Address(String),
    /// The address is none of a group.
    #[error(
        "{0} is no multicast address, which are 224.0.0.0 to 239.255.255.255; try udpm://239.255.76.67:7667?ttl=0"
    )]
    Unicast(Ipv4Addr),
    /// An option that does not exist, or a value that it cannot have.
    #[error(
        "the option \"{0}\" is not understood; there are ttl=0 to ttl=255 and recv_buf_size=BYTES"
    )]
    Option(String),
}

impl Network {
    /// Reads a URL. Group, port and options may be absent.
    ///
    /// # Errors
    /// [`NetworkError`] with what a URL must look like.
    pub fn parse(url: &str) -> Result<Self, NetworkError> {
        let rest = url.strip_prefix("udpm://").ok_or(NetworkError::Scheme)?;
        let (address, options) = rest.split_once('?').unwrap_or((rest, ""));
        let group = address_of(address)?;
        if !group.ip().is_multicast() {
            return Err(NetworkError::Unicast(*group.ip()));
        }
        let mut network = Self { group, ttl: 0, receive_buffer: DEFAULT_RECEIVE_BUFFER };
        for option in options.split('&').filter(|o| !o.is_empty()) {
            network.set(option).ok_or_else(|| NetworkError::Option(option.to_owned()))?;
        }
        Ok(network)
    }

    fn set(&mut self, option: &str) -> Option<()> {
        match option.split_once('=')? {
            ("ttl", value) => self.ttl = value.parse().ok()?,
            ("recv_buf_size", value) => {
                let bytes = value.parse::<u32>().ok().filter(|b| i32::try_from(*b).is_ok())?;
                // liblcm leaves the system's own size where 0 is asked for.
                if bytes > 0 {
                    self.receive_buffer = bytes as usize;
                }
            }
            _ => return None,
        }
        Some(())
    }

    /// Opens a socket that sends to the group. It is not connected: a connected one is not heard
    /// on this host where multicast is routed over `lo` beside another interface.
    ///
    /// # Errors
    /// Those of the system, such as a host without a route for multicast.
    pub fn sender(&self) -> io::Result<DatagramSender> {
        // A socket of its own tells whether there is a route; see above.
        UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?.connect(self.group)?;
        let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
        socket.set_multicast_ttl_v4(self.ttl.into())?;
        socket.set_multicast_loop_v4(true)?;
        Ok(DatagramSender::new(socket, self.group))
    }

    /// Opens a socket that hears the group and nothing else, and the receive buffer in bytes
    /// that the system granted.
    pub(super) fn receiver(&self) -> io::Result<(UdpSocket, usize)> {
        let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
        // Each program of this host hears the group.
        socket.set_reuse_address(true)?;
        socket.set_recv_buffer_size(self.receive_buffer)?;
        // Bound to the group, not to any address: else other groups on this port are heard too.
        socket.bind(&self.group.into())?;
        socket.join_multicast_v4(self.group.ip(), &Ipv4Addr::UNSPECIFIED)?;
        // Linux doubles what is asked for, for its own bookkeeping, and tells the double.
        let told = socket.recv_buffer_size()?;
        let granted = if cfg!(target_os = "linux") { told / 2 } else { told };
        Ok((socket.into(), granted))
    }

    /// The only addresses that are heard, where the network is this host's alone.
    pub(super) fn own_addresses(&self) -> Option<OwnAddresses> {
        (self.ttl == 0).then(|| OwnAddresses::new(*self.group.ip()))
    }
}

impl fmt::Display for Network {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { group, ttl, receive_buffer } = self;
        write!(f, "udpm://{group}?ttl={ttl}")?;
        if *receive_buffer != DEFAULT_RECEIVE_BUFFER {
            write!(f, "&recv_buf_size={receive_buffer}")?;
        }
        Ok(())
    }
}

/// `ADDRESS:PORT`, `ADDRESS` or nothing.
fn address_of(text: &str) -> Result<SocketAddrV4, NetworkError> {
    if text.is_empty() {
        return Ok(DEFAULT_GROUP);
    }
    let full = if text.contains(':') {
        text.parse().ok()
    } else {
        text.parse().ok().map(|address| SocketAddrV4::new(address, DEFAULT_GROUP.port()))
    };
    full.filter(|a: &SocketAddrV4| a.port() != 0)
        .ok_or_else(|| NetworkError::Address(text.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn group(last: u8, port: u16) -> SocketAddrV4 {
        SocketAddrV4::new(Ipv4Addr::new(239, 255, 76, last), port)
    }

    #[test]
    fn a_network_is_told_by_its_url() {
        let network = |url| Network::parse(url).unwrap();
        let url = "udpm://239.255.76.5:7000?recv_buf_size=100000&ttl=3";
        let told = Network { group: group(5, 7000), ttl: 3, receive_buffer: 100_000 };
        assert_eq!(network(url), told);
        assert_eq!(network("udpm://239.255.76.5:7000").ttl, 0);
        assert_eq!(network("udpm://239.255.76.5?ttl=1").group, group(5, 7667));
        assert_eq!(network("udpm://").group, group(67, 7667));
        assert_eq!(network(url).to_string(), "udpm://239.255.76.5:7000?ttl=3&recv_buf_size=100000");
        assert_eq!(network("udpm://").to_string(), "udpm://239.255.76.67:7667?ttl=0");
        assert_eq!(network("udpm://?recv_buf_size=0").receive_buffer, DEFAULT_RECEIVE_BUFFER);
    }

    #[test]
    fn a_url_that_names_no_group_is_refused_with_what_to_write() {
        for (url, word) in [
            ("memq://", "udpm://"),
            ("udpm://10.0.0.1:7667?ttl=0", "multicast"),
            ("udpm://127.0.0.1:7667", "multicast"),
            ("udpm://239.255.76.67:70000", "no address"),
            ("udpm://239.255.76.67:0", "no address"),
            ("udpm://robot:7667", "no address"),
            ("udpm://239.255.76.67:7667?ttl=256", "ttl=256"),
            ("udpm://239.255.76.67:7667?ttl", "ttl"),
            ("udpm://239.255.76.67:7667?ttl=0&colour=red", "colour"),
            ("udpm://239.255.76.67:7667?recv_buf_size=-1", "recv_buf_size"),
        ] {
            let error = Network::parse(url).unwrap_err().to_string();
            assert!(error.contains(word), "{url}: {error}");
        }
    }
}
