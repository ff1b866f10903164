//! Describes the surface of the object as surfels: points with a normal and an albedo.
//!
//! In: labelled keyframes with the pose of each part.
//! Out: surfels in the object frame at configuration 0, metres; albedo in CIELAB.

use super::albedo::{Piece, SeenColour, albedos};
use super::part_labels::{LabelGrid, PosedFrame, STEP};
use super::region::Region;
use crate::image::cielab::CielabImage;
use crate::math::grid::cell;
use crate::object::appearance::Surfel;
use linkage_frames::depth::NormalMap;
use nalgebra::{Point3, Vector3};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use std::collections::HashMap;

/// Side of a neighbourhood whose pieces of surface are compared in colour, metres.
const NEIGHBOURHOOD_M: f64 = 0.1;

/// Part, cell, and main direction of the normal; the direction keeps the two sides of a board
/// apart.
type VoxelKey = (u16, [i32; 3], u8);

/// Sums over the surface points of one voxel, with the colour in each keyframe.
#[derive(Default)]
struct Voxel {
    point: Vector3<f64>,
    normal: Vector3<f64>,
    count: f64,
    colours: Vec<SeenColour>,
}

/// Surface seen at one pixel, in the object frame at configuration 0.
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

/// Surface of several keyframes, averaged in voxels.
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

    /// One surfel for each voxel that at least two keyframes show with consistent normals. The
    /// order is random, so that the first surfels are spread over the whole surface.
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

#[cfg(test)]
mod tests {
    use super::*;

    const VOXEL_M: f64 = 0.02;

    /// Surface at a place.
    type Place = fn() -> SeenSurfel;

    /// A grey place in the middle of a voxel of a part, looking along `normal`.
    fn place(part: u16, column: i32, normal: Vector3<f64>) -> SeenSurfel {
        let x = VOXEL_M * (f64::from(column) + 0.5);
        SeenSurfel { part, point: Point3::new(x, 0.01, 1.01), normal, lab: [50.0, 1.0, 2.0] }
    }

    fn towards_camera() -> Vector3<f64> {
        -Vector3::z()
    }

    /// The surfels of what some keyframes show, each place twice.
    fn surfels_of(keyframes: &[(usize, Vec<Place>)]) -> Vec<Surfel> {
        let mut grid = VoxelGrid::new(VOXEL_M);
        for (keyframe, places) in keyframes {
            grid.add(*keyframe, places.iter().flat_map(|p| [p(), p()]).collect());
        }
        grid.into_surfels()
    }

    #[test]
    fn a_surfel_lies_where_its_places_lie_on_average() {
        let mut grid = VoxelGrid::new(VOXEL_M);
        let at = |x: f64, tilt: f64| SeenSurfel {
            point: Point3::new(x, 0.01, 1.01),
            normal: Vector3::new(tilt, 0.0, -1.0).normalize(),
            ..place(1, 0, towards_camera())
        };
        grid.add(0, vec![at(0.002, 0.1), at(0.008, -0.1)]);
        grid.add(1, vec![at(0.002, -0.1), at(0.008, 0.1)]);
        let [surfel] = grid.into_surfels()[..] else { panic!("one voxel, one surfel") };
        assert_eq!(surfel.part, 1);
        assert!((surfel.point[0] - 0.005).abs() < 1e-6 && (surfel.point[2] - 1.01).abs() < 1e-6);
        assert!((surfel.normal[2] + 1.0).abs() < 1e-6 && surfel.normal[0].abs() < 1e-6);
        assert!((surfel.lab[0] - 50.0).abs() < 1e-4);
    }

    #[test]
    fn what_one_keyframe_alone_shows_is_no_surfel() {
        let here: Place = || place(0, 0, towards_camera());
        assert!(surfels_of(&[(0, vec![here, here, here])]).is_empty());
        assert_eq!(surfels_of(&[(0, vec![here]), (1, vec![here])]).len(), 1);
        assert!(surfels_of(&[]).is_empty());
    }

    #[test]
    fn both_sides_of_a_board_and_two_parts_in_one_place_are_kept_apart() {
        let places: [Place; 3] = [
            || place(0, 0, towards_camera()),
            || place(0, 0, -towards_camera()),
            || place(1, 0, towards_camera()),
        ];
        let found = surfels_of(&[(0, places.to_vec()), (1, places.to_vec())]);
        let mut sides: Vec<(u16, bool)> =
            found.iter().map(|s| (s.part, s.normal[2] > 0.0)).collect();
        sides.sort_unstable();
        assert_eq!(sides, [(0, false), (0, true), (1, false)]);
    }

    #[test]
    fn where_the_normals_disagree_there_is_no_surfel() {
        let leaning: [Place; 2] = [
            || place(0, 0, Vector3::new(0.7, 0.0, -0.72).normalize()),
            || place(0, 0, Vector3::new(-0.7, 0.0, -0.72).normalize()),
        ];
        assert!(surfels_of(&[(0, leaning.to_vec()), (1, leaning.to_vec())]).is_empty());
    }

    #[test]
    fn the_order_in_which_keyframes_come_does_not_matter() {
        let places: [Place; 4] = [
            || place(0, 0, towards_camera()),
            || place(0, 1, towards_camera()),
            || place(1, 5, towards_camera()),
            || place(0, -3, towards_camera()),
        ];
        let mut reversed = places.to_vec();
        reversed.reverse();
        let forth = surfels_of(&[(0, places.to_vec()), (1, places.to_vec())]);
        assert_eq!(forth, surfels_of(&[(0, reversed.clone()), (1, reversed)]));
        assert_eq!(forth.len(), 4);
    }

    #[test]
    fn the_first_surfels_of_each_part_are_kept_part_by_part() {
        let surfel = |part, x| Surfel {
            part,
            point: [x, 0.0, 1.0],
            normal: [0.0, 0.0, -1.0],
            lab: [50.0, 0.0, 0.0],
        };
        let all = [surfel(1, 0.0), surfel(0, 1.0), surfel(1, 2.0), surfel(1, 3.0), surfel(0, 4.0)];
        let kept: Vec<(u16, f32)> = thinned(&all, 2).iter().map(|s| (s.part, s.point[0])).collect();
        assert_eq!(kept, [(0, 1.0), (0, 4.0), (1, 0.0), (1, 2.0)]);
        assert!(thinned(&all, 0).is_empty() && thinned(&[], 5).is_empty());
    }
}
