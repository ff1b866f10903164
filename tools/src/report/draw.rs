//! Drawing into a frame's picture: features by part, joint axes, motion manifolds.

use linkage_driver::{ColorImage, PinholeCamera, RgbdFrame};
use linkage_skill::Pose;
use linkage_skill::object::{JointGeometry, JointKind};
use nalgebra::{Point2, Point3};
use opencv::core::{Mat, Point, Scalar, Size, Vec3b, Vector};
use opencv::imgproc;
use opencv::prelude::*;

/// A colour, RGB.
pub type Rgb = [u8; 3];

/// Colours of parts, the base first: Okabe and Ito's, which colour-blind people tell apart.
const PART_COLOURS: [Rgb; 7] = [
    [0, 114, 178],
    [230, 159, 0],
    [0, 158, 115],
    [204, 121, 167],
    [213, 94, 0],
    [86, 180, 233],
    [240, 228, 66],
];

/// Drawn under a line, so that it is seen on any ground.
const HALO: Rgb = [255, 255, 255];

/// The colour of a part; many parts share colours.
pub fn part_colour(part: usize) -> Rgb {
    // The base has a colour of its own.
    let moving = PART_COLOURS.len() - 1;
    if part == 0 { PART_COLOURS[0] } else { PART_COLOURS[1 + (part - 1) % moving] }
}

/// Half of a drawn axis, metres.
const AXIS_HALF_M: f64 = 0.25;

/// A frame's picture that can be drawn on.
pub struct Canvas {
    picture: Mat,
    camera: PinholeCamera,
}

impl Canvas {
    /// Starts from a frame.
    pub fn new(frame: &RgbdFrame) -> opencv::Result<Self> {
        let pixels: Vec<Vec3b> =
            frame.color.as_rgb().chunks_exact(3).map(|p| Vec3b::from([p[0], p[1], p[2]])).collect();
        let rows = frame.color.height() as i32;
        let picture =
            Mat::new_rows_cols_with_data(rows, frame.color.width() as i32, &pixels)?.try_clone()?;
        Ok(Self { picture, camera: (*frame.camera).clone() })
    }

    /// A filled dot.
    pub fn dot(&mut self, at: Point2<f64>, radius: i32, colour: Rgb) -> opencv::Result<()> {
        imgproc::circle(
            &mut self.picture,
            point(&at),
            radius,
            scalar(colour),
            -1,
            imgproc::LINE_AA,
            0,
        )
    }

    /// A line between two places in the camera frame, where both are in front.
    pub fn segment(
        &mut self,
        a: &Point3<f64>,
        b: &Point3<f64>,
        thickness: i32,
        colour: Rgb,
    ) -> opencv::Result<()> {
        if let (Some(a), Some(b)) = (self.camera.project(a), self.camera.project(b)) {
            imgproc::line(
                &mut self.picture,
                point(&a),
                point(&b),
                scalar(colour),
                thickness,
                imgproc::LINE_AA,
                0,
            )?;
        }
        Ok(())
    }

    /// A joint's axis; slides get an arrow head.
    pub fn axis(&mut self, line: &JointGeometry, colour: Rgb) -> opencv::Result<()> {
        let half = line.axis.into_inner() * AXIS_HALF_M;
        let (a, b) = (line.origin - half, line.origin + half);
        self.segment(&a, &b, 7, HALO)?;
        self.segment(&a, &b, 3, colour)?;
        if line.kind == JointKind::Prismatic
            && let (Some(a), Some(b)) = (self.camera.project(&a), self.camera.project(&b))
        {
            imgproc::arrowed_line(
                &mut self.picture,
                point(&a),
                point(&b),
                scalar(colour),
                3,
                imgproc::LINE_AA,
                0,
                0.12,
            )?;
        }
        if let Some(origin) = self.camera.project(&line.origin) {
            self.dot(origin, 8, HALO)?;
            self.dot(origin, 6, colour)?;
        }
        Ok(())
    }

    /// The motion manifold: an outline (places in the camera frame) carried along poses.
    pub fn manifold(
        &mut self,
        outline: &[Point3<f64>],
        motions: &[Pose],
        colour: Rgb,
    ) -> opencv::Result<()> {
        for (i, motion) in motions.iter().enumerate() {
            let corners: Vector<Point> = outline
                .iter()
                .filter_map(|p| self.camera.project(&(motion * p)))
                .map(|p| point(&p))
                .collect();
            if corners.len() < 3 {
                continue;
            }
            let fade = 0.35 + 0.65 * i as f64 / motions.len().max(1) as f64;
            let shade = colour.map(|c| (f64::from(c) * fade) as u8);
            let mut outlines: Vector<Vector<Point>> = Vector::new();
            outlines.push(corners);
            imgproc::polylines(
                &mut self.picture,
                &outlines,
                true,
                scalar(shade),
                2,
                imgproc::LINE_AA,
                0,
            )?;
        }
        Ok(())
    }

    /// Makes the picture narrower, to a width in pixels; one that is narrower already stays.
    pub fn shrink_to(&mut self, width: i32) -> opencv::Result<()> {
        let (cols, rows) = (self.picture.cols(), self.picture.rows());
        if cols <= width {
            return Ok(());
        }
        let size = Size::new(width, (rows * width / cols).max(1));
        let mut small = Mat::default();
        imgproc::resize(&self.picture, &mut small, size, 0.0, 0.0, imgproc::INTER_AREA)?;
        self.picture = small;
        Ok(())
    }

    /// The finished picture.
    pub fn finish(self) -> anyhow::Result<ColorImage> {
        let rgb = self.picture.data_typed::<Vec3b>()?.iter().flat_map(|p| p.0).collect();
        Ok(ColorImage::new(self.picture.cols() as usize, self.picture.rows() as usize, rgb)?)
    }
}

fn point(p: &Point2<f64>) -> Point {
    let bound = |x: f64| x.clamp(-4000.0, 8000.0).round() as i32;
    Point::new(bound(p.x), bound(p.y))
}

fn scalar(c: Rgb) -> Scalar {
    Scalar::new(f64::from(c[0]), f64::from(c[1]), f64::from(c[2]), 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_moving_part_has_the_colour_of_the_base() {
        assert!((1..30).all(|part| part_colour(part) != part_colour(0)));
        assert_ne!(part_colour(1), part_colour(2));
    }
}
