//! Recognition in a future encounter (paper, section III-E): which learned object is in the
//! picture, where its frame is, and at which configuration each of its joints is.
//!
//! Features are matched, hypotheses of each part's pose come from matches that agree in
//! space, the other parts follow through their joints, everything is refined together, and
//! the result is verified against the picture: geometry alone cannot tell look-alikes apart,
//! inliers alone cannot either.

mod ambiguity;
mod edge_test;
mod kinematics;
mod normal_equations;
mod occupied_space;
mod surface_cache;
#[cfg(test)]
mod test_data;

mod elimination;
mod follow;
mod hypothesis;
mod matching;
mod pnp;
mod refine;
mod retrieval;
mod scene;
mod stillness;
mod verify;

pub use follow::{Asked, FollowConfig, Followed, Follower, Lost};
pub use retrieval::{Index, NotAVocabulary, Vocabulary, Words};
pub(crate) use retrieval::{Posting, Postings};
pub use scene::Scene;

use crate::object::appearance::Appearance;

use crate::math::rigid::{Pose, pose_to_array};
use crate::object::joint_geometry::{JointGeometry, JointKind};
use crate::object::model::ObjectModel;
use kinematics::{Articulated, ChainJoint, State};
use matching::{Compared, FeatureTable, Match};
use nalgebra::UnitVector3;
use normal_equations::System;
use occupied_space::OccupiedVoxels;
use rayon::prelude::*;
use refine::Refiner;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use verify::{Cloud, Verdict};

/// Name and version of the JSON form.
pub const RECOGNITION_SCHEMA: &str = "linkage.recognition/1";

/// Values of the recognition stage. All ours.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecogniseConfig {
    /// Score above which an object is reported. Of 6435 wrong pairs (`bench --suite recognise`,
    /// the same with `--seed 2` and `--seed 3`) none scores more. Of models learned with other
    /// seeds one did: a closed door, longer than the learned one, in a longer frame, of which a
    /// post hides half.
    pub min_score: f64,
    /// Matches kept, best first.
    pub max_matches: usize,
    /// Largest ratio of the best match's distance to that of the best elsewhere.
    pub max_ratio: f64,
    /// Matches that agree in space before anything dense is computed.
    pub min_inliers: usize,
    /// Pose hypotheses that are refined and verified.
    pub hypotheses: usize,
    /// Where distinct matches lead to no object of a shortlist, all are tried, for what is not
    /// hidden.
    pub try_all_matches: bool,
    /// Most objects compared in full at a time; of more, the likeliest by their words come first,
    /// and those whose words stand out alone.
    pub shortlist: usize,
    /// Shortlists gone through, one after the other, until something is recognised.
    pub shortlists: usize,
    /// Surfaces are compared in colour too, not in depth alone.
    pub compare_looks: bool,
    /// Surface that is seen through counts against a state.
    pub check_free_space: bool,
    /// Surface that goes on where the learned one ends counts against a state.
    pub check_ends: bool,
    /// States are aligned by their surface too, not by matches alone.
    pub align_surface: bool,
    /// Hypotheses of a part in whose place another thing is seen are not followed.
    pub dismiss_early: bool,
    /// Configurations that few matches tell are searched for by surface.
    pub search_configurations: bool,
    /// Configurations are told only where no other one explains the picture about as well.
    pub check_rivals: bool,
    /// Configurations that nothing shows are told where all others are ruled out.
    pub eliminate: bool,
    /// Things of one make that are looked for in one picture; at least one.
    pub max_of_a_make: usize,
}

impl Default for RecogniseConfig {
    fn default() -> Self {
        Self {
            min_score: 0.5,
            max_matches: 400,
            max_ratio: 0.9,
            min_inliers: 7,
            hypotheses: 4,
            try_all_matches: true,
            shortlist: 6,
            shortlists: 3,
            compare_looks: true,
            check_free_space: true,
            check_ends: true,
            align_surface: true,
            dismiss_early: true,
            search_configurations: true,
            check_rivals: true,
            eliminate: true,
            max_of_a_make: 4,
        }
    }
}

/// An object with its appearance prepared for matching.
pub struct KnownObject {
    /// Motion.
    pub model: ObjectModel,
    table: FeatureTable,
    cloud: Cloud,
    coarse: Cloud,
}

impl KnownObject {
    /// Prepares an object.
    pub fn new(model: ObjectModel, appearance: &Appearance) -> Self {
        let cloud = Cloud::new(appearance);
        Self { model, table: FeatureTable::new(appearance), coarse: cloud.thinned(), cloud }
    }
}

/// A joint as it is now, in the camera frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JointState {
    /// Its name.
    pub name: String,
    /// Its kind.
    #[serde(rename = "type")]
    pub kind: JointKind,
    /// Unit direction, camera frame.
    pub axis: [f64; 3],
    /// A point on it, camera frame, metres.
    pub origin: [f64; 3],
    /// Metres a turn, for screws; else 0 and left out.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub pitch: f64,
    /// Configuration; `null` without evidence of its own.
    pub configuration: Option<f64>,
    /// Standard deviation of the configuration, rad or m; left out where it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deviation: Option<f64>,
    /// Why the configuration is `null`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Range seen in the demonstrations.
    pub range: [f64; 2],
}

/// What [`Recognised::base_known`] is where it is left out.
pub fn yes() -> bool {
    true
}

/// Where it is left out.
pub fn is_yes(known: &bool) -> bool {
    *known
}

fn is_zero(pitch: &f64) -> bool {
    *pitch == 0.0
}

impl JointState {
    /// Its line, camera frame.
    pub fn geometry(&self) -> JointGeometry {
        JointGeometry {
            kind: self.kind,
            axis: UnitVector3::new_normalize(self.axis.into()),
            origin: self.origin.into(),
            pitch: self.pitch,
        }
    }
}

/// A recognised object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Recognised {
    /// Its name.
    pub object: String,
    /// Probability that it is there, and there; reported above [`RecogniseConfig::min_score`].
    pub score: f64,
    /// Matches that agree in space.
    pub inliers: usize,
    /// Pose of the object frame.
    pub camera_from_object: [f64; 7],
    /// False where nothing tells where the base is, as where only parts are seen whose
    /// configuration is not known: `camera_from_object` is then a guess, while the axes of the
    /// joints that carry them are right. Left out where true.
    #[serde(default = "yes", skip_serializing_if = "is_yes")]
    pub base_known: bool,
    /// Its joints.
    pub joints: Vec<JointState>,
    /// Configurations that the pose goes with, those included that are not told; stays in the
    /// program. Empty where they are not known.
    #[serde(skip)]
    pub assumed: Vec<f64>,
}

/// All that was recognised in a frame: `linkage.recognition/1`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Recognition {
    /// [`RECOGNITION_SCHEMA`].
    pub schema: String,
    /// Best first.
    pub matches: Vec<Recognised>,
    /// Best score of what is not believed; stays in the program.
    #[serde(skip)]
    pub best_refused: f64,
}

impl Recognition {
    /// Wraps matches, best first.
    pub fn new(mut matches: Vec<Recognised>) -> Self {
        matches.sort_by(|a, b| b.score.total_cmp(&a.score));
        Self { schema: RECOGNITION_SCHEMA.to_owned(), matches, best_refused: 0.0 }
    }
}

/// Looks for every object in the scene; those above the threshold, best first.
///
/// Where distinct matches lead to no object at all, all matches are tried, of each. That costs as
/// much again, and more: where something is known to be seen it is not asked for.
pub fn recognise(
    scene: &Scene,
    objects: &[Arc<KnownObject>],
    config: &RecogniseConfig,
    seed: u64,
) -> Recognition {
    let mut looks: Vec<ObjectSearch> =
        objects.par_iter().map(|object| ObjectSearch::new(scene, object, config, seed)).collect();
    if !looks.iter().any(ObjectSearch::is_recognised) {
        looks.par_iter_mut().for_each(ObjectSearch::try_all_matches);
    }
    let found: Vec<(Vec<Recognised>, f64)> =
        looks.into_par_iter().map(ObjectSearch::all_of_its_make).collect();
    let best_refused = found.iter().map(|(_, refused)| *refused).fold(0.0, f64::max);
    let matches = found.into_iter().flat_map(|(matches, _)| matches).collect();
    Recognition { best_refused, ..Recognition::new(matches) }
}

/// The best explanation of the scene by one object, whatever its score; `None` when too few
/// matches agree in space.
pub fn find(
    scene: &Scene,
    object: &KnownObject,
    config: &RecogniseConfig,
    seed: u64,
) -> Option<Recognised> {
    let mut look = ObjectSearch::new(scene, object, config, seed);
    if !look.is_recognised() {
        look.try_all_matches();
    }
    look.found.as_ref().map(|found| report(object, &look.articulated, found))
}

/// One object looked for in a scene.
struct ObjectSearch<'l> {
    scene: &'l Scene,
    object: &'l KnownObject,
    config: &'l RecogniseConfig,
    seed: u64,
    articulated: Articulated,
    compared: Compared,
    /// Distinct ones.
    matches: Vec<Match>,
    /// Hypotheses that were followed.
    tried: Vec<(usize, Pose)>,
    /// The best of them.
    found: Option<Detection>,
}

impl<'l> ObjectSearch<'l> {
    /// By distinct matches.
    fn new(
        scene: &'l Scene,
        object: &'l KnownObject,
        config: &'l RecogniseConfig,
        seed: u64,
    ) -> Self {
        let articulated = Articulated::new(&object.model);
        let compared = Compared::new(&scene.features, scene.queries(), &object.table);
        let matches = compared.distinct(|_| true, config);
        tracing::debug!(
            object = object.model.object,
            features = scene.features.len(),
            distinct = matches.len(),
            of_base = matches.iter().filter(|m| m.part == 0).count(),
            "matched"
        );
        let mut tried = Vec::new();
        let found = by_distinct(scene, object, &articulated, &matches, config, &mut tried, seed);
        Self { scene, object, config, seed, articulated, compared, matches, tried, found }
    }

    fn is_recognised(&self) -> bool {
        self.found.as_ref().is_some_and(|f| is_believed(f.score, self.config))
    }

    /// Paint that repeats has its like elsewhere: of 40 matches that are right two may be
    /// distinct. As more agree by chance, nothing is forgiven for being hidden, and a joint has to
    /// show.
    fn try_all_matches(&mut self) {
        let Self { config, .. } = *self;
        if !config.try_all_matches || !self.scene.has_depth() {
            return;
        }
        let KnownObject { cloud, coarse, .. } = self.object;
        let refiner = Refiner {
            scene: self.scene,
            articulated: &self.articulated,
            cloud,
            coarse,
            matches: &self.matches,
            config,
        };
        let all = self.compared.all();
        let of_all = Refiner { matches: &all, ..refiner };
        let settled = best_settled(&of_all, config.min_inliers + 1, &mut self.tried, self.seed);
        let found = settled.map(|settled| {
            let score = settled.score * settled.verdict.unhidden();
            decide(&refiner, RefinedPose { score, ..settled })
        });
        let is_certain = |f: &Detection| is_believed(f.score, config) && f.evident.contains(&true);
        if let Some(found) = found.filter(is_certain) {
            self.found = Some(found);
        }
    }

    /// What was recognised, and further ones of its make, and the best score below the threshold.
    /// Each next one is looked for where none of those before it stands. As pieces of room may
    /// look alike, a further one must show both sides of a joint and half as much as the first.
    fn all_of_its_make(self) -> (Vec<Recognised>, f64) {
        let Self { scene, object, articulated, compared, seed, .. } = self;
        let Some(first) = self.found else { return (Vec::new(), 0.0) };
        let mut config = self.config.clone();
        config.min_inliers = config.min_inliers.max(first.inliers.div_ceil(2));
        let (mut taken, mut all, mut next) = (OccupiedVoxels::default(), Vec::new(), Some(first));
        while let Some(found) = next.take() {
            let recognised = report(object, &articulated, &found);
            if recognised.score < config.min_score {
                return (all, recognised.score);
            }
            let places = occupied_space::places_of(&object.cloud, &articulated, &found.state);
            let is_further = found.evident.contains(&true) && taken.share(&places) <= MAX_SHARED;
            if !all.is_empty() && !is_further {
                break;
            }
            taken.add(&places);
            all.push(recognised);
            if all.len() < config.max_of_a_make && scene.has_depth() {
                let left = compared.distinct(|place| !taken.holds(place), &config);
                let tried = &mut Vec::new();
                next = by_distinct(scene, object, &articulated, &left, &config, tried, seed);
            }
        }
        (all, 0.0)
    }
}

/// The best explanation of the scene by distinct matches; where there is no depth, by where they
/// lie in the picture.
fn by_distinct(
    scene: &Scene,
    object: &KnownObject,
    articulated: &Articulated,
    matches: &[Match],
    config: &RecogniseConfig,
    tried: &mut Vec<(usize, Pose)>,
    seed: u64,
) -> Option<Detection> {
    let KnownObject { cloud, coarse, .. } = object;
    let found = if scene.has_depth() {
        let refiner = Refiner { scene, articulated, cloud, coarse, matches, config };
        best_settled(&refiner, config.min_inliers.saturating_sub(1), tried, seed)
            .map(|settled| decide(&refiner, settled))
    } else {
        pnp::find(scene, articulated, cloud, matches)
    }?;
    tracing::debug!(
        object = object.model.object,
        score = found.score,
        inliers = found.inliers,
        verdict = ?found.verdict,
        placed = ?found.placed,
        evident = ?found.evident,
        "candidate"
    );
    Some(found)
}

/// Share of its surface up to which a thing may stand where another stands.
const MAX_SHARED: f64 = 0.3;

/// A state that a hypothesis led to.
struct RefinedPose {
    state: State,
    score: f64,
    inliers: usize,
    verdict: Verdict,
}

/// A state of the object with its evidence.
struct Detection {
    state: State,
    score: f64,
    inliers: usize,
    verdict: Verdict,
    /// Parts of which something seen tells where they are.
    placed: Vec<bool>,
    /// Joints whose configuration can be told.
    evident: Vec<bool>,
    /// Standard deviation of each joint's configuration, rad or m, where the picture tells it.
    deviations: Vec<Option<f64>>,
}

fn is_believed(score: f64, config: &RecogniseConfig) -> bool {
    probability(score) >= config.min_score
}

/// Hypotheses of one part that are no farther apart lead to one state, metres and radians.
const SAME_PLACE_M: f64 = 0.05;
const SAME_TURN: f64 = 0.2;

/// Share of the matches that agree with one state from which another may be the better one.
const SHARE_OF_MOST: f64 = 0.4;

/// The best state that hypotheses lead to, of those that were not tried before. Where far more
/// matches agree on another, the picture shows something else that has the learned paint.
fn best_settled(
    refiner: &Refiner,
    least_support: usize,
    tried: &mut Vec<(usize, Pose)>,
    seed: u64,
) -> Option<RefinedPose> {
    let Refiner { scene, articulated, cloud, matches, config, .. } = *refiner;
    let hypotheses = hypothesis::all(articulated, matches, seed);
    tracing::debug!(
        hypotheses = hypotheses.len(),
        best = hypotheses.first().map_or(0, |h| h.support),
        "hypotheses"
    );
    let most_support = hypotheses.first().map_or(0, |h| h.support);
    let mut followed = 0;
    let mut least_support = least_support;
    let mut best: Option<(f64, RefinedPose)> = None;
    for h in &hypotheses {
        if followed == config.hypotheses || h.support < least_support {
            break;
        }
        let is_tried = |(part, pose): &(usize, Pose)| {
            let apart = pose.inverse() * h.camera_from_part;
            *part == h.part
                && apart.translation.vector.norm() < SAME_PLACE_M
                && apart.rotation.angle() < SAME_TURN
        };
        if tried.iter().any(is_tried) {
            continue;
        }
        tried.push((h.part, h.camera_from_part));
        followed += 1;
        let matches = &hypothesis::within_reach(articulated, matches, &h.state)[..];
        let Some(state) = (Refiner { matches, ..*refiner }).settle(h) else { continue };
        let inliers = hypothesis::unique_inliers(articulated, matches, &state, None);
        let verdict = verify::verify(scene, articulated, cloud, &state);
        let score = score_of(&verdict, inliers, config);
        tracing::debug!(part = h.part, support = h.support, inliers, score, q = ?state.q, ?verdict, "settled");
        if is_believed(score, config) {
            tried.extend(articulated.poses(&state).into_iter().enumerate());
            least_support = least_support.max((SHARE_OF_MOST * inliers as f64) as usize);
        }
        // A small piece of the room may look better than all of the object does in poor light:
        // what counts is how much is explained, and how well.
        let explained = score * refine::explained(&verdict, inliers);
        if best.as_ref().is_none_or(|(most, _)| explained > *most) {
            best = Some((explained, RefinedPose { state, score, inliers, verdict }));
        }
    }
    let least = config.min_inliers.max((SHARE_OF_MOST * most_support as f64) as usize);
    best.map(|(_, best)| best).filter(|b| b.inliers >= least)
}

/// What of a state can be told.
fn decide(refiner: &Refiner, settled: RefinedPose) -> Detection {
    let Refiner { scene, articulated, cloud, config, .. } = *refiner;
    let RefinedPose { state, score, inliers, verdict } = settled;
    let placed = placed_parts(articulated, refiner.matches, &state, &verdict);
    let evident = evident_joints(articulated, &placed);
    let deviations = configuration_deviations(articulated, &refiner.system(&state));
    let mut found = Detection { state, score, inliers, verdict, placed, evident, deviations };
    if config.check_rivals && is_believed(found.score, config) {
        doubt_rivalled(refiner, &mut found, 0..articulated.joints.len());
    }
    if config.eliminate && is_believed(found.score, config) {
        eliminate(scene, articulated, cloud, &mut found);
    }
    if !found.evident.contains(&true) {
        found.score *= found.verdict.mechanism(articulated);
    }
    found
}

/// [`Verdict::score`] of what the configuration asks for.
fn score_of(verdict: &Verdict, inliers: usize, config: &RecogniseConfig) -> f64 {
    let looks = if config.compare_looks { verdict.looks() } else { 1.0 };
    let free_space = if config.check_free_space { verdict.free_space() } else { 1.0 };
    let ends = if config.check_ends { verdict.ends() } else { 1.0 };
    looks * free_space * ends * verdict.agreement(inliers)
}

/// Parts of which something was itself seen, where the state puts it.
fn placed_parts(
    articulated: &Articulated,
    matches: &[Match],
    state: &State,
    verdict: &Verdict,
) -> Vec<bool> {
    (0..articulated.parts)
        .map(|part| {
            let features = hypothesis::unique_inliers(articulated, matches, state, Some(part));
            features >= 4 || verdict.parts[part].is_seen()
        })
        .collect()
}

/// A configuration is told when something on either side of the joint tells where it is.
fn evident_joints(articulated: &Articulated, placed: &[bool]) -> Vec<bool> {
    (0..articulated.joints.len())
        .map(|j| {
            let moved = articulated.moved_by(j);
            let on = |side: bool| {
                (0..articulated.parts).any(|p| placed[p] && moved.contains(&p) == side)
            };
            on(true) && on(false)
        })
        .collect()
}

/// Parts that could as well be elsewhere, by these joints, do not tell where they are.
fn doubt_rivalled(
    refiner: &Refiner,
    found: &mut Detection,
    joints: impl IntoIterator<Item = usize>,
) {
    for joint in joints {
        if found.evident[joint] {
            for part in ambiguity::adrift(refiner, &found.state, joint) {
                found.placed[part] = false;
            }
        }
    }
    found.evident = evident_joints(refiner.articulated, &found.placed);
}

/// What the residuals' own scatter does not show, in deviations of a configuration: neighbouring
/// surfels err alike.
const SCATTER_WORTH: f64 = 2.0;
/// What the learned model and the camera err by, however many surfels agree: radians.
const LEAST_TURN_DEVIATION: f64 = 0.008;
/// The same for slides, metres.
const LEAST_SLIDE_DEVIATION: f64 = 0.0015;

/// Standard deviation of each configuration, by the normal equations at a state.
fn configuration_deviations(articulated: &Articulated, system: &System) -> Vec<Option<f64>> {
    let of_all = system.deviations();
    let of_joint = |(joint, deviation): (&ChainJoint, &Option<f64>)| {
        let least = match joint.geometry.kind {
            JointKind::Prismatic => LEAST_SLIDE_DEVIATION,
            _ => LEAST_TURN_DEVIATION,
        };
        deviation.map(|d| least.hypot(SCATTER_WORTH * d))
    };
    articulated.joints.iter().zip(&of_all[6..]).map(of_joint).collect()
}

/// Tells configurations that nothing seen beyond the joint shows, where all others can be
/// ruled out.
fn eliminate(scene: &Scene, articulated: &Articulated, cloud: &Cloud, found: &mut Detection) {
    for j in 0..articulated.joints.len() {
        let moved = articulated.moved_by(j);
        let held = (0..articulated.parts).any(|p| found.placed[p] && !moved.contains(&p));
        if found.evident[j] || !held {
            continue;
        }
        if let Some(left) = elimination::remaining(scene, articulated, cloud, &found.state, j) {
            found.state.q[j] = left.middle;
            found.deviations[j] = Some(left.deviation());
            found.evident[j] = true;
        }
    }
}

/// What part of the reports that look perfect are right.
const CEILING: f64 = 0.97;
/// Verdict at which half of that part are, and how fast it changes there.
const EVEN: f64 = 0.42;
const STEEPNESS: f64 = 16.0;

/// How often a state with this verdict's score is right: a logistic curve through the pairs of
/// `bench --suite recognise`, which prints how well it holds.
fn probability(score: f64) -> f64 {
    CEILING / (1.0 + (-STEEPNESS * (score - EVEN)).exp())
}

/// Something tells where the base is, or a part from which told configurations lead to it.
fn base_is_known(articulated: &Articulated, found: &Detection) -> bool {
    let leads = |part: usize| {
        (0..found.evident.len())
            .all(|j| found.evident[j] || !articulated.moved_by(j).contains(&part))
    };
    (0..articulated.parts).any(|part| found.placed[part] && leads(part))
}

/// Why a joint's configuration is not told.
fn reason(
    model: &ObjectModel,
    articulated: &Articulated,
    found: &Detection,
    joint: usize,
) -> String {
    let moved = articulated.moved_by(joint);
    let is_hidden =
        |side: bool| (0..articulated.parts).all(|p| !found.placed[p] || moved.contains(&p) != side);
    let name = |part: usize| model.parts[part].name.as_str();
    let (parent, child) = (name(model.joints[joint].parent), name(model.joints[joint].child));
    match (is_hidden(true), is_hidden(false)) {
        (true, false) => format!("nothing seen of {child} tells where it is"),
        (false, true) => format!("nothing seen of {parent} tells where it is"),
        (true, true) => format!("nothing seen of {parent} and {child} tells where they are"),
        (false, false) => format!("what is seen of {child} does not tell how far it has moved"),
    }
}

fn report(object: &KnownObject, articulated: &Articulated, found: &Detection) -> Recognised {
    let motions = object.model.part_motions(&found.state.q);
    let joints = object
        .model
        .joints
        .iter()
        .enumerate()
        .map(|(i, joint)| {
            // The line is carried by the parent, from where it was at configuration 0.
            let camera_from_parent = found.state.camera_from_object * motions[joint.parent];
            let line = joint.geometry().transformed(&camera_from_parent);
            JointState {
                name: joint.name.clone(),
                kind: joint.kind,
                axis: line.axis.into_inner().into(),
                origin: line.origin.into(),
                pitch: line.pitch,
                configuration: found.evident[i].then_some(found.state.q[i]),
                deviation: found.evident[i].then_some(found.deviations[i]).flatten(),
                reason: (!found.evident[i]).then(|| reason(&object.model, articulated, found, i)),
                range: joint.range,
            }
        })
        .collect();
    Recognised {
        object: object.model.object.clone(),
        score: probability(found.score),
        inliers: found.inliers,
        camera_from_object: pose_to_array(&found.state.camera_from_object),
        base_known: base_is_known(articulated, found),
        joints,
        assumed: found.state.q.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_better_verdict_is_more_probable_and_none_is_certain() {
        let at = |score| probability(score);
        assert!(at(0.0) < 0.002 && at(0.2) < 0.05);
        assert!((1..=100).all(|i| at(f64::from(i) / 100.0) > at(f64::from(i - 1) / 100.0)));
        assert!(at(1.0) < 0.98);
    }
}
