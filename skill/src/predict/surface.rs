//! The surface of a part that moves, as a maximally stable extremal region (paper, section
//! III-E; Matas et al. 2004): the region of the normal picture that holds most of the part's
//! features. It is used for drawing the motion manifold.

use linkage_driver::RgbdFrame;
use linkage_driver::depth::NormalMap;
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
/// convex polygon in the picture; `None` where no region holds a third of them.
///
/// # Errors
/// Whatever the vision library says.
pub fn moved_surface(
    frame: &RgbdFrame,
    features: &[Point2<f64>],
) -> opencv::Result<Option<Vec<Point2<f64>>>> {
    if features.len() < 3 {
        return Ok(None);
    }
    let towards = mean_normal(frame, features);
    let picture = facing_picture(frame, &towards)?;
    let mut mser = MSER::create(5, MIN_AREA_PX, MAX_AREA_PX, 0.25, 0.2, 200, 1.01, 0.003, 5)?;
    let mut regions: Vector<Vector<Point>> = Vector::new();
    let mut boxes: Vector<Rect> = Vector::new();
    mser.detect_regions(&picture, &mut regions, &mut boxes)?;
    let mut best: Option<(f64, Vec<Point2<f64>>)> = None;
    for region in &regions {
        let mut hull: Vector<Point> = Vector::new();
        imgproc::convex_hull(&region, &mut hull, false, true)?;
        let mut held = 0;
        for f in features {
            let p = opencv::core::Point2f::new(f.x as f32, f.y as f32);
            held += i32::from(imgproc::point_polygon_test(&hull, p, false)? >= 0.0);
        }
        let area = imgproc::contour_area(&hull, false)?.max(1.0);
        let share = f64::from(held) / features.len() as f64;
        // Most features, in the tightest region.
        let quality = share - 0.1 * area / f64::from(MAX_AREA_PX);
        if share > 1.0 / 3.0 && best.as_ref().is_none_or(|(q, _)| quality > *q) {
            let outline =
                hull.iter().map(|p| Point2::new(f64::from(p.x), f64::from(p.y))).collect();
            best = Some((quality, outline));
        }
    }
    Ok(best.map(|(_, outline)| outline))
}

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
