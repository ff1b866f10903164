//! The addresses of this host: where nothing is to leave it, nothing from elsewhere is heard.

use std::net::{IpAddr, Ipv4Addr};
use std::time::{Duration, Instant};

/// The addresses of this host, asked for again when one is not among them.
#[derive(Debug)]
pub(super) struct OwnAddresses {
    known: Vec<IpAddr>,
    asked: Option<Instant>,
    /// Whether a packet from 0.0.0.0 can be from this host alone.
    unspecified_is_ours: bool,
}

/// Shortest time between two questions for this host's addresses: a flood of packets from
/// elsewhere asks no more often.
const ASK_AGAIN: Duration = Duration::from_secs(1);

impl OwnAddresses {
    /// Those that may send to a group.
    ///
    /// Where `lo` is the only interface, what this host sends comes from 0.0.0.0. Linux drops
    /// such packets of other hosts, except to groups 224.0.0.0 to 224.0.0.255.
    pub fn new(group: Ipv4Addr) -> Self {
        let unspecified_is_ours = group.octets()[..3] != [224, 0, 0];
        Self { known: Vec::new(), asked: None, unspecified_is_ours }
    }

    /// Whether an address is one of this host.
    pub fn has(&mut self, address: IpAddr) -> bool {
        if address.is_unspecified() {
            return self.unspecified_is_ours;
        }
        if address.is_loopback() || self.known.contains(&address) {
            return true;
        }
        if self.asked.is_some_and(|t| t.elapsed() < ASK_AGAIN) {
            return false;
        }
        self.asked = Some(Instant::now());
        if let Ok(interfaces) = nix::ifaddrs::getifaddrs() {
            self.known =
                interfaces.filter_map(|i| Some(i.address?.as_sockaddr_in()?.ip().into())).collect();
        }
        self.known.contains(&address)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_host_knows_its_addresses_and_no_others() {
        let mut own = OwnAddresses::new(Ipv4Addr::new(239, 255, 76, 67));
        assert!(own.has(Ipv4Addr::LOCALHOST.into()));
        assert!(!own.has(Ipv4Addr::new(192, 0, 2, 254).into()));
        assert!(own.has(Ipv4Addr::UNSPECIFIED.into()));
        let mut of_local_group = OwnAddresses::new(Ipv4Addr::new(224, 0, 0, 5));
        assert!(!of_local_group.has(Ipv4Addr::UNSPECIFIED.into()));
        for interface in nix::ifaddrs::getifaddrs().unwrap() {
            let address = interface.address.and_then(|a| Some(a.as_sockaddr_in()?.ip()));
            assert!(address.is_none_or(|a| own.has(a.into())), "{interface:?}");
        }
    }
}
