//! Following of a recognised object from frame to frame.
//!
//! In: a recognition, then successive frames.
//! Out: for each frame, the pose of the object and the configurations that are determined (camera frame, metres and
//! radians).
//!
//! A reported configuration stays reported while surface stands on both sides of its joint and its standard
//! deviation stays small. The colour of the part need not correlate in each frame, since that of a door seen at an
//! angle hardly does. If neither depth nor lightness determines a joint, its deviation grows with time;
//! [`Follower::is_unsure`] then reports that recognition should be requested again, and [`Follower::consider`] takes
//! the answer. A configuration that was not reported before is tested for ambiguity. An occluded base is where it
//! was while the camera stands still ([`EdgeView`]). A part that is not where it was predicted, e.g. because it was
//! edge-on and now shows its other side, is searched along its joint.

mod align;
mod answer;
mod lightness;

pub use answer::Asked;

use super::ambiguity::withdraw_ambiguous;
use super::config::RecogniseConfig;
use super::evidence::{Detection, evident_joints, told_within};
use super::kinematics::{Articulated, State};
use super::known_object::KnownObject;
use super::refine::Refiner;
use super::render_cloud::{Cloud, edge_on};
use super::result::{Recognised, report};
use super::scene::Scene;
use super::stillness::EdgeView;
use super::verdict::{PartVerdict, Verdict};
use super::verify::verify;
use crate::object::joint_geometry::JointKind;
use crate::vision_error::VisionError;
use align::Aligner;
use answer::{Answer, state_of, told_by};
use linkage_frames::RgbdFrame;
use std::sync::Arc;

/// The object in one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Followed {
    /// Pose, joints, and a score by surface alone; occluded joints have no configuration.
    pub recognised: Recognised,
    /// False if the frame does not show the object, so that its last state is held.
    pub seen: bool,
}

/// Why following stopped.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Lost {
    /// The object was not seen for too many frames.
    #[error("{object} has not been seen for {frames} frames; recognise it again")]
    Unseen {
        /// Name of the object.
        object: String,
        /// Number of consecutive frames that do not show the object.
        frames: usize,
    },
    /// The vision library failed.
    #[error("vision: {0}")]
    Vision(#[from] VisionError),
}

/// Follower of one object.
pub struct Follower {
    object: Arc<KnownObject>,
    articulated: Articulated,
    /// Pose and configurations in the last frame that showed the object.
    state: State,
    /// Change of each configuration in the last frame, rad or m.
    step: Vec<f64>,
    /// Number of consecutive frames that do not show the object.
    unseen: usize,
    /// True if the last frame showed the base.
    base_seen: bool,
    /// Edges of the last image in which the base stood where it should; of the first image before that.
    base_view: Option<EdgeView>,
    /// Standard deviation of each configuration in the last frame that showed the base, rad or m.
    base_deviations: Vec<Option<f64>>,
    /// For each joint, true if its configuration was reported in the last frame.
    told: Vec<bool>,
    /// For each joint, true if its configuration was reported in any frame.
    ever_told: Vec<bool>,
    /// Standard deviation of each configuration in the last frame, rad or m.
    deviations: Vec<Option<f64>>,
    /// Time stamp of the last frame, microseconds.
    last_utime: Option<i64>,
    /// Answer of recognition that no frame has used yet.
    answer: Option<Answer>,
}

/// A state that was aligned with a frame, its fit in surfels, and its verdict.
struct Aligned {
    fit: f64,
    state: State,
    verdict: Verdict,
}

impl Aligned {
    /// The aligned state, or `before` alignment if that fits much better.
    fn unless_spoiled(self, before: Self) -> Self {
        if self.fit < SPOILED * before.fit { before } else { self }
    }
}

/// Largest number of steps along a joint whose part is searched.
const MOST_ALONG: f64 = 60.0;
/// Largest number of alignment steps in a frame.
const STEPS: usize = 8;
/// Share of a state's fit below which alignment has spoiled it. The base under the lid of a shut laptop agrees in depth
/// with the lid above it: alignment drew the lid into the base, from frame to frame, until the laptop was lost. The limit
/// is not 1, because a slow motion changes the fit by less than its noise.
const SPOILED: f64 = 0.9;
/// Share of the last step of a configuration that is predicted again.
const PERSISTENCE: f64 = 0.8;
/// Smallest score of a frame that shows the object.
const MIN_SCORE: f64 = 0.2;
/// Assumed speed of a hinge for which the image gives no evidence, rad/s.
const UNSEEN_TURN_RATE: f64 = 0.05;
/// Assumed speed of a slide for which the image gives no evidence, m/s.
const UNSEEN_SLIDE_RATE: f64 = 0.015;
/// Largest time between two frames that is taken into account, seconds.
const LONGEST_GAP_S: f64 = 5.0;
/// Share of the largest reported deviation above which recognition is requested again.
const UNSURE_SHARE: f64 = 0.5;

impl Follower {
    /// Largest number of consecutive frames without the object; after more it is lost.
    pub const PATIENCE: usize = 15;

    /// Starts at a recognised state; `None` if its pose is invalid.
    #[must_use]
    pub fn new(object: Arc<KnownObject>, found: &Recognised) -> Option<Self> {
        let articulated = Articulated::new(&object.model);
        let state = state_of(found, &articulated)?;
        let step = vec![0.0; articulated.joints.len()];
        let told = told_by(found);
        Some(Self {
            step,
            unseen: 0,
            base_seen: false,
            base_view: None,
            base_deviations: found.joints.iter().map(|j| j.deviation).collect(),
            ever_told: told.clone(),
            deviations: found.joints.iter().map(|j| j.deviation).collect(),
            last_utime: None,
            answer: None,
            object,
            articulated,
            state,
            told,
        })
    }

    /// True if a configuration is not determined, or hardly: recognition should be requested again.
    pub fn is_unsure(&self) -> bool {
        (0..self.told.len()).any(|j| {
            let limit = UNSURE_SHARE * self.limit(j);
            !self.told[j] || self.deviations[j].is_none_or(|d| d > limit)
        })
    }

    /// Largest standard deviation of a configuration that is reported, rad or m.
    fn limit(&self, joint: usize) -> f64 {
        told_within(self.articulated.joints[joint].geometry.kind)
    }

    /// Current state, to be kept for [`Self::consider`] when recognition is requested for the newest frame.
    pub fn ask(&self) -> Asked {
        Asked(self.state.clone())
    }

    /// Takes what recognition found in the frame for which it was requested. The next frame decides between that and
    /// what was followed since.
    pub fn consider(&mut self, asked: &Asked, found: &Recognised) {
        let answer = Answer::new(&self.articulated, asked, &self.state, found);
        self.answer = answer.or(self.answer.take());
    }

    /// Follows the object into the next frame.
    ///
    /// # Errors
    /// [`Lost::Unseen`] after too many frames that do not show the object, [`Lost::Vision`] if the vision library
    /// fails.
    pub fn follow(&mut self, frame: &RgbdFrame) -> Result<Followed, Lost> {
        let scene = Scene::plain(frame)?;
        let answer = self.answer.take();
        let (state, verdict) = self.best_state(&scene, answer.as_ref());
        let score = verdict.score_of_followed();
        let seen = score >= MIN_SCORE;
        self.unseen = if seen { 0 } else { self.unseen + 1 };
        if self.unseen > Self::PATIENCE {
            let object = self.object.model.object.clone();
            return Err(Lost::Unseen { object, frames: self.unseen });
        }
        self.base_seen = verdict.parts[0].is_seen();
        if seen {
            self.step = state.q.iter().zip(&self.state.q).map(|(now, then)| now - then).collect();
            self.state = state;
        } else {
            self.step.fill(0.0);
        }
        tracing::debug!(score, seen, q = ?self.state.q, ?verdict, "followed");
        self.deviations = self.deviations(&scene, answer.as_ref());
        let base_stands = seen && verdict.parts[0].stands();
        if base_stands || self.base_view.is_none() {
            self.base_view = Some(EdgeView::of(&scene));
        }
        if self.base_seen {
            self.base_deviations.clone_from(&self.deviations);
        }
        self.last_utime = Some(frame.utime);
        let found = self.evidence(&scene, verdict, seen, answer.as_ref());
        self.told.clone_from(&found.evident);
        self.ever_told.iter_mut().zip(&self.told).for_each(|(ever, told)| *ever |= told);
        Ok(Followed { recognised: report(&self.object, &self.articulated, &found), seen })
    }

    /// State with the best fit from several starts: the motion continues, the motion has stopped, or the answer of
    /// recognition. A joint without surface on both sides is searched along its range.
    fn best_state(&self, scene: &Scene, answer: Option<&Answer>) -> (State, Verdict) {
        let starts = [self.expected(), self.state.clone()];
        let starts = starts.into_iter().chain(answer.map(|c| c.state.clone()));
        let mut best = starts
            .map(|start| self.aligned(scene, start))
            .max_by(|a, b| a.fit.total_cmp(&b.fit))
            .expect("two states are tried");
        for joint in 0..self.articulated.joints.len() {
            let stands: Vec<bool> = best.verdict.parts.iter().map(PartVerdict::stands).collect();
            if evident_joints(&self.articulated, &stands)[joint] {
                continue;
            }
            let elsewhere = self.aligned(scene, self.best_along(scene, &best.state, joint));
            if elsewhere.fit > best.fit {
                best = elsewhere;
            }
        }
        (best.state, best.verdict)
    }

    /// Aligns a state with the frame. A state that alignment spoiled is left as it was.
    fn aligned(&self, scene: &Scene, start: State) -> Aligned {
        let with_fit = |state: State| {
            let (fit, verdict) = self.judged(scene, &self.object.cloud, &state);
            Aligned { fit, state, verdict }
        };
        let moved = with_fit(self.aligner(scene).align(start.clone(), STEPS));
        moved.unless_spoiled(with_fit(start))
    }

    /// State with the configuration of one joint that explains most of the image.
    fn best_along(&self, scene: &Scene, state: &State, joint: usize) -> State {
        let j = &self.articulated.joints[joint];
        let steps = ((j.high - j.low) / self.limit(joint)).ceil().clamp(1.0, MOST_ALONG);
        let at = |i: usize| {
            let mut q = state.q.clone();
            q[joint] = j.low + (j.high - j.low) * i as f64 / steps;
            State { q, ..state.clone() }
        };
        (0..=steps as usize)
            .map(at)
            .map(|state| (self.judged(scene, &self.object.coarse, &state).0, state))
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .map_or_else(|| state.clone(), |(_, state)| state)
    }

    /// Fit of a state in surfels, and its verdict.
    fn judged(&self, scene: &Scene, cloud: &Cloud, state: &State) -> (f64, Verdict) {
        let verdict = verify(scene, &self.articulated, cloud, state);
        (verdict.fit() - self.articulated.range_penalty(state), verdict)
    }

    /// Detection in this frame: the parts that are placed, and the configurations that are determined.
    fn evidence(
        &self,
        scene: &Scene,
        verdict: Verdict,
        seen: bool,
        answer: Option<&Answer>,
    ) -> Detection {
        // Of a part that is edge-on only the rim is seen.
        let edge_on = edge_on(&self.object.cloud, &self.articulated.poses(&self.state));
        let stands = |(part, edge_on): (&PartVerdict, &bool)| {
            seen && (part.stands() || *edge_on && !part.is_missing())
        };
        let mut stands: Vec<bool> = verdict.parts.iter().zip(&edge_on).map(stands).collect();
        // An occluded base is where it was while the camera stands still.
        stands[0] |= seen && self.base_view.as_ref().is_some_and(|view| view.is_still(scene));
        let looks_right: Vec<bool> = verdict.parts.iter().map(|p| seen && p.is_seen()).collect();
        let standing = evident_joints(&self.articulated, &stands);
        let evident = evident_joints(&self.articulated, &looks_right);
        let joints = 0..self.articulated.joints.len();
        let is_held =
            |j: usize| standing[j] && self.deviations[j].is_some_and(|d| d <= self.limit(j));
        // A reported configuration stays reported; one that recognition reports is accepted if it is held too.
        let is_confirmed = |j: usize| {
            answer.is_some_and(|c| c.confirms(j, self.state.q[j], self.limit(j)).is_some())
        };
        let is_kept = |j: usize| is_held(j) && (self.told[j] || is_confirmed(j));
        let kept: Vec<bool> = joints.clone().map(is_kept).collect();
        let is_hoped = |j: usize| is_held(j) && (evident[j] || self.ever_told[j]);
        let hoped: Vec<bool> = joints.map(|j| kept[j] || is_hoped(j)).collect();
        let mut found = Detection {
            state: self.state.clone(),
            score: verdict.score_of_followed(),
            inliers: 0,
            verdict,
            placed: stands,
            evident: hoped,
            deviations: self.deviations.clone(),
        };
        self.withdraw_ambiguous(scene, &mut found, &kept);
        found
    }

    /// Withdraws ambiguous configurations, except those that are kept from before.
    fn withdraw_ambiguous(&self, scene: &Scene, found: &mut Detection, kept: &[bool]) {
        let KnownObject { cloud, coarse, .. } = &*self.object;
        let refiner = Refiner {
            scene,
            articulated: &self.articulated,
            cloud,
            coarse,
            matches: &[],
            shape: None,
            min_inliers: 0,
            room: &[],
            config: &RecogniseConfig::default(),
        };
        let hoped = found.evident.clone();
        let doubtful = (0..kept.len()).filter(|&j| hoped[j] && !kept[j]);
        withdraw_ambiguous(&refiner, found, doubtful);
        let unambiguous = std::mem::take(&mut found.evident);
        found.evident = (0..kept.len()).map(|j| kept[j] || hoped[j] && unambiguous[j]).collect();
    }

    /// Standard deviation of each configuration, rad or m: the smallest of that measured in this frame, that of the
    /// last frame plus possible motion since, and that of the answer. Possible motion includes the last step, since
    /// the motion may have stopped or continued.
    fn deviations(&self, scene: &Scene, answer: Option<&Answer>) -> Vec<Option<f64>> {
        let measured = self.aligner(scene).deviations(&self.state, &self.base_deviations);
        let gap_us = self.last_utime.map_or(0, |last| scene.frame.utime.saturating_sub(last));
        let gap_s = (gap_us as f64 * 1e-6).clamp(0.0, LONGEST_GAP_S);
        let of_joint = |j: usize| {
            let rate = match self.articulated.joints[j].geometry.kind {
                JointKind::Prismatic => UNSEEN_SLIDE_RATE,
                _ => UNSEEN_TURN_RATE,
            };
            let moved = (rate * gap_s).max(self.step[j].abs());
            let carried = self.deviations[j].filter(|_| self.told[j]).map(|d| d.hypot(moved));
            let confirmed = answer.and_then(|c| c.confirms(j, self.state.q[j], self.limit(j)));
            [measured[j], carried, confirmed].into_iter().flatten().min_by(f64::total_cmp)
        };
        (0..self.articulated.joints.len()).map(of_joint).collect()
    }

    fn aligner<'a>(&'a self, scene: &'a Scene) -> Aligner<'a> {
        let Self { articulated, object, base_seen, .. } = self;
        Aligner { scene, articulated, object, base_seen: *base_seen }
    }

    /// State if the joints continue their last motion.
    fn expected(&self) -> State {
        let q = self
            .articulated
            .joints
            .iter()
            .zip(self.state.q.iter().zip(&self.step))
            .map(|(j, (q, step))| (q + PERSISTENCE * step).clamp(j.low, j.high))
            .collect();
        State { camera_from_object: self.state.camera_from_object, q }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::Pose;
    use crate::object::joint_geometry::JointGeometry;
    use crate::object::model::{Joint, MODEL_SCHEMA, ObjectModel, Part, ReferenceFrame};
    use crate::recognise::matching::FeatureTable;
    use crate::recognise::render_cloud::CloudPoint;
    use crate::recognise::test_data::{BOARD_M, PLATE_M, on_board, on_plate, slider_surface};
    use crate::test_data::seen;
    use linkage_frames::ColorImage;
    use nalgebra::{Point3, Vector3};

    /// Grey of horizontal stripes, 0 to 1.
    fn stripes(y: f64) -> f64 {
        0.5 + 0.3 * (45.0 * y).sin()
    }

    /// A board that slides to and fro before a plate.
    fn slider() -> Arc<KnownObject> {
        let line = JointGeometry::slide(Vector3::x_axis(), Point3::origin());
        let model = ObjectModel {
            schema: MODEL_SCHEMA.to_owned(),
            object: "slider".to_owned(),
            reference_frame: ReferenceFrame::at_camera(0.0),
            parts: vec![Part::new(0, "base", 1), Part::new(1, "board", 1)],
            joints: vec![Joint { range: [-0.1, 0.1], ..Joint::of(&line) }],
            demonstrations: 1,
            profile: "default".to_owned(),
            version: String::new(),
        };
        let cloud = slider_surface(|y| 100.0 * stripes(y) as f32);
        let table = FeatureTable::new(&[]);
        Arc::new(KnownObject::of(model, table, cloud, Vec::new()))
    }

    /// The board, with stripes behind it that go on or end where the plate does.
    fn picture(stripes_end: bool) -> RgbdFrame {
        let depth = |x: f64, y: f64| match (on_board(x, y), !stripes_end || on_plate(x, y)) {
            (true, _) => BOARD_M,
            (false, true) => PLATE_M,
            (false, false) => 2.5,
        };
        striped(depth)
    }

    /// Frame with this depth, and stripes on all surface.
    fn striped(depth: impl Fn(f64, f64) -> f64) -> RgbdFrame {
        let frame = seen(0, &depth);
        let camera = &frame.camera;
        let grey = |i: usize| {
            let x = ((i % camera.width) as f64 - camera.cx) / camera.fx;
            let y = ((i / camera.width) as f64 - camera.cy) / camera.fy;
            (255.0 * stripes(y * depth(x, y))) as u8
        };
        let (width, height) = (camera.width, camera.height);
        let color = (0..width * height).flat_map(|i| [grey(i); 3]).collect();
        let color = ColorImage::new(width, height, color).unwrap();
        RgbdFrame { color, ..frame }
    }

    /// Configuration that the follower reports; `configuration`: reported or not when it starts.
    fn told(configuration: Option<f64>, stripes_end: bool) -> Option<f64> {
        let object = slider();
        let articulated = Articulated::new(&object.model);
        let found = Detection {
            state: State { camera_from_object: Pose::identity(), q: vec![0.0] },
            score: 1.0,
            inliers: 0,
            verdict: Verdict::default(),
            placed: vec![true; 2],
            evident: vec![configuration.is_some()],
            deviations: vec![Some(0.001)],
        };
        let found = report(&object, &articulated, &found);
        let mut follower = Follower::new(object, &found).unwrap();
        let followed = follower.follow(&picture(stripes_end)).unwrap();
        assert!(followed.seen);
        followed.recognised.joints[0].configuration
    }

    #[test]
    fn a_configuration_that_was_not_told_is_told_once_it_is_not_ambiguous() {
        assert_eq!(told(None, false), None);
        assert!(told(None, true).is_some_and(|q| q.abs() < 0.01));
    }

    #[test]
    fn a_configuration_that_was_told_is_told_on() {
        assert!(told(Some(0.0), false).is_some());
    }

    /// Distance of a gate's hinge from the camera, metres.
    const HINGE_M: f64 = 1.2;

    /// A gate that turns about an upright hinge, above a plate that faces the camera: at 0 one
    /// side of it faces the camera, at half a turn the other.
    fn gate() -> Arc<KnownObject> {
        let hinge = JointGeometry::hinge(-Vector3::y_axis(), Point3::new(0.0, 0.0, HINGE_M));
        let model = ObjectModel {
            schema: MODEL_SCHEMA.to_owned(),
            object: "gate".to_owned(),
            reference_frame: ReferenceFrame::at_camera(0.0),
            parts: vec![Part::new(0, "base", 1), Part::new(1, "gate", 1)],
            joints: vec![Joint { range: [0.3, 2.8], ..Joint::of(&hinge) }],
            demonstrations: 1,
            profile: "default".to_owned(),
            version: String::new(),
        };
        let surfel = |part, x: i32, y: i32, z, normal| {
            let point = Point3::new(0.015 * f64::from(x), 0.015 * f64::from(y), z);
            let lightness = 100.0 * stripes(point.y) as f32;
            CloudPoint { part, point, normal, lab: [lightness, 0.0, 0.0] }
        };
        let back = -Vector3::z();
        let base = (-20..=20).flat_map(|x| (14..=26).map(move |y| (x, y)));
        let base = base.map(|(x, y)| surfel(0, x, y, HINGE_M, back));
        let sides = [(HINGE_M, back), (HINGE_M, -back)];
        let leaf = (1..=26).flat_map(|x| (-10..=10).map(move |y| (x, y)));
        let leaf = leaf.flat_map(|(x, y)| sides.map(|(z, normal)| surfel(1, x, y, z, normal)));
        let cloud = Cloud::of(base.chain(leaf).collect());
        let table = FeatureTable::new(&[]);
        Arc::new(KnownObject::of(model, table, cloud, Vec::new()))
    }

    /// The gate turned so far before a wall.
    fn gate_at(q: f64) -> RgbdFrame {
        striped(|x, y| {
            // Where the ray meets the gate's plane, and how far that is from the hinge.
            let z = HINGE_M * q.cos() / (q.cos() - x * q.sin());
            let along = z * x * q.cos() + (z - HINGE_M) * q.sin();
            if z > 0.0 && (0.0..0.4).contains(&along) && (z * y).abs() < 0.16 {
                return z;
            }
            let on_base = (HINGE_M * x).abs() < 0.31 && (0.2..0.4).contains(&(HINGE_M * y));
            if on_base { HINGE_M } else { 3.0 }
        })
    }

    #[test]
    fn a_part_that_shows_its_other_side_is_found_along_its_joint() {
        let object = gate();
        let articulated = Articulated::new(&object.model);
        let found = Detection {
            state: State { camera_from_object: Pose::identity(), q: vec![1.0] },
            score: 1.0,
            inliers: 0,
            verdict: Verdict::default(),
            placed: vec![true; 2],
            evident: vec![true],
            deviations: vec![Some(0.01)],
        };
        let found = report(&object, &articulated, &found);
        let mut follower = Follower::new(object, &found).unwrap();
        // In the third frame the gate is edge-on, after a motion too fast to be followed.
        for (q, is_told) in [(1.0, true), (2.2, true), (1.55, false), (0.7, true)] {
            let followed = follower.follow(&gate_at(q)).unwrap();
            let told = followed.recognised.joints[0].configuration;
            assert_eq!(told.is_some(), is_told, "{q}: {told:?}");
            assert!(told.is_none_or(|told| (told - q).abs() < 0.03), "{q}: {told:?}");
        }
    }

    #[test]
    fn a_state_that_alignment_spoiled_is_left_as_it_was() {
        let with = |fit, q| {
            let state = State { camera_from_object: Pose::identity(), q: vec![q] };
            Aligned { fit, state, verdict: Verdict::default() }
        };
        let chosen = |fit| with(fit, 0.1).unless_spoiled(with(800.0, 0.0)).state.q[0];
        assert_eq!([700.0, 780.0, 900.0].map(chosen), [0.0, 0.1, 0.1]);
    }
}
