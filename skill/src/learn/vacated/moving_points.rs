//! Finds what moves near a surface, keyframe by keyframe: the readings through which other keyframes see. A part that
//! was moved is among them, and the hand that moved it. Where a joint puts the part, there must be such a reading; a
//! reading of a wall that was always there does not support it.
//!
//! In: the keyframes with the camera's poses, a place, a radius, and points on known parts; base frame, metres.
//! Out: the moving readings of each keyframe, base frame, and what they show of a point of a part.

use super::point_grid::{PointGrid, cell_of};
use super::view::View;
use crate::learn::free_space::depth_margin;
use crate::math::rigid::{Pose, matrix_pose};
use linkage_frames::depth::DepthBounds;
use nalgebra::{IsometryMatrix3, Point3, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Distance between two readings that are tested, pixels: a cell of [`DepthBounds`].
const STRIDE_PX: usize = DepthBounds::STRIDE_PX;
/// Width of the image border that is not used, pixels.
const BORDER_PX: f64 = 4.0;
/// Fewest keyframes that must see through a moving reading.
const MIN_THROUGH: usize = 2;
/// Fewest of the eight readings around a moving one that must move as well: edges of what rests flicker.
const MIN_BESIDE: usize = 4;
/// Largest distance from a known part at which a reading is the part's, metres.
pub const KNOWN_M: f64 = 0.03;
/// Edge of the cells that keep one reading each, metres.
const THIN_M: f64 = 0.008;
/// Largest distance from a point to the reading that is its own, metres.
pub const MAX_DISTANCE_M: f64 = 0.025;
/// Smallest cosine of the angle between a normal and the direction to the camera at which a surface is seen.
const MIN_FACING: f64 = 0.15;

/// What a keyframe shows of a point of a part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Evidence {
    /// A reading at the point or beside it moves, and the depths there do not exclude the point.
    Found,
    /// Something behind the point is seen.
    Through,
    /// The point is occluded or outside the image, has no reading, or lies on a surface that was always there.
    Unknown,
}

/// The moving readings of one keyframe.
pub struct MovingPoints<'v, 'r> {
    view: &'v View<'r>,
    /// Cells that move, and the cells beside them.
    next_to_moving: CellSet,
    /// Moving readings, thinned, base frame.
    readings: PointGrid,
}

impl<'v, 'r> MovingPoints<'v, 'r> {
    /// The moving readings within `radius` metres of a place, in each keyframe. Readings on known plain parts are
    /// left out; `known` gives points on these, by frame.
    pub fn near(
        centre: &Point3<f64>,
        radius: f64,
        views: &'v [View<'r>],
        known: &(dyn Fn(usize) -> Vec<Point3<f64>> + Sync),
    ) -> Vec<Self> {
        let of = |k: usize| Self::of_view(k, centre, radius, views, &known(views[k].frame));
        (0..views.len()).into_par_iter().map(of).collect()
    }

    fn of_view(
        k: usize,
        centre: &Point3<f64>,
        radius: f64,
        views: &'v [View<'r>],
        known: &[Point3<f64>],
    ) -> Self {
        let view = &views[k];
        let known = PointGrid::new(known, KNOWN_M);
        let others: Vec<&View> = (0..views.len()).filter(|i| *i != k).map(|i| &views[i]).collect();
        let near = cells(view).filter_map(|cell| {
            let [u, v] = pixel_of(cell);
            let place = view.surface_at(u, v)?;
            ((place - centre).norm() < radius).then_some((cell, place))
        });
        let mut readings = moving_readings(near, view, &others);
        readings.retain(|(_, place)| known.nearest(place).is_none());
        let moves = CellSet::of(view, readings.iter().map(|(cell, _)| *cell));
        let is_speck = |cell: Cell| beside(cell).filter(|c| moves.holds(*c)).count() < MIN_BESIDE;
        readings.retain(|(cell, _)| !is_speck(*cell));
        // Sorted row by row, so that the first reading of each spatial cell is kept.
        readings.sort_unstable_by_key(|(cell, _)| *cell);
        let mut thinned: BTreeMap<[i32; 3], Point3<f64>> = BTreeMap::new();
        for (_, place) in &readings {
            thinned.entry(cell_of(place, THIN_M)).or_insert(*place);
        }
        let thinned: Vec<Point3<f64>> = thinned.into_values().collect();
        let around = readings.iter().flat_map(|(cell, _)| beside(*cell).chain([*cell]));
        Self {
            view,
            next_to_moving: CellSet::of(view, around),
            readings: PointGrid::new(&thinned, MAX_DISTANCE_M),
        }
    }

    /// Frame number.
    pub fn frame(&self) -> usize {
        self.view.frame
    }

    /// Pose of a part in the camera frame, from its pose in the base frame.
    pub fn camera_from_part(&self, base_from_part: &Pose) -> IsometryMatrix3<f64> {
        self.view.camera_from_base * matrix_pose(base_from_part)
    }

    /// What the keyframe shows of a point of a part and its normal, both in the part's frame.
    #[inline]
    pub fn evidence(
        &self,
        camera_from_part: &IsometryMatrix3<f64>,
        place: &Point3<f64>,
        normal: &Vector3<f64>,
    ) -> Evidence {
        let in_camera = camera_from_part * place;
        let (camera, bounds) = (&self.view.picture.camera, self.view.picture.depth.bounds());
        let pixel = camera.project(&in_camera).filter(|px| camera.sees(px, BORDER_PX));
        let Some(cell) = pixel.and_then(|px| bounds.cell_at(px.x, px.y)) else {
            return Evidence::Unknown;
        };
        let margin = depth_margin(camera.depth_sensor, in_camera.z);
        let [nearest, farthest] = bounds.around(cell).map(f64::from);
        if nearest > in_camera.z + margin {
            return Evidence::Through;
        }
        let is_found = self.next_to_moving.has(cell)
            && farthest >= in_camera.z - margin
            && faces_camera(&in_camera, &(camera_from_part * normal));
        if is_found { Evidence::Found } else { Evidence::Unknown }
    }

    /// The moving reading nearest to a point, base frame; `None` if the point does not face the camera or no reading
    /// is near.
    pub fn nearest(&self, place: &Point3<f64>, normal: &Vector3<f64>) -> Option<Point3<f64>> {
        self.faces(place, normal).then(|| self.readings.nearest(place)).flatten()
    }

    /// True if the keyframe shows a surface, moving or not, within this distance of a place, metres; base frame.
    pub fn shows_within(&self, distance: f64, place: &Point3<f64>) -> bool {
        self.view.surface_near(place).is_some_and(|seen| (seen - place).norm() < distance)
    }

    /// True if the keyframe shows free space at a place; base frame.
    pub fn shows_behind(&self, place: &Point3<f64>) -> bool {
        self.view.shows_behind(place)
    }

    /// True if at least `least` moving readings were free space in an earlier keyframe: something has come since.
    pub fn has_arrived_since(&self, earlier: &Self, least: usize) -> bool {
        let arrived = self.readings.points().iter().filter(|p| earlier.view.shows_behind(p));
        arrived.take(least).count() == least
    }

    /// True if at least `least` moving readings are farther than `apart` metres from all `places`.
    pub fn has_apart_from(&self, places: &[Point3<f64>], apart: f64, least: usize) -> bool {
        let places = PointGrid::new(places, apart);
        let is_apart = |p: &&Point3<f64>| places.nearest(p).is_none();
        self.readings.points().iter().filter(is_apart).take(least).count() == least
    }

    /// Time of the keyframe, microseconds.
    pub fn utime(&self) -> i64 {
        self.view.picture.utime
    }

    /// True if a surface with this normal is seen from its front; base frame.
    pub fn faces(&self, place: &Point3<f64>, normal: &Vector3<f64>) -> bool {
        let camera_from_base = &self.view.camera_from_base;
        faces_camera(&(camera_from_base * place), &(camera_from_base * normal))
    }
}

/// True if a surface with this normal is seen from its front; camera frame.
pub fn faces_camera(place: &Point3<f64>, normal: &Vector3<f64>) -> bool {
    -normal.dot(&place.coords) > MIN_FACING * place.coords.norm()
}

/// Row and column of a cell.
type Cell = (usize, usize);

/// A cell and the point that is read in it, base frame.
type Reading = (Cell, Point3<f64>);

/// All cells of a keyframe.
fn cells(view: &View) -> impl Iterator<Item = Cell> {
    let bounds = view.picture.depth.bounds();
    let columns = bounds.columns();
    (0..bounds.len()).map(move |cell| (cell / columns, cell % columns))
}

/// Column and row of a cell's pixel.
fn pixel_of((row, column): Cell) -> [usize; 2] {
    [column * STRIDE_PX, row * STRIDE_PX]
}

/// The eight cells around one; those outside the image have a row or a column that no image has.
fn beside((row, column): Cell) -> impl Iterator<Item = Cell> {
    let steps = (0..9).filter(|k| *k != 4).map(|k| (k / 3, k % 3));
    let step = |x: usize, d: usize| x.wrapping_add(d).wrapping_sub(1);
    steps.map(move |(dy, dx)| (step(row, dy), step(column, dx)))
}

/// A set of cells of a keyframe.
struct CellSet {
    columns: usize,
    marks: Vec<bool>,
}

impl CellSet {
    /// The set of the given cells; cells outside the image are left out.
    fn of(view: &View, cells: impl Iterator<Item = Cell>) -> Self {
        let bounds = view.picture.depth.bounds();
        let mut set = Self { columns: bounds.columns(), marks: vec![false; bounds.len()] };
        for cell in cells {
            if let Some(index) = set.index(cell) {
                set.marks[index] = true;
            }
        }
        set
    }

    fn holds(&self, cell: Cell) -> bool {
        self.index(cell).is_some_and(|index| self.has(index))
    }

    /// True if the cell with this index, row by row, is in the set.
    #[inline]
    fn has(&self, index: usize) -> bool {
        self.marks[index]
    }

    fn index(&self, (row, column): Cell) -> Option<usize> {
        let index = row.checked_mul(self.columns)?.checked_add(column)?;
        (column < self.columns && index < self.marks.len()).then_some(index)
    }
}

/// The readings of a keyframe through which enough of the others see. One cell of four is tested first, then the
/// cells up to two beside a moving one. Everything that moves in two by two cells or more is found so; thinner pieces
/// may be missed.
fn moving_readings(
    readings: impl Iterator<Item = Reading>,
    view: &View,
    others: &[&View],
) -> Vec<Reading> {
    let is_first = |(row, column): Cell| row % 2 == 0 && column % 2 == 0;
    let (first, later): (Vec<Reading>, Vec<Reading>) =
        readings.partition(|(cell, _)| is_first(*cell));
    let first = seen_through(first, view, others);
    let around = first.iter().flat_map(|(cell, _)| beside(*cell));
    let around = CellSet::of(view, around.flat_map(|cell| beside(cell).chain([cell])));
    let beside_it = later.into_iter().filter(|(cell, _)| around.holds(*cell));
    let rest = seen_through(beside_it.collect(), view, others);
    first.into_iter().chain(rest).collect()
}

/// The readings through which enough of the other keyframes see. One of the others is tested on all readings before
/// the next one, so that its image stays in the processor's cache.
fn seen_through(readings: Vec<Reading>, view: &View, others: &[&View]) -> Vec<Reading> {
    let mut through = Vec::new();
    let mut undecided: Vec<(usize, Cell, Point3<f64>)> = Vec::new();
    for (cell, place) in readings {
        match view.is_seen_through(pixel_of(cell)) {
            Some(true) => through.push((cell, place)),
            Some(false) => {}
            None => undecided.push((0, cell, place)),
        }
    }
    for other in others {
        undecided.retain_mut(|(times, cell, place)| {
            *times += usize::from(other.shows_behind(place));
            let is_decided = *times >= MIN_THROUGH;
            if is_decided {
                view.keep_seen_through(pixel_of(*cell), true);
                through.push((*cell, *place));
            }
            !is_decided
        });
    }
    for (_, cell, _) in undecided {
        view.keep_seen_through(pixel_of(cell), false);
    }
    through
}

#[cfg(test)]
mod tests {
    use super::super::test_data::{PIVOT_M, lever, recording, turn};
    use super::*;
    use crate::learn::recording::Recording;

    fn moving(recording: &Recording, ask: impl Fn(&[MovingPoints])) {
        let views = View::all(recording);
        ask(&MovingPoints::near(&Point3::from(PIVOT_M), 0.6, &views, &|_| Vec::new()));
    }

    /// A point on the bar at this turn, radians.
    fn on_bar(turn: f64) -> Point3<f64> {
        Point3::from(PIVOT_M) + 0.25 * Vector3::new(turn.cos(), turn.sin(), 0.0)
    }

    #[test]
    fn a_keyframe_tells_where_the_part_is_and_where_it_is_not() {
        let to_camera = -Vector3::z();
        moving(&lever(turn), |views| {
            let [first, last] = [&views[0], &views[23]];
            let evidence = |view: &MovingPoints, place: &Point3<f64>, normal: &Vector3<f64>| {
                view.evidence(&view.camera_from_part(&Pose::identity()), place, normal)
            };
            let ask = |view: &MovingPoints, q: f64| evidence(view, &on_bar(q), &to_camera);
            assert_eq!(ask(first, 0.0), Evidence::Found);
            assert_eq!(ask(first, 1.2), Evidence::Through);
            assert_eq!(ask(last, 1.2), Evidence::Found);
            assert_eq!(ask(last, 0.0), Evidence::Through);
            let wall = Point3::new(0.0, -0.2, 1.6);
            assert_eq!(
                evidence(first, &wall, &to_camera),
                Evidence::Unknown,
                "it was always there"
            );
            let turned_away = evidence(first, &on_bar(0.0), &Vector3::z());
            assert_eq!(turned_away, Evidence::Unknown);
        });
    }

    #[test]
    fn the_reading_next_to_a_place_is_of_what_moves() {
        moving(&lever(turn), |views| {
            let beside = on_bar(0.0) + Vector3::new(0.0, 0.0, 0.01);
            let reading = views[0].nearest(&beside, &-Vector3::z()).unwrap();
            assert!((reading.z - PIVOT_M[2]).abs() < 1e-6);
            assert_eq!(views[0].nearest(&on_bar(1.2), &-Vector3::z()), None);
        });
    }

    #[test]
    fn what_moves_in_more_than_a_speck_is_found_by_a_quarter_of_the_cells() {
        let recording = lever(turn);
        let views = View::all(&recording);
        let view = &views[0];
        let others: Vec<&View> = views[1..].iter().collect();
        let readings = || {
            cells(view).filter_map(|cell| {
                let [u, v] = pixel_of(cell);
                Some((cell, view.surface_at(u, v)?))
            })
        };
        let sorted = |mut found: Vec<Reading>| {
            found.sort_by_key(|(cell, _)| *cell);
            found.into_iter().map(|(cell, _)| cell).collect::<Vec<Cell>>()
        };
        let quick = sorted(moving_readings(readings(), view, &others));
        let fresh = View::all(&recording);
        let all = sorted(seen_through(readings().collect(), &fresh[0], &others));
        assert!(quick.len() > 100);
        assert_eq!(quick, all);
    }

    #[test]
    fn cells_beside_the_border_are_outside() {
        let twice = beside((0, 0)).flat_map(beside).filter(|cell| *cell == (0, 0)).count();
        assert_eq!(twice, 8);
        let recording = lever(turn);
        let views = View::all(&recording);
        assert_eq!(CellSet::of(&views[0], beside((0, 0))).marks.iter().filter(|m| **m).count(), 3);
    }

    #[test]
    fn what_comes_is_told_from_what_was_there() {
        let block = |frame: usize| (frame > 2).then_some([0.25, -0.2]);
        moving(&recording(|_| 0.0, block), |views| {
            assert!(!views[1].has_arrived_since(&views[0], 1));
            assert!(views[5].has_arrived_since(&views[0], 30));
            assert!(views[5].has_apart_from(&[on_bar(0.0)], 0.1, 30));
            assert!(!views[5].has_apart_from(&[on_bar(0.0)], 9.0, 1));
        });
    }
}
