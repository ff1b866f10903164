//! Discs in a picture, joined to one area that is coloured and that the picture shows through.

use opencv::core::{BORDER_CONSTANT, CV_8U, CV_32S, Mat, Point, Scalar, Size, Vec3b, Vector};
use opencv::imgproc;
use opencv::prelude::*;

/// Share of their radius by which the joined discs are taken back: what lies between places stays, what
/// bulges out round the outermost does not.
const TAKEN_BACK: f64 = 0.7;
/// Connected areas smaller than this share of the largest are left out: what is drawn of them would be
/// strays.
const LEAST_SHARE: f64 = 0.1;

/// A disc in a picture, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Disc {
    pub at: Point,
    pub radius: i32,
}

/// Colours the area of the discs, with a line round it; `opacity` is 0 to 1.
pub fn veil(picture: &mut Mat, discs: &[Disc], colour: Scalar, opacity: f64) -> opencv::Result<()> {
    if discs.is_empty() {
        return Ok(());
    }
    let area = main_area(&joined(discs, picture.size()?)?)?;
    let share = |old: u8, new: f64| ((1.0 - opacity) * f64::from(old) + opacity * new) as u8;
    let inside = area.data_bytes()?.iter();
    for (pixel, _) in
        picture.data_typed_mut::<Vec3b>()?.iter_mut().zip(inside).filter(|(_, a)| **a > 0)
    {
        for (channel, new) in pixel.0.iter_mut().zip(colour.0) {
            *channel = share(*channel, new);
        }
    }
    let mut lines: Vector<Vector<Point>> = Vector::new();
    let (mode, method) = (imgproc::RETR_LIST, imgproc::CHAIN_APPROX_SIMPLE);
    imgproc::find_contours(&area, &mut lines, mode, method, Point::default())?;
    imgproc::polylines(picture, &lines, true, colour, 1, imgproc::LINE_AA, 0)
}

/// The area that the discs cover, without what bulges out.
fn joined(discs: &[Disc], size: Size) -> opencv::Result<Mat> {
    let mut area = Mat::new_size_with_default(size, CV_8U, Scalar::all(0.0))?;
    for disc in discs {
        let (white, filled) = (Scalar::all(255.0), imgproc::FILLED);
        imgproc::circle(&mut area, disc.at, disc.radius, white, filled, imgproc::LINE_8, 0)?;
    }
    let largest = discs.iter().map(|disc| disc.radius).max().unwrap_or(0);
    let side = 2 * (TAKEN_BACK * f64::from(largest)) as i32 + 1;
    let middle = Point::new(-1, -1);
    let round =
        imgproc::get_structuring_element(imgproc::MORPH_ELLIPSE, Size::new(side, side), middle)?;
    let border = imgproc::morphology_default_border_value()?;
    let mut smooth = Mat::default();
    imgproc::erode(&area, &mut smooth, &round, middle, 1, BORDER_CONSTANT, border)?;
    Ok(smooth)
}

/// The largest connected area, and others that are not much smaller.
fn main_area(area: &Mat) -> opencv::Result<Mat> {
    let (mut labels, mut statistics, mut centers) =
        (Mat::default(), Mat::default(), Mat::default());
    let count = imgproc::connected_components_with_stats(
        area,
        &mut labels,
        &mut statistics,
        &mut centers,
        8,
        CV_32S,
    )?;
    let pixels = |label: i32| statistics.at_2d::<i32>(label, imgproc::CC_STAT_AREA).copied();
    // Label 0 is the ground.
    let sizes = (1..count).map(pixels).collect::<opencv::Result<Vec<i32>>>()?;
    let least = LEAST_SHARE * f64::from(sizes.iter().copied().max().unwrap_or(0));
    let mut kept = area.clone();
    let labels = labels.data_typed::<i32>()?;
    for (pixel, label) in kept.data_bytes_mut()?.iter_mut().zip(labels) {
        let size = usize::try_from(*label - 1).ok().and_then(|i| sizes.get(i));
        if size.is_none_or(|size| f64::from(*size) < least) {
            *pixel = 0;
        }
    }
    Ok(kept)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn disc(x: i32, y: i32, radius: i32) -> Disc {
        Disc { at: Point::new(x, y), radius }
    }

    #[test]
    fn discs_that_touch_are_one_area_and_the_picture_shows_through() {
        let size = Size::new(60, 40);
        let mut picture =
            Mat::new_size_with_default(size, opencv::core::CV_8UC3, Scalar::all(100.0)).unwrap();
        let discs = [disc(17, 20, 9), disc(23, 20, 9), disc(55, 5, 1)];
        veil(&mut picture, &discs, Scalar::new(200.0, 0.0, 100.0, 0.0), 0.5).unwrap();
        let at = |x, y| picture.at_2d::<Vec3b>(y, x).unwrap().0;
        assert_eq!(at(20, 20), [150, 50, 100], "between the two");
        assert_eq!(at(55, 5), [100; 3], "a stray");
        assert_eq!(at(45, 20), [100; 3], "outside");
    }

    #[test]
    fn no_discs_and_discs_outside_of_the_picture_colour_nothing() {
        let size = Size::new(10, 10);
        let blank =
            || Mat::new_size_with_default(size, opencv::core::CV_8UC3, Scalar::all(9.0)).unwrap();
        for discs in [vec![], vec![disc(-50, 3, 4), disc(500, 500, 4)]] {
            let mut picture = blank();
            veil(&mut picture, &discs, Scalar::all(255.0), 1.0).unwrap();
            assert_eq!(picture.data_bytes().unwrap(), blank().data_bytes().unwrap());
        }
    }
}
