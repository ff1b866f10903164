//! The streaming loop, a minute of it, without the clock: nothing is allocated on its thread.

use linkage_planner_bridge::MotionLimits;
use linkage_planner_bridge::service::Streamer;
use linkage_planner_bridge::time_optimal;
use linkage_realtime::{Motion, OrderQueue};
use std::time::Duration;

#[test]
fn a_minute_of_setpoints_allocates_nothing() {
    let limits = MotionLimits { velocity: 0.02, acceleration: 0.5, jerk: 2.0 };
    let mut motion = Motion::new("drawer").unwrap();
    motion.push(time_optimal("joint1", 0.0, 1.19, &limits).unwrap()).unwrap();
    assert!((59.0..61.0).contains(&motion.duration()), "{} s", motion.duration());
    let mut queue = OrderQueue::new();
    let (mut orders, taken) = queue.split();
    let mut streamer = Streamer::new("udpm://239.255.76.67:7717?ttl=0", 200.0, taken).unwrap();
    orders.enqueue(Some(motion)).unwrap();
    let counted = allocation_counter::measure(|| {
        for tick in 0..13_000 {
            streamer.tick(tick * 5000, Duration::from_micros(7));
        }
    });
    assert_eq!(counted.count_total, 0);
    let report = streamer.report();
    assert!(report.sent + report.failed > 11_800, "{} were sent", report.sent);
}
