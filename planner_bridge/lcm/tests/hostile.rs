//! Datagrams of any bytes before a connection that receives.

mod support;

use linkage_lcm::Lcm;
use std::time::{Duration, Instant};
use support::{attacker, group, listener, next, url};

/// A fragment with a channel's name before its bytes where it is the first.
fn fragment(sequence: u32, size: u32, offset: u32, number: u16, count: u16) -> Vec<u8> {
    let mut datagram = b"LC03".to_vec();
    [sequence, size, offset].iter().for_each(|word| datagram.extend(word.to_be_bytes()));
    [number, count].iter().for_each(|half| datagram.extend(half.to_be_bytes()));
    if number == 0 {
        datagram.extend(b"KINECT_FRAME\0");
    }
    datagram.extend([0x41; 1000]);
    datagram
}

fn short(name: &[u8]) -> Vec<u8> {
    [&b"LC02\0\0\0\x07"[..], name].concat()
}

/// Sends datagrams to a connection, and then sees that an ordinary message arrives within a
/// second.
fn survives(number: u8, datagrams: &[Vec<u8>]) -> linkage_lcm::Reception {
    let url = url(number);
    let mut listener = listener(&url);
    let attacker = attacker();
    for datagram in datagrams {
        attacker.send_to(datagram, group(&url)).unwrap();
    }
    let start = Instant::now();
    Lcm::new(&url).unwrap().publish_bytes("LINKAGE_STATUS", b"alive").unwrap();
    let timeout = Duration::from_secs(1);
    assert_eq!(next(&mut listener, "LINKAGE_STATUS", timeout).as_deref(), Some(&b"alive"[..]));
    assert!(start.elapsed() < timeout);
    listener.reception()
}

fn resident_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|l| l.starts_with("VmHWM:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

#[test]
fn a_fragment_whose_offset_wraps_is_refused() {
    let first = fragment(1, 100_000, 0, 0, 3);
    let reception = survives(1, &[first, fragment(1, 100_000, u32::MAX - 8, 1, 3)]);
    assert_eq!((reception.refused, reception.received), (1, 1));
}

#[test]
fn a_datagram_shorter_than_its_header_is_refused() {
    let whole = fragment(1, 5000, 0, 0, 5);
    let cut: Vec<_> = (0..33).map(|length| whole[..length].to_vec()).collect();
    let more = [short(b""), short(b"ABC"), b"LC02".to_vec(), b"\x4c".to_vec()];
    let reception = survives(2, &[&cut[..], &more].concat());
    assert_eq!((reception.refused, reception.received), (33 + 4, 1));
}

#[test]
fn fragments_that_claim_much_take_neither_memory_nor_time() {
    let before = resident_kib();
    let claims: Vec<_> = (0..40).map(|n| fragment(n, 268_000_000, 0, 0, 4100)).collect();
    let within: Vec<_> = (40..80).map(|n| fragment(n, 60_000_000, 0, 0, 60_000)).collect();
    let reception = survives(3, &[claims, within].concat());
    assert_eq!((reception.oversized, reception.received), (40, 1));
    let grown = resident_kib().saturating_sub(before);
    assert!(grown < 60_000, "{grown} KiB more");
}

#[test]
fn numbers_that_no_fragment_has_are_refused() {
    let reception = survives(
        4,
        &[
            fragment(1, 2000, 1000, 2, 2),
            fragment(1, 2000, 1000, 1, 0),
            fragment(1, 2000, 500, 1, 2),
            fragment(1, 2000, 500, 0, 2),
            fragment(1, 0, 0, 0, 1),
        ],
    );
    assert_eq!((reception.refused, reception.received), (5, 1));
}

#[test]
fn channels_that_none_can_have_are_refused() {
    let long = [vec![b'C'; 64], vec![0, 1, 2]].concat();
    let endless = vec![b'C'; 60_000];
    let reception =
        survives(5, &[short(&long), short(&endless), short(b"\xff\xfe\0abc"), short(b"\0abc")]);
    assert_eq!((reception.refused, reception.received), (4, 1));
}

#[test]
fn a_message_above_its_subscription_is_counted_and_not_received() {
    let url = url(6);
    let mut lcm = Lcm::new(&url).unwrap();
    lcm.subscribe_up_to("LINKAGE_COMMAND", 1000).unwrap();
    for length in [1001, 70_000, 1000] {
        lcm.publish_bytes("LINKAGE_COMMAND", &vec![7; length]).unwrap();
    }
    let received = next(&mut lcm, "LINKAGE_COMMAND", Duration::from_secs(5));
    assert_eq!(received.map(|b| b.len()), Some(1000));
    assert_eq!((lcm.reception().oversized, lcm.reception().missing()), (2, 0));
}

/// Sends what a random generator gives, each datagram begun as one of LCM.
#[test]
fn random_datagrams_are_survived() {
    let mut state = 1_u64;
    let mut random = move || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize
    };
    let datagrams: Vec<Vec<u8>> = (0..3000)
        .map(|_| {
            let length = random() % 64;
            let body: Vec<u8> = (0..length)
                .map(|_| if random().is_multiple_of(2) { 0 } else { random() as u8 })
                .collect();
            [[&b"LC02"[..], b"LC03"][random() % 2], &body].concat()
        })
        .collect();
    for (number, some) in datagrams.chunks(1000).enumerate() {
        survives(20 + number as u8, some);
    }
}
