//! Detects corners at several scales, spread over the image by a mask.
//!
//! In: a grey image, and the places of the features that are tracked, pixels.
//! Out: new corners, pixels.
//! From: good features to track (Shi & Tomasi 1994), as in the paper's section III-A; the limit per
//! cell is ours.

use super::config::TrackConfig;
use crate::image::gray::{Gray, empty_mask};
use nalgebra::Point2;
use opencv::core::{Mat, Point, Point2f, Scalar, Size, Vector};
use opencv::imgproc;
use opencv::prelude::*;

/// Radius around a feature in which no other feature starts, pixels: the detection mask.
const SPACING_PX: f64 = 6.0;
/// Side of a cell of [`TrackConfig::max_per_cell`], pixels.
const CELL_PX: usize = 32;
/// Width of the image border in which no feature starts, pixels.
const BORDER_PX: f32 = 8.0;

/// At most `wanted` corners away from the `occupied` places: the finest scale first, and the
/// strongest first within each scale.
pub fn corners(
    gray: &Gray,
    occupied: &[Point2<f32>],
    wanted: usize,
    config: &TrackConfig,
) -> opencv::Result<Vec<Point2<f32>>> {
    let mut mask = empty_mask(gray.width(), gray.height(), 255.0)?;
    let mut cells = CellCount::new(gray, config.max_per_cell);
    for p in occupied {
        block(&mut mask, p, SPACING_PX)?;
        cells.take(p);
    }
    let mut found = Vec::new();
    let mut level = gray.mat().try_clone()?;
    for scale in 0..config.scales.max(1) {
        let factor = f32::from(1_u16 << scale);
        if scale > 0 {
            let mut smaller = Mat::default();
            imgproc::pyr_down(&level, &mut smaller, Size::default(), 4)?;
            level = smaller;
        }
        for corner in level_corners(&level, &mask, factor, wanted, config)? {
            if found.len() >= wanted {
                return Ok(found);
            }
            let inside = corner.x >= BORDER_PX
                && corner.y >= BORDER_PX
                && corner.x <= gray.width() as f32 - 1.0 - BORDER_PX
                && corner.y <= gray.height() as f32 - 1.0 - BORDER_PX;
            if inside && is_free(&mask, &corner) && cells.take(&corner) {
                block(&mut mask, &corner, SPACING_PX)?;
                found.push(corner);
            }
        }
    }
    Ok(found)
}

fn level_corners(
    level: &Mat,
    mask: &Mat,
    factor: f32,
    wanted: usize,
    config: &TrackConfig,
) -> opencv::Result<Vec<Point2<f32>>> {
    let mut level_mask = Mat::default();
    imgproc::resize(mask, &mut level_mask, level.size()?, 0.0, 0.0, imgproc::INTER_NEAREST)?;
    let mut corners: Vector<Point2f> = Vector::new();
    imgproc::good_features_to_track(
        level,
        &mut corners,
        // Full cells may refuse some: more are detected than are wanted.
        (wanted * 2) as i32,
        config.quality,
        (SPACING_PX / f64::from(factor)).max(2.0),
        &level_mask,
        5,
        false,
        0.04,
    )?;
    let centre = 0.5 * (factor - 1.0);
    Ok(corners.iter().map(|c| Point2::new(c.x * factor + centre, c.y * factor + centre)).collect())
}

fn block(mask: &mut Mat, p: &Point2<f32>, radius_px: f64) -> opencv::Result<()> {
    let centre = Point::new(p.x.round() as i32, p.y.round() as i32);
    imgproc::circle(mask, centre, radius_px.round() as i32, Scalar::all(0.0), -1, 8, 0)
}

fn is_free(mask: &Mat, p: &Point2<f32>) -> bool {
    mask.at_2d::<u8>(p.y.round() as i32, p.x.round() as i32).is_ok_and(|&m| m > 0)
}

struct CellCount {
    columns: usize,
    limit: usize,
    counts: Vec<usize>,
}

impl CellCount {
    fn new(gray: &Gray, limit: usize) -> Self {
        let columns = gray.width() / CELL_PX + 1;
        Self { columns, limit, counts: vec![0; columns * (gray.height() / CELL_PX + 1)] }
    }

    /// Counts a corner in the cell of `p`; false if the cell is full.
    fn take(&mut self, p: &Point2<f32>) -> bool {
        let cell = (p.y.max(0.0) as usize / CELL_PX) * self.columns
            + (p.x.max(0.0) as usize / CELL_PX).min(self.columns - 1);
        let Some(count) = self.counts.get_mut(cell) else { return false };
        *count += 1;
        self.limit == 0 || *count <= self.limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chequerboard with squares of 16 pixels.
    fn chequerboard() -> Gray {
        let at =
            |i: usize| if ((i % 160) / 16 + (i / 160) / 16).is_multiple_of(2) { 200 } else { 50 };
        Gray::new(160, 128, &(0..160 * 128).map(at).collect::<Vec<u8>>()).unwrap()
    }

    fn config() -> TrackConfig {
        TrackConfig { max_per_cell: 0, ..TrackConfig::default() }
    }

    #[test]
    fn corners_are_where_four_squares_meet() {
        let found = corners(&chequerboard(), &[], 20, &config()).unwrap();
        assert_eq!(found.len(), 20);
        for corner in &found {
            let off = |x: f32| (x - 15.5 - 16.0 * ((x - 15.5) / 16.0).round()).abs();
            assert!(off(corner.x) < 2.0 && off(corner.y) < 2.0, "{corner}");
        }
    }

    #[test]
    fn none_are_found_beside_those_that_are_there() {
        let first = corners(&chequerboard(), &[], 10, &config()).unwrap();
        let more = corners(&chequerboard(), &first, 10, &config()).unwrap();
        let near = |a: &Point2<f32>| first.iter().any(|b| (a - b).norm() < SPACING_PX as f32);
        assert!(!more.is_empty() && !more.iter().any(near));
    }

    #[test]
    fn a_cell_holds_no_more_than_it_may() {
        let few = TrackConfig { max_per_cell: 1, ..config() };
        let found = corners(&chequerboard(), &[], 1000, &few).unwrap();
        let mut cells: Vec<(usize, usize)> =
            found.iter().map(|p| (p.x as usize / CELL_PX, p.y as usize / CELL_PX)).collect();
        let all = cells.len();
        cells.sort_unstable();
        cells.dedup();
        assert!(all > 10 && cells.len() == all, "{all} corners in {} cells", cells.len());
    }
}
