//! Grows the known points of each part along the surface that moves with it. The tracks and planes that determined a
//! joint may cover only a strip of a plain door; the rest of the door moves as the strip does. Only depth may label
//! the grown surface: a plain floor, or a shadow on it, looks as if it slid with a drawer.
//!
//! In: keyframes with the pose of each part, points of each part at configuration 0 (object frame, metres), and the
//! number of its tracks.
//! Out: more such points for parts with few tracks.
//! From: region growing.

use super::occupancy::Occupancy;
use super::part_labels::{By, PosedFrame, label_point};
use crate::math::grid::cell;
use nalgebra::Point3;
use rayon::prelude::*;
use std::collections::HashSet;

/// A part with this many tracks is covered already and is not grown.
const COVERED: usize = 150;
/// Most keyframes in which pixels are tested.
const FRAMES: usize = 8;
/// Distance between tested pixels, pixels.
const STEP_PX: usize = 8;
/// A pixel is tested for a part if known points of the part lie within this distance, metres.
const REACH_M: f64 = 0.1;
/// Most rounds; each grows a part by up to [`REACH_M`].
const ROUNDS: usize = 24;
/// Side of a cell of the outlier filter, metres.
const CELL_M: f64 = 0.08;
/// Fewest new points in a cell, over all keyframes; fewer are outliers.
const LEAST_PLACES: usize = 3;

/// A pixel without a label.
struct Place {
    frame: usize,
    pixel: (usize, usize),
    /// The point in the frame of each part at configuration 0, if the part's pose is known.
    at_rest: Vec<Option<Point3<f64>>>,
}

/// The known points of each part, and those of the connected surface that moves as the part does. `tracked`: number
/// of tracks of each part.
pub fn grown(
    posed: &[PosedFrame],
    mut known: Vec<Vec<Point3<f64>>>,
    tracked: &[usize],
) -> Vec<Vec<Point3<f64>>> {
    let grows = |part: usize| tracked[part] < COVERED;
    if (1..known.len()).all(|part| !grows(part)) {
        return known;
    }
    let mut places = places(posed);
    for _ in 0..ROUNDS {
        let near: Vec<Occupancy> = known
            .iter()
            .map(|points| Occupancy::new(points.iter().copied()).grown(REACH_M))
            .collect();
        let may_be = |part: usize, p: &Point3<f64>| near[part].holds(p);
        let (asked, left): (Vec<Place>, Vec<Place>) = places.into_iter().partition(|place| {
            let of_parts = place.at_rest.iter().enumerate().skip(1);
            of_parts.into_iter().any(|(part, p)| p.is_some_and(|p| may_be(part, &p)))
        });
        places = left;
        let told = |place: &Place| {
            let told = label_point(posed, place.frame, place.pixel, &may_be)?;
            let part = usize::from(told.part);
            (told.by == By::Depth).then_some((part, place.at_rest[part]?))
        };
        let told: Vec<(usize, Point3<f64>)> = asked.par_iter().filter_map(told).collect();
        let mut has_grown = false;
        for (part, points) in known.iter_mut().enumerate().skip(1).filter(|k| grows(k.0)) {
            let own = told.iter().filter(|(p, _)| *p == part).map(|(_, point)| *point).collect();
            let own = without_strays(own);
            has_grown |= !own.is_empty();
            points.extend(own);
        }
        if !has_grown {
            break;
        }
    }
    known
}

/// Pixels with depth, of some keyframes.
fn places(posed: &[PosedFrame]) -> Vec<Place> {
    let stride = posed.len().div_ceil(FRAMES).max(1);
    let of_frame = |frame: usize| {
        let PosedFrame { frame: picture, camera_from_part, .. } = &posed[frame];
        let (width, height) = (picture.camera.width, picture.camera.height);
        let rows = (STEP_PX / 2..height).step_by(STEP_PX);
        let pixels =
            rows.flat_map(move |v| (STEP_PX / 2..width).step_by(STEP_PX).map(move |u| (u, v)));
        pixels.filter_map(move |pixel| {
            let p = picture.point_at(pixel.0, pixel.1)?;
            let at_rest = camera_from_part
                .iter()
                .map(|pose| Some(pose.as_ref()?.inverse_transform_point(&p)))
                .collect();
            Some(Place { frame, pixel, at_rest })
        })
    };
    (0..posed.len()).step_by(stride).flat_map(of_frame).collect()
}

/// Points whose cell holds enough of them; the others are outliers.
fn without_strays(points: Vec<Point3<f64>>) -> Vec<Point3<f64>> {
    let mut cells: Vec<[i32; 3]> = points.iter().map(|p| cell(p, CELL_M)).collect();
    cells.sort_unstable();
    let full: HashSet<[i32; 3]> = cells
        .chunk_by(|a, b| a == b)
        .filter(|same| same.len() >= LEAST_PLACES)
        .map(|same| same[0])
        .collect();
    points.into_iter().filter(|p| full.contains(&cell(p, CELL_M))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::Pose;
    use crate::test_data::{board, seen};
    use linkage_frames::RgbdFrame;

    const HALF_M: f64 = 0.3;

    /// A drawer's front, flush in a wall, comes 30 cm towards the camera.
    fn pulled() -> Vec<(RgbdFrame, f64)> {
        let at = |i: i64| 0.02 * i as f64;
        (0..16).map(|i| (seen(i + 1, board(HALF_M, 1.5 - at(i), 1.5)), at(i))).collect()
    }

    #[test]
    fn a_part_grows_to_where_its_surface_ends() {
        let frames = pulled();
        let pose = |slid: &f64| Some(Pose::translation(0.0, 0.0, -slid));
        let posed: Vec<PosedFrame> = frames
            .iter()
            .enumerate()
            .map(|(number, (frame, slid))| PosedFrame {
                frame,
                number,
                camera_from_part: vec![Some(Pose::identity()), pose(slid)],
            })
            .collect();
        let strip: Vec<Point3<f64>> =
            (-5..=5).map(|i| Point3::new(0.02 * f64::from(i), 0.0, 1.5)).collect();
        let known = grown(&posed, vec![Vec::new(), strip], &[0, 0]);
        assert!(known[0].is_empty());
        let farthest = |k: usize| known[1].iter().map(|p| p[k].abs()).fold(0.0, f64::max);
        for k in [0, 1] {
            assert!(farthest(k) > HALF_M - 0.04 && farthest(k) < HALF_M + 0.03, "{}", farthest(k));
        }
    }
}
