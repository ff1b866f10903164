//! Datagrams of any bytes from several senders: no message above its channel's limit, and no
//! more memory than the unfinished ones may take.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_lcm::Subscriptions;
use linkage_lcm::udpm::Reassembly;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::LazyLock;
use std::time::{Duration, Instant};

const LARGE: usize = 1 << 20;
const SMALL: usize = 100;

/// Compiled once: that takes longer than all else.
static WANTED: LazyLock<Subscriptions> = LazyLock::new(|| {
    let mut wanted = Subscriptions::default();
    wanted.add("A", LARGE).expect("a channel");
    wanted.add("B.*", SMALL).expect("a channel");
    wanted
});

fuzz_target!(|datagrams: Vec<(u8, u8, &[u8])>| {
    let mut reassembly = Reassembly::default();
    let mut now = Instant::now();
    let mut taken = 0;
    for (how, milliseconds, body) in datagrams {
        now += Duration::from_millis(milliseconds.into());
        let from = SocketAddr::from((Ipv4Addr::LOCALHOST, 1 + u16::from(how & 0x0f)));
        let magic: &[u8] = match how >> 6 {
            0 => b"",
            1 => b"LC02",
            _ => b"LC03",
        };
        let datagram = [magic, body].concat();
        taken += datagram.len();
        if let Some(whole) = reassembly.take(from, &datagram, &WANTED, now) {
            let limit = if whole.channel == "A" { LARGE } else { SMALL };
            assert!(whole.bytes.len() <= limit && whole.bytes.len() <= taken);
        }
        assert!(reassembly.held_bytes() <= 4 * LARGE);
    }
    reassembly.give_up_old(now + Duration::from_secs(1));
    assert_eq!(reassembly.held_bytes(), 0);
});
