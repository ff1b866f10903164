//! Multicast on hosts of other networks, each a network namespace of its own. Making one wants
//! root, or a system where everybody may; elsewhere these tests say that they did not run.

mod support;

use linkage_lcm::Lcm;
use std::process::Command;
use std::time::Duration;
use support::{image, listener, next};

const URL: &str = "udpm://239.255.76.67:7667?ttl=0";
const TIMEOUT: Duration = Duration::from_secs(5);
/// A cable from `eth0` to `eth1`, and a way out through `eth0`.
const ETHERNET: &str = "ip link add eth0 type veth peer name eth1 && \
    ip addr add 10.9.0.2/24 dev eth0 && ip link set eth1 up && ip link set eth0 up && \
    ip route add default via 10.9.0.1 && ";
const MULTICAST_OVER_LO: &str = "ip route add 224.0.0.0/4 dev lo && ";

/// The words that run a test of this program that is ignored otherwise.
fn inner(test: &str) -> String {
    let program = std::env::current_exe().unwrap();
    format!("{} --quiet --ignored --exact {test}", program.display())
}

/// Runs words of a shell in a namespace of their own, in which `lo` is up.
fn in_namespace(words: &str) {
    let can = |options: &[&str]| {
        let mut unshare = Command::new("unshare");
        let made = unshare.args(options).args(["ip", "link", "set", "lo", "up"]).output();
        made.is_ok_and(|output| output.status.success())
    };
    let Some(options) = [&["-n"][..], &["-rn"]].into_iter().find(|options| can(options)) else {
        eprintln!("not run: this user may make no network namespace");
        return;
    };
    let words = format!("ip link set lo up && {words}");
    let mut shell = Command::new("unshare");
    let output = shell.args(options).args(["sh", "-c", &words]).output().unwrap();
    let said = [output.stdout, output.stderr].concat();
    let said = String::from_utf8_lossy(&said);
    assert!(output.status.success() && said.contains("1 passed"), "{words}\n{said}");
}

#[test]
fn it_works_where_lo_is_the_only_interface() {
    in_namespace(&format!("{MULTICAST_OVER_LO} {}", inner("messages_are_received")));
}

#[test]
fn it_works_where_multicast_leaves_through_the_default_route() {
    in_namespace(&format!("{ETHERNET} {}", inner("messages_are_received")));
}

#[test]
fn it_works_where_multicast_is_routed_over_lo_beside_another_interface() {
    in_namespace(&format!("{ETHERNET} {MULTICAST_OVER_LO} {}", inner("messages_are_received")));
}

#[test]
fn a_host_without_a_route_for_multicast_is_told_what_to_do() {
    in_namespace(&inner("joining_is_refused"));
}

#[test]
fn another_host_is_not_heard_where_nothing_leaves_this_one() {
    // The other host has the other end of the cable.
    let words = format!(
        "{{ unshare -n sleep 30 & }} && other=$! && sleep 0.5 && \
         ip link add eth0 type veth peer name eth1 netns $other && \
         ip addr add 10.9.0.1/24 dev eth0 && ip link set eth0 up && \
         ip route add 224.0.0.0/4 dev eth0 && \
         nsenter -n -t $other ip addr add 10.9.0.2/24 dev eth1 && \
         nsenter -n -t $other ip link set eth1 up && \
         nsenter -n -t $other ip route add 224.0.0.0/4 dev eth1 && \
         {{ nsenter -n -t $other {} & }} && {}; status=$?; kill $other; exit $status",
        inner("the_other_host_commands"),
        inner("the_other_host_is_counted"),
    );
    in_namespace(&words);
}

#[test]
#[ignore = "runs in a namespace"]
fn messages_are_received() {
    let mut listener = listener(URL);
    let sender = Lcm::new(URL).unwrap();
    sender.self_test(TIMEOUT).unwrap();
    sender.publish_bytes("C", &image(300_000)).unwrap();
    assert!(next(&mut listener, "C", TIMEOUT).is_some_and(|bytes| bytes == image(300_000)));
    let network = linkage_lcm::udpm::Network::parse(URL).unwrap();
    network.self_test(&network.sender().unwrap(), TIMEOUT).unwrap();
}

#[test]
#[ignore = "runs in a namespace"]
fn joining_is_refused() {
    let error = Lcm::new(URL).err().unwrap().to_string();
    assert!(error.contains("ip route add 224.0.0.0/4 dev lo"), "{error}");
}

#[test]
#[ignore = "runs in a namespace"]
fn the_other_host_commands() {
    let lcm = Lcm::new(&URL.replace("ttl=0", "ttl=1")).unwrap();
    for _ in 0..100 {
        lcm.publish_bytes("LINKAGE_COMMAND", b"open").unwrap();
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
#[ignore = "runs in a namespace"]
fn the_other_host_is_counted() {
    let mut this_host_only = listener(URL);
    let mut everybody = listener(&URL.replace("ttl=0", "ttl=1"));
    assert!(next(&mut everybody, "LINKAGE_COMMAND", TIMEOUT).is_some());
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(this_host_only.receive(Duration::ZERO).unwrap(), None);
    assert!(this_host_only.reception().foreign > 0);
    Lcm::new(URL).unwrap().publish_bytes("LINKAGE_COMMAND", b"ours").unwrap();
    let received = next(&mut this_host_only, "LINKAGE_COMMAND", TIMEOUT);
    assert_eq!(received.as_deref(), Some(&b"ours"[..]));
}
