//! Drawing into a frame's picture: features by part, joint axes, motion manifolds.

pub use super::veil::Disc;
use super::veil::veil;
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

/// Gap between pictures, pixels.
const GAP_PX: usize = 8;
/// Largest radius of a disc, pixels.
const LARGEST_DISC_PX: f64 = 60.0;
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
        Ok(Self { camera: (*frame.camera).clone(), ..Self::of(&frame.color)? })
    }

    /// Starts from a picture of which no camera is known: places in space have no pixel of their own.
    pub fn of(picture: &ColorImage) -> opencv::Result<Self> {
        let pixels: Vec<Vec3b> =
            picture.as_rgb().chunks_exact(3).map(|p| Vec3b::from([p[0], p[1], p[2]])).collect();
        let (rows, columns) = (picture.height() as i32, picture.width() as i32);
        let picture = Mat::new_rows_cols_with_data(rows, columns, &pixels)?.try_clone()?;
        Ok(Self { picture, camera: PinholeCamera::kinect() })
    }

    /// A title in the upper left corner, in plain ASCII: the vision library has no other letters.
    pub fn title(&mut self, text: &str) -> opencv::Result<()> {
        for (thickness, colour) in [(6, [0, 0, 0]), (2, HALO)] {
            imgproc::put_text(
                &mut self.picture,
                text,
                Point::new(12, 34),
                imgproc::FONT_HERSHEY_SIMPLEX,
                0.9,
                scalar(colour),
                thickness,
                imgproc::LINE_AA,
                false,
            )?;
        }
        Ok(())
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

    /// The disc that a ball of this radius, metres, is seen as; `None` behind the camera.
    pub fn disc(&self, middle: &Point3<f64>, radius_m: f64) -> Option<Disc> {
        let at = point(&self.camera.project(middle)?);
        let radius = (self.camera.fx * radius_m / middle.z).clamp(1.0, LARGEST_DISC_PX);
        Some(Disc { at, radius: radius.ceil() as i32 })
    }

    /// An area that discs cover, which the picture shows through.
    pub fn veil(&mut self, discs: &[Disc], colour: Rgb, opacity: f64) -> opencv::Result<()> {
        veil(&mut self.picture, discs, scalar(colour), opacity)
    }

    /// A way through places in the camera frame, with a dot at its end.
    pub fn way(&mut self, places: &[Point3<f64>], colour: Rgb) -> opencv::Result<()> {
        for (thickness, colour) in [(5, HALO), (2, colour)] {
            for pair in places.windows(2) {
                self.segment(&pair[0], &pair[1], thickness, colour)?;
            }
        }
        if let Some(end) = places.last().and_then(|p| self.camera.project(p)) {
            self.dot(end, 6, HALO)?;
            self.dot(end, 4, colour)?;
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

/// Pictures beside each other with a white gap, as high as the highest.
pub fn side_by_side(pictures: &[ColorImage]) -> anyhow::Result<ColorImage> {
    let height = pictures.iter().map(ColorImage::height).max().unwrap_or(0);
    let width: usize = pictures.iter().map(|p| p.width() + GAP_PX).sum();
    let width = width.saturating_sub(GAP_PX);
    let mut rgb = vec![255; 3 * width * height];
    let mut left = 0;
    for picture in pictures {
        let row_bytes = 3 * picture.width();
        for (v, row) in picture.as_rgb().chunks_exact(row_bytes.max(1)).enumerate() {
            let start = 3 * (v * width + left);
            rgb[start..start + row_bytes].copy_from_slice(row);
        }
        left += picture.width() + GAP_PX;
    }
    Ok(ColorImage::new(width, height, rgb)?)
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
    fn pictures_of_two_sizes_stand_beside_each_other() {
        let picture = |width: usize, height: usize, shade: u8| {
            ColorImage::new(width, height, vec![shade; 3 * width * height]).unwrap()
        };
        let joined = side_by_side(&[picture(4, 3, 10), picture(5, 2, 20)]).unwrap();
        assert_eq!((joined.width(), joined.height()), (4 + GAP_PX + 5, 3));
        let shades = [(3, 2), (4, 0), (4 + GAP_PX, 1), (4 + GAP_PX, 2)];
        let shades = shades.map(|(u, v)| joined.at(u, v).map(|p| p[0]));
        assert_eq!(shades, [Some(10), Some(255), Some(20), Some(255)]);
        assert_eq!(side_by_side(&[]).unwrap().width(), 0);
    }

    #[test]
    fn no_moving_part_has_the_colour_of_the_base() {
        assert!((1..30).all(|part| part_colour(part) != part_colour(0)));
        assert_ne!(part_colour(1), part_colour(2));
    }
}
