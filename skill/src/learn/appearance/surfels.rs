//! The surface of the object as surfels: points with a normal and an albedo.

use super::albedo::{Piece, SeenColour, albedos};
use super::occupancy::cell;
use super::part_labels::{LabelGrid, PosedFrame, STEP};
use super::region::Region;
use crate::image::cielab::CielabImage;
use crate::object::appearance::Surfel;
use linkage_frames::depth::NormalMap;
use nalgebra::{Point3, Vector3};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use std::collections::HashMap;

/// Side of a neighbourhood whose pieces of surface are compared in colour, metres.
const NEIGHBOURHOOD_M: f64 = 0.1;

/// Part, cell and main direction of the normal: the two sides of a board are kept apart.
type VoxelKey = (u16, [i32; 3], u8);

/// Surface gathered in one voxel.
#[derive(Default)]
struct Voxel {
    point: Vector3<f64>,
    normal: Vector3<f64>,
    count: f64,
    colours: Vec<SeenColour>,
}

/// Surface seen at a pixel, in the object frame at configuration 0.
pub struct SeenSurfel {
    part: u16,
    point: Point3<f64>,
    normal: Vector3<f64>,
    lab: [f32; 3],
}

/// The surface that a keyframe shows of the object.
pub fn seen_surface(
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

/// Surface averaged in voxels.
pub struct VoxelGrid {
    voxel_m: f64,
    voxels: HashMap<VoxelKey, Voxel>,
}

impl VoxelGrid {
    /// An empty grid whose voxels have this side, metres.
    pub fn new(voxel_m: f64) -> Self {
        Self { voxel_m, voxels: HashMap::new() }
    }

    /// Adds the surface that a keyframe shows.
    pub fn add(&mut self, keyframe: usize, surface: Vec<SeenSurfel>) {
        for s in surface {
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

    /// A surfel for each voxel that at least two keyframes show, shuffled: the first ones are spread
    /// over the whole surface.
    pub fn into_surfels(self) -> Vec<Surfel> {
        surfels(self.voxels)
    }
}

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

/// The first `per_part` surfels of each part.
pub fn thinned(surfels: &[Surfel], per_part: usize) -> Vec<Surfel> {
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
