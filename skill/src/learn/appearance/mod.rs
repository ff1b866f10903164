//! Builds an object's appearance from its demonstration: features, surfels and occlusion edges.
//!
//! Each place of the keyframes is labelled with its part ([`part_labels`]). Of the static surface, only what belongs
//! to the object is kept ([`region`]). Several keyframes are then described: features ([`features`]), surface
//! ([`surfels`]) and where the surface ends ([`occlusion_edges`]).
//!
//! In: a demonstration: keyframes, tracks, and the pose of each part in each frame (camera_from_part).
//! Out: the appearance, in the object frame at configuration 0, metres; colours in CIELAB.
//! From: the paper's section III-E, which stores feature descriptors; surfels and edges are our additions.

mod albedo;
mod connected_person;
mod dynamic_features;
mod features;
mod moving_parts;
pub(crate) mod occlusion_edges;
pub(crate) mod occupancy;
mod other_light;
mod part_growth;
mod part_labels;
mod region;
mod room_planes;
mod shadows;
mod surfels;
mod tally;
#[cfg(test)]
mod test_data;

use super::demonstration::Demonstration;
use crate::object::appearance::{Appearance, ModelFeature, Surfel};
use dynamic_features::DynamicFeatures;
use features::{SeenFeatures, merged, seen_features};
use linkage_frames::depth::NormalMap;
use moving_parts::{object_distance, swept_volume, tracked_points};
use nalgebra::Point3;
use occlusion_edges::edges;
use occupancy::Occupancy;
use part_growth::grown;
use part_labels::{LabelGrid, NearPart, PosedFrame, label};
use rayon::prelude::*;
use region::Region;
use shadows::without_shadows;
use surfels::{SeenSurfel, VoxelGrid, seen_surface, thinned};

/// Side of a voxel in which surface is averaged, metres, for an object up to 1 m away. It grows in proportion to the
/// distance beyond, because a farther object is seen in fewer, noisier pixels.
const VOXEL_M: f64 = 0.006;
/// Most keyframes whose depth determines the part of a pixel.
const LABEL_FRAMES: usize = 32;
/// How far a part may extend beyond its known points, metres.
const PART_REACH_M: f64 = 0.12;
/// Most keyframes that are described.
const DESCRIBED_KEYFRAMES: usize = 16;
/// Most features kept per part, at most half of them of one kind.
const MAX_FEATURES_PER_PART: usize = 2000;
/// Most features of the room that are kept, at most half of them of one kind.
const MAX_ROOM_FEATURES: usize = 1200;
/// Most surfels kept per part.
const MAX_SURFELS_PER_PART: usize = 1200;
/// Most edges kept per part: the outline of a door is 6 m long, and an edge every few centimetres determines its
/// direction.
const MAX_EDGES_PER_PART: usize = 1200;
/// Largest distance of the base's edges from the swept volume, metres; farther away, rooms differ.
const EDGE_MARGIN_M: f64 = 0.1;
/// Keyframes described in parallel; more would hold more normal maps in memory.
const AT_ONCE: usize = 2;

/// Builds the appearance; empty if the demonstration has no joints.
pub fn build(demonstration: &Demonstration) -> opencv::Result<Appearance> {
    if demonstration.model.joints.is_empty() {
        return Ok(Appearance::default());
    }
    let posed = posed_frames(demonstration, LABEL_FRAMES);
    let tracked: Vec<Vec<Point3<f64>>> = (0..demonstration.model.parts.len())
        .map(|p| if p == 0 { Vec::new() } else { tracked_points(demonstration, &posed, p) })
        .collect();
    let tracks_of = |part| demonstration.track_parts.iter().filter(|p| **p == Some(part)).count();
    let tracks: Vec<usize> = (0..tracked.len()).map(tracks_of).collect();
    let tracked = grown(&posed, tracked, &tracks);
    let swept = swept_volume(demonstration, &tracked);
    let labelled = labelled_keyframes(demonstration, &posed, &tracked);
    let at_rest = Occupancy::new(tracked.iter().flatten().copied());
    let region = Region::new(&swept, &at_rest, &posed, &labelled);
    let voxel_m = VOXEL_M * object_distance(demonstration).max(1.0);
    let mut voxels = VoxelGrid::new(voxel_m);
    let (mut features, mut room) = (Vec::new(), Vec::new());
    // Keyframes are described in parallel and added in their order, so that the sums are the same
    // for any number of threads.
    for some in labelled.chunks(AT_ONCE) {
        let seen = some
            .par_iter()
            .map(|(index, grid)| SeenObject::new(&posed[*index], grid, &region))
            .collect::<opencv::Result<Vec<SeenObject>>>()?;
        for ((keyframe, _), seen) in some.iter().zip(seen) {
            let of_frame = |f: Vec<ModelFeature>| f.into_iter().map(|f| (f, *keyframe));
            features.extend(of_frame(seen.features.own));
            room.extend(of_frame(seen.features.room));
            voxels.add(*keyframe, seen.surface);
        }
    }
    let surface = voxels.into_surfels();
    let near = swept.grown(EDGE_MARGIN_M);
    let may_end = |s: &&Surfel| s.part > 0 || near.holds(&Point3::from(s.point.map(f64::from)));
    let near_motion: Vec<Surfel> = surface.iter().filter(may_end).copied().collect();
    Ok(Appearance {
        features: merged(features, MAX_FEATURES_PER_PART),
        surfels: thinned(&surface, MAX_SURFELS_PER_PART),
        edges: edges(&posed, &near_motion, &demonstration.model, MAX_EDGES_PER_PART),
        room: merged(room, MAX_ROOM_FEATURES),
    })
}

/// At most `wanted` keyframes, evenly spread, with the poses of the parts.
fn posed_frames<'d>(demonstration: &'d Demonstration, wanted: usize) -> Vec<PosedFrame<'d>> {
    let stride = demonstration.keyframes.len().div_ceil(wanted.max(1)).max(1);
    demonstration
        .keyframes
        .iter()
        .step_by(stride)
        .map(|(index, frame)| PosedFrame {
            frame,
            number: index,
            camera_from_part: demonstration.camera_from_part.iter().map(|t| t[index]).collect(),
        })
        .collect()
}

/// The keyframes that are described, each with its index in `posed` and the part of each place.
/// `tracked`: points of each part at configuration 0, object frame, metres.
fn labelled_keyframes(
    demonstration: &Demonstration,
    posed: &[PosedFrame],
    tracked: &[Vec<Point3<f64>>],
) -> Vec<(usize, LabelGrid)> {
    let Some(first) = posed.first() else { return Vec::new() };
    let reach: Vec<Occupancy> = tracked
        .iter()
        .map(|points| Occupancy::new(points.iter().copied()).grown(PART_REACH_M))
        .collect();
    let near_part = |part: usize, p: &Point3<f64>| reach[part].holds(p);
    let dynamic_features = DynamicFeatures::new(demonstration, &first.frame.camera);
    let described: Vec<usize> =
        (0..posed.len()).step_by(posed.len().div_ceil(DESCRIBED_KEYFRAMES).max(1)).collect();
    described
        .into_par_iter()
        .map(|index| {
            let mut features = dynamic_features.in_frame(posed[index].number);
            // A feature that moves near a part may lie on that part.
            features.dynamic.retain(|p| !is_near_a_part(&posed[index], p, &near_part));
            (index, label(posed, index, &near_part, &features))
        })
        .collect()
}

/// True if a point in the camera frame lies near a moving part.
fn is_near_a_part(posed: &PosedFrame, point: &Point3<f64>, near_part: &NearPart) -> bool {
    let parts = posed.camera_from_part.iter().enumerate().skip(1);
    parts
        .filter_map(|(part, pose)| Some((part, pose.as_ref()?.inverse_transform_point(point))))
        .any(|(part, at_rest)| near_part(part, &at_rest))
}

/// Features and surface that one keyframe shows of the object.
struct SeenObject {
    features: SeenFeatures,
    surface: Vec<SeenSurfel>,
}

impl SeenObject {
    fn new(posed: &PosedFrame, grid: &LabelGrid, region: &Region) -> opencv::Result<Self> {
        let normals = NormalMap::new(&posed.frame.depth, &posed.frame.camera);
        let grid = without_shadows(posed.frame, grid, &normals);
        Ok(Self {
            features: seen_features(posed, &grid, region, &normals)?,
            surface: seen_surface(posed, &grid, region, &normals)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::test_data::{FRAMES, demonstration, front, pulled_out};
    use super::*;

    #[test]
    fn the_front_of_a_drawer_is_learned_where_it_was_at_first() {
        let appearance = build(&pulled_out()).unwrap();
        let of_front: Vec<&Surfel> = appearance.surfels.iter().filter(|s| s.part == 1).collect();
        assert!(of_front.len() > 100, "{} surfels", of_front.len());
        for surfel in &of_front {
            let [x, y, z] = surfel.point;
            assert!((z - 1.5).abs() < 0.005 && x.abs() < 0.21 && y.abs() < 0.21);
            assert!(surfel.normal[2] < -0.99);
        }
        assert!(appearance.features.is_empty(), "it is plain");
        // It ends where the wall beside it is seen once it stands out.
        let of_front = appearance.edges.iter().filter(|edge| edge.part == 1);
        let ends: Vec<f32> =
            of_front.map(|edge| edge.beyond[0].abs().max(edge.beyond[1].abs())).collect();
        assert!(!ends.is_empty() && ends.iter().all(|end| (0.2..0.3).contains(end)), "{ends:?}");
    }

    #[test]
    fn an_object_without_joints_looks_like_nothing() {
        assert_eq!(build(&demonstration(&front())).unwrap(), Appearance::default());
    }

    #[test]
    fn the_same_demonstration_gives_the_same_appearance() {
        assert_eq!(build(&pulled_out()).unwrap(), build(&pulled_out()).unwrap());
    }

    #[test]
    fn keyframes_are_taken_evenly_and_no_more_than_wanted() {
        let whole = pulled_out();
        let numbers = |wanted: usize| {
            posed_frames(&whole, wanted).iter().map(|posed| posed.number).collect::<Vec<_>>()
        };
        assert_eq!(numbers(5), [0, 4, 8, 12]);
        assert_eq!(numbers(1000), (0..FRAMES).collect::<Vec<_>>());
        assert_eq!(numbers(0), [0]);
        assert!(posed_frames(&demonstration(&[]), 5).is_empty());
    }
}
