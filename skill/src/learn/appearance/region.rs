//! Decides which static surface belongs to the object's base, and not to the room or to a dynamic object.
//!
//! In: labelled keyframes, and the swept volume of the moving parts (object frame, metres).
//! Out: cells of the object frame in which features and surface belong to the base.

use super::connected_person::connected;
use super::occupancy::{COARSE_M, Occupancy};
use super::part_labels::{LabelGrid, PosedFrame, STEP};
use super::room_planes::{Plane, is_room, room_planes};
use crate::math::grid::cell;
use nalgebra::Point3;
use std::collections::{HashMap, HashSet};

/// Largest distance of the base's features from the swept volume, metres.
const FEATURE_MARGIN_M: f64 = 0.3;
/// Largest distance of the base's surface from the swept volume, metres, unless there is little of it.
const SURFACE_MARGIN_M: f64 = 0.25;
/// Reach of the base along connected surface, metres, if little surface lies near the swept volume.
const BASE_REACH_M: f64 = 0.4;
/// Number of coarse cells of the base's surface that is enough to recognise the base.
const ENOUGH_SURFACE: usize = 40;

/// Where the object's base is, in the object frame.
pub struct Region {
    /// Cells in which features may belong to the base.
    pub features: Occupancy,
    /// Cells in which surface may belong to the base.
    pub surface: Occupancy,
    room: Vec<Plane>,
    dynamic: Occupancy,
}

impl Region {
    /// The region near the moving parts, without the room's planes. If it holds little static surface, the surface
    /// connected to it is added: the foot under a seat.
    pub fn new(swept: &Occupancy, posed: &[PosedFrame], labelled: &[(usize, LabelGrid)]) -> Self {
        let room = room_planes(posed.first(), swept);
        let near = swept.grown(SURFACE_MARGIN_M);
        let (resting, dynamic) = resting_surface(posed, labelled, &room);
        let little = near.0.intersection(&resting.0).count() < ENOUGH_SURFACE;
        let reach = if little { BASE_REACH_M } else { 0.0 };
        let connected = near.extended_along(&resting, reach);
        Self {
            features: swept.grown(FEATURE_MARGIN_M).with(&connected),
            surface: near.with(&connected),
            room,
            dynamic,
        }
    }

    /// True if a point in the object frame, seen at depth `z`, metres, belongs to the base and lies in `region`,
    /// which is `features` or `surface`.
    pub fn is_own_base(&self, region: &Occupancy, p: &Point3<f64>, z: f64) -> bool {
        region.holds(p) && !self.is_dynamic(p) && !is_room(&self.room, p, z)
    }

    /// True if more keyframes show a dynamic object than static surface in the cell of a point.
    pub fn is_dynamic(&self, p: &Point3<f64>) -> bool {
        self.dynamic.holds(p)
    }
}

/// Two sets of cells, object frame: where at least a quarter of the labelled keyframes show static surface that is
/// not the room's, and where more keyframes show a dynamic object than static surface.
fn resting_surface(
    posed: &[PosedFrame],
    labelled: &[(usize, LabelGrid)],
    room: &[Plane],
) -> (Occupancy, Occupancy) {
    // For each cell, the number of keyframes that show static surface, and of those that show a dynamic object.
    let mut shown: HashMap<[i32; 3], [usize; 2]> = HashMap::new();
    for (index, grid) in labelled {
        let frame = posed[*index].frame;
        let Some(camera_from_base) = posed[*index].camera_from_part[0] else { continue };
        let person = connected(&posed[*index], grid, room);
        let mut here = HashSet::new();
        for v in (STEP / 2..frame.camera.height).step_by(STEP) {
            for u in (STEP / 2..frame.camera.width).step_by(STEP) {
                if grid.at(u, v) != Some(0) {
                    continue;
                }
                let is_dynamic = grid.is_dynamic(u, v) || person.contains(&(u / STEP, v / STEP));
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

#[cfg(test)]
mod tests {
    use super::super::dynamic_features::FrameFeatures;
    use super::super::part_labels::label;
    use super::*;
    use crate::math::rigid::Pose;
    use crate::test_data::{board, seen};
    use linkage_frames::RgbdFrame;

    const FRONT_M: f64 = 1.5;
    const WALL_M: f64 = 3.0;

    /// What moved: a strip in the middle of the front, just before it.
    fn swept() -> Occupancy {
        let side = || (-3..=3).map(|i| 0.03 * f64::from(i));
        Occupancy::new(side().flat_map(|x| side().map(move |y| Point3::new(x, y, FRONT_M - 0.05))))
    }

    /// The region of a cupboard 60 cm wide before a wall; features that move are seen at some places.
    fn region(dynamic: &[Point3<f64>]) -> Region {
        let frames: Vec<RgbdFrame> =
            (0..8).map(|i| seen(i + 1, board(0.3, FRONT_M, WALL_M))).collect();
        let posed: Vec<PosedFrame> = frames
            .iter()
            .map(|frame| PosedFrame {
                frame,
                number: 0,
                camera_from_part: vec![Some(Pose::identity())],
            })
            .collect();
        let features = FrameFeatures { dynamic: dynamic.to_vec(), resting: Vec::new() };
        let labelled: Vec<(usize, LabelGrid)> =
            (0..8).map(|i| (i, label(&posed, i, &|_, _| false, &features))).collect();
        Region::new(&swept(), &posed, &labelled)
    }

    #[test]
    fn the_front_around_what_moved_is_the_bases_and_the_wall_is_the_rooms() {
        let region = region(&[]);
        let front = Point3::new(0.2, 0.1, FRONT_M);
        assert!(region.is_own_base(&region.surface, &front, FRONT_M));
        assert!(region.is_own_base(&region.features, &front, FRONT_M));
        let wall = Point3::new(0.2, 0.1, WALL_M);
        assert!(!region.is_own_base(&region.surface, &wall, WALL_M));
        assert!(is_room(&region.room, &wall, WALL_M));
    }

    #[test]
    fn features_reach_a_little_farther_than_surface() {
        let region = region(&[]);
        // Cells are 4 cm wide: each margin is rounded to these.
        let beside = Point3::new(0.09 + 0.27, 0.0, FRONT_M - 0.05);
        assert!(region.features.holds(&beside) && !region.surface.holds(&beside));
    }

    #[test]
    fn where_somebody_stands_before_the_front_it_is_not_the_bases() {
        let hand = Point3::new(0.16, 0.0, FRONT_M);
        let near = |i: i32| hand + nalgebra::Vector3::new(0.01 * f64::from(i), 0.0, 0.0);
        let region = region(&(0..4).map(near).collect::<Vec<_>>());
        assert!(!region.is_own_base(&region.surface, &hand, FRONT_M));
        let elsewhere = Point3::new(-0.16, 0.0, FRONT_M);
        assert!(region.is_own_base(&region.surface, &elsewhere, FRONT_M));
    }

    #[test]
    fn without_keyframes_the_region_is_what_is_near_to_what_moved() {
        let region = Region::new(&swept(), &[], &[]);
        assert!(region.surface.holds(&Point3::new(0.2, 0.0, FRONT_M - 0.05)));
        assert!(!region.surface.holds(&Point3::new(0.6, 0.0, FRONT_M - 0.05)));
        assert!(region.dynamic.0.is_empty() && region.room.is_empty());
    }
}
