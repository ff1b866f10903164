//! Builds an object's appearance from its demonstration.

pub(crate) mod occlusion_edges;
mod albedo;
mod dynamic_features;
mod part_labels;

use super::demonstration::Demonstration;
use crate::features::quantised::{product, quantise, similarity};
use crate::features::{FeatureDensity, FeatureKind, Keypoints};
use crate::image::cielab::CielabImage;
use crate::math::rigid::plane_through;
use crate::math::robust::without_strays;
use crate::object::appearance::{Appearance, ModelFeature, Surfel};
use linkage_frames::depth::{NormalMap, depth_sigma};
use nalgebra::{Point3, Vector3};
use albedo::{Piece, SeenColour, albedos};
use dynamic_features::DynamicFeatures;
use occlusion_edges::edges;
use part_labels::{LabelGrid, NearPart, PosedFrame, STEP, belongs, label};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};

/// Side of a voxel in which surface is averaged, metres, for an object one metre away;
/// farther ones are seen in fewer, noisier pixels.
const VOXEL_M: f64 = 0.006;
/// Keyframes whose depth is asked which part a pixel belongs to.
const LABEL_FRAMES: usize = 32;
/// Side of a cell of the coarse occupancy that stands for "near", metres.
const COARSE_M: f64 = 0.04;
/// How far beyond its tracked features a part may extend, metres.
const PART_REACH_M: f64 = 0.12;
/// A place is a stray unless this many others lie this near, metres.
const STRAY_M: f64 = 0.08;
const STRAY_NEIGHBOURS: usize = 4;
/// Side of a neighbourhood whose pieces of surface are compared in colour, metres.
const NEIGHBOURHOOD_M: f64 = 0.1;
/// Views of one point are merged within this distance, metres.
const MERGE_M: f64 = 0.015;

/// Coarse occupied space.
struct Occupancy(HashSet<[i32; 3]>);

impl Occupancy {
    fn new(points: impl Iterator<Item = Point3<f64>>) -> Self {
        Self(points.map(|p| cell(&p, COARSE_M)).collect())
    }

    /// All cells within `margin`.
    fn grown(&self, margin: f64) -> Self {
        let reach = (margin / COARSE_M).round() as i32;
        let mut grown = HashSet::new();
        for c in &self.0 {
            for x in -reach..=reach {
                for y in -reach..=reach {
                    for z in -reach..=reach {
                        if x * x + y * y + z * z <= reach * reach {
                            grown.insert([c[0] + x, c[1] + y, c[2] + z]);
                        }
                    }
                }
            }
        }
        Self(grown)
    }

    fn holds(&self, p: &Point3<f64>) -> bool {
        self.0.contains(&cell(p, COARSE_M))
    }

    /// The cells of `surface` that hang together with this, up to `reach` away from it along
    /// the surface.
    fn extended_along(&self, surface: &Self, reach: f64) -> Self {
        let mut front: Vec<[i32; 3]> = self.0.intersection(&surface.0).copied().collect();
        let mut reached: HashSet<[i32; 3]> = front.iter().copied().collect();
        for _ in 0..(reach / COARSE_M).round() as usize {
            front = front
                .iter()
                .flat_map(neighbours)
                .filter(|c| surface.0.contains(c) && reached.insert(*c))
                .collect();
        }
        Self(reached)
    }

    /// True when no cell lies within `distance` of a place.
    fn is_far_from(&self, p: &Point3<f64>, distance: f64) -> bool {
        let centre = |c: &[i32; 3]| Point3::from(c.map(|x| (f64::from(x) + 0.5) * COARSE_M));
        self.0.iter().all(|c| (centre(c) - p).norm() > distance)
    }

    fn with(mut self, other: &Self) -> Self {
        self.0.extend(&other.0);
        self
    }
}

/// Cells that touch a cell.
fn neighbours(c: &[i32; 3]) -> impl Iterator<Item = [i32; 3]> + use<> {
    let [x, y, z] = *c;
    (0..27).map(move |i| [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1])
}

fn cell(p: &Point3<f64>, side: f64) -> [i32; 3] {
    [0, 1, 2].map(|k| (p[k] / side).floor() as i32)
}

/// Keyframes that are described.
const DESCRIBED_KEYFRAMES: usize = 16;
/// Features kept per part.
const MAX_FEATURES_PER_PART: usize = 2000;
/// Surfels kept per part.
const MAX_SURFELS_PER_PART: usize = 1200;
/// Edges kept per part.
const MAX_EDGES_PER_PART: usize = 300;
/// The base's features are kept within this distance of what moved, metres.
const FEATURE_MARGIN_M: f64 = 0.3;
/// The base's surface is kept within this distance of what moved, metres.
const SURFACE_MARGIN_M: f64 = 0.25;
/// Where that is little, the base's surface is kept this much farther along what hangs together with
/// it, metres.
const BASE_REACH_M: f64 = 0.4;
/// The base's edges are kept within this distance of what moved, metres: farther away rooms differ.
const EDGE_MARGIN_M: f64 = 0.1;
/// Keyframes described side by side: more would hold more pictures' normals in memory.
const AT_ONCE: usize = 2;

/// Builds the appearance; empty when the demonstration has no joints.
pub fn build(demonstration: &Demonstration) -> opencv::Result<Appearance> {
    if demonstration.model.joints.is_empty() {
        return Ok(Appearance::default());
    }
    let posed = posed_frames(demonstration, LABEL_FRAMES);
    let parts = demonstration.model.parts.len();
    let tracked: Vec<Vec<Point3<f64>>> = (0..parts)
        .map(|p| if p == 0 { Vec::new() } else { tracked_points(demonstration, &posed, p) })
        .collect();
    let reach: Vec<Occupancy> = tracked
        .iter()
        .map(|points| Occupancy::new(points.iter().copied()).grown(PART_REACH_M))
        .collect();
    let near_part = |part: usize, p: &Point3<f64>| reach[part].holds(p);
    let swept = swept_volume(demonstration, &tracked);
    let described: Vec<usize> =
        (0..posed.len()).step_by(posed.len().div_ceil(DESCRIBED_KEYFRAMES).max(1)).collect();
    let Some(first) = posed.first() else { return Ok(Appearance::default()) };
    let dynamic_features = DynamicFeatures::new(demonstration, &first.frame.camera);
    let labelled: Vec<(usize, LabelGrid)> = described
        .into_par_iter()
        .map(|index| {
            let mut features = dynamic_features.in_frame(posed[index].number);
            // A feature that moves near a part may lie on that part.
            features.dynamic.retain(|p| !is_near_a_part(&posed[index], p, &near_part));
            (index, label(&posed, index, &near_part, &features))
        })
        .collect();
    let region = Region::new(&swept, &posed, &labelled);
    let voxel_m = VOXEL_M * object_distance(demonstration).max(1.0);
    let mut builder = Builder { voxel_m, features: Vec::new(), voxels: HashMap::new() };
    // Pictures are described side by side and taken in their order, so that sums come out the
    // same whatever the number of threads.
    for some in labelled.chunks(AT_ONCE) {
        let seen = some
            .par_iter()
            .map(|(index, grid)| BaseObservation::new(&posed[*index], grid, &region))
            .collect::<opencv::Result<Vec<BaseObservation>>>()?;
        for ((index, _), seen) in some.iter().zip(seen) {
            builder.take(*index, seen);
        }
    }
    let surface = surfels(builder.voxels);
    let near = swept.grown(EDGE_MARGIN_M);
    let ends = |s: &&Surfel| s.part > 0 || near.holds(&Point3::from(s.point.map(f64::from)));
    let beside: Vec<Surfel> = surface.iter().filter(ends).copied().collect();
    Ok(Appearance {
        features: merged(builder.features, MAX_FEATURES_PER_PART),
        surfels: thinned(&surface, MAX_SURFELS_PER_PART),
        edges: edges(&posed, &beside, &demonstration.model, MAX_EDGES_PER_PART),
    })
}

/// A place in the camera frame may lie on a part that moves.
fn is_near_a_part(posed: &PosedFrame, place: &Point3<f64>, near_part: &NearPart) -> bool {
    let parts = posed.camera_from_part.iter().enumerate().skip(1);
    parts
        .filter_map(|(part, pose)| Some((part, pose.as_ref()?.inverse_transform_point(place))))
        .any(|(part, at_rest)| near_part(part, &at_rest))
}

/// Coarse cells of the base's surface that are enough to know it by.
const LITTLE_SURFACE: usize = 40;
/// A plane may be the room's when two fifths of it lie farther than this from what moved, metres.
const ROOM_CLEARANCE_M: f64 = 0.2;
/// A tenth of the room's plane lies farther than this from what moved, metres, or beyond the picture:
/// floor, table and wall go on, a foot under a seat does not.
const ROOM_REACH_M: f64 = 0.5;
/// Samples at the picture's border by which a plane leaves it.
const LEAVING: usize = 4;

/// Which of the base belongs to the object.
struct Region {
    features: Occupancy,
    surface: Occupancy,
    room: Vec<Plane>,
    dynamic: Occupancy,
}

impl Region {
    /// What is near the moving parts but not the room's; where that is little, what hangs
    /// together with it as well: the foot under a seat.
    fn new(swept: &Occupancy, posed: &[PosedFrame], labelled: &[(usize, LabelGrid)]) -> Self {
        let room = room_planes(posed.first(), swept);
        let near = swept.grown(SURFACE_MARGIN_M);
        let (resting, dynamic) = resting_surface(posed, labelled, &room);
        let little = near.0.intersection(&resting.0).count() < LITTLE_SURFACE;
        let reach = if little { BASE_REACH_M } else { 0.0 };
        let connected = near.extended_along(&resting, reach);
        Self {
            features: swept.grown(FEATURE_MARGIN_M).with(&connected),
            surface: near.with(&connected),
            room,
            dynamic,
        }
    }

    fn is_own_base(&self, region: &Occupancy, p: &Point3<f64>, z: f64) -> bool {
        region.holds(p) && !self.dynamic.holds(p) && !is_room(&self.room, p, z)
    }
}

fn is_room(room: &[Plane], p: &Point3<f64>, z: f64) -> bool {
    room.iter().any(|plane| plane.holds(p, z))
}

/// Two sets of cells: where several of the labelled keyframes show surface that rests and is not the
/// room's, and where more keyframes show a dynamic object than show surface that rests.
fn resting_surface(
    posed: &[PosedFrame],
    labelled: &[(usize, LabelGrid)],
    room: &[Plane],
) -> (Occupancy, Occupancy) {
    // Number of keyframes that show in a cell what rests, and of those that show what is dynamic.
    let mut shown: HashMap<[i32; 3], [usize; 2]> = HashMap::new();
    for (index, grid) in labelled {
        let frame = posed[*index].frame;
        let Some(camera_from_base) = posed[*index].camera_from_part[0] else { continue };
        let mut here = HashSet::new();
        for v in (STEP / 2..frame.camera.height).step_by(STEP) {
            for u in (STEP / 2..frame.camera.width).step_by(STEP) {
                if grid.at(u, v) != Some(0) {
                    continue;
                }
                let is_dynamic = grid.is_dynamic(u, v);
                let Some(p) = frame.point_at(u, v) else { continue };
                let in_base = camera_from_base.inverse_transform_point(&p);
                if !is_room(room, &in_base, p.z) {
                    here.insert((cell(&in_base, COARSE_M), usize::from(is_dynamic)));
                }
            }
        }
        for (cell, is_dynamic) in here {
            shown.entry(cell).or_default()[is_dynamic] += 1;
        }
    }
    let often = labelled.len().div_ceil(4);
    let cells = |is_meant: &dyn Fn(&[usize; 2]) -> bool| {
        Occupancy(shown.iter().filter(|(_, n)| is_meant(n)).map(|(c, _)| *c).collect())
    };
    (cells(&|[rests, _]| *rests >= often), cells(&|[rests, dynamic]| dynamic > rests))
}

/// A plane of the room, in the object frame.
struct Plane {
    normal: Vector3<f64>,
    through: Point3<f64>,
}

impl Plane {
    fn holds(&self, p: &Point3<f64>, z: f64) -> bool {
        self.normal.dot(&(p - self.through)).abs() < 0.012 + 3.0 * depth_sigma(z)
    }
}

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

/// Places of a part's tracks at configuration 0, from their first posed observation; of a plain
/// part those of its plane. The hand that moves the part moves with it: what the keyframes
/// contradict is left out.
fn tracked_points(
    demonstration: &Demonstration,
    posed: &[PosedFrame],
    part: usize,
) -> Vec<Point3<f64>> {
    let poses = &demonstration.camera_from_part;
    let points = demonstration
        .tracks
        .tracks
        .iter()
        .zip(&demonstration.track_parts)
        .filter(|(_, p)| **p == Some(part))
        .filter_map(|(track, _)| {
            track.lifted().find_map(|(f, p)| {
                let at_rest = poses[part][f]?.inverse_transform_point(&p);
                Some((at_rest, poses[0][f]?.inverse_transform_point(&p)))
            })
        })
        .filter(|(at_rest, in_base)| belongs(posed, part, at_rest, in_base))
        .map(|(at_rest, _)| at_rest)
        .chain(demonstration.plain_surface[part].iter().copied())
        .collect::<Vec<_>>();
    // One stray would make an object of the room round it.
    without_strays(&points, STRAY_M, STRAY_NEIGHBOURS)
}

/// Median depth of the moving parts' features and plain surfaces, metres.
fn object_distance(demonstration: &Demonstration) -> f64 {
    let plain = demonstration.camera_from_part.iter().zip(&demonstration.plain_surface);
    let of_plain = plain.filter_map(|(poses, places)| {
        let pose = poses.iter().flatten().next()?;
        Some(places.iter().map(move |p| (pose * p).z))
    });
    let mut depths: Vec<f64> = demonstration
        .tracks
        .tracks
        .iter()
        .zip(&demonstration.track_parts)
        .filter(|(_, p)| p.is_some_and(|p| p > 0))
        .filter_map(|(track, _)| track.lifted().next().map(|(_, p)| p.z))
        .chain(of_plain.flatten())
        .collect();
    crate::math::robust::median(&mut depths).unwrap_or(1.0)
}

/// All that moving parts passed through.
fn swept_volume(demonstration: &Demonstration, tracked: &[Vec<Point3<f64>>]) -> Occupancy {
    let frames = demonstration.frame_utimes.len();
    let mut points = Vec::new();
    for f in (0..frames).step_by(4) {
        let Some(camera_from_object) = demonstration.camera_from_part[0][f] else { continue };
        for (part, at_rest) in tracked.iter().enumerate().skip(1) {
            if let Some(pose) = demonstration.camera_from_part[part][f] {
                let object_from_part = camera_from_object.inverse() * pose;
                points.extend(at_rest.iter().map(|p| object_from_part * p));
            }
        }
    }
    Occupancy::new(points.into_iter())
}

/// A piece of surface in the object frame.
struct Sample {
    point: Point3<f64>,
    normal: Vector3<f64>,
    /// Its depth when seen.
    z: f64,
    /// It was seen at the picture's border.
    at_border: bool,
}

impl Plane {
    fn carries(&self, s: &Sample) -> bool {
        self.holds(&s.point, s.z) && s.normal.dot(&self.normal) > 0.93
    }
}

/// Planes of the first keyframe that lead away from what moved: floor, table, wall.
fn room_planes(first: Option<&PosedFrame>, swept: &Occupancy) -> Vec<Plane> {
    let Some((frame, camera_from_object)) =
        first.and_then(|f| Some((f.frame, f.camera_from_part[0]?)))
    else {
        return Vec::new();
    };
    let normals = NormalMap::new(&frame.depth, &frame.camera);
    let mut left: Vec<Sample> = Vec::new();
    let (width, height) = (frame.camera.width, frame.camera.height);
    let near_border = |x: usize, side: usize| x < BORDER_PX || x + BORDER_PX >= side;
    for v in (0..height).step_by(6) {
        for u in (0..width).step_by(6) {
            let (Some(p), Some(n)) = (frame.point_at(u, v), normals.at(u, v)) else { continue };
            if p.z < 3.5 {
                left.push(Sample {
                    point: camera_from_object.inverse_transform_point(&p),
                    normal: camera_from_object.inverse_transform_vector(&n.normal),
                    z: p.z,
                    at_border: near_border(u, width) || near_border(v, height),
                });
            }
        }
    }
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut planes = Vec::new();
    for _ in 0..8 {
        if left.len() < 150 {
            break;
        }
        let mut best: (usize, Option<Plane>) = (0, None);
        let mut order: Vec<usize> = (0..left.len()).collect();
        order.partial_shuffle(&mut rng, 80);
        for &i in order.iter().rev().take(80) {
            let plane = Plane { normal: left[i].normal, through: left[i].point };
            let count = left.iter().filter(|s| plane.carries(s)).count();
            if count > best.0 {
                best = (count, Some(plane));
            }
        }
        let (count, Some(plane)) = best else { break };
        if count < 120 {
            break;
        }
        // One pixel's normal is noisy: the plane is fitted to all that follow it, twice.
        let plane = refitted(&refitted(&plane, &left), &left);
        let (on, off): (Vec<_>, Vec<_>) = left.into_iter().partition(|s| plane.carries(s));
        left = off;
        if leads_away(&on, swept) {
            planes.push(plane);
        }
    }
    planes
}

/// A pixel as near to the border as this is at it.
const BORDER_PX: usize = 16;

fn leads_away(plane: &[Sample], swept: &Occupancy) -> bool {
    let beyond = |distance: f64| {
        plane.iter().filter(|s| swept.is_far_from(&s.point, distance)).count() as f64
            / plane.len() as f64
    };
    let leaves = plane.iter().filter(|s| s.at_border).count() >= LEAVING;
    beyond(ROOM_CLEARANCE_M) > 0.4 && (leaves || beyond(ROOM_REACH_M) > 0.1)
}

/// The plane through all samples that lie on a plane.
fn refitted(plane: &Plane, samples: &[Sample]) -> Plane {
    let on: Vec<Point3<f64>> =
        samples.iter().filter(|s| plane.carries(s)).map(|s| s.point).collect();
    let (through, normal) = plane_through(&on);
    let facing = normal.dot(&plane.normal).signum();
    Plane { normal: normal * facing, through }
}

/// Part, cell and main direction of the normal: two sides of a board stay apart.
type VoxelKey = (u16, [i32; 3], u8);
/// Part and cell.
type PlaceKey = (u16, [i32; 3]);

/// Surface gathered in one voxel.
#[derive(Default)]
struct Voxel {
    point: Vector3<f64>,
    normal: Vector3<f64>,
    count: f64,
    colours: Vec<SeenColour>,
}

/// Surface seen at a pixel, in the object frame at configuration 0.
struct SeenSurfel {
    part: u16,
    point: Point3<f64>,
    normal: Vector3<f64>,
    lab: [f32; 3],
}

/// What one keyframe shows of the object.
struct BaseObservation {
    features: Vec<ModelFeature>,
    surface: Vec<SeenSurfel>,
}

impl BaseObservation {
    fn new(posed: &PosedFrame, grid: &LabelGrid, region: &Region) -> opencv::Result<Self> {
        let normals = NormalMap::new(&posed.frame.depth, &posed.frame.camera);
        Ok(Self {
            features: seen_features(posed, grid, region, &normals)?,
            surface: seen_surface(posed, grid, region, &normals)?,
        })
    }
}

fn seen_features(
    posed: &PosedFrame,
    grid: &LabelGrid,
    region: &Region,
    normals: &NormalMap,
) -> opencv::Result<Vec<ModelFeature>> {
    let on_a_part = |u, v| grid.at(u, v).is_some();
    let keypoints = Keypoints::new(posed.frame, FeatureDensity::Model, on_a_part)?;
    let placed = keypoints.describe(posed.frame, normals)?.into_iter().filter_map(|feature| {
        let (u, v) = (feature.pixel[0] as usize, feature.pixel[1] as usize);
        let (part, point) = (grid.at(u, v)?, feature.point?);
        let pose = posed.camera_from_part[usize::from(part)]?;
        let at_rest = pose.inverse_transform_point(&point);
        let own = part != 0 || region.is_own_base(&region.features, &at_rest, point.z);
        own.then(|| ModelFeature {
            part,
            kind: feature.kind,
            point: at_rest.coords.map(|x| x as f32).into(),
            normal: pose.inverse_transform_vector(&feature.normal).map(|x| x as f32).into(),
            size_m: feature.size as f32,
            descriptor: quantise(&feature.descriptor).to_vec(),
        })
    });
    Ok(placed.collect())
}

fn seen_surface(
    posed: &PosedFrame,
    grid: &LabelGrid,
    region: &Region,
    normals: &NormalMap,
) -> opencv::Result<Vec<SeenSurfel>> {
    let frame = posed.frame;
    let lab = CielabImage::new(&frame.color)?;
    let mut surface = Vec::new();
    for v in (STEP / 2..frame.camera.height).step_by(STEP / 2) {
        for u in (STEP / 2..frame.camera.width).step_by(STEP / 2) {
            let Some(part) = grid.at(u, v) else { continue };
            let Some(pose) = &posed.camera_from_part[usize::from(part)] else { continue };
            let Some(patch) = normals.at(u, v) else { continue };
            let in_camera = frame.camera.back_project(u as f64, v as f64, patch.z);
            if -patch.normal.dot(&in_camera.coords.normalize()) < 0.25 {
                continue;
            }
            let point = pose.inverse_transform_point(&in_camera);
            if part == 0 && !region.is_own_base(&region.surface, &point, in_camera.z) {
                continue;
            }
            let normal = pose.inverse_transform_vector(&patch.normal);
            surface.push(SeenSurfel { part, point, normal, lab: lab.at(u, v) });
        }
    }
    Ok(surface)
}

struct Builder {
    voxel_m: f64,
    features: Vec<(ModelFeature, usize)>,
    voxels: HashMap<VoxelKey, Voxel>,
}

impl Builder {
    fn take(&mut self, keyframe: usize, seen: BaseObservation) {
        self.features.extend(seen.features.into_iter().map(|f| (f, keyframe)));
        for s in seen.surface {
            let side = s.normal.iamax() as u8 * 2 + u8::from(s.normal[s.normal.iamax()] > 0.0);
            let voxel =
                self.voxels.entry((s.part, cell(&s.point, self.voxel_m), side)).or_default();
            voxel.point += s.point.coords;
            voxel.normal += s.normal;
            voxel.count += 1.0;
            let lab = Vector3::from(s.lab.map(f64::from));
            match voxel.colours.last_mut().filter(|seen| seen.keyframe == keyframe) {
                Some(seen) => seen.add(lab),
                None => voxel.colours.push(SeenColour::new(keyframe, lab)),
            }
        }
    }
}

/// All of the surface, in an order that stands for none of it.
fn surfels(voxels: HashMap<VoxelKey, Voxel>) -> Vec<Surfel> {
    let mut solid: Vec<(VoxelKey, Voxel)> = voxels
        .into_iter()
        .filter(|(_, v)| v.colours.len() >= 2 && v.count >= 3.0 && v.normal.norm() > 0.8 * v.count)
        .collect();
    solid.sort_by_key(|(key, _)| *key);
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    solid.shuffle(&mut rng);
    let pieces = solid.iter().map(|((part, _, side), v)| Piece {
        face: (*part, *side),
        neighbourhood: cell(&Point3::from(v.point / v.count), NEIGHBOURHOOD_M),
        seen: &v.colours,
    });
    let albedos = albedos(&pieces.collect::<Vec<_>>());
    let surfel = |(((part, _, _), v), albedo): ((VoxelKey, Voxel), Vector3<f64>)| Surfel {
        part,
        point: (v.point / v.count).map(|x| x as f32).into(),
        normal: v.normal.normalize().map(|x| x as f32).into(),
        lab: albedo.map(|x| x as f32).into(),
    };
    solid.into_iter().zip(albedos).map(surfel).collect()
}

/// The first so many of each part.
fn thinned(surfels: &[Surfel], per_part: usize) -> Vec<Surfel> {
    let mut taken: HashMap<u16, usize> = HashMap::new();
    let mut is_among_first = |s: &&Surfel| {
        let count = taken.entry(s.part).or_default();
        *count += 1;
        *count <= per_part
    };
    let mut kept: Vec<Surfel> = surfels.iter().filter(&mut is_among_first).copied().collect();
    kept.sort_by_key(|s| s.part);
    kept
}

/// Views of one point (same part and kind, near, similar size and description) become one
/// feature; those seen most often are kept first.
fn merged(features: Vec<(ModelFeature, usize)>, per_part: usize) -> Vec<ModelFeature> {
    let mut cells: HashMap<PlaceKey, Vec<usize>> = HashMap::new();
    for (i, (f, _)) in features.iter().enumerate() {
        let p = Point3::from(Vector3::from(f.point).map(f64::from));
        cells.entry((f.part, cell(&p, 2.0 * MERGE_M))).or_default().push(i);
    }
    let mut groups: Vec<(PlaceKey, Vec<usize>)> = cells.into_iter().collect();
    groups.sort_by_key(|(key, _)| *key);
    let mut kept: Vec<(usize, usize)> = Vec::new();
    for (_, mut members) in groups {
        while let Some((best, support)) = members
            .iter()
            .map(|&i| {
                (i, members.iter().filter(|&&j| alike(&features[i].0, &features[j].0)).count())
            })
            .max_by_key(|&(i, support)| (support, std::cmp::Reverse(i)))
        {
            kept.push((best, support));
            members.retain(|&j| !alike(&features[best].0, &features[j].0));
        }
    }
    kept.sort_by_key(|&(i, support)| (std::cmp::Reverse(support), i));
    let mut taken: HashMap<(u16, FeatureKind), usize> = HashMap::new();
    let mut result: Vec<ModelFeature> = Vec::new();
    for (i, _) in kept {
        let feature = &features[i].0;
        let count = taken.entry((feature.part, feature.kind)).or_default();
        if *count < per_part / 2 {
            *count += 1;
            result.push(feature.clone());
        }
    }
    result.sort_by_key(|f| f.part);
    result
}

fn alike(a: &ModelFeature, b: &ModelFeature) -> bool {
    let apart = Vector3::from(a.point) - Vector3::from(b.point);
    let size = (a.size_m / b.size_m).ln().abs();
    let distance_sq = 2.0 - 2.0 * similarity(product(&a.descriptor, &b.descriptor));
    a.kind == b.kind && f64::from(apart.norm()) < MERGE_M && size < 0.3 && distance_sq < 0.2
}
