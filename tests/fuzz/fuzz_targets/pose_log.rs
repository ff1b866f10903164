//! A pose log of any bytes: refused, or poses in the order of time that a joint is fitted to.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_skill::articulation::fit_models;
use linkage_skill::internals::parse_pose_log;

/// Samples beyond which a fit takes too long for a fuzzer.
const MAX_SAMPLES: usize = 40;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(log) = parse_pose_log("fuzz", bytes, None) {
        assert!(log.samples.is_sorted_by(|a, b| a.t < b.t));
        assert!(log.samples.iter().all(|s| s.position.coords.iter().all(|x| x.is_finite())));
        let some = &log.samples[..log.samples.len().min(MAX_SAMPLES)];
        if let Ok(fits) = fit_models(some) {
            assert!(fits.iter().all(|f| f.configuration.len() == some.len()));
        }
    }
});
