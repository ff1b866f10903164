//! The search for one object in a scene.
//!
//! In: a scene and a known object.
//! Out: what is determined of the object, as a [`Recognised`], or several if objects of one class stand side by
//! side.
//!
//! The steps: distinct matches of features; hypotheses of each part's pose from matches that agree geometrically;
//! refinement of the best hypotheses; verification of each refined state by the image; choice of the best state;
//! decision which of its configurations are determined. Without depth, PnP replaces the first steps.

use super::ambiguity::withdraw_ambiguous;
use super::base_by_room;
use super::config::RecogniseConfig;
use super::elimination::add_by_elimination;
use super::evidence::{
    Detection, RefinedPose, configuration_deviations, evident_joints, is_believed, placed_parts,
    score_of, withdraw_uncertain,
};
use super::hypothesis::{self, Hypothesis};
use super::kinematics::Articulated;
use super::known_object::KnownObject;
use super::matching::{Compared, Match};
use super::occupied_space::{OccupiedVoxels, places_of};
use super::part_by_contour;
use super::pnp;
use super::refine::{self, Refiner};
use super::result::{Recognised, report};
use super::room_search;
use super::scene::Scene;
use super::shape::{ContourGrid, Contours};
use super::shape_search::{self, FoundByShape};
use super::verdict::PartVerdict;
use super::verify::verify;
use crate::math::rigid::Pose;
use nalgebra::Point3;

/// Smallest number of matches, each place counted once, that must agree with a refined state.
const MIN_INLIERS: usize = 7;
/// Largest number of objects of one class that are searched for in one frame.
const MAX_OF_A_MAKE: usize = 4;
/// Factor on the score of a state that determines no configuration: one rigid surface is less evidence than two that
/// a joint connects. Fourteen plain things that were found so had scores from 0.50 on before, and a door of other
/// planks 0.43, which is a probability of 0.54.
const NO_CONFIGURATION: f64 = 0.9;
/// Factor on the score of a moving part alone of which no outline is seen. A table top of the veneer of a nightstand's
/// drawer was taken for it, by 7 to 14 matches; its outline ended as learned at no edge and went on at up to 17. Of 14
/// doors, lids and drawers that were alone in sight, all ended as learned at more edges than they went on.
const WITHOUT_OUTLINE: f64 = 0.5;
/// Largest share of an object's surface that may lie in space that another object occupies.
pub const MAX_SHARED: f64 = 0.3;

/// Search for one object in a scene.
pub struct ObjectSearch<'l> {
    scene: &'l Scene,
    object: &'l KnownObject,
    config: &'l RecogniseConfig,
    seed: u64,
    articulated: Articulated,
    compared: Compared,
    /// Distinct matches.
    distinct: Vec<Match>,
    /// Poses of hypotheses that were refined.
    tried: TriedPoses,
    /// Best detection so far.
    found: Option<Detection>,
    /// How much of the image the state that was found by shape explains; 0 if none was.
    explained_by_shape: f64,
}

impl<'l> ObjectSearch<'l> {
    /// Searches for the object by its distinct matches.
    pub fn by_distinct_matches(
        scene: &'l Scene,
        object: &'l KnownObject,
        config: &'l RecogniseConfig,
        seed: u64,
    ) -> Self {
        let articulated = Articulated::new(&object.model);
        let compared = Compared::new(&scene.features, scene.queries(), &object.table);
        let distinct = compared.distinct(|_| true, config);
        tracing::debug!(
            object = object.model.object,
            features = scene.features.len(),
            distinct = distinct.len(),
            of_base = distinct.iter().filter(|m| m.part == 0).count(),
            "matched"
        );
        let mut tried = TriedPoses::default();
        let search = Self {
            scene,
            object,
            config,
            seed,
            articulated,
            compared,
            distinct,
            tried: TriedPoses::default(),
            found: None,
            explained_by_shape: 0.0,
        };
        let found = search.detect(&search.distinct, MIN_INLIERS, &mut tried);
        Self { tried, found, ..search }
    }

    /// True if the score of the best detection is high enough.
    pub fn is_recognised(&self) -> bool {
        self.found.as_ref().is_some_and(|f| is_believed(f.score, self.config))
    }

    /// Best detection as it is reported, whatever its score.
    pub fn best(&self) -> Option<Recognised> {
        self.found.as_ref().map(|found| report(self.object, &self.articulated, found))
    }

    /// Searches for the object by all matches. Matches of repeated texture are not distinct: of 40 right matches two
    /// may be. As more matches agree by chance, occluded surface counts against the state, and the configuration of
    /// a joint has to be determined.
    pub fn retry_with_all_matches(&mut self) {
        if !self.config.try_all_matches || !self.scene.has_depth() {
            return;
        }
        let all = self.compared.all();
        let mut tried = std::mem::take(&mut self.tried);
        let by_all = self.refiner(&all, MIN_INLIERS);
        let best = best_pose(&by_all, MIN_INLIERS + 1, &mut tried, self.seed);
        let found = best.map(|best| {
            let score = best.score * best.verdict.visible_ratio();
            let by_distinct = self.refiner(&self.distinct, MIN_INLIERS);
            decide(&by_distinct, RefinedPose { score, ..best })
        });
        self.tried = tried;
        let is_certain =
            |f: &Detection| is_believed(f.score, self.config) && f.evident.contains(&true);
        if let Some(found) = found.filter(is_certain) {
            self.found = Some(found);
        }
    }

    /// Searches for the object at the place that the matches of its room give, if its room is seen.
    pub fn retry_in_room(&mut self, seen: &ContourGrid) {
        let contours = Contours { shape: self.object.shape(), seen };
        let in_room = Refiner { shape: Some(contours), ..self.refiner(&self.distinct, 0) };
        if let Some(found) = room_search::find(&in_room, contours, &self.room_matches(), self.seed)
        {
            self.found = Some(found);
        }
    }

    /// Adds configurations of hinges by the place that the room gives to the base, if the object is recognised, its
    /// base is not in sight, and a configuration is unknown. The score stays as it was.
    pub fn complete_by_room(&mut self) {
        let lacks = |f: &Detection| f.evident.contains(&false) && !f.placed[0];
        if !self.scene.has_depth() || !self.is_recognised() {
            return;
        }
        let Some(mut found) = self.found.take_if(|found| lacks(found)) else { return };
        let refiner = self.refiner(&self.distinct, 0);
        base_by_room::add_configurations(&refiner, &self.room_matches(), self.seed, &mut found);
        self.found = Some(found);
    }

    /// True if the object is recognised, by features or in its room, and one of its configurations is unknown.
    pub fn lacks_configuration(&self) -> bool {
        let lacks = |f: &Detection| f.evident.contains(&false);
        self.explained_by_shape == 0.0
            && self.is_recognised()
            && self.found.as_ref().is_some_and(lacks)
    }

    /// Adds configurations of plain parts by their contour. The score stays as it was.
    pub fn complete_by_contour(&mut self, seen: &ContourGrid) {
        let Some(mut found) = self.found.take() else { return };
        let contours = Contours { shape: self.object.shape(), seen };
        let by_features = self.refiner(&self.distinct, 0);
        let by_both = Refiner { shape: Some(contours), coarse: &self.object.cloud, ..by_features };
        part_by_contour::add_configurations(&by_both, contours, &mut found);
        self.found = Some(found);
    }

    /// Distinct matches of the room and of the object's own base.
    fn room_matches(&self) -> Vec<Match> {
        let of_room = Compared::new(&self.scene.features, self.scene.queries(), &self.object.room);
        let mut matches = of_room.distinct(|_| true, self.config);
        tracing::debug!(object = self.object.model.object, distinct = matches.len(), "of its room");
        matches.extend(self.distinct.iter().filter(|m| m.part == 0).cloned());
        matches
    }

    /// Searches for the object by its contour: plain objects have no features, but their surface ends.
    pub fn retry_by_shape(&mut self, seen: &ContourGrid) {
        let KnownObject { cloud, model, .. } = self.object;
        tracing::debug!(object = model.object, "looked for by shape");
        // Edges determine configurations, and a thinned surface has none.
        let contours = Contours { shape: self.object.shape(), seen };
        let by_shape = Refiner { shape: Some(contours), coarse: cloud, ..self.refiner(&[], 0) };
        if let Some(FoundByShape { detection, explained }) = shape_search::find(&by_shape, contours)
        {
            self.found = Some(detection);
            self.explained_by_shape = explained;
        }
    }

    /// Places of the object's surface in its best state, if it is recognised; camera frame, metres.
    pub fn places(&self) -> Option<Vec<Point3<f64>>> {
        let found = self.found.as_ref().filter(|_| self.is_recognised())?;
        Some(places_of(&self.object.cloud, &self.articulated, &found.state))
    }

    /// How much of the image the state that was found by shape explains; 0 if none was.
    pub fn explained_by_shape(&self) -> f64 {
        self.explained_by_shape
    }

    /// Forgets what was found by shape.
    pub fn withdraw(&mut self) {
        (self.found, self.explained_by_shape) = (None, 0.0);
    }

    /// Recognised objects of this class, and the score of the first one below the threshold, 0 if there is none.
    /// Each further one is searched for outside the space of those before it. As parts of a room may be alike, a
    /// further one must show both sides of a joint and have half as many inliers as the first.
    pub fn same_class_instances(mut self) -> (Vec<Recognised>, f64) {
        let Some(first) = self.found.take() else { return (Vec::new(), 0.0) };
        let min_inliers = MIN_INLIERS.max(first.inliers.div_ceil(2));
        let (mut occupied, mut all) = (OccupiedVoxels::default(), Vec::new());
        let mut next = Some(first);
        while let Some(found) = next.take() {
            let recognised = report(self.object, &self.articulated, &found);
            if recognised.score < self.config.min_score {
                return (all, recognised.score);
            }
            let places = places_of(&self.object.cloud, &self.articulated, &found.state);
            let is_further = found.evident.contains(&true) && occupied.share(&places) <= MAX_SHARED;
            if !all.is_empty() && !is_further {
                break;
            }
            occupied.add(&places);
            all.push(recognised);
            if all.len() < MAX_OF_A_MAKE && self.scene.has_depth() {
                let left = self.compared.distinct(|place| !occupied.holds(place), self.config);
                next = self.detect(&left, min_inliers, &mut TriedPoses::default());
            }
        }
        (all, 0.0)
    }

    /// Best explanation of the scene by matches; without depth, by their pixels.
    fn detect(
        &self,
        matches: &[Match],
        min_inliers: usize,
        tried: &mut TriedPoses,
    ) -> Option<Detection> {
        let found = if self.scene.has_depth() {
            let refiner = self.refiner(matches, min_inliers);
            best_pose(&refiner, min_inliers.saturating_sub(1), tried, self.seed)
                .map(|best| decide(&refiner, best))
        } else {
            pnp::find(self.scene, &self.articulated, &self.object.cloud, matches)
        }?;
        tracing::debug!(
            object = self.object.model.object,
            score = found.score,
            inliers = found.inliers,
            verdict = ?found.verdict,
            placed = ?found.placed,
            evident = ?found.evident,
            "candidate"
        );
        Some(found)
    }

    fn refiner<'r>(&'r self, matches: &'r [Match], min_inliers: usize) -> Refiner<'r> {
        let KnownObject { cloud, coarse, .. } = self.object;
        Refiner {
            scene: self.scene,
            articulated: &self.articulated,
            cloud,
            coarse,
            matches,
            shape: None,
            min_inliers,
            room: &[],
            config: self.config,
        }
    }
}

/// Poses of parts that were refined already: none is refined twice.
#[derive(Default)]
struct TriedPoses(Vec<(usize, Pose)>);

/// Largest distance between two poses of one part that count as one pose, metres.
const SAME_PLACE_M: f64 = 0.05;
/// Largest rotation between two poses of one part that count as one pose, radians.
const SAME_TURN: f64 = 0.2;

impl TriedPoses {
    fn add(&mut self, part: usize, camera_from_part: Pose) {
        self.0.push((part, camera_from_part));
    }

    fn contains(&self, part: usize, camera_from_part: &Pose) -> bool {
        self.0.iter().any(|(tried_part, tried)| {
            let apart = tried.inverse() * camera_from_part;
            *tried_part == part
                && apart.translation.vector.norm() < SAME_PLACE_M
                && apart.rotation.angle() < SAME_TURN
        })
    }
}

/// Smallest share of the matches that agree with one state that must agree with another state for it to be the
/// better one.
const SHARE_OF_MOST: f64 = 0.4;

/// Best state that hypotheses lead to, of those that were not tried before; `None` if far more matches agree on
/// another hypothesis: the image then shows something else with the learned texture.
fn best_pose(
    refiner: &Refiner,
    mut least_support: usize,
    tried: &mut TriedPoses,
    seed: u64,
) -> Option<RefinedPose> {
    let Refiner { articulated, matches, min_inliers, config, .. } = *refiner;
    let hypotheses = hypothesis::all(articulated, matches, seed);
    let most_support = hypotheses.first().map_or(0, |h| h.support);
    tracing::debug!(hypotheses = hypotheses.len(), best = most_support, "hypotheses");
    let mut count = 0;
    let mut best: Option<(f64, RefinedPose)> = None;
    for hypothesis in &hypotheses {
        if count == config.hypotheses || hypothesis.support < least_support {
            break;
        }
        let (part, camera_from_part) = (hypothesis.part, hypothesis.camera_from_part);
        if tried.contains(part, &camera_from_part) {
            continue;
        }
        tried.add(part, camera_from_part);
        count += 1;
        let Some(refined) = refined_and_verified(refiner, hypothesis) else { continue };
        if is_believed(refined.score, config) {
            let poses = articulated.poses(&refined.state);
            poses.into_iter().enumerate().for_each(|(part, pose)| tried.add(part, pose));
            least_support = least_support.max((SHARE_OF_MOST * refined.inliers as f64) as usize);
        }
        // In poor light a small piece of the room may score better than the whole object, so that states are ranked
        // by score times explained surface.
        let explained = refined.score * refine::explained(&refined.verdict, refined.inliers);
        if best.as_ref().is_none_or(|(most, _)| explained > *most) {
            best = Some((explained, refined));
        }
    }
    let least = min_inliers.max((SHARE_OF_MOST * most_support as f64) as usize);
    best.map(|(_, best)| best).filter(|b| b.inliers >= least)
}

/// State that a hypothesis leads to, and its comparison with the image; `None` if another object is seen in its
/// place.
fn refined_and_verified(refiner: &Refiner, hypothesis: &Hypothesis) -> Option<RefinedPose> {
    let Refiner { scene, articulated, cloud, config, .. } = *refiner;
    let matches = &hypothesis::within_reach(articulated, refiner.matches, &hypothesis.state)[..];
    let state = Refiner { matches, ..*refiner }.settle(hypothesis)?;
    let inliers = hypothesis::unique_inliers(articulated, matches, &state, None);
    let verdict = verify(scene, articulated, cloud, &state);
    let score = score_of(&verdict, inliers, config);
    let (part, support) = (hypothesis.part, hypothesis.support);
    tracing::debug!(part, support, inliers, score, q = ?state.q, ?verdict, "refined");
    Some(RefinedPose { state, score, inliers, verdict })
}

/// Decides which configurations of a state are determined, and lowers the score if none is seen. One that follows by
/// elimination does not raise it again: that a lid can be nowhere else says nothing about whose base is seen.
fn decide(refiner: &Refiner, refined: RefinedPose) -> Detection {
    let Refiner { scene, articulated, cloud, config, .. } = *refiner;
    let RefinedPose { state, score, inliers, verdict } = refined;
    let placed = placed_parts(articulated, refiner.matches, &state, &verdict);
    let evident = evident_joints(articulated, &placed);
    let deviations = configuration_deviations(articulated, &refiner.system(&state));
    let mut found = Detection { state, score, inliers, verdict, placed, evident, deviations };
    if config.check_ambiguity && is_believed(found.score, config) {
        withdraw_ambiguous(refiner, &mut found, 0..articulated.joints.len());
    }
    withdraw_uncertain(articulated, &mut found);
    if !found.evident.contains(&true) {
        found.score *= NO_CONFIGURATION * found.verdict.articulation_evidence(articulated);
    }
    if is_texture_alone(&found) {
        found.score *= WITHOUT_OUTLINE;
    }
    if config.eliminate && is_believed(found.score, config) {
        add_by_elimination(scene, articulated, cloud, &mut found);
    }
    found
}

/// True if only moving parts are placed, and no part ends as learned at more edges than it goes on: any plane of the
/// same texture agrees with them.
fn is_texture_alone(found: &Detection) -> bool {
    let shows_outline = |part: &PartVerdict| part.edges.as_learned > part.edges.goes_on;
    !found.placed[0] && !found.verdict.parts.iter().any(shows_outline)
}

#[cfg(test)]
mod tests {
    use super::super::edge_test::EdgeCounts;
    use super::super::elimination::tests::{flap, scene};
    use super::super::kinematics::State;
    use super::super::test_data::detection;
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    #[test]
    fn a_pose_near_one_that_was_tried_is_not_tried_again() {
        let at = |x: f64, turn: f64| {
            let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), turn);
            Pose::from_parts(Vector3::new(x, 0.0, 1.0).into(), rotation)
        };
        let mut tried = TriedPoses::default();
        tried.add(1, at(0.0, 0.0));
        assert!(tried.contains(1, &at(0.04, 0.1)));
        assert!(!tried.contains(1, &at(0.06, 0.0)) && !tried.contains(1, &at(0.0, 0.3)));
        assert!(!tried.contains(0, &at(0.0, 0.0)));
    }

    #[test]
    fn a_texture_alone_is_no_object_unless_its_outline_or_its_base_is_seen() {
        let ((articulated, cloud), scene) = (flap(), scene(|_, _| false));
        let state = State { camera_from_object: Pose::identity(), q: vec![0.7] };
        let verdict = verify(&scene, &articulated, &cloud, &state);
        let mut found = detection(state, verdict, vec![false, true]);
        let mut is_alone = |is_base_placed: bool, as_learned: usize, goes_on: usize| {
            found.placed[0] = is_base_placed;
            found.verdict.parts[0].edges = EdgeCounts::default();
            found.verdict.parts[1].edges = EdgeCounts { as_learned, goes_on };
            is_texture_alone(&found)
        };
        assert!(is_alone(false, 0, 0));
        assert!(is_alone(false, 5, 9), "the surface goes on");
        assert!(!is_alone(false, 5, 0));
        assert!(!is_alone(true, 0, 0));
    }

    #[test]
    fn a_configuration_that_is_left_over_is_told_but_is_no_evidence_for_the_object() {
        let ((articulated, cloud), scene) = (flap(), scene(|_, _| false));
        let config = RecogniseConfig::default();
        let decided = |score: f64| {
            let refiner = Refiner::by_surface(&scene, &articulated, &cloud, &config);
            let state = State { camera_from_object: Pose::identity(), q: vec![0.7] };
            let mut verdict = verify(&scene, &articulated, &cloud, &state);
            // The wall is plain; a textured one would correlate.
            verdict.parts[0].correlation = Some(0.9);
            decide(&refiner, RefinedPose { state, score, inliers: 20, verdict })
        };
        let of_wall_alone = decided(0.8);
        assert!(
            of_wall_alone.placed == [true, false] && !is_believed(of_wall_alone.score, &config)
        );
        let certain = decided(1.0);
        assert!(certain.evident == [true] && certain.score < 0.6, "{}", certain.score);
    }
}
