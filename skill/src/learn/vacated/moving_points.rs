//! What moves near a surface, keyframe by keyframe: the readings through which other keyframes see. A part
//! that was moved is among them, and the hand that moved it. Where a joint puts the part, there must be such
//! a reading: one of a wall that was always there is none of the part.

use super::point_grid::{PointGrid, cell_of};
use super::view::View;
use crate::learn::free_space::depth_margin;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Pixels between two readings that are asked about.
const STRIDE_PX: usize = 2;
/// Pixels at the border of a picture that are not asked.
const BORDER_PX: f64 = 4.0;
/// Fewest keyframes that must see through a reading.
const MIN_THROUGH: usize = 2;
/// Fewest of the eight readings around one that must move as well: edges of what rests flicker.
const MIN_BESIDE: usize = 4;
/// A reading that near to a known part is the part's, metres.
pub const KNOWN_M: f64 = 0.03;
/// Edge of the cells that thin the readings, metres.
const THIN_M: f64 = 0.008;
/// Largest distance of a place from the reading that is its own, metres.
pub const MAX_DISTANCE_M: f64 = 0.025;
/// Least cosine of the angle between a normal and the direction to the camera for which a surface is seen.
const MIN_FACING: f64 = 0.15;

/// What a keyframe says about a place of a part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Evidence {
    /// A reading around it moves, and none that is behind it excludes it.
    Found,
    /// Something behind it is seen.
    Through,
    /// Hidden, outside, no reading, or a surface that was always there.
    Unknown,
}

/// The readings of a cell of the grid of pixels and of the eight around it.
#[derive(Debug, Clone, Copy)]
struct Around {
    /// Least depth, metres.
    nearest: f32,
    /// Greatest depth; 0 without any reading.
    farthest: f32,
    /// One of them moves.
    moves: bool,
}

/// The moving readings of one keyframe.
pub struct MovingPoints<'v, 'r> {
    view: &'v View<'r>,
    /// What is read around each cell of the grid of pixels, row by row.
    around: Vec<Around>,
    columns: usize,
    /// The readings that move, base frame.
    readings: PointGrid,
}

impl<'v, 'r> MovingPoints<'v, 'r> {
    /// Those within `radius` metres of a place, in each of the keyframes. `known` gives places on plain parts that
    /// are known already, by keyframe.
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
        let others = || views.iter().enumerate().filter(|(i, _)| *i != k).map(|(_, view)| view);
        let is_vacated = |place: &Point3<f64>| {
            others().filter(|v| v.shows_behind(place)).take(MIN_THROUGH).count() >= MIN_THROUGH
        };
        let moves = |(u, v): (usize, usize), place: &Point3<f64>| {
            (place - centre).norm() < radius
                && view.is_seen_through(u, v, || is_vacated(place))
                && known.nearest(place).is_none()
        };
        let depth = &view.picture.depth;
        let (rows, columns) = (depth.height() / STRIDE_PX, depth.width() / STRIDE_PX);
        let cells = || (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column)));
        let readings: BTreeMap<(usize, usize), Point3<f64>> = cells()
            .filter_map(|(row, column)| {
                let pixel = (column * STRIDE_PX, row * STRIDE_PX);
                let place = view.surface_at(pixel.0, pixel.1)?;
                moves(pixel, &place).then_some(((row, column), place))
            })
            .collect();
        let is_speck = |cell: &(usize, usize)| {
            beside(*cell).filter(|beside| readings.contains_key(beside)).count() < MIN_BESIDE
        };
        let mut is_moving = vec![false; rows * columns];
        let mut thinned: BTreeMap<[i32; 3], Point3<f64>> = BTreeMap::new();
        for (cell, place) in readings.iter().filter(|(cell, _)| !is_speck(cell)) {
            is_moving[cell.0 * columns + cell.1] = true;
            thinned.entry(cell_of(place, THIN_M)).or_insert(*place);
        }
        let around = cells()
            .map(|cell| {
                let mut all = Around { nearest: f32::INFINITY, farthest: 0.0, moves: false };
                let inside = |(row, column): &(usize, usize)| *row < rows && *column < columns;
                for (row, column) in beside(cell).chain([cell]).filter(inside) {
                    if let Some(z) = depth.at(column * STRIDE_PX, row * STRIDE_PX) {
                        all.nearest = all.nearest.min(z);
                        all.farthest = all.farthest.max(z);
                    }
                    all.moves |= is_moving[row * columns + column];
                }
                all
            })
            .collect();
        let thinned: Vec<Point3<f64>> = thinned.into_values().collect();
        let readings = PointGrid::new(&thinned, MAX_DISTANCE_M);
        Self { view, around, columns, readings }
    }

    /// Frame number.
    pub fn frame(&self) -> usize {
        self.view.frame
    }

    /// What the keyframe says about a place whose surface has a normal; base frame.
    pub fn evidence(&self, place: &Point3<f64>, normal: &Vector3<f64>) -> Evidence {
        let in_camera = self.view.camera_from_base * place;
        let Some(around) = self.around(&in_camera) else { return Evidence::Unknown };
        let margin = depth_margin(self.view.picture.camera.depth_sensor, in_camera.z);
        if f64::from(around.nearest) > in_camera.z + margin {
            Evidence::Through
        } else if around.moves
            && f64::from(around.farthest) >= in_camera.z - margin
            && self.faces(place, normal)
        {
            Evidence::Found
        } else {
            Evidence::Unknown
        }
    }

    /// The same of a plate, of which only the face that is turned to the camera is seen, or seen through.
    pub fn evidence_of_plate(&self, place: &Point3<f64>, normal: &Vector3<f64>) -> Evidence {
        if self.faces(place, normal) { self.evidence(place, normal) } else { Evidence::Unknown }
    }

    /// The readings around a place in the camera frame; `None` outside the picture and without any.
    fn around(&self, in_camera: &Point3<f64>) -> Option<Around> {
        let camera = &self.view.picture.camera;
        let pixel = camera.project(in_camera).filter(|px| camera.sees(px, BORDER_PX))?;
        let cell = |x: f64| (x / STRIDE_PX as f64 + 0.5) as usize;
        let around = self.around.get(cell(pixel.y) * self.columns + cell(pixel.x))?;
        (around.farthest > 0.0).then_some(*around)
    }

    /// The moving reading next to a place that faces the camera.
    pub fn nearest(&self, place: &Point3<f64>, normal: &Vector3<f64>) -> Option<Point3<f64>> {
        self.faces(place, normal).then(|| self.readings.nearest(place)).flatten()
    }

    /// Readings that were free in another keyframe: something has come since.
    pub fn arrived_since(&self, earlier: &Self) -> usize {
        self.readings.points().iter().filter(|p| earlier.view.shows_behind(p)).count()
    }

    /// Readings farther than `apart` metres from all of some places.
    pub fn apart_from(&self, places: &[Point3<f64>], apart: f64) -> usize {
        let places = PointGrid::new(places, apart);
        let is_apart = |p: &&Point3<f64>| places.nearest(p).is_none();
        self.readings.points().iter().filter(is_apart).count()
    }

    /// Time of the keyframe, microseconds.
    pub fn utime(&self) -> i64 {
        self.view.picture.utime
    }

    /// A surface with this normal is seen from its front.
    pub fn faces(&self, place: &Point3<f64>, normal: &Vector3<f64>) -> bool {
        let to_camera = self.view.camera_place() - place;
        normal.dot(&to_camera) > MIN_FACING * to_camera.norm()
    }
}

/// The eight cells around one in the grid of pixels.
fn beside((row, column): (usize, usize)) -> impl Iterator<Item = (usize, usize)> {
    let steps = (0..9).filter(|k| *k != 4).map(|k| (k / 3, k % 3));
    steps.map(move |(dy, dx)| ((row + dy).wrapping_sub(1), (column + dx).wrapping_sub(1)))
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

    /// A place on the bar when it is turned by so much.
    fn on_bar(turn: f64) -> Point3<f64> {
        Point3::from(PIVOT_M) + 0.25 * Vector3::new(turn.cos(), turn.sin(), 0.0)
    }

    #[test]
    fn a_keyframe_tells_where_the_part_is_and_where_it_is_not() {
        let to_camera = -Vector3::z();
        moving(&lever(turn), |views| {
            let [first, last] = [&views[0], &views[23]];
            let ask = |view: &MovingPoints, q: f64| view.evidence(&on_bar(q), &to_camera);
            assert_eq!(ask(first, 0.0), Evidence::Found);
            assert_eq!(ask(first, 1.2), Evidence::Through);
            assert_eq!(ask(last, 1.2), Evidence::Found);
            assert_eq!(ask(last, 0.0), Evidence::Through);
            let wall = Point3::new(0.0, -0.2, 1.6);
            assert_eq!(first.evidence(&wall, &to_camera), Evidence::Unknown, "it was always there");
            let turned_away = first.evidence(&on_bar(0.0), &Vector3::z());
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
    fn what_comes_is_told_from_what_was_there() {
        let block = |frame: usize| (frame > 2).then_some([0.25, -0.2]);
        moving(&recording(|_| 0.0, block), |views| {
            assert_eq!(views[1].arrived_since(&views[0]), 0);
            assert!(views[5].arrived_since(&views[0]) > 30);
            assert!(views[5].apart_from(&[on_bar(0.0)], 0.1) > 30);
        });
    }
}
