//! Finds the shadow of a moving part on static surface. The floor below a door or a drawer coincides with itself when
//! it is moved as the part moves, so that depth does not discriminate, and the shadow on it does move with the part.
//!
//! In: one keyframe, and for each place of its label grid the part and what determined it.
//! Out: the grid without the places whose colour alone determined a moving part, if the plane around is static.
//! From: ours. Before, 13 % of the surface of an air fryer's basket was table, which recognition saw through at every
//! other configuration; a wine cooler's door and a dresser's drawer had floor.

use super::part_labels::{By, LabelGrid, STEP, Told, pixel_of};
use linkage_frames::RgbdFrame;
use linkage_frames::depth::NormalMap;
use nalgebra::Point3;
use rayon::prelude::*;

/// Radius of the surface around a place that is compared, metres: half the depth of a large drawer's shadow.
const AROUND_M: f64 = 0.2;
/// Largest radius of the surface around a place that is compared, places of the grid.
const MOST_PLACES: usize = 40;
/// Largest distance of surface from the plane of a place, metres, in addition to the noise of the depth sensor. At
/// 1.2 m that is less than the two centimetres by which a turntable stands above its table.
const SAME_PLANE_M: f64 = 0.01;
/// Smallest number of static places in the plane.
const LEAST_STATIC: usize = 4;
/// Smallest number of places in the plane that belong to the part by depth, as a share of the static ones, for the
/// plane to be the part's: of a plain door that slides in its own plane, depth determines little more than the borders.
const SHARE_OF_PART: f64 = 0.1;

/// The labels of a keyframe without places on static surface whose colour moves with a part. `normals`: those of the
/// keyframe.
pub fn without_shadows(frame: &RgbdFrame, grid: &LabelGrid, normals: &NormalMap) -> LabelGrid {
    let told: Vec<Option<Told>> = grid.told().collect();
    let is_by_colour = |told: &Option<Told>| told.is_some_and(|t| t.part > 0 && t.by == By::Colour);
    let columns = grid.columns();
    let point = |place| {
        let (u, v) = pixel_of(place, columns);
        frame.point_at(u, v)
    };
    let points: Vec<Option<Point3<f64>>> = (0..told.len()).map(point).collect();
    let places = Places { frame, columns, told: &told, points: &points };
    let is_shadow = |(place, told)| is_by_colour(told) && places.are_static_around(place, normals);
    let left_out: Vec<bool> = told.par_iter().enumerate().map(is_shadow).collect();
    grid.without(&left_out)
}

/// The labelled places of a keyframe.
struct Places<'g> {
    frame: &'g RgbdFrame,
    columns: usize,
    told: &'g [Option<Told>],
    /// Point of each place, camera frame, metres.
    points: &'g [Option<Point3<f64>>],
}

impl Places<'_> {
    /// True if static places lie in the plane around a place, and hardly any that belong to its part by more than their
    /// colour.
    fn are_static_around(&self, place: usize, normals: &NormalMap) -> bool {
        let (u, v) = pixel_of(place, self.columns);
        let (Some(own), Some(point), Some(surface)) =
            (self.told[place], self.points[place], normals.at(u, v))
        else {
            return false;
        };
        let sensor = self.frame.camera.depth_sensor;
        let (mut of_base, mut of_part) = (0, 0);
        for other in self.around(place, point.z) {
            let (Some(told), Some(p)) = (self.told[other], self.points[other]) else { continue };
            let apart = p - point;
            let tolerance = SAME_PLANE_M + 2.0 * sensor.reading_sigma(p.z);
            if apart.norm() < AROUND_M && surface.normal.dot(&apart).abs() < tolerance {
                of_base += usize::from(told.part == 0);
                of_part += usize::from(told.part == own.part && told.by != By::Colour);
            }
        }
        of_base >= LEAST_STATIC && (of_part as f64) < SHARE_OF_PART * of_base as f64
    }

    /// Every second place of the grid, across and down, within [`AROUND_M`] of a place at this depth, metres.
    fn around(&self, place: usize, depth: f64) -> impl Iterator<Item = usize> + use<> {
        let columns = self.columns;
        let rows = self.told.len() / columns;
        let reach = self.frame.camera.fx * AROUND_M / depth / STEP as f64;
        let reach = (reach.ceil() as usize).clamp(1, MOST_PLACES);
        let of = |at: usize, end: usize| at.saturating_sub(reach)..(at + reach + 1).min(end);
        let (of_row, of_column) = (of(place % columns, columns), of(place / columns, rows));
        let every = |places: std::ops::Range<usize>| places.step_by(2);
        every(of_column)
            .flat_map(move |row| every(of_row.clone()).map(move |column| row * columns + column))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::seen;

    const COLUMNS: usize = 320 / STEP;
    const ROWS: usize = 240 / STEP;

    /// Numbers of places that remain the part's, by depth and by colour. The part has columns 30 to 39 of the grid, and
    /// of these the last `by_depth` by depth; all others are static.
    fn remaining(frame: &RgbdFrame, by_depth: usize) -> [usize; 2] {
        let of = |place: usize| {
            let column = place % COLUMNS;
            let is_part = (30..40).contains(&column);
            let by = if is_part && column + by_depth >= 40 { By::Depth } else { By::Colour };
            Some(Told { part: u16::from(is_part), by })
        };
        let told: Vec<Option<Told>> = (0..COLUMNS * ROWS).map(of).collect();
        let normals = NormalMap::new(&frame.depth, &frame.camera);
        let grid = without_shadows(frame, &LabelGrid::of(COLUMNS, told), &normals);
        let count = |by: By| grid.told().flatten().filter(|t| t.part == 1 && t.by == by).count();
        [By::Depth, By::Colour].map(count)
    }

    #[test]
    fn a_shadow_on_plain_floor_is_not_the_parts() {
        let [by_depth, by_colour] = remaining(&seen(1, |_, _| 1.2), 0);
        assert_eq!(by_depth, 0);
        // At the borders of the image there are no normals.
        assert!(by_colour < ROWS, "{by_colour} of {} places", 10 * ROWS);
    }

    #[test]
    fn a_face_of_which_depth_determines_the_border_slides_in_its_plane() {
        let [by_depth, by_colour] = remaining(&seen(1, |_, _| 1.2), 3);
        assert_eq!([by_depth, by_colour], [3 * ROWS, 7 * ROWS]);
    }

    #[test]
    fn a_plate_that_stands_out_is_not_the_floors() {
        let is_plate = |x: f64| x > -0.16 && x < 0.0;
        let plate = seen(1, |x, _| if is_plate(x) { 1.15 } else { 1.2 });
        let [_, by_colour] = remaining(&plate, 0);
        assert!(by_colour > 8 * ROWS, "{by_colour} of {} places", 10 * ROWS);
    }
}
