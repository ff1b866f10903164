//! A recognised object followed from frame to frame: its surface is brought to agreement with
//! depth and with lightness, base pose and configurations together. Depth alone would not see a
//! sliding door slide; lightness tells where on its surface one is. A configuration that was told
//! is told on while both sides of its joint are seen; another is first asked for rivals, as in
//! recognition.

use super::articulated::{Articulated, State};
use super::scene::Scene;
use super::system::{System, add_surface};
use super::verify::{Cloud, Verdict, verify, visible};
use super::{
    Found, KnownObject, RecogniseConfig, Recognised, Refiner, doubt_rivalled, evident_joints,
    report,
};
use crate::geometry::pose_from_array;
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
    /// Joints whose configuration was told in the last frame.
    told: Vec<bool>,
    config: FollowConfig,
}

impl Follower {
    /// Starts where an object was recognised; `None` if its pose is none.
    pub fn new(object: Arc<KnownObject>, found: &Recognised, config: FollowConfig) -> Option<Self> {
        let articulated = Articulated::new(&object.model);
        let q = if found.assumed.len() == articulated.joints.len() {
            found.assumed.clone()
        } else {
            articulated.rest()
        };
        let state = State { camera_from_object: pose_from_array(&found.camera_from_object)?, q };
        let step = vec![0.0; articulated.joints.len()];
        let told = found.joints.iter().map(|j| j.configuration.is_some()).collect();
        Some(Self { object, articulated, state, step, unseen: 0, base_seen: false, told, config })
    }

    /// Takes the next frame.
    ///
    /// # Errors
    /// [`Lost::Unseen`] after too many frames that do not show the object.
    pub fn follow(&mut self, frame: &RgbdFrame) -> Result<Followed, Lost> {
        let scene = Scene::plain(frame)?;
        // A hand may have let go: motion that goes on is a guess, standing still another one.
        let (state, verdict) = [self.expected(), self.state.clone()]
            .into_iter()
            .map(|start| {
                let state = self.align(&scene, start);
                let verdict = verify(&scene, &self.articulated, &self.object.cloud, &state);
                (state, verdict)
            })
            .max_by(|a, b| a.1.fit().total_cmp(&b.1.fit()))
            .expect("two states are tried");
        let score = surface_score(&verdict);
        let seen = score >= self.config.min_score;
        self.unseen = if seen { 0 } else { self.unseen + 1 };
        if self.unseen > self.config.patience {
            let object = self.object.model.object.clone();
            return Err(Lost::Unseen { object, frames: self.unseen });
        }
        let parts: Vec<bool> =
            verdict.parts.iter().map(super::verify::PartVerdict::is_seen).collect();
        self.base_seen = parts[0];
        if seen {
            self.step = state.q.iter().zip(&self.state.q).map(|(now, then)| now - then).collect();
            self.state = state;
        } else {
            self.step.fill(0.0);
        }
        let placed: Vec<bool> = parts.into_iter().map(|p| p && seen).collect();
        let mut found = Found {
            state: self.state.clone(),
            score,
            inliers: 0,
            verdict,
            evident: evident_joints(&self.articulated, &placed),
            placed,
        };
        let KnownObject { cloud, coarse, .. } = &*self.object;
        let refiner = Refiner {
            scene: &scene,
            articulated: &self.articulated,
            cloud,
            coarse,
            matches: &[],
            config: &RecogniseConfig::default(),
        };
        let untold = self.told.iter().enumerate().filter(|(_, told)| !**told).map(|(j, _)| j);
        doubt_rivalled(&refiner, &mut found, untold);
        self.told.clone_from(&found.evident);
        Ok(Followed { recognised: report(&self.object, &self.articulated, &found), seen })
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
    use super::super::matching::FeatureTable;
    use super::super::specimen::{BOARD_M, PLATE_M, on_board, on_plate, slider_surface};
    use super::*;
    use crate::appearance::Appearance;
    use crate::articulate::JointGeometry;
    use crate::model::{Joint, MODEL_SCHEMA, ObjectModel, Part, ReferenceFrame};
    use crate::specimen::seen;
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
        let found = Found {
            state: State { camera_from_object: crate::geometry::Pose::identity(), q: vec![0.0] },
            score: 1.0,
            inliers: 0,
            verdict: Verdict::default(),
            placed: vec![true; 2],
            evident: vec![configuration.is_some()],
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
