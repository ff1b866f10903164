//! Recognition in a future encounter (paper, section III-E): which learned object is in the
//! picture, where its frame is, and at which configuration each of its joints is.
//!
//! In: a [`Scene`] (one frame, prepared) and known objects. Out: a [`Recognition`]: poses, lines of
//! joints and configurations in the camera frame, metres and radians.
//!
//! The way of one object, a file a step: its features are compared with the scene's (`matching`);
//! hypotheses of each part's pose come from matches that agree in space, the other parts follow
//! through their joints (`hypothesis`); everything is refined together (`refine`); the result is
//! verified against the picture (`verify`, `edge_test`): geometry alone cannot tell look-alikes
//! apart, inliers alone cannot either. What of it is told is decided last (`evidence`, `ambiguity`,
//! `elimination`). Where nothing is found by its own features, plain things are looked for in the room in
//! which they were learned (`room_search`). [`Follower`] then follows the object from frame to frame, and an index of
//! words (`retrieval`) tells which objects of a large store are worth a search.

mod ambiguity;
pub(crate) mod config;
mod edge_test;
mod elimination;
mod evidence;
mod follow;
mod hypothesis;
mod kinematics;
mod known_object;
mod matching;
mod normal_equations;
mod object_search;
mod occupied_space;
mod patch_colour;
#[cfg(test)]
mod plain_slider;
mod pnp;
mod refine;
mod render_cloud;
pub(crate) mod result;
pub(crate) mod retrieval;
mod room_search;
mod scene;
mod shape;
mod shape_search;
mod still_frames;
mod stillness;
mod surface_cache;
#[cfg(test)]
mod test_data;
mod verdict;
mod verify;

use config::RecogniseConfig;
pub use follow::{Asked, Followed, Follower, Lost};
pub use known_object::KnownObject;
pub use result::{JointState, RECOGNITION_SCHEMA, Recognised, Recognition};
pub use scene::Scene;
pub use still_frames::StillFrames;

use object_search::ObjectSearch;
use rayon::prelude::*;
use shape::ContourGrid;
use std::sync::Arc;

/// Looks for every object in the scene; those above the threshold, best first.
///
/// Where distinct matches lead to no object at all, all matches are tried, of each. That costs as
/// much again, and more: where something is known to be seen it is not asked for.
#[must_use]
pub fn recognise(
    scene: &Scene,
    objects: &[Arc<KnownObject>],
    config: &RecogniseConfig,
    seed: u64,
) -> Recognition {
    let mut searches: Vec<ObjectSearch> = objects
        .par_iter()
        .map(|object| ObjectSearch::by_distinct_matches(scene, object, config, seed))
        .collect();
    if !searches.iter().any(ObjectSearch::is_recognised) {
        searches.par_iter_mut().for_each(ObjectSearch::retry_with_all_matches);
    }
    retry_plain(&mut searches, scene, config);
    let instances: Vec<(Vec<Recognised>, f64)> =
        searches.into_par_iter().map(ObjectSearch::same_class_instances).collect();
    let refused: Vec<f64> = instances.iter().map(|(_, refused)| *refused).collect();
    let matches = instances.into_iter().flat_map(|(matches, _)| matches).collect();
    let mut recognition = Recognition::new(matches);
    for (object, score) in objects.iter().zip(refused) {
        recognition.refuse(&object.model.object, score);
    }
    recognition
}

/// Where nothing was recognised, looks for each object without features of its own: in its room, then
/// by its shape.
fn retry_plain(searches: &mut [ObjectSearch], scene: &Scene, config: &RecogniseConfig) {
    let is_recognised =
        |searches: &[ObjectSearch]| searches.iter().any(ObjectSearch::is_recognised);
    if !scene.has_depth() || is_recognised(searches) {
        return;
    }
    let seen = ContourGrid::of(scene);
    searches.par_iter_mut().for_each(|search| search.retry_in_room(&seen));
    if config.try_shape && !is_recognised(searches) {
        searches.iter_mut().for_each(|search| search.retry_by_shape(&seen));
    }
}

/// The best explanation of the scene by one object, whatever its score; `None` when too few
/// matches agree in space.
#[must_use]
pub fn find(
    scene: &Scene,
    object: &KnownObject,
    config: &RecogniseConfig,
    seed: u64,
) -> Option<Recognised> {
    let mut search = ObjectSearch::by_distinct_matches(scene, object, config, seed);
    if !search.is_recognised() {
        search.retry_with_all_matches();
    }
    search.best()
}
