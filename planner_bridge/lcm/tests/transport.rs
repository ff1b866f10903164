//! Messages over a real network of this host.

use linkage_lcm::messages::linkage::Status;
use linkage_lcm::{Lcm, LcmError, decode};
use std::time::Duration;

const URL: &str = "udpm://239.255.76.67:7691?ttl=0";

#[test]
fn what_is_published_is_received() {
    let mut listener = Lcm::new(URL).unwrap();
    listener.subscribe("LINKAGE_TEST_STATUS").unwrap();
    let sender = Lcm::new(URL).unwrap();
    sender.self_test(Duration::from_secs(5)).unwrap();
    let status = Status { state: "idle".into(), frames: 3, ..Default::default() };
    sender.publish("LINKAGE_TEST_STATUS", &status).unwrap();
    let packet = listener.receive(Duration::from_secs(5)).unwrap().expect("a packet");
    assert_eq!(packet.channel, "LINKAGE_TEST_STATUS");
    assert_eq!(decode::<Status>(&packet.bytes).unwrap(), status);
}

#[test]
fn a_url_that_is_none_is_refused_with_what_to_do() {
    let error = Lcm::new("carrier-pigeon://coop").err().unwrap();
    assert!(matches!(error, LcmError::Join { .. }));
    assert!(error.to_string().contains("carrier-pigeon"), "{error}");
}

#[test]
fn an_empty_channel_is_refused() {
    let lcm = Lcm::new(URL).unwrap();
    assert!(matches!(lcm.publish_bytes("", b"x"), Err(LcmError::Channel { .. })));
}
