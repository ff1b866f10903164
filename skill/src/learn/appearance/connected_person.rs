//! Finds the surface that is connected with something that moves by itself: the person who shows the object stands
//! beside it and may hardly move, but the arm moves, and the trunk is connected with it.
//!
//! In: a labelled keyframe, and the planes of the room (object frame, metres).
//! Out: the places of the label grid that are connected with a place that belongs neither to the base nor to a part.
//! From: region growing in the depth image.

use super::part_labels::{LabelGrid, PosedFrame, STEP};
use super::room_planes::Room;
use crate::math::grid::four_neighbours;
use std::collections::HashSet;

/// Largest difference of depth between neighbouring places of one surface: metres, plus a share of the depth.
const SAME_SURFACE: (f64, f64) = (0.015, 0.006);

/// Places, by column and row of the grid, that are connected with what moves by itself. Planes of the room are left
/// out, because floor, table and wall connect everything that stands on them.
pub fn connected(posed: &PosedFrame, grid: &LabelGrid, room: &Room) -> HashSet<(usize, usize)> {
    let frame = posed.frame;
    let Some(camera_from_base) = posed.camera_from_part[0] else { return HashSet::new() };
    let size = (frame.camera.width / STEP, frame.camera.height / STEP);
    let pixel = |(c, r): (usize, usize)| (c * STEP + STEP / 2, r * STEP + STEP / 2);
    let depth = |place: (usize, usize)| {
        let (u, v) = pixel(place);
        frame.point_at(u, v)
    };
    let is_foreign = |place: (usize, usize)| {
        let (u, v) = pixel(place);
        grid.is_foreign(u, v)
    };
    let all = (0..size.1).flat_map(|r| (0..size.0).map(move |c| (c, r)));
    // A single foreign place may be an error; on an arm, the neighbours are foreign too.
    let mut front: Vec<(usize, usize)> = all
        .filter(|place| is_foreign(*place) && four_neighbours(*place, size).all(is_foreign))
        .collect();
    let mut reached: HashSet<(usize, usize)> = front.iter().copied().collect();
    while let Some(place) = front.pop() {
        let Some(here) = depth(place) else { continue };
        for next in four_neighbours(place, size) {
            let (u, v) = pixel(next);
            let Some(there) = depth(next).filter(|_| grid.at(u, v) == Some(0)) else { continue };
            let step = SAME_SURFACE.0 + SAME_SURFACE.1 * here.z;
            let is_one_surface = (there.z - here.z).abs() < step
                && !room.holds(&camera_from_base.inverse_transform_point(&there), there.z);
            if is_one_surface && reached.insert(next) {
                front.push(next);
            }
        }
    }
    reached
}
