//! A recognised object followed from frame to frame: its surface is brought to agreement with
//! depth and with lightness, base pose and configurations together. Depth alone would not see a
//! sliding door slide; lightness tells where on its surface one is.
//!
//! What recognition told is kept while the picture agrees with it: a configuration stays told as
//! long as surface stands on both sides of its joint, and its standard deviation stays small. A
//! part need not look like itself in every frame for that, which a door that is seen at an angle
//! hardly ever does. Where neither depth nor lightness tells how far a joint has moved, its
//! deviation grows with time. [`Follower::is_unsure`] then says that recognition should be asked
//! again, and [`Follower::consider`] takes its answer. A configuration that was not told before is
//! asked for rivals, as in recognition. A base that the moving part hides is where it was as long
//! as the camera stands still ([`EdgeView`]).

use super::elimination::told_within;
use super::kinematics::{Articulated, State};
use super::normal_equations::{System, add_surface};
use super::scene::Scene;
use super::stillness::EdgeView;
use super::verify::{Cloud, Verdict, verify, visible};
use super::{
    Detection, KnownObject, RecogniseConfig, Recognised, Refiner, configuration_deviations,
    doubt_rivalled, evident_joints, report,
};
use crate::math::rigid::{Pose, pose_from_array};
use crate::object::joint_geometry::JointKind;
use linkage_driver::RgbdFrame;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Values of the following stage. All ours.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FollowConfig {
    /// Steps of the alignment a frame.
    pub steps: usize,
    /// Share of the last step of a configuration that is expected again.
    pub persistence: f64,
    /// Score below which a frame does not show the object.
    pub min_score: f64,
    /// Frames in a row without the object after which it is lost.
    pub patience: usize,
}

impl Default for FollowConfig {
    fn default() -> Self {
        Self { steps: 8, persistence: 0.8, min_score: 0.2, patience: 15 }
    }
}

/// Where the object is in a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Followed {
    /// Pose, joints, and a score by surface alone; joints that are hidden tell nothing.
    pub recognised: Recognised,
    /// False where the frame does not show the object and its last state is held.
    pub seen: bool,
}

/// Why following ends.
#[derive(Debug, thiserror::Error)]
pub enum Lost {
    /// The object has not been seen for too long.
    #[error("{object} has not been seen for {frames} frames; recognise it again")]
    Unseen {
        /// The object.
        object: String,
        /// For how long.
        frames: usize,
    },
    /// The vision library failed.
    #[error("vision: {0}")]
    Vision(#[from] opencv::Error),
}

/// Surfels below which nothing is aligned.
const LEAST_SURFACE: usize = 20;
/// Depth gates of the first and the last step, metres.
const GATES: [f64; 2] = [0.05, 0.012];
/// Pixels to either side between which lightness is differenced, in the first and last step.
const REACHES: [f64; 2] = [5.0, 1.5];
/// Deviation of lightness that light and noise explain, of 100.
const LIGHTNESS_SIGMA: f64 = 6.0;
/// All of the lightness weighs as much as so many independent surfels.
const LIGHTNESS_WORTH: f64 = 200.0;
/// Least evidence that fixes an unknown which nothing seen tells of.
const DAMPING: f64 = 30.0;

/// Where the base is not seen, what moves is taken for a joint's motion, not for the base's:
/// evidence that holds the pose, some tenths of a millimetre.
const HOLD: f64 = 1e7;

/// Follows one object.
pub struct Follower {
    object: Arc<KnownObject>,
    articulated: Articulated,
    state: State,
    /// Last step of each configuration.
    step: Vec<f64>,
    unseen: usize,
    base_seen: bool,
    /// The picture in which the base was seen last, and what that told of each configuration.
    base_view: Option<EdgeView>,
    base_deviations: Vec<Option<f64>>,
    /// Joints whose configuration was told in the last frame.
    told: Vec<bool>,
    /// Joints whose configuration was told at any time.
    ever_told: Vec<bool>,
    /// Standard deviation of each configuration in the last frame, rad or m.
    deviations: Vec<Option<f64>>,
    /// Time stamp of the last frame.
    last_utime: Option<i64>,
    /// What recognition found meanwhile.
    considered: Option<Considered>,
    config: FollowConfig,
}

/// Where the object was when recognition was asked again.
#[derive(Debug, Clone)]
pub struct Asked(State);

/// A state that recognition found, brought to the present.
struct Considered {
    state: State,
    told: Vec<bool>,
    deviations: Vec<Option<f64>>,
}

impl Considered {
    /// What it tells of a joint that now is at `q`: its deviation, if it was told there.
    fn confirms(&self, joint: usize, q: f64, limit: f64) -> Option<f64> {
        let told = self.told[joint] && (self.state.q[joint] - q).abs() <= limit;
        told.then_some(self.deviations[joint]?)
    }
}

/// How fast a joint of which nothing in the picture tells may be moving meanwhile: rad/s.
const UNSEEN_TURN_RATE: f64 = 0.05;
/// The same for slides, m/s.
const UNSEEN_SLIDE_RATE: f64 = 0.015;
/// Longest time between two frames that counts, seconds.
const LONGEST_GAP_S: f64 = 5.0;
/// Share of the deviation up to which a configuration is told at which recognition is asked again.
const UNSURE_SHARE: f64 = 0.5;

impl Follower {
    /// Starts where an object was recognised; `None` if its pose is none.
    pub fn new(object: Arc<KnownObject>, found: &Recognised, config: FollowConfig) -> Option<Self> {
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
            considered: None,
            object,
            articulated,
            state,
            told,
            config,
        })
    }

    /// The configuration of a joint is not told, or hardly: recognition may know more.
    pub fn is_unsure(&self) -> bool {
        (0..self.told.len()).any(|j| {
            let limit = UNSURE_SHARE * self.limit(j);
            !self.told[j] || self.deviations[j].is_none_or(|d| d > limit)
        })
    }

    /// Deviation up to which a configuration is told, rad or m.
    fn limit(&self, joint: usize) -> f64 {
        told_within(self.articulated.joints[joint].geometry.kind)
    }

    /// Remembers the present state for [`Self::consider`], when recognition is asked about the
    /// newest frame.
    pub fn ask(&self) -> Asked {
        Asked(self.state.clone())
    }

    /// Takes what recognition found in the frame that it was asked about. The next frame judges
    /// between that and what was followed since.
    pub fn consider(&mut self, Asked(then): &Asked, found: &Recognised) {
        let Some(seen) = state_of(found, &self.articulated) else { return };
        let since = self.state.camera_from_object * then.camera_from_object.inverse();
        let moved = self.state.q.iter().zip(&then.q).map(|(now, then)| now - then);
        let q = seen
            .q
            .iter()
            .zip(moved)
            .zip(&self.articulated.joints)
            .map(|((q, moved), j)| (q + moved).clamp(j.low, j.high))
            .collect();
        let state = State { camera_from_object: since * seen.camera_from_object, q };
        let deviations = found.joints.iter().map(|j| j.deviation).collect();
        self.considered = Some(Considered { state, told: told_by(found), deviations });
    }

    /// Takes the next frame.
    ///
    /// # Errors
    /// [`Lost::Unseen`] after too many frames that do not show the object.
    pub fn follow(&mut self, frame: &RgbdFrame) -> Result<Followed, Lost> {
        let scene = Scene::plain(frame)?;
        let considered = self.considered.take();
        let (state, verdict) = self.best_state(&scene, considered.as_ref());
        let score = surface_score(&verdict);
        let seen = score >= self.config.min_score;
        self.unseen = if seen { 0 } else { self.unseen + 1 };
        if self.unseen > self.config.patience {
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
        self.deviations = self.deviations(&scene, considered.as_ref());
        let base_stands = seen && verdict.parts[0].stands();
        if base_stands || self.base_view.is_none() {
            self.base_view = Some(EdgeView::of(&scene));
        }
        if self.base_seen {
            self.base_deviations.clone_from(&self.deviations);
        }
        self.last_utime = Some(frame.utime);
        let found = self.evidence(&scene, verdict, seen, considered.as_ref());
        self.told.clone_from(&found.evident);
        self.ever_told.iter_mut().zip(&self.told).for_each(|(ever, told)| *ever |= told);
        Ok(Followed { recognised: report(&self.object, &self.articulated, &found), seen })
    }

    /// The state that fits the picture best. A hand may have let go: motion that goes on is a
    /// guess, standing still another one, and what recognition found a third one.
    fn best_state(&self, scene: &Scene, considered: Option<&Considered>) -> (State, Verdict) {
        let starts = [self.expected(), self.state.clone()];
        starts
            .into_iter()
            .chain(considered.map(|c| c.state.clone()))
            .map(|start| {
                let state = self.align(scene, start);
                let verdict = verify(scene, &self.articulated, &self.object.cloud, &state);
                let fit = verdict.fit() - self.articulated.range_penalty(&state);
                (fit, state, verdict)
            })
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, state, verdict)| (state, verdict))
            .expect("two states are tried")
    }

    /// What the picture says of each joint.
    fn evidence(
        &self,
        scene: &Scene,
        verdict: Verdict,
        seen: bool,
        considered: Option<&Considered>,
    ) -> Detection {
        let mut stands: Vec<bool> = verdict.parts.iter().map(|p| seen && p.stands()).collect();
        // A base that is hidden stays where it was while the camera does.
        stands[0] |= seen && self.base_view.as_ref().is_some_and(|view| view.is_still(scene));
        let looks_right: Vec<bool> = verdict.parts.iter().map(|p| seen && p.is_seen()).collect();
        let standing = evident_joints(&self.articulated, &stands);
        let evident = evident_joints(&self.articulated, &looks_right);
        let joints = 0..self.articulated.joints.len();
        let is_held =
            |j: usize| standing[j] && self.deviations[j].is_some_and(|d| d <= self.limit(j));
        // What was told is told on; what recognition tells is believed where it is held too.
        let is_confirmed = |j: usize| {
            considered.is_some_and(|c| c.confirms(j, self.state.q[j], self.limit(j)).is_some())
        };
        let is_kept = |j: usize| is_held(j) && (self.told[j] || is_confirmed(j));
        let kept: Vec<bool> = joints.clone().map(is_kept).collect();
        let is_hoped = |j: usize| is_held(j) && (evident[j] || self.ever_told[j]);
        let hoped: Vec<bool> = joints.map(|j| kept[j] || is_hoped(j)).collect();
        let mut found = Detection {
            state: self.state.clone(),
            score: surface_score(&verdict),
            inliers: 0,
            verdict,
            placed: stands,
            evident: hoped,
            deviations: self.deviations.clone(),
        };
        self.doubt(scene, &mut found, &kept);
        found
    }

    /// Joints that are not kept from before are told only where they have no rival.
    fn doubt(&self, scene: &Scene, found: &mut Detection, kept: &[bool]) {
        let KnownObject { cloud, coarse, .. } = &*self.object;
        let refiner = Refiner {
            scene,
            articulated: &self.articulated,
            cloud,
            coarse,
            matches: &[],
            config: &RecogniseConfig::default(),
        };
        let hoped = found.evident.clone();
        let doubtful = (0..kept.len()).filter(|&j| hoped[j] && !kept[j]);
        doubt_rivalled(&refiner, found, doubtful);
        let unrivalled = std::mem::take(&mut found.evident);
        found.evident = (0..kept.len()).map(|j| kept[j] || hoped[j] && unrivalled[j]).collect();
    }

    /// Standard deviation of each configuration: by depth and lightness in this frame, or by what
    /// was known before and may have changed since, whichever is less.
    fn deviations(&self, scene: &Scene, considered: Option<&Considered>) -> Vec<Option<f64>> {
        let measured = self.measured_deviations(scene);
        let gap_us = self.last_utime.map_or(0, |last| scene.frame.utime.saturating_sub(last));
        let gap_s = (gap_us as f64 * 1e-6).clamp(0.0, LONGEST_GAP_S);
        let of_joint = |j: usize| {
            let rate = match self.articulated.joints[j].geometry.kind {
                JointKind::Prismatic => UNSEEN_SLIDE_RATE,
                _ => UNSEEN_TURN_RATE,
            };
            let carried =
                self.deviations[j].filter(|_| self.told[j]).map(|d| d.hypot(rate * gap_s));
            let confirmed = considered.and_then(|c| c.confirms(j, self.state.q[j], self.limit(j)));
            [measured[j], carried, confirmed].into_iter().flatten().min_by(f64::total_cmp)
        };
        (0..self.articulated.joints.len()).map(of_joint).collect()
    }

    fn measured_deviations(&self, scene: &Scene) -> Vec<Option<f64>> {
        let (gate, reach) = (GATES[1], REACHES[1]);
        let Self { articulated, state, object, .. } = self;
        let mut system = System::new(6 + articulated.joints.len());
        add_surface(&mut system, scene, articulated, &object.cloud, state, gate);
        add_lightness(&mut system, scene, articulated, &object.cloud, state, (gate, reach));
        system.draw_into_range(articulated, state);
        if self.base_seen {
            return configuration_deviations(articulated, &system);
        }
        // The joints turn about a base that is no better known than when it was seen.
        system.hold_pose(HOLD);
        let with_base = |(held, base): (Option<f64>, &Option<f64>)| Some(held?.hypot((*base)?));
        let held = configuration_deviations(articulated, &system);
        held.into_iter().zip(&self.base_deviations).map(with_base).collect()
    }

    fn expected(&self) -> State {
        let q = self
            .articulated
            .joints
            .iter()
            .zip(self.state.q.iter().zip(&self.step))
            .map(|(j, (q, step))| (q + self.config.persistence * step).clamp(j.low, j.high))
            .collect();
        State { camera_from_object: self.state.camera_from_object, q }
    }

    fn align(&self, scene: &Scene, mut state: State) -> State {
        let last = (self.config.steps - 1).max(1) as f64;
        for i in 0..self.config.steps {
            let done = i as f64 / last;
            let between = |ends: [f64; 2]| ends[0] + (ends[1] - ends[0]) * done;
            let cloud = if done < 0.7 { &self.object.coarse } else { &self.object.cloud };
            let (gate, reach) = (between(GATES), between(REACHES));
            let mut system = System::new(6 + self.articulated.joints.len());
            let planes = add_surface(&mut system, scene, &self.articulated, cloud, &state, gate);
            if planes < LEAST_SURFACE {
                break;
            }
            add_lightness(&mut system, scene, &self.articulated, cloud, &state, (gate, reach));
            system.draw_into_range(&self.articulated, &state);
            if !self.base_seen {
                system.hold_pose(HOLD);
            }
            let Some(step) = system.solve(DAMPING) else { break };
            state = self.articulated.stepped(&state, &step);
            if step.amax() < 1e-4 && done >= 0.7 {
                break;
            }
        }
        state
    }
}

/// The state that a recognition tells; joints that it does not tell are where it assumes them.
fn state_of(found: &Recognised, articulated: &Articulated) -> Option<State> {
    let q = if found.assumed.len() == articulated.joints.len() {
        found.assumed.clone()
    } else {
        articulated.rest()
    };
    let camera_from_object: Pose = pose_from_array(&found.camera_from_object)?;
    Some(State { camera_from_object, q })
}

/// The joints whose configuration a recognition tells.
fn told_by(found: &Recognised) -> Vec<bool> {
    found.joints.iter().map(|j| j.configuration.is_some()).collect()
}

/// A verdict's score without features.
fn surface_score(verdict: &Verdict) -> f64 {
    verdict.score(usize::MAX)
}

/// A surfel in the picture: its part, learned and seen lightness, and how the residual moves
/// with each unknown.
struct Sample {
    part: usize,
    learned: f64,
    seen: f64,
    row: Vec<f64>,
}

/// Differences of lightness at visible surfels, after each part's light is accounted for.
fn add_lightness(
    system: &mut System,
    scene: &Scene,
    articulated: &Articulated,
    cloud: &Cloud,
    state: &State,
    (gate, reach): (f64, f64),
) {
    let samples = lightness_samples(scene, articulated, cloud, state, gate, reach);
    let share = (LIGHTNESS_WORTH / samples.len().max(1) as f64).min(1.0);
    for part in 0..articulated.parts {
        let own: Vec<&Sample> = samples.iter().filter(|s| s.part == part).collect();
        if own.len() < LEAST_SURFACE {
            continue;
        }
        let (gain, offset) = light(&own);
        for s in own {
            let residual = s.seen - gain * s.learned - offset;
            let weight =
                share / LIGHTNESS_SIGMA.powi(2) / (residual.abs() / LIGHTNESS_SIGMA).max(1.0);
            system.add(s.row.iter().copied(), residual, weight);
        }
    }
}

fn lightness_samples(
    scene: &Scene,
    articulated: &Articulated,
    cloud: &Cloud,
    state: &State,
    gate: f64,
    reach: f64,
) -> Vec<Sample> {
    let poses = articulated.poses(state);
    let velocities = articulated.velocities(&poses);
    let camera = &scene.frame.camera;
    visible(scene, cloud, &poses)
        .into_iter()
        .filter_map(|p| {
            let z = f64::from(scene.frame.depth.at(p.pixel.0, p.pixel.1)?);
            if (z - p.point.z).abs() > gate + 0.02 {
                return None;
            }
            let pixel = camera.project(&p.point)?;
            let at = |du: f64, dv: f64| scene.lab.lightness(pixel.x + du, pixel.y + dv);
            let slope_u = (at(reach, 0.0)? - at(-reach, 0.0)?) / (2.0 * reach);
            let slope_v = (at(0.0, reach)? - at(0.0, -reach)?) / (2.0 * reach);
            let (x, y) = (p.point.x / p.point.z, p.point.y / p.point.z);
            let row = velocities
                .of(p.part, &p.point)
                .map(|v| {
                    (slope_u * camera.fx * (v.x - x * v.z) + slope_v * camera.fy * (v.y - y * v.z))
                        / p.point.z
                })
                .collect();
            Some(Sample {
                part: p.part,
                learned: f64::from(cloud.surfels[p.index].lab[0]),
                seen: at(0.0, 0.0)?,
                row,
            })
        })
        .collect()
}

/// Gain and offset of the light by which a part is seen.
fn light(samples: &[&Sample]) -> (f64, f64) {
    let n = samples.len() as f64;
    let mean = |f: fn(&Sample) -> f64| samples.iter().map(|s| f(s)).sum::<f64>() / n;
    let (learned, seen) = (mean(|s| s.learned), mean(|s| s.seen));
    let (mut variance, mut common) = (1.0, 1.0);
    for s in samples {
        variance += (s.learned - learned).powi(2);
        common += (s.learned - learned) * (s.seen - seen);
    }
    let gain = (common / variance).clamp(0.3, 3.0);
    (gain, seen - gain * learned)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object::appearance::Appearance;
    use crate::object::joint_geometry::JointGeometry;
    use crate::object::model::{Joint, MODEL_SCHEMA, ObjectModel, Part, ReferenceFrame};
    use crate::recognise::matching::FeatureTable;
    use crate::recognise::test_data::{BOARD_M, PLATE_M, on_board, on_plate, slider_surface};
    use crate::test_data::seen;
    use linkage_driver::ColorImage;
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
        let table = FeatureTable::new(&Appearance::default());
        Arc::new(KnownObject { model, table, coarse: cloud.thinned(), cloud })
    }

    /// The board, with stripes behind it that go on or end where the plate does.
    fn picture(stripes_end: bool) -> RgbdFrame {
        let depth = |x: f64, y: f64| match (on_board(x, y), !stripes_end || on_plate(x, y)) {
            (true, _) => BOARD_M,
            (false, true) => PLATE_M,
            (false, false) => 2.5,
        };
        let frame = seen(0, depth);
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

    /// What the follower tells of the slide, told or untold when it starts.
    fn told(configuration: Option<f64>, stripes_end: bool) -> Option<f64> {
        let object = slider();
        let articulated = Articulated::new(&object.model);
        let found = Detection {
            state: State { camera_from_object: crate::math::rigid::Pose::identity(), q: vec![0.0] },
            score: 1.0,
            inliers: 0,
            verdict: Verdict::default(),
            placed: vec![true; 2],
            evident: vec![configuration.is_some()],
            deviations: vec![Some(0.001)],
        };
        let found = report(&object, &articulated, &found);
        let mut follower = Follower::new(object, &found, FollowConfig::default()).unwrap();
        let followed = follower.follow(&picture(stripes_end)).unwrap();
        assert!(followed.seen);
        followed.recognised.joints[0].configuration
    }

    #[test]
    fn a_configuration_that_was_not_told_is_told_once_it_has_no_rival() {
        assert_eq!(told(None, false), None);
        assert!(told(None, true).is_some_and(|q| q.abs() < 0.01));
    }

    #[test]
    fn a_configuration_that_was_told_is_told_on() {
        assert!(told(Some(0.0), false).is_some());
    }
}
