//! Profiles, rigs and tags.toml of any text: refused, or values that can be used.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_planner_bridge::Rig;
use linkage_skill::SkillConfig;
use std::io::Write;

#[path = "../../../tools/src/tags/places.rs"]
#[allow(dead_code)] // what reads a file; here there is but text
mod places;

fuzz_target!(|text: &str| {
    let mut file = tempfile::NamedTempFile::new().expect("a temporary file");
    file.write_all(text.as_bytes()).expect("room for it");
    let _ = SkillConfig::load("default", Some(file.path()));
    if let Ok(rig) = Rig::read(file.path()) {
        assert!(rig.revolute.velocity > 0.0 && rig.prismatic.jerk.is_finite());
    }
    if let Ok(places) = places::TagPlaces::parse(text) {
        assert!(places.tag.iter().all(|tag| tag.size_m > 0.0));
    }
});
