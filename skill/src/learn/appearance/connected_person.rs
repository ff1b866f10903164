//! Finds the surface that is connected with something that moves by itself: the person who shows the object stands
//! beside it and may hardly move, but the arm moves, and the trunk is connected with it.
//!
//! In: a labelled keyframe, and the planes of the room (object frame, metres).
//! Out: the places of the label grid that are connected with a place that belongs neither to the base nor to a part.
//! From: region growing in the depth image.

use super::part_labels::{LabelGrid, PosedFrame, STEP};
use super::room_planes::Room;
use crate::learn::one_surface::{Cell, connected_cells};
use crate::math::grid::four_neighbours;
use std::collections::HashSet;

/// Places, by column and row of the grid, that are connected with what moves by itself. Planes of the room are left
/// out, because floor, table and wall connect everything that stands on them.
pub fn connected(posed: &PosedFrame, grid: &LabelGrid, room: &Room) -> HashSet<Cell> {
    let frame = posed.frame;
    let Some(camera_from_base) = posed.camera_from_part[0] else { return HashSet::new() };
    let size = (frame.camera.width / STEP, frame.camera.height / STEP);
    let pixel = |(c, r): Cell| (c * STEP + STEP / 2, r * STEP + STEP / 2);
    let point = |place: Cell| {
        let (u, v) = pixel(place);
        frame.point_at(u, v)
    };
    let is_foreign = |place: Cell| {
        let (u, v) = pixel(place);
        grid.is_foreign(u, v)
    };
    let may_be_person = |place: Cell| {
        let (u, v) = pixel(place);
        let is_room = |p| room.holds(&camera_from_base.inverse_transform_point(&p), p.z);
        grid.at(u, v) == Some(0) && !point(place).is_some_and(is_room)
    };
    let all = (0..size.1).flat_map(|r| (0..size.0).map(move |c| (c, r)));
    // A single foreign place may be an error; on an arm, the neighbours are foreign too.
    let start = all
        .filter(|place| is_foreign(*place) && four_neighbours(*place, size).all(is_foreign))
        .collect();
    connected_cells(start, size, |place| point(place).map(|p| p.z), may_be_person)
}
