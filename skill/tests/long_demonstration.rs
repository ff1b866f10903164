//! A demonstration may last for any time: memory is bounded by a number of frames, frames in which
//! nothing moves are forgotten, and what moved is still learned.

use linkage_skill::object::JointKind;
use linkage_skill::{Learner, SkillConfig};
use std::sync::Arc;

#[path = "support/panel.rs"]
#[allow(dead_code)]
mod panel;

use panel::{camera, frame};

#[test]
fn a_demonstration_far_longer_than_memory_is_kept_for_is_learned() {
    const ROOM: usize = 120;
    let mut config = SkillConfig::load("default", None).unwrap();
    config.track.max_frames = ROOM;
    let mut learner = Learner::new(&config);
    let camera = Arc::new(camera());
    // Still for long, 60 frames of motion, still for longer: seven times as many as there is room for.
    let configuration = |i: usize| (i.clamp(300, 360) - 300) as f64 * 0.005;
    for i in 0..840 {
        learner.push(&frame(i, configuration(i), &camera)).unwrap();
        assert!(learner.tracker().frames() <= ROOM);
        let seen = learner.tracker().seen();
        assert!(seen.tracks.iter().all(|t| t.observations.len() <= ROOM));
    }
    let learned = learner.finish("panel").unwrap();
    let joint = &learned.model.joints[0];
    assert_eq!(learned.model.joints.len(), 1);
    assert_eq!(joint.kind, JointKind::Prismatic);
    assert!(joint.axis[0].abs() > 0.99, "{:?}", joint.axis);
    assert!((joint.range[1] - 0.3).abs() < 0.02, "{:?}", joint.range);
    let times = &learned.frame_utimes;
    assert!((times[0], *times.last().unwrap()) == (0, 839 * 33_333));
}
