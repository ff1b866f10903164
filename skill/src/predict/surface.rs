//! The surface of a part that moves, as a maximally stable extremal region (paper, section
//! III-E; Matas et al. 2004): the region of the normal picture that holds most of the part's
//! features. It is used for drawing the motion manifold.
//!
//! In: a frame, and the pixels of the part's features. Out: a convex polygon, pixels.

use crate::vision_error::VisionError;
use linkage_frames::RgbdFrame;
use linkage_frames::depth::NormalMap;
use nalgebra::{Point2, Vector3};
use opencv::core::{CV_8U, Mat, Point, Rect, Scalar, Vector};
use opencv::features2d::MSER;
use opencv::imgproc;
use opencv::prelude::*;

/// Smallest region, pixels. Original code: 100.
const MIN_AREA_PX: i32 = 100;
/// Largest region, pixels. Original code: 320 x 240.
const MAX_AREA_PX: i32 = 320 * 240;

/// Outline of the surface that carries the part's `features` (pixels, at least three), as a
/// convex polygon in the picture: of the region that covers the features' own hull best, or
/// that hull where no region does.
///
/// # Errors
/// [`VisionError`] if the vision library fails.
pub fn moved_surface(
    frame: &RgbdFrame,
    features: &[Point2<f64>],
) -> Result<Option<Vec<Point2<f64>>>, VisionError> {
    if features.len() < 3 {
        return Ok(None);
    }
    outline(frame, features).map_err(VisionError::new)
}

/// [`moved_surface`] of enough features.
fn outline(
    frame: &RgbdFrame,
    features: &[Point2<f64>],
) -> opencv::Result<Option<Vec<Point2<f64>>>> {
    let towards = mean_normal(frame, features);
    let picture = facing_picture(frame, &towards)?;
    let mut mser = MSER::create(5, MIN_AREA_PX, MAX_AREA_PX, 0.25, 0.2, 200, 1.01, 0.003, 5)?;
    let mut regions: Vector<Vector<Point>> = Vector::new();
    let mut boxes: Vector<Rect> = Vector::new();
    mser.detect_regions(&picture, &mut regions, &mut boxes)?;
    let pixels: Vector<Point> =
        features.iter().map(|f| Point::new(f.x.round() as i32, f.y.round() as i32)).collect();
    let own = hull_of(&pixels)?;
    let own_area = imgproc::contour_area(&own, false)?.max(1.0);
    let mut best = (MIN_OVERLAP, own.clone());
    for region in &regions {
        let hull = hull_of(&region)?;
        let mut shared: Vector<Point> = Vector::new();
        let common = imgproc::intersect_convex_convex(&hull, &own, &mut shared, true);
        let common = f64::from(common.unwrap_or(0.0));
        let area = imgproc::contour_area(&hull, false)?;
        let overlap = common / (area + own_area - common).max(1.0);
        if overlap > best.0 {
            best = (overlap, hull);
        }
    }
    let outline: Vec<Point2<f64>> =
        best.1.iter().map(|p| Point2::new(f64::from(p.x), f64::from(p.y))).collect();
    Ok((outline.len() >= 3).then_some(outline))
}

/// Least share that a region and the features' hull have in common of their union.
const MIN_OVERLAP: f64 = 0.5;

/// The convex hull of pixels.
fn hull_of(points: &Vector<Point>) -> opencv::Result<Vector<Point>> {
    let mut hull: Vector<Point> = Vector::new();
    imgproc::convex_hull(points, &mut hull, false, true)?;
    Ok(hull)
}

/// Mean normal of the surface at the features; towards the camera where there is none.
fn mean_normal(frame: &RgbdFrame, features: &[Point2<f64>]) -> Vector3<f64> {
    let normals = NormalMap::new(&frame.depth, &frame.camera);
    let sum: Vector3<f64> = features
        .iter()
        .filter_map(|f| normals.at(f.x.round().max(0.0) as usize, f.y.round().max(0.0) as usize))
        .map(|n| n.normal)
        .sum();
    sum.try_normalize(1e-6).unwrap_or(-Vector3::z())
}

/// How much each pixel's surface faces as the part does, as a grey picture.
fn facing_picture(frame: &RgbdFrame, towards: &Vector3<f64>) -> opencv::Result<Mat> {
    let normals = NormalMap::new(&frame.depth, &frame.camera);
    let (width, height) = (frame.camera.width, frame.camera.height);
    let mut bytes = vec![0_u8; width * height];
    for v in 0..height {
        for u in 0..width {
            if let Some(n) = normals.at(u, v) {
                bytes[v * width + u] = (255.0 * n.normal.dot(towards).max(0.0).powi(4)) as u8;
            }
        }
    }
    let rows = Mat::new_rows_cols_with_data(height as i32, width as i32, &bytes)?;
    let mut picture =
        Mat::new_rows_cols_with_default(height as i32, width as i32, CV_8U, Scalar::all(0.0))?;
    imgproc::median_blur(&rows, &mut picture, 5)?;
    Ok(picture)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::seen;

    /// A board that faces the camera before a wall that slants away; 80 pixels to each side.
    fn slanted_room() -> RgbdFrame {
        seen(0, |x, y| {
            let (board, wall) = (1.0, 2.0 / (1.0 - 0.9 * x));
            if x.abs() < 80.0 / 260.0 && y.abs() < 80.0 / 260.0 { board } else { wall }
        })
    }

    fn pixels(reach: f64) -> Vec<Point2<f64>> {
        let at = |i: usize| {
            let (x, y) = ((i % 5) as f64 - 2.0, (i / 5) as f64 - 2.0);
            Point2::new(160.0 + reach * x / 2.0, 120.0 + reach * y / 2.0)
        };
        (0..25).map(at).collect()
    }

    fn reach_of(outline: &[Point2<f64>]) -> f64 {
        outline.iter().map(|p| (p.x - 160.0).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn the_outline_is_that_of_the_surface_that_carries_the_features() {
        let outline = moved_surface(&slanted_room(), &pixels(66.0)).unwrap().unwrap();
        let reach = reach_of(&outline);
        assert!((70.0..90.0).contains(&reach), "the board reaches 80 pixels, the outline {reach}");
    }

    #[test]
    fn where_no_region_fits_it_is_the_hull_of_the_features() {
        let outline = moved_surface(&slanted_room(), &pixels(20.0)).unwrap().unwrap();
        assert!((reach_of(&outline) - 20.0).abs() < 1.5, "{outline:?}");
    }

    #[test]
    fn two_features_have_no_outline() {
        assert_eq!(moved_surface(&slanted_room(), &pixels(10.0)[..2]).unwrap(), None);
    }
}
