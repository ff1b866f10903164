//! Decides which of the static surface belongs to the object's base, and not to the room or to a
//! dynamic object.

use super::occupancy::{COARSE_M, Occupancy, cell};
use super::part_labels::{LabelGrid, PosedFrame, STEP};
use super::room_planes::{Plane, is_room, room_planes};
use nalgebra::Point3;
use std::collections::{HashMap, HashSet};

/// The base's features are kept within this distance of what moved, metres.
const FEATURE_MARGIN_M: f64 = 0.3;
/// The base's surface is kept within this distance of what moved, metres.
const SURFACE_MARGIN_M: f64 = 0.25;
/// Where that surface is little, the base's surface is kept this much farther along what is connected
/// to it, metres.
const BASE_REACH_M: f64 = 0.4;
/// Coarse cells of the base's surface that are enough to recognise the base.
const ENOUGH_SURFACE: usize = 40;

/// Where the object's base is, in the object frame.
pub struct Region {
    /// Where features are the base's.
    pub features: Occupancy,
    /// Where surface is the base's.
    pub surface: Occupancy,
    room: Vec<Plane>,
    dynamic: Occupancy,
}

impl Region {
    /// The surface near the moving parts, without the room's; where that is little, also the surface
    /// that is connected to it: the foot under a seat.
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

    /// A point at depth `z`, metres, belongs to the base and lies in `region`, which is one of its two.
    pub fn is_own_base(&self, region: &Occupancy, p: &Point3<f64>, z: f64) -> bool {
        region.holds(p) && !self.dynamic.holds(p) && !is_room(&self.room, p, z)
    }
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
