//! Recognition, asked again on a thread of its own while an object is followed: following keeps
//! its pace, and takes the answer when it is there.

use linkage_driver::RgbdFrame;
use linkage_skill::SkillConfig;
use linkage_skill::recognise::{Asked, Follower, KnownObject, Recognised, Scene, recognise};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::{Duration, Instant};

/// Time between two inquiries while following is unsure of a joint.
const UNSURE_EVERY: Duration = Duration::from_millis(300);
/// Time between two inquiries while it is sure: what it follows may have drifted.
const SURE_EVERY: Duration = Duration::from_secs(10);

/// Asks recognition about what is followed, one frame at a time.
#[derive(Default)]
pub struct Reacquisition {
    inquiry: Option<Inquiry>,
    asked_at: Option<Instant>,
}

/// A frame that recognition looks at.
struct Inquiry {
    asked: Asked,
    answer: Receiver<Option<Recognised>>,
}

impl Reacquisition {
    /// For an object that recognition has just found.
    pub fn begun_now() -> Self {
        Self { inquiry: None, asked_at: Some(Instant::now()) }
    }

    /// Hands the answer to the follower, if it is there: before it takes the next frame.
    pub fn answer(&mut self, follower: &mut Follower) {
        let Some(inquiry) = self.inquiry.take() else { return };
        match inquiry.answer.try_recv() {
            Ok(Some(found)) => follower.consider(&inquiry.asked, &found),
            Ok(None) | Err(TryRecvError::Disconnected) => {}
            Err(TryRecvError::Empty) => self.inquiry = Some(inquiry),
        }
    }

    /// Asks about a frame that was just followed, where another answer is needed; `near` is where
    /// the object is in it.
    ///
    /// # Errors
    /// The error of the operating system when a thread cannot be started.
    pub fn ask(
        &mut self,
        follower: &Follower,
        object: &Arc<KnownObject>,
        near: &Recognised,
        frame: &RgbdFrame,
        skill: &SkillConfig,
    ) -> std::io::Result<()> {
        let every = if follower.is_unsure() { UNSURE_EVERY } else { SURE_EVERY };
        if self.inquiry.is_some() || self.asked_at.is_some_and(|at| at.elapsed() < every) {
            return Ok(());
        }
        self.asked_at = Some(Instant::now());
        let (sender, answer) = channel();
        let (object, frame, near) = (Arc::clone(object), frame.clone(), near.camera_from_object);
        let skill = skill.clone();
        std::thread::Builder::new().name("recognise".to_owned()).spawn(move || {
            // Nobody waits any more when the object was lost meanwhile.
            let _ = sender.send(found_near(&object, &frame, &near, &skill));
        })?;
        self.inquiry = Some(Inquiry { asked: follower.ask(), answer });
        Ok(())
    }
}

/// What recognition finds of an object; of several of one make the one nearest to a pose.
fn found_near(
    object: &Arc<KnownObject>,
    frame: &RgbdFrame,
    near: &[f64; 7],
    skill: &SkillConfig,
) -> Option<Recognised> {
    let scene = Scene::new(frame).ok()?;
    let found = recognise(&scene, &[Arc::clone(object)], &skill.recognise, skill.seed);
    let distance = |m: &Recognised| -> f64 {
        m.camera_from_object.iter().zip(near).take(3).map(|(a, b)| (a - b).powi(2)).sum()
    };
    found.matches.into_iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))
}
