//! Finds surfaces that were vacated: something rested at one end of the recording, with no occluder before it, and
//! other keyframes see through the place where it was. Neither texture nor a plane is needed.
//!
//! The drawers of one front touch, so a piece is divided by the episodes in which its points were vacated.
//!
//! In: the keyframes with the camera's poses.
//! Out: pieces of surface, base frame, metres, each with the keyframe that shows it at rest; the largest first.
//! From: free-space test between keyframes, and connected components.

use super::moving_points::{Evidence, KNOWN_M, MovingPoints, faces_camera};
use super::point_grid::{PointGrid, cell_of};
use super::view::View;
use crate::learn::episodes::{AwayKeyframes, episodes};
use crate::learn::free_space::Probe;
use crate::math::rigid::{Pose, plane_through};
use nalgebra::{IsometryMatrix3, Point3, UnitVector3, Vector3};
use std::collections::BTreeMap;

/// Consecutive keyframes in which a surface must rest.
const REST_KEYFRAMES: usize = 4;
/// Fewest keyframes that must see through a vacated place.
const MIN_THROUGH: usize = 3;
/// Distance between two places that are tested, pixels.
const STRIDE_PX: usize = 2;
/// Edge of the cells that connect a piece, metres: points in touching cells are one piece.
const CELL_M: f64 = 0.05;
/// Fewest points of a piece.
const MIN_PLACES: usize = 50;
/// A column or row of the image has readings if at least one in this many pixels has one.
const LEAST_OF_A_LINE: usize = 20;
/// Distance from the border of the readings below which a place is at the border, pixels.
const BORDER_PX: f64 = 8.0;
/// Most points of a piece that are kept.
const MAX_POINTS: usize = 100;
/// Radius of the neighbourhood that determines a normal, metres.
const NORMAL_RADIUS_M: f64 = 0.015;
/// Fewest points that determine a normal.
const NORMAL_PLACES: usize = 5;

/// Fewest keyframes between those in which two parts of a surface left their places.
const PARTED_KEYFRAMES: usize = 3;
/// Smallest share of a surface's points in either of two parts.
const LEAST_PARTED: f64 = 0.25;

/// Largest distance of four fifths of a flat surface's points from its plane, metres.
const FLAT_M: f64 = 0.01;

/// The end of a recording at which a surface rests.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum End {
    /// The surface rests first, and is moved later.
    First,
    /// The surface was moved, and rests at the end.
    Last,
}

impl End {
    /// Index of the `k`-th of `len` keyframes, counted from this end.
    pub fn at(self, k: usize, len: usize) -> usize {
        if self == Self::First { k } else { len - 1 - k }
    }
}

/// A piece of surface at rest, base frame.
#[derive(Debug, Clone)]
pub struct RestSurface {
    /// Index of the keyframe that shows the surface at rest.
    pub keyframe: usize,
    /// Points of the surface, evenly spread, metres.
    pub points: Vec<Point3<f64>>,
    /// Unit normals at the points, towards the camera.
    pub normals: Vec<Vector3<f64>>,
    /// Distance of the other face behind the points, metres; `None` if only one face is known.
    pub thickness: Option<f64>,
}

impl RestSurface {
    /// The surface with another face, `thickness` metres behind: a lid that is opened shows its underside.
    pub fn with_other_face(&self, thickness: f64) -> Self {
        Self { thickness: Some(thickness), ..self.clone() }
    }

    /// The surface with at most `most` points.
    pub fn thinned(&self, most: usize) -> Self {
        let step = self.points.len().div_ceil(most).max(1);
        let points = self.points.iter().copied().step_by(step).collect();
        let normals = self.normals.iter().copied().step_by(step).collect();
        Self { points, normals, ..*self }
    }

    /// What a keyframe shows of one of the surface's points. Of a plate, only the face that is turned to the camera
    /// can be found or seen through.
    #[inline]
    pub fn evidence(
        &self,
        view: &MovingPoints,
        camera_from_part: &IsometryMatrix3<f64>,
        place: &Point3<f64>,
        normal: &Vector3<f64>,
    ) -> Evidence {
        let is_seen = || faces_camera(&(camera_from_part * place), &(camera_from_part * normal));
        if self.thickness.is_none() || is_seen() {
            view.evidence(camera_from_part, place, normal)
        } else {
            Evidence::Unknown
        }
    }

    /// Points that a keyframe finds where a motion puts them, less those that it sees through, as a share of the
    /// points of one face.
    pub fn margin(&self, view: &MovingPoints, motion: &Pose) -> f64 {
        let camera_from_part = view.camera_from_part(motion);
        let worth = |(place, normal)| match self.evidence(view, &camera_from_part, &place, &normal)
        {
            Evidence::Found => 1.0,
            Evidence::Through => -1.0,
            Evidence::Unknown => 0.0,
        };
        self.places().map(worth).sum::<f64>() / self.points.len().max(1) as f64
    }

    /// Points and normals of both faces, as far as they are known.
    pub fn places(&self) -> impl Iterator<Item = (Point3<f64>, Vector3<f64>)> + '_ {
        let front = || self.points.iter().zip(&self.normals).map(|(p, n)| (*p, *n));
        let other = self.thickness.map(|t| front().map(move |(p, n)| (p - t * n, -n)));
        front().chain(other.into_iter().flatten())
    }

    /// Mean of the points.
    pub fn centre(&self) -> Point3<f64> {
        let sum: Vector3<f64> = self.points.iter().map(|p| p.coords).sum();
        Point3::from(sum / self.points.len().max(1) as f64)
    }

    /// The normal of a flat surface, towards the camera; `None` for a surface that is not flat.
    pub fn flat_normal(&self) -> Option<UnitVector3<f64>> {
        let (mean, normal) = plane_through(&self.points);
        let mut off: Vec<f64> = self.points.iter().map(|p| normal.dot(&(p - mean)).abs()).collect();
        off.sort_by(f64::total_cmp);
        let most = off.get(off.len() * 4 / 5)?;
        let sense = if normal.dot(self.normals.first()?) < 0.0 { -1.0 } else { 1.0 };
        (*most < FLAT_M).then(|| UnitVector3::new_normalize(normal * sense))
    }

    /// The two parts of a surface, one of which left its place later than the other; none if all of it left together,
    /// or gradually, as a door does from its handle on.
    pub fn parted_by_time(&self, views: &[View], end: End) -> Vec<Self> {
        let at = |k: usize| end.at(k, views.len());
        let left = |place: &Point3<f64>| {
            let away = (0..views.len()).filter(|k| views[at(*k)].shows_behind(place));
            away.take(MIN_THROUGH).last().unwrap_or(views.len())
        };
        let left: Vec<usize> = self.points.iter().map(left).collect();
        let mut sorted = left.clone();
        sorted.sort_unstable();
        let fewest = (LEAST_PARTED * sorted.len() as f64).ceil() as usize;
        let parting = (fewest.max(1)..=sorted.len().saturating_sub(fewest))
            .max_by_key(|i| (sorted[*i] - sorted[i - 1], std::cmp::Reverse(*i)));
        let Some(i) = parting.filter(|i| sorted[*i] - sorted[i - 1] >= PARTED_KEYFRAMES) else {
            return Vec::new();
        };
        let of = |is_later: bool| {
            let kept = (0..left.len()).filter(|k| (left[*k] >= sorted[i]) == is_later);
            let (points, normals) = kept.map(|k| (self.points[k], self.normals[k])).unzip();
            Self { points, normals, ..*self }
        };
        [false, true].map(of).into()
    }

    /// Largest distance of a point from the centre, metres.
    pub fn radius(&self) -> f64 {
        let centre = self.centre();
        self.points.iter().map(|p| (p - centre).norm()).fold(0.0, f64::max)
    }
}

/// The pieces of surface that rest at one end of the recording and are vacated at other times. Surface on known plain
/// parts is left out; `known` gives points on these, by frame.
pub fn vacated_surfaces(
    views: &[View],
    end: End,
    known: impl Fn(usize) -> Vec<Point3<f64>>,
) -> Vec<RestSurface> {
    if views.len() < REST_KEYFRAMES + MIN_THROUGH {
        return Vec::new();
    }
    let at = |k: usize| end.at(k, views.len());
    let rest: Vec<&View> = (0..REST_KEYFRAMES).map(|k| &views[at(k)]).collect();
    let others: Vec<&View> = (REST_KEYFRAMES..views.len()).map(|k| &views[at(k)]).collect();
    let known = PointGrid::new(&known(rest[0].frame), KNOWN_M);
    let mut places = vacated_places(&rest, &others);
    places.retain(|_, place| known.nearest(place).is_none());
    let touching = connected(without_specks(places));
    let mut pieces: Vec<Vec<Point3<f64>>> =
        touching.into_iter().flat_map(|piece| divided(piece, &others)).collect();
    let seen = ReadingsBorder::of(rest[0]);
    pieces.retain(|piece| piece.len() >= MIN_PLACES && !piece.iter().any(|p| seen.is_at(p)));
    pieces.sort_by_key(|piece| std::cmp::Reverse(piece.len()));
    let camera = rest[0].camera_place();
    let surface = |places: Vec<Point3<f64>>| {
        let step = places.len().div_ceil(MAX_POINTS).max(1);
        let points: Vec<Point3<f64>> = places.iter().copied().step_by(step).collect();
        let normals = points.iter().map(|p| normal_at(p, &places, &camera)).collect();
        RestSurface { keyframe: at(0), points, normals, thickness: None }
    };
    pieces.into_iter().map(surface).collect()
}

/// The border of the region in which a keyframe has readings. A piece that it cuts is not whole: most often a person,
/// the rest of whom is outside the image.
struct ReadingsBorder<'v, 'r> {
    view: &'v View<'r>,
    /// First and last column with readings.
    columns: [usize; 2],
    /// First and last row with readings.
    rows: [usize; 2],
}

impl<'v, 'r> ReadingsBorder<'v, 'r> {
    fn of(view: &'v View<'r>) -> Self {
        let depth = &view.picture.depth;
        let (width, height) = (depth.width(), depth.height());
        let has = |u: usize, v: usize| depth.at(u, v).is_some();
        let in_column = |u: usize| (0..height).step_by(STRIDE_PX).filter(|v| has(u, *v)).count();
        let in_row = |v: usize| (0..width).step_by(STRIDE_PX).filter(|u| has(*u, v)).count();
        let is_seen = |n: usize, size: usize| n * STRIDE_PX * LEAST_OF_A_LINE >= size;
        let bounds =
            |seen: Vec<usize>| [seen.first(), seen.last()].map(|x| x.copied().unwrap_or(0));
        Self {
            view,
            columns: bounds((0..width).filter(|u| is_seen(in_column(*u), height)).collect()),
            rows: bounds((0..height).filter(|v| is_seen(in_row(*v), width)).collect()),
        }
    }

    /// True if a point is at the border of the readings, or outside the image.
    fn is_at(&self, place: &Point3<f64>) -> bool {
        let Some(pixel) = self.view.pixel_of(place) else { return true };
        let near = |x: f64, [first, last]: [usize; 2]| {
            x < first as f64 + BORDER_PX || x > last as f64 - BORDER_PX
        };
        near(pixel.x, self.columns) || near(pixel.y, self.rows)
    }
}

/// Points that rest and are seen through at other times, by their cell in the grid of pixels.
fn vacated_places(rest: &[&View], others: &[&View]) -> BTreeMap<(usize, usize), Point3<f64>> {
    let depth = &rest[0].picture.depth;
    let (columns, rows) = (depth.width() / STRIDE_PX, depth.height() / STRIDE_PX);
    let is_vacated = |place: &Point3<f64>| {
        // One reading excludes most places that stay; only for the others the readings around it are tested as well.
        let behind = others.iter().filter(|view| view.shows_behind(place));
        behind.clone().take(MIN_THROUGH).count() >= MIN_THROUGH
            && rest.iter().all(|view| view.shows(place))
            && behind.filter(|view| view.probe(place) == Probe::Through).count() >= MIN_THROUGH
    };
    let cells = (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column)));
    cells
        .filter_map(|(row, column)| {
            let place = rest[0].surface_at(column * STRIDE_PX, row * STRIDE_PX)?;
            is_vacated(&place).then_some(((row, column), place))
        })
        .collect()
}

/// Points without those that have fewer than two neighbours in the grid: noise at edges.
fn without_specks(places: BTreeMap<(usize, usize), Point3<f64>>) -> Vec<Point3<f64>> {
    let has = |row: usize, column: usize| usize::from(places.contains_key(&(row, column)));
    let neighbours = |row: usize, column: usize| {
        has(row.wrapping_sub(1), column)
            + has(row + 1, column)
            + has(row, column.wrapping_sub(1))
            + has(row, column + 1)
    };
    let kept = places.iter().filter(|((row, column), _)| neighbours(*row, *column) >= 2);
    kept.map(|(_, place)| *place).collect()
}

/// Connected components: points in cells that touch are one piece.
fn connected(places: Vec<Point3<f64>>) -> Vec<Vec<Point3<f64>>> {
    let mut cells: BTreeMap<[i32; 3], Vec<Point3<f64>>> = BTreeMap::new();
    places
        .into_iter()
        .for_each(|place| cells.entry(cell_of(&place, CELL_M)).or_default().push(place));
    let mut pieces = Vec::new();
    while let Some((first, places)) = cells.pop_first() {
        let (mut piece, mut open) = (places, vec![first]);
        while let Some(at) = open.pop() {
            for beside in neighbours(at) {
                if let Some(places) = cells.remove(&beside) {
                    piece.extend(places);
                    open.push(beside);
                }
            }
        }
        pieces.push(piece);
    }
    pieces
}

/// Divides a piece by the episodes in which its points were vacated. `others`: keyframes in the order of time, or
/// against it.
fn divided(piece: Vec<Point3<f64>>, others: &[&View]) -> Vec<Vec<Point3<f64>>> {
    let stride = others.len().div_ceil(AwayKeyframes::BITS as usize).max(1);
    let asked: Vec<&View> = others.iter().copied().step_by(stride).collect();
    let away = |place: &Point3<f64>| {
        let behind = asked.iter().enumerate().filter(|(_, view)| view.shows_behind(place));
        behind.fold(0, |away: AwayKeyframes, (bit, _)| away | 1 << bit)
    };
    let of_place = episodes(&piece.iter().map(away).collect::<Vec<_>>());
    let mut parts = BTreeMap::<usize, Vec<Point3<f64>>>::new();
    piece
        .into_iter()
        .zip(of_place)
        .for_each(|(p, episode)| parts.entry(episode).or_default().push(p));
    parts.into_values().collect()
}

/// A cell and the 26 around it.
fn neighbours([x, y, z]: [i32; 3]) -> impl Iterator<Item = [i32; 3]> {
    let beside = |x: i32, step: i32| x.saturating_add(step - 1);
    (0..27).map(move |k| [beside(x, k % 3), beside(y, k / 3 % 3), beside(z, k / 9)])
}

/// The normal of a surface at one of its points; the direction to the camera if too few points determine it.
fn normal_at(place: &Point3<f64>, places: &[Point3<f64>], camera: &Point3<f64>) -> Vector3<f64> {
    let near = places.iter().filter(|p| (*p - place).norm() < NORMAL_RADIUS_M);
    let near: Vec<Point3<f64>> = near.copied().collect();
    let to_camera = (camera - place).normalize();
    if near.len() < NORMAL_PLACES {
        return to_camera;
    }
    let (_, normal) = plane_through(&near);
    if normal.dot(&to_camera) < 0.0 { -normal } else { normal }
}

#[cfg(test)]
mod tests {
    use super::super::test_data::{PIVOT_M, lever, turn, two_sliders};
    use super::*;

    fn surfaces(turn: impl Fn(usize) -> f64, end: End) -> Vec<RestSurface> {
        let recording = lever(turn);
        vacated_surfaces(&View::all(&recording), end, |_| Vec::new())
    }

    #[test]
    fn what_rests_first_and_leaves_its_place_is_one_surface() {
        let found = surfaces(turn, End::First);
        assert_eq!(found.len(), 1);
        let centre = found[0].centre();
        assert!((centre.x - PIVOT_M[0] - 0.15).abs() < 0.04, "{centre}");
        assert!((centre.y - PIVOT_M[1]).abs() < 0.01 && (centre.z - PIVOT_M[2]).abs() < 1e-6);
        assert!(found[0].normals.iter().all(|n| n.z < -0.9), "towards the camera");
        assert_eq!(found[0].keyframe, 0);
    }

    #[test]
    fn a_plate_has_its_other_face_behind_the_first() {
        let surface = surfaces(turn, End::First).remove(0);
        let plate = surface.with_other_face(0.03);
        let n = surface.points.len();
        let places: Vec<_> = plate.places().collect();
        assert_eq!((surface.places().count(), places.len()), (n, 2 * n));
        let [front, behind] = [places[0], places[n]];
        assert!((behind.0.z - front.0.z - 0.03).abs() < 1e-3, "farther from the camera");
        assert_eq!(behind.1, -front.1);
    }

    #[test]
    fn what_rests_last_is_found_in_the_last_keyframe() {
        let found = surfaces(turn, End::Last);
        assert_eq!((found.len(), found[0].keyframe), (1, 23));
        assert!(found[0].centre().y > PIVOT_M[1] + 0.05, "where it was turned to");
    }

    #[test]
    fn nothing_is_vacated_where_nothing_moves_or_rests() {
        assert!(surfaces(|_| 0.3, End::First).is_empty());
        assert!(surfaces(|frame| 0.3 * frame as f64, End::First).is_empty(), "it never rests");
    }

    #[test]
    fn what_the_border_of_the_picture_cuts_is_no_surface() {
        let recording = lever(turn);
        let views = View::all(&recording);
        let border = ReadingsBorder::of(&views[0]);
        assert!(!border.is_at(&views[0].surface_at(100, 100).unwrap()));
        for (u, v) in [(2, 100), (316, 100), (100, 1), (100, 237)] {
            assert!(border.is_at(&views[0].surface_at(u, v).unwrap()), "{u}, {v}");
        }
    }

    #[test]
    fn a_surface_of_a_known_part_is_left_out() {
        let recording = lever(turn);
        let known = |_: usize| {
            let along = |k: i32| PIVOT_M[0] + 0.02 * f64::from(k);
            (-3..18).map(|k| Point3::new(along(k), PIVOT_M[1], PIVOT_M[2])).collect()
        };
        assert!(vacated_surfaces(&View::all(&recording), End::First, known).is_empty());
    }

    #[test]
    fn drawers_that_touch_are_two_surfaces_where_they_are_pulled_one_after_the_other() {
        let pulled = |frames: std::ops::Range<usize>, frame: usize| {
            if frames.contains(&frame) { 0.2 } else { 0.0 }
        };
        let found = |ways: &dyn Fn(usize) -> [f64; 2]| {
            let views = two_sliders(ways);
            vacated_surfaces(&View::all(&views), End::First, |_| Vec::new())
        };
        let apart = found(&|frame| [pulled(5..11, frame), pulled(14..20, frame)]);
        let mut middles: Vec<f64> = apart.iter().map(|s| s.centre().x).collect();
        middles.sort_by(f64::total_cmp);
        assert_eq!(middles.len(), 2);
        assert!((middles[0] + 0.065).abs() < 0.01 && (middles[1] - 0.065).abs() < 0.01);
        let together = found(&|frame| [pulled(5..11, frame); 2]);
        assert_eq!(together.len(), 1);
    }

    #[test]
    fn of_drawers_that_stay_open_the_second_one_left_later() {
        let opened = |first: usize, frame: usize| if frame < first { 0.0 } else { 0.2 };
        let parted = |ways: &dyn Fn(usize) -> [f64; 2]| {
            let recording = two_sliders(ways);
            let views = View::all(&recording);
            let whole = vacated_surfaces(&views, End::First, |_| Vec::new());
            assert_eq!(whole.len(), 1, "they are away at the same time");
            whole[0].parted_by_time(&views, End::First)
        };
        let parts = parted(&|frame| [opened(5, frame), opened(12, frame)]);
        assert_eq!(parts.len(), 2);
        assert!((parts[0].centre().x + 0.065).abs() < 0.01, "the left one was first");
        assert!((parts[1].centre().x - 0.065).abs() < 0.01);
        assert!(parted(&|frame| [opened(5, frame); 2]).is_empty());
    }

    #[test]
    fn places_are_one_piece_where_they_are_close() {
        let row = |x: f64| (0..30).map(move |k| Point3::new(x + 0.01 * f64::from(k), 0.0, 1.0));
        let sizes = |places: Vec<Point3<f64>>| connected(places).len();
        assert_eq!(sizes(row(0.0).chain(row(0.3)).collect()), 1);
        assert_eq!(sizes(row(0.0).chain(row(0.6)).collect()), 2);
    }
}
