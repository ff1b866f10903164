//! What the tests of the network share.

#![allow(dead_code, reason = "each of them uses a part of it")]

use linkage_lcm::Lcm;
use std::net::{SocketAddrV4, UdpSocket};
use std::time::Duration;

/// A network that no other test of this or another program uses.
pub fn url(number: u8) -> String {
    let [.., high, low] = std::process::id().to_be_bytes();
    format!("udpm://239.255.{high}.{low}:{}?ttl=0", 17_000 + u16::from(number))
}

/// The group and port of such a network.
pub fn group(url: &str) -> SocketAddrV4 {
    linkage_lcm::udpm::Network::parse(url).unwrap().group
}

/// A listener on all channels.
pub fn listener(url: &str) -> Lcm {
    let mut lcm = Lcm::new(url).unwrap();
    lcm.subscribe(".*").unwrap();
    lcm
}

/// A socket that sends any datagrams to a group from this host.
pub fn attacker() -> UdpSocket {
    let socket = UdpSocket::bind(("0.0.0.0", 0)).unwrap();
    socket.set_multicast_ttl_v4(0).unwrap();
    socket
}

/// The bytes of the next packet of a channel.
pub fn next(lcm: &mut Lcm, channel: &str, timeout: Duration) -> Option<Vec<u8>> {
    let start = std::time::Instant::now();
    while start.elapsed() < timeout {
        match lcm.receive(timeout.saturating_sub(start.elapsed())).unwrap() {
            Some(packet) if packet.channel == channel => return Some(packet.bytes),
            _ => {}
        }
    }
    None
}

/// Bytes that tell where they lie.
pub fn image(length: usize) -> Vec<u8> {
    (0..length).map(|i| (i * 31 % 251) as u8).collect()
}
