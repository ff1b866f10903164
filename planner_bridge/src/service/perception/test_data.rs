//! The thread that perceives, for tests: nothing is known to it, and no frame comes.

use super::perceiver::{Inbox, Perception};
use super::state::{Pending, Tracking};
use crate::limits::Rig;
use crate::plan::test_data::fridge;
use crate::service::capture::{Arrived, Lost};
use crate::service::config::{Playback, ServiceConfig};
use crate::service::observer::Observer;
use crate::service::publisher::{Answer, Note, Outbox};
use crate::service::reacquire::Reacquisition;
use linkage_driver::live::{LatestReader, LatestWriter, latest};
use linkage_driver::{ColorImage, DepthImage, PinholeCamera, RgbdFrame};
use linkage_skill::SkillConfig;
use linkage_skill::object::Appearance;
use linkage_skill::predict::Target;
use linkage_skill::recognise::{Follower, KnownObject};
use linkage_skill::store::Library;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// What it does is noted here.
pub fn perception<'q>() -> (Perception<'q>, LatestReader<Note>) {
    let (perception, noted, _) = perception_with_frames();
    (perception, noted)
}

/// The same, with the queue that it takes frames from.
pub fn perception_with_frames<'q>() -> (Perception<'q>, LatestReader<Note>, LatestWriter<Arrived>) {
    let config = ServiceConfig {
        skill: SkillConfig::default(),
        rig: Rig::default(),
        store: PathBuf::from("no such store"),
        url: "memq://".to_owned(),
        stream_hz: None,
        playback: Playback::default(),
    };
    let (frame_writer, frames) = latest(8);
    let (_, commands) = crossbeam_channel::bounded(1);
    let ((packets, _), (notes, noted)) = (latest(8), latest(64));
    let inbox = Inbox { frames, lost: Lost::default(), commands };
    let out = Outbox { packets, notes, observer: Observer::default() };
    let perception = Perception::new(&config, Library::new(Vec::new()), inbox, out, None);
    (perception, noted, frame_writer)
}

/// A fridge that is followed, as it was seen a moment ago.
pub fn tracked() -> Tracking {
    let (model, recognised) = fridge();
    let object = Arc::new(KnownObject::new(model, &Appearance::default()));
    let follower = Follower::new(Arc::clone(&object), &recognised).expect("its pose is one");
    Tracking {
        object,
        follower,
        recognised,
        seen: true,
        utime: 1,
        arrived: Instant::now(),
        pending: None,
        reacquisition: Reacquisition::begun_now(),
    }
}

/// All notes so far.
pub fn notes(noted: &LatestReader<Note>) -> Vec<Note> {
    std::iter::from_fn(|| noted.pop(Duration::ZERO).ok()).collect()
}

/// The answers among the notes so far.
pub fn answers(noted: &LatestReader<Note>) -> Vec<Answer> {
    let answer = |note| if let Note::Answer(answer) = note { Some(answer) } else { None };
    notes(noted).into_iter().filter_map(answer).collect()
}

/// A prediction that command 7 asked for so many seconds ago.
pub fn asked_for(seconds_ago: u64) -> Pending {
    let since = Instant::now().checked_sub(Duration::from_secs(seconds_ago));
    let since = since.expect("the machine runs for longer");
    Pending { command: 7, joint: None, target: Target::Open, grasp: None, since, expires: None }
}

/// A grey wall 2 m away, which has just arrived.
pub fn frame(utime: i64) -> Arrived {
    let (width, height) = (160, 120);
    let camera = PinholeCamera { width, height, cx: 80.0, cy: 60.0, ..PinholeCamera::kinect() };
    let color = ColorImage::new(width, height, vec![9; width * height * 3]).expect("it fits");
    let depth = DepthImage::from_metres(width, height, vec![2.0; width * height]).expect("it fits");
    let frame = RgbdFrame::new(utime, Arc::new(camera), color, depth).expect("they fit");
    Arrived { frame, at: Instant::now() }
}
