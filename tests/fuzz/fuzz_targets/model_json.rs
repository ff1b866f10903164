//! Models in JSON: what is read is a model that kinematics can work with.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_skill::ObjectModel;

fuzz_target!(|data: &[u8]| {
    let Ok(model) = serde_json::from_slice::<ObjectModel>(data) else { return };
    let middle: Vec<f64> = model.joints.iter().map(|j| 0.5 * (j.range[0] + j.range[1])).collect();
    let motions = model.part_motions(&middle);
    assert!(motions.iter().all(|m| m.translation.vector.iter().all(|x| x.is_finite())));
});
