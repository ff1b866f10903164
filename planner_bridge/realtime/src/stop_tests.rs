//! A stop as a motion: it holds the limits, and may be braked itself.

use crate::brake::stop;
use crate::brake::tests::moving;
use crate::motion::JointMotion;
use crate::segment::Bounds;
use proptest::prelude::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn a_stop_holds_the_limits_and_ends_at_rest((limits, from) in moving()) {
        let needed = from.acceleration.abs().powi(2) / (2.0 * limits.jerk);
        prop_assume!(needed <= limits.velocity);
        let stop = stop(from, &limits);
        let bounds = Bounds { limits, range: [-1e3, 1e3] };
        let motion =
            JointMotion::new("j", &stop.segments, stop.duration, stop.position, bounds);
        prop_assert!(motion.is_ok(), "{:?}: {stop:?}", motion);
        prop_assert_eq!(motion.unwrap().at(0.0), from);
    }

    #[test]
    fn a_stop_that_is_braked_again_comes_to_rest_at_the_same_place(
        (limits, from) in moving(), share in 0.0..1.0_f64,
    ) {
        let needed = from.acceleration.abs().powi(2) / (2.0 * limits.jerk);
        prop_assume!(needed <= limits.velocity);
        let first = stop(from, &limits);
        let bounds = Bounds { limits, range: [-1e3, 1e3] };
        let motion =
            JointMotion::new("j", &first.segments, first.duration, first.position, bounds);
        let again = motion.unwrap().brake(share * first.duration);
        prop_assert!((again.target() - first.position).abs() < 1e-9);
    }
}
