//! Recognition in a future encounter: which learned object is in the image, the pose of its frame, and the
//! configuration of each of its joints.
//!
//! In: a [`Scene`] (one prepared RGB-D frame) and known objects.
//! Out: a [`Recognition`]: poses, joint lines and configurations in the camera frame, metres and radians.
//! From: paper, section III-E, which matches descriptors; the refinement and verification are ours.
//!
//! The steps for one object, one file each: its features are matched with those of the scene (`matching`). Matches
//! that agree geometrically give hypotheses of a part's pose; the other parts follow through their joints
//! (`hypothesis`). A hypothesis is refined (`refine`) and verified (`verify`, `edge_test`), since neither geometry
//! nor inliers alone distinguish similar objects. Which configurations are reported is decided last (`evidence`,
//! `ambiguity`, `elimination`). Objects without features are searched in their room (`room_search`), and
//! the room gives the place of a base that is not in sight (`base_by_room`). [`Follower`]
//! follows an object from frame to frame. An index of words (`retrieval`) selects the objects of a large store to be
//! searched.

mod ambiguity;
mod base_by_room;
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
mod part_by_contour;
mod patch_colour;
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
pub use result::{JointState, PartEvidence, RECOGNITION_SCHEMA, Recognised, Recognition};
pub use scene::Scene;
pub use still_frames::StillFrames;

use nalgebra::Point3;
use object_search::{MAX_SHARED, ObjectSearch};
use occupied_space::OccupiedVoxels;
use rayon::prelude::*;
use shape::ContourGrid;
use std::cell::OnceCell;
use std::sync::Arc;

/// Searches the scene for every object and returns those above the threshold, best first.
///
/// If distinct matches lead to no object at all, each object is searched again with all matches, which at least doubles
/// the time, then in its room and, if configured, by its shape; of objects that are found by shape in one place, one is
/// kept. Of a recognised object whose base is not in sight, the room gives configurations. The contour of plain parts
/// gives further ones.
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
    let contour = OnceCell::new();
    retry_plain(&mut searches, scene, config, &contour);
    searches.par_iter_mut().for_each(ObjectSearch::complete_by_room);
    complete_by_contour(&mut searches, scene, &contour);
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

/// If nothing was recognised, searches for each object in its room, then, if configured, by its shape. `contour`: that
/// of the scene, once it is needed.
fn retry_plain(
    searches: &mut [ObjectSearch],
    scene: &Scene,
    config: &RecogniseConfig,
    contour: &OnceCell<ContourGrid>,
) {
    let is_recognised =
        |searches: &[ObjectSearch]| searches.iter().any(ObjectSearch::is_recognised);
    if !scene.has_depth() || is_recognised(searches) {
        return;
    }
    let seen = contour.get_or_init(|| ContourGrid::of(scene));
    searches.par_iter_mut().for_each(|search| search.retry_in_room(seen));
    if config.try_shape && !is_recognised(searches) {
        searches.iter_mut().for_each(|search| search.retry_by_shape(seen));
        withdraw_overlapping(searches);
    }
}

/// Adds configurations of plain parts of recognised objects by their contour; of several objects of one class, to the
/// first one only. Takes about 0.1 s where a configuration is unknown.
fn complete_by_contour(
    searches: &mut [ObjectSearch],
    scene: &Scene,
    contour: &OnceCell<ContourGrid>,
) {
    let lacking = searches.iter_mut().filter(|search| search.lacks_configuration());
    let mut lacking: Vec<&mut ObjectSearch> = lacking.collect();
    if scene.has_depth() && !lacking.is_empty() {
        let seen = contour.get_or_init(|| ContourGrid::of(scene));
        lacking.par_iter_mut().for_each(|search| search.complete_by_contour(seen));
    }
}

/// Of objects that were found by shape in one place, keeps the one that explains most of the image.
fn withdraw_overlapping(searches: &mut [ObjectSearch]) {
    let mut order: Vec<usize> = (0..searches.len()).collect();
    let explained = |i: &usize| searches[*i].explained_by_shape();
    order.sort_by(|a, b| explained(b).total_cmp(&explained(a)).then(a.cmp(b)));
    let mut kept: Vec<(Vec<Point3<f64>>, OccupiedVoxels)> = Vec::new();
    for i in order {
        let Some(places) = searches[i].places() else { continue };
        let mut own = OccupiedVoxels::default();
        own.add(&places);
        // A small object may stand within a large one.
        let is_shared = kept
            .iter()
            .any(|(others, occupied)| occupied.share(&places).max(own.share(others)) > MAX_SHARED);
        if is_shared {
            searches[i].withdraw();
        } else {
            kept.push((places, own));
        }
    }
}

/// Best explanation of the scene by one object, whatever its score; `None` if too few matches agree geometrically.
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
    search.complete_by_room();
    complete_by_contour(std::slice::from_mut(&mut search), scene, &OnceCell::new());
    search.best()
}

#[cfg(test)]
mod tests {
    use super::test_data::{BOARD_M, PLATE_M, on_board, on_plate};
    use super::*;
    use crate::features::quantised::quantise;
    use crate::object::appearance::{Appearance, ModelFeature, Surfel};
    use crate::object::joint_geometry::JointGeometry;
    use crate::object::model::{Joint, MODEL_SCHEMA, ObjectModel, Part, ReferenceFrame};
    use crate::test_data::{painted, patches};
    use linkage_frames::RgbdFrame;
    use nalgebra::Vector3;

    /// Distance of the wall behind both parts, metres.
    const WALL_M: f64 = 2.5;

    /// A painted plate, and a painted board that was slid to the right by so much, before a plain wall.
    fn slider(paint: u32, slid: f64) -> RgbdFrame {
        let part = move |x: f64, y: f64| match (on_board(x - slid / BOARD_M, y), on_plate(x, y)) {
            (true, _) => Some(1),
            (false, true) => Some(0),
            (false, false) => None,
        };
        let depth = move |x, y| part(x, y).map_or(WALL_M, |part| [PLATE_M, BOARD_M][part]);
        painted(1, depth, move |x, y| match part(x, y) {
            Some(1) => patches(paint, BOARD_M * x - slid, BOARD_M * y),
            Some(_) => patches(paint + 1, PLATE_M * x, PLATE_M * y),
            None => 120,
        })
    }

    fn scene(paint: u32, slid: f64) -> Scene {
        Scene::new(&slider(paint, slid)).unwrap()
    }

    /// Known object made of one scene of the slider, at configuration 0.
    fn known(name: &str, paint: u32) -> Arc<KnownObject> {
        let scene = scene(paint, 0.0);
        let part_at = |z: f64| match z {
            z if z < 0.5 * (BOARD_M + PLATE_M) => Some(1),
            z if z < 0.5 * (PLATE_M + WALL_M) => Some(0),
            _ => None,
        };
        let narrow = |v: Vector3<f64>| v.map(|x| x as f32).into();
        let feature = |f: &crate::features::DescribedFeature| {
            let point = f.point?;
            Some(ModelFeature {
                part: part_at(point.z)?,
                kind: f.kind,
                point: narrow(point.coords),
                normal: narrow(f.normal),
                size_m: f.size as f32,
                descriptor: quantise(&f.descriptor).to_vec(),
            })
        };
        let camera = &scene.frame.camera;
        let surfel = |(u, v): (usize, usize)| {
            let surface = scene.surface(u, v)?;
            let point = camera.back_project(u as f64, v as f64, surface.z);
            Some(Surfel {
                part: part_at(point.z)?,
                point: narrow(point.coords),
                normal: narrow(surface.normal),
                lab: scene.lab.at(u, v),
            })
        };
        let pixels = (0..camera.height)
            .step_by(3)
            .flat_map(|v| (0..camera.width).step_by(3).map(move |u| (u, v)));
        let appearance = Appearance {
            features: scene.features.iter().filter_map(feature).collect(),
            surfels: pixels.filter_map(surfel).collect(),
            ..Appearance::default()
        };
        let slide = JointGeometry::slide(Vector3::x_axis(), Point3::origin());
        let model = ObjectModel {
            schema: MODEL_SCHEMA.to_owned(),
            object: name.to_owned(),
            reference_frame: ReferenceFrame::at_camera(0.0),
            parts: vec![Part::new(0, "base", 9), Part::new(1, "part1", 9)],
            joints: vec![Joint { range: [0.0, 0.3], ..Joint::of(&slide) }],
            demonstrations: 1,
            profile: "default".to_owned(),
            version: "0".to_owned(),
        };
        Arc::new(KnownObject::new(model, &appearance))
    }

    fn recognised(scene: &Scene, objects: &[Arc<KnownObject>]) -> Recognition {
        recognise(scene, objects, &RecogniseConfig::default(), 1)
    }

    #[test]
    fn a_thing_is_recognised_where_it_stands_and_its_configuration_is_told() {
        let found = recognised(&scene(1, 0.1), &[known("slider", 1)]);
        let [slider] = &found.matches[..] else { panic!("{found:?}") };
        assert_eq!(slider.object, "slider");
        let pose = crate::math::rigid::pose_from_array(&slider.camera_from_object).unwrap();
        assert!(pose.translation.vector.norm() < 0.01 && pose.rotation.angle() < 0.02, "{pose}");
        let configuration = slider.joints[0].configuration.unwrap();
        assert!((configuration - 0.1).abs() < 0.005, "{configuration}");
    }

    #[test]
    fn of_several_things_only_the_one_in_sight_is_reported() {
        let objects = [known("other", 20), known("slider", 1), known("third", 40)];
        let found = recognised(&scene(1, 0.0), &objects);
        let names: Vec<&str> = found.matches.iter().map(|m| m.object.as_str()).collect();
        assert_eq!(names, ["slider"]);
    }

    #[test]
    fn where_nothing_known_is_in_sight_nothing_is_reported() {
        assert!(recognised(&scene(1, 0.0), &[]).matches.is_empty());
        let other = known("other", 20);
        assert!(recognised(&scene(1, 0.0), std::slice::from_ref(&other)).matches.is_empty());
        assert!(find(&scene(1, 0.0), &other, &RecogniseConfig::default(), 1).is_none());
    }

    #[test]
    fn one_object_is_found_whatever_score_is_asked_for() {
        let strict = RecogniseConfig { min_score: 1.0, ..RecogniseConfig::default() };
        let (scene, slider) = (scene(1, 0.0), known("slider", 1));
        assert!(find(&scene, &slider, &strict, 1).is_some_and(|found| found.score > 0.5));
        let refused = recognise(&scene, &[slider], &strict, 1);
        assert!(refused.matches.is_empty());
        assert_eq!(refused.best_refused_object.as_deref(), Some("slider"));
        assert!(refused.best_refused > 0.5);
    }

    #[test]
    fn the_same_picture_and_seed_give_the_same_answer() {
        let (scene, objects) = (scene(1, 0.1), [known("slider", 1)]);
        assert_eq!(recognised(&scene, &objects), recognised(&scene, &objects));
    }
}
