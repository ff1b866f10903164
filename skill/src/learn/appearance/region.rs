//! Decides which static surface belongs to the object's base, and not to the room or to a dynamic object: it is
//! connected with the place of a moving part at rest. A person who stands beside the object, and what stands before
//! it on a table, are not.
//!
//! In: labelled keyframes, the swept volume of the moving parts, and their place at rest (object frame, metres).
//! Out: cells of the object frame in which features and surface belong to the base.

use super::connected_person::connected;
use super::occupancy::{COARSE_M, Occupancy};
use super::part_labels::{LabelGrid, PosedFrame, STEP};
use super::room_planes::{Room, room_planes};
use crate::math::grid::cell;
use nalgebra::Point3;
use std::collections::{HashMap, HashSet};

/// Distance of the base's features from the swept volume, metres. One cell is added for depth noise, and cells are
/// counted as wholes, so that features reach up to 0.36 m.
const FEATURE_MARGIN_M: f64 = 0.3;
/// Distance of the base's surface from the swept volume, metres, for the same reasons up to 0.28 m. Where little surface
/// is found, [`BASE_REACH_M`] applies.
const SURFACE_MARGIN_M: f64 = 0.25;
/// Largest distance from a moving part at rest to static surface that touches it, metres: the known points of a part
/// do not reach its edges.
const TOUCH_M: f64 = 0.08;
/// Fewest cells of connected surface. Fewer are errors of labels: what is near is taken instead. The foot of a screen
/// is not connected with what is known of the screen, which near its axis is hard to tell from the foot.
const MIN_CONNECTED: usize = 10;
/// Reach of the base along connected surface, metres, if little surface lies near the swept volume.
const BASE_REACH_M: f64 = 0.4;
/// Number of coarse cells of the base's surface that is enough to recognise the base.
const ENOUGH_SURFACE: usize = 40;

/// Fewest keyframes that show static surface: the inside of a cabinet is seen while its door stands open.
const MIN_KEYFRAMES: usize = 2;

/// Where the object's base is, in the object frame.
pub struct Region {
    /// Cells in which features may belong to the base.
    pub features: Occupancy,
    /// Cells in which surface may belong to the base.
    pub surface: Occupancy,
    room: Room,
    dynamic: Occupancy,
}

impl Region {
    /// The static surface near the moving parts that is connected with their place `at_rest`, without the room's
    /// planes. If there is little of it, connected surface farther away is added: the foot under a seat. If next to
    /// nothing is connected, the region is all that is near.
    pub fn new(
        swept: &Occupancy,
        at_rest: &Occupancy,
        posed: &[PosedFrame],
        labelled: &[(usize, LabelGrid)],
    ) -> Self {
        let room = room_planes(posed.first(), swept);
        let (resting, dynamic) = resting_surface(posed, labelled, &room);
        let touching = at_rest.grown(TOUCH_M);
        let connected_within = |margin: f64| {
            let near = swept.grown(margin);
            let connected = touching.connected(&near.intersection(&resting));
            if connected.0.len() < MIN_CONNECTED { near } else { connected }
        };
        let surface = connected_within(SURFACE_MARGIN_M);
        let little = surface.intersection(&resting).0.len() < ENOUGH_SURFACE;
        let farther = surface.extended_along(&resting, if little { BASE_REACH_M } else { 0.0 });
        // Depth noise moves surface to the next cell.
        let whole = |cells: Occupancy| cells.with(&farther).grown(COARSE_M);
        Self {
            features: whole(connected_within(FEATURE_MARGIN_M)),
            surface: whole(surface),
            room,
            dynamic,
        }
    }

    /// True if a point in the object frame, seen at depth `z`, metres, belongs to the base and lies in `region`,
    /// which is `features` or `surface`.
    pub fn is_own_base(&self, region: &Occupancy, p: &Point3<f64>, z: f64) -> bool {
        region.holds(p) && !self.is_dynamic(p) && !self.room.holds(p, z)
    }

    /// True if more keyframes show a dynamic object than static surface in the cell of a point.
    pub fn is_dynamic(&self, p: &Point3<f64>) -> bool {
        self.dynamic.holds(p)
    }
}

/// Two sets of cells, object frame: where at least [`MIN_KEYFRAMES`] keyframes show static surface that is not the
/// room's, and no more show a dynamic object; and where more keyframes show a dynamic object than static surface.
fn resting_surface(
    posed: &[PosedFrame],
    labelled: &[(usize, LabelGrid)],
    room: &Room,
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
                if !room.holds(&in_base, p.z) {
                    here.insert((cell(&in_base, COARSE_M), usize::from(is_dynamic)));
                }
            }
        }
        for (cell, is_dynamic) in here {
            shown.entry(cell).or_default()[is_dynamic] += 1;
        }
    }
    let cells = |is_meant: &dyn Fn(&[usize; 2]) -> bool| {
        Occupancy(shown.iter().filter(|(_, n)| is_meant(n)).map(|(c, _)| *c).collect())
    };
    (
        cells(&|[rests, dynamic]| *rests >= MIN_KEYFRAMES && dynamic <= rests),
        cells(&|[rests, dynamic]| dynamic > rests),
    )
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
        region_with(board(0.3, FRONT_M, WALL_M), dynamic)
    }

    /// The region where this depth is seen in each direction.
    fn region_of(depth: impl Fn(f64, f64) -> f64) -> Region {
        region_with(depth, &[])
    }

    fn region_with(depth: impl Fn(f64, f64) -> f64, dynamic: &[Point3<f64>]) -> Region {
        let frames: Vec<RgbdFrame> = (0..8).map(|i| seen(i + 1, &depth)).collect();
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
        Region::new(&swept(), &swept(), &posed, &labelled)
    }

    #[test]
    fn the_front_around_what_moved_is_the_bases_and_the_wall_is_the_rooms() {
        let region = region(&[]);
        let front = Point3::new(0.2, 0.1, FRONT_M);
        assert!(region.is_own_base(&region.surface, &front, FRONT_M));
        assert!(region.is_own_base(&region.features, &front, FRONT_M));
        let wall = Point3::new(0.2, 0.1, WALL_M);
        assert!(!region.is_own_base(&region.surface, &wall, WALL_M));
        assert!(region.room.holds(&wall, WALL_M));
    }

    #[test]
    fn what_stands_near_and_is_not_connected_is_not_the_bases() {
        // A box 20 cm before the front, beside what moved.
        let region = region_of(|x, y| {
            let z = FRONT_M - 0.2;
            let is_box = (0.12..0.25).contains(&(x * z)) && (y * z).abs() < 0.1;
            if is_box { z } else { board(0.3, FRONT_M, WALL_M)(x, y) }
        });
        let on_box = Point3::new(0.18, 0.0, FRONT_M - 0.2);
        assert!(!region.surface.holds(&on_box) && !region.features.holds(&on_box));
        let front = Point3::new(-0.18, 0.1, FRONT_M);
        assert!(region.is_own_base(&region.surface, &front, FRONT_M));
    }

    #[test]
    fn features_reach_a_little_farther_than_surface() {
        // The front goes on where surface of the base ends.
        let region = region_of(board(0.6, FRONT_M, WALL_M));
        let beside = Point3::new(0.09 + 0.34, 0.0, FRONT_M);
        assert!(region.features.holds(&beside) && !region.surface.holds(&beside));
    }

    #[test]
    fn where_nothing_is_connected_the_region_is_what_is_near() {
        // Only the wall is seen, which is the room's.
        let region = region_of(|_, _| WALL_M);
        assert!(region.surface.holds(&Point3::new(0.2, 0.0, FRONT_M - 0.05)));
        assert!(!region.surface.holds(&Point3::new(0.6, 0.0, FRONT_M - 0.05)));
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
    fn a_few_connected_cells_are_no_base() {
        // Of the front only a strip beside what moved is seen; the foot lies below, and is not connected.
        let strip =
            |x: f64, y: f64| (0.1..0.13).contains(&(x * FRONT_M)) && (y * FRONT_M).abs() < 0.04;
        let foot =
            |x: f64, y: f64| (0.22..0.4).contains(&(y * FRONT_M)) && (x * FRONT_M).abs() < 0.2;
        let region = region_of(|x, y| match () {
            () if strip(x, y) || foot(x, y) => FRONT_M,
            () => WALL_M,
        });
        let on_foot = Point3::new(0.0, 0.26, FRONT_M);
        assert!(region.is_own_base(&region.surface, &on_foot, FRONT_M));
    }

    #[test]
    fn without_keyframes_the_region_is_what_is_near_to_what_moved() {
        let region = Region::new(&swept(), &swept(), &[], &[]);
        assert!(region.surface.holds(&Point3::new(0.2, 0.0, FRONT_M - 0.05)));
        assert!(!region.surface.holds(&Point3::new(0.6, 0.0, FRONT_M - 0.05)));
        assert!(region.dynamic.0.is_empty() && !region.room.holds(&Point3::origin(), 1.0));
    }
}
