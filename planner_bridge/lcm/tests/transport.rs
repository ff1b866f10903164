//! Messages over real networks of this host.

mod support;

use linkage_lcm::messages::linkage::Status;
use linkage_lcm::udpm::Network;
use linkage_lcm::{Lcm, LcmError, decode};
use std::io::{Read, Write};
use std::net::{TcpListener, UdpSocket};
use std::time::{Duration, Instant};
use support::{attacker, group, image, listener, next, url};

const TIMEOUT: Duration = Duration::from_secs(5);

#[test]
fn what_is_published_is_received() {
    let url = url(50);
    let mut listener = Lcm::new(&url).unwrap();
    listener.subscribe("LINKAGE_TEST_STATUS").unwrap();
    let sender = Lcm::new(&url).unwrap();
    sender.self_test(TIMEOUT).unwrap();
    let status = Status { state: "idle".into(), frames: 3, ..Default::default() };
    sender.publish("LINKAGE_TEST_STATUS", &status).unwrap();
    let packet = listener.receive(TIMEOUT).unwrap().expect("a packet");
    assert_eq!(packet.channel, "LINKAGE_TEST_STATUS");
    assert!(packet.sender.is_some_and(|s| s.port() != 0));
    assert_eq!(decode::<Status>(&packet.bytes).unwrap(), status);
}

#[test]
fn messages_of_all_lengths_are_received() {
    let url = url(51);
    let mut listener = listener(&url);
    let sender = Lcm::new(&url).unwrap();
    // With its channel and a NUL, a message of 65497 bytes is the longest that goes in one piece.
    for length in [0, 1, 65_496, 65_497, 65_498, 130_971, 130_972, 130_973, 1_000_000, 4_000_000] {
        sender.publish_bytes("C", &image(length)).unwrap();
        let received = next(&mut listener, "C", TIMEOUT);
        assert!(received.is_some_and(|bytes| bytes == image(length)), "{length}");
    }
    assert_eq!(listener.reception().missing(), 0);
}

#[test]
fn another_group_on_the_same_port_is_not_heard() {
    let ours = url(52);
    let others = ours.replacen("239.255", "239.254", 1);
    let mut listener = listener(&ours);
    // This host has joined the other group too.
    let mut others_listener = support::listener(&others);
    Lcm::new(&others).unwrap().publish_bytes("LINKAGE_COMMAND", b"theirs").unwrap();
    let unicast = b"LC02\0\0\0\0LINKAGE_COMMAND\0unicast";
    attacker().send_to(unicast, ("127.0.0.1", group(&ours).port())).unwrap();
    assert!(next(&mut others_listener, "LINKAGE_COMMAND", TIMEOUT).is_some());
    Lcm::new(&ours).unwrap().publish_bytes("LINKAGE_COMMAND", b"ours").unwrap();
    let received = next(&mut listener, "LINKAGE_COMMAND", TIMEOUT);
    assert_eq!(received.as_deref(), Some(&b"ours"[..]));
    assert_eq!(listener.reception().received, 1);
}

#[test]
fn messages_that_a_sender_left_out_are_counted_as_lost() {
    let url = url(53);
    let mut listener = listener(&url);
    let socket = attacker();
    for sequence in [0_u32, 1, 5, 6] {
        let datagram = [b"LC02", &sequence.to_be_bytes()[..], b"KINECT_FRAME\0abc"].concat();
        socket.send_to(&datagram, group(&url)).unwrap();
    }
    for _ in 0..4 {
        assert!(next(&mut listener, "KINECT_FRAME", TIMEOUT).is_some());
    }
    assert_eq!((listener.reception().lost, listener.reception().missing()), (3, 3));
}

#[test]
fn each_image_is_received_or_counted_as_missing() {
    let url = url(59);
    // A buffer that holds no image.
    let mut listener = listener(&format!("{url}&recv_buf_size=50000"));
    let sender = Lcm::new(&url).unwrap();
    sender.publish_bytes("KINECT_FRAME", b"first").unwrap();
    assert!(next(&mut listener, "KINECT_FRAME", TIMEOUT).is_some());
    (0..50).for_each(|_| sender.publish_bytes("KINECT_FRAME", &image(300_000)).unwrap());
    // Until one arrives, of those after the images too.
    let mut sent = 51;
    loop {
        sent += 1;
        sender.publish_bytes("LAST", b"last").unwrap();
        if next(&mut listener, "LAST", Duration::from_millis(100)).is_some() {
            break;
        }
    }
    std::thread::sleep(Duration::from_millis(700));
    let reception = listener.reception();
    assert_eq!(reception.received + reception.missing(), sent);
    assert!(reception.missing() > 0 && reception.refused == 0);
}

#[test]
fn a_datagram_is_sent_without_allocating() {
    let network = Network::parse(&url(60)).unwrap();
    let sender = network.sender().unwrap();
    sender.set_nonblocking(true).unwrap();
    network.self_test(&sender, TIMEOUT).unwrap();
    let datagram = b"LC02\0\0\0\0LINKAGE_SETPOINT\0abc";
    let memory = allocation_counter::measure(|| sender.send(datagram).unwrap());
    assert_eq!(memory.count_total, 0);
}

#[test]
fn what_nobody_takes_in_time_is_counted() {
    let url = url(54);
    let listener = listener(&url);
    let sender = Lcm::new(&url).unwrap();
    for number in 0..1500_u32 {
        sender.publish_bytes("C", &number.to_be_bytes()).unwrap();
        if number % 50 == 0 {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
    let start = Instant::now();
    let all_are_there = || listener.reception().received + listener.reception().lost >= 1500;
    while !all_are_there() && start.elapsed() < TIMEOUT {
        std::thread::sleep(Duration::from_millis(5));
    }
    let reception = listener.reception();
    assert_eq!(reception.received - reception.pushed_out, 1024);
    assert_eq!(reception.missing(), 1500 - 1024);
}

#[test]
fn the_receive_buffer_that_was_granted_is_told() {
    let url = format!("{}&recv_buf_size=100000", url(55));
    let reception = listener(&url).reception();
    assert_eq!((reception.requested_buffer, reception.granted_buffer), (100_000, 100_000));
    let most: usize =
        std::fs::read_to_string("/proc/sys/net/core/rmem_max").unwrap().trim().parse().unwrap();
    let reception = listener(&support::url(56)).reception();
    assert_eq!(reception.granted_buffer, reception.requested_buffer.min(most));
}

#[test]
fn urls_that_name_no_network_are_refused_with_what_to_do() {
    for (url, word) in [
        ("carrier-pigeon://coop", "udpm://"),
        ("mpudpm://239.255.76.67:7667", "udpm://"),
        ("", "udpm://"),
        ("udpm://127.0.0.1:7716?ttl=0", "multicast"),
        ("udpm://239.255.76.67:7667?ttl=x", "ttl"),
        ("file:///nowhere/at/all.lcmlog", "file:///nowhere/at/all.lcmlog"),
        ("file:///", "cannot open"),
        ("file://", "cannot open"),
        ("tcpq://127.0.0.1:1", "tcpq://127.0.0.1:1"),
        ("tcpq://robot:7700", "no address"),
        ("tcpq://127.0.0.1:x", "no address"),
    ] {
        let error = Lcm::new(url).err().unwrap_or_else(|| panic!("{url} is joined"));
        assert!(matches!(error, LcmError::Join { .. }), "{error}");
        let text = error.to_string();
        assert!(text.contains("LCM cannot join") && text.contains(word), "{text}");
    }
}

/// What a server of `tcpq` says first.
const HELLO: &[u8] = b"\x28\x76\x17\xfa\0\0\x01\0";

/// A peer that accepts some connections, answers with some bytes, and closes each but the one of
/// number `kept`; then it is gone.
fn peer(answer: &'static [u8], connections: usize, kept: usize) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("tcpq://{}", listener.local_addr().unwrap());
    std::thread::spawn(move || {
        for number in 1..=connections {
            let (mut socket, _) = listener.accept().unwrap();
            let mut hello = [0; 8];
            let _ = socket.read_exact(&mut hello);
            let _ = socket.write_all(answer);
            if number == kept {
                let _ = std::io::copy(&mut socket, &mut std::io::sink());
            }
        }
    });
    url
}

#[test]
fn a_peer_that_is_no_server_is_told_and_does_not_hold_us_up() {
    let error = Lcm::new(&peer(b"SSH-2.0-OpenSSH", 1, 0)).err().unwrap().to_string();
    assert!(error.contains("no LCM server"), "{error}");
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let start = Instant::now();
    let url = format!("tcpq://{}", silent.local_addr().unwrap());
    assert!(matches!(Lcm::new(&url), Err(LcmError::Join { .. })));
    assert!(start.elapsed() < Duration::from_secs(10));
}

#[test]
fn a_server_that_vanishes_is_an_error() {
    // The first connection is the one that asks whether there is a server at all.
    let mut lcm = Lcm::new(&peer(HELLO, 2, 0)).unwrap();
    lcm.subscribe("C").unwrap();
    for _ in 0..3 {
        assert!(matches!(lcm.receive(Duration::from_secs(1)), Err(LcmError::Receive { .. })));
        assert!(matches!(lcm.publish_bytes("C", b"abc"), Err(LcmError::Publish { .. })));
    }
}

#[test]
fn a_server_that_returns_is_published_to_again() {
    let mut lcm = Lcm::new(&peer(HELLO, 4, 4)).unwrap();
    lcm.subscribe("C").unwrap();
    assert!(lcm.receive(Duration::from_secs(1)).is_err());
    assert!(lcm.publish_bytes("C", b"abc").is_ok());
}

/// A server that says its first words, sends `then` on each connection, and neither takes nor sends anything after
/// that.
fn silent_server(then: &'static [u8]) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("tcpq://{}", listener.local_addr().unwrap());
    std::thread::spawn(move || {
        let mut connected = Vec::new();
        for socket in listener.incoming() {
            let mut socket = socket.unwrap();
            socket.read_exact(&mut [0; 8]).unwrap();
            let _ = socket.write_all(HELLO).and_then(|()| socket.write_all(then));
            connected.push(socket);
        }
    });
    url
}

#[test]
fn a_server_that_takes_nothing_holds_its_publisher_up_for_seconds_at_most() {
    let lcm = Lcm::new(&silent_server(b"")).unwrap();
    let message = vec![7; 1 << 20];
    // Buffers of the system take the first ones. The connection that is made after the failure is no better.
    for _ in 0..2 {
        let start = Instant::now();
        let failed = (0..64).map(|_| lcm.publish_bytes("C", &message)).find_map(Result::err);
        assert!(matches!(failed, Some(LcmError::Publish { .. })), "{failed:?}");
        assert!(start.elapsed() < Duration::from_secs(10), "{:?}", start.elapsed());
    }
    let (start, large) = (Instant::now(), vec![7; 32 << 20]);
    assert!(lcm.publish_bytes("C", &large).is_err());
    assert!(start.elapsed() < Duration::from_secs(10), "{:?}", start.elapsed());
}

#[test]
fn a_server_that_sends_half_a_message_holds_its_receiver_up_for_seconds_at_most() {
    // A message, and a channel of ten bytes, of which one comes.
    let mut lcm = Lcm::new(&silent_server(b"\0\0\0\x01\0\0\0\x0aC")).unwrap();
    lcm.subscribe("C").unwrap();
    let start = Instant::now();
    let received = lcm.receive(Duration::from_millis(50));
    assert!(matches!(received, Err(LcmError::Receive { .. })), "{received:?}");
    assert!(start.elapsed() < Duration::from_secs(10), "{:?}", start.elapsed());
}

#[test]
fn memory_carries_messages_up_to_their_limit() {
    let mut lcm = Lcm::new("memq://").unwrap();
    lcm.subscribe_up_to("LINKAGE_COMMAND", 1000).unwrap();
    for length in [1001, 0, 1000] {
        lcm.publish_bytes("LINKAGE_COMMAND", &image(length)).unwrap();
    }
    for length in [0, 1000] {
        assert_eq!(lcm.receive(TIMEOUT).unwrap().unwrap().bytes, image(length));
    }
    assert_eq!(lcm.receive(Duration::from_millis(10)).unwrap(), None);
    assert_eq!((lcm.reception().oversized, lcm.reception().received), (1, 2));
}

#[test]
fn a_channel_that_none_can_have_is_refused() {
    let mut lcm = Lcm::new(&url(57)).unwrap();
    for channel in ["", "A\0B", &"C".repeat(64)] {
        let refused = lcm.publish_bytes(channel, b"x");
        assert!(matches!(refused, Err(LcmError::Channel { .. })), "{channel:?}");
    }
    assert!(lcm.publish_bytes(&"C".repeat(63), b"x").is_ok());
    assert!(matches!(lcm.subscribe("(unfinished"), Err(LcmError::Channel { .. })));
}

#[test]
fn a_connection_without_subscription_leaves_the_port_alone() {
    let url = url(58);
    let lcm = Lcm::new(&url).unwrap();
    lcm.publish_bytes("C", b"x").unwrap();
    assert!(UdpSocket::bind(("0.0.0.0", group(&url).port())).is_ok());
}
