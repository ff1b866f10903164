//! The pinhole camera with lens distortion.

use crate::depth_noise::DepthSensor;
use crate::text_table;
use nalgebra::{Point2, Point3};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::path::Path;

/// Most pixels of a picture that is taken: learning from a dozen of this size takes 1 GB.
pub const MAX_PIXELS: usize = 3840 * 2160;

/// A camera description that is not possible.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CameraError {
    /// The description could not be read or holds keys that are not known.
    #[error("{path}: {reason}")]
    File {
        /// The file.
        path: String,
        /// What is wrong, with what would be right.
        reason: String,
    },
    /// A value that no camera has.
    #[error("camera {key} is {value}: it must be {needed}")]
    Value {
        /// The key in camera.toml.
        key: &'static str,
        /// The value found.
        value: f64,
        /// What it must be.
        needed: &'static str,
    },
    /// Noise of depth that no sensor has.
    #[error("camera depth_sensor: {0}")]
    DepthSensor(String),
    /// Distortion that cannot be undone: two pixels have one line of sight, a pixel has none, or
    /// distortion moves it too far.
    #[error(
        "camera distortion cannot be undone at column {u:.0}, row {v:.0}: \
         it must be OpenCV's k1 k2 p1 p2 k3 k4 k5 k6 of this picture's size and focal length"
    )]
    Distortion {
        /// Column.
        u: f64,
        /// Row.
        v: f64,
    },
}

/// Narrowest and widest picture that is accepted, as the angle across it, degrees. Depth cameras
/// have 40 to 120; wider ones are no pinhole cameras.
const FIELD_OF_VIEW_DEG: [f64; 2] = [5.0, 150.0];
/// Least and greatest ratio of the two focal lengths: pixels are nearly square.
const ASPECT: [f64; 2] = [0.4, 2.5];
/// The principal point keeps this share of the picture's side from its border.
const BORDER: f64 = 0.05;
/// How many times farther from the axis, or nearer to it, distortion may move a pixel.
const STRETCH: f64 = 4.0;
/// Depth units in a metre that are accepted: steps of 10 mm to 0.01 mm.
const UNITS_PER_METRE: [f64; 2] = [100.0, 100_000.0];

/// Intrinsics in pixels; the centre of the top-left pixel is (0, 0).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PinholeCamera {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Focal length along x, in pixels.
    pub fx: f64,
    /// Focal length along y, in pixels.
    pub fy: f64,
    /// Principal point, column.
    pub cx: f64,
    /// Principal point, row.
    pub cy: f64,
    /// Raw depth units in a metre (5000 in the TUM layout, 1000 for millimetres).
    pub depth_units_per_metre: f64,
    /// OpenCV's `[k1, k2, p1, p2, k3, k4, k5, k6]` on normalised coordinates, all zero when
    /// absent. In camera.toml the last ones may be left out: 4 or 5 values are Brown's
    /// polynomial model, 8 the rational one.
    #[serde(default, deserialize_with = "read_distortion", serialize_with = "write_distortion")]
    pub distortion: [f64; 8],
    /// How depth is measured: `"structured_light"` (the default), `"time_of_flight"` or `"stereo"`, or the noise that
    /// was measured, `{ polynomial = [a, b, c] }`.
    #[serde(default, skip_serializing_if = "DepthSensor::is_default")]
    pub depth_sensor: DepthSensor,
}

fn read_distortion<'de, D: Deserializer<'de>>(input: D) -> Result<[f64; 8], D::Error> {
    let values = Vec::<f64>::deserialize(input)?;
    if ![4, 5, 8].contains(&values.len()) {
        return Err(serde::de::Error::custom(format!(
            "distortion has {} values; understood are 4 (k1 k2 p1 p2), 5 (and k3) and 8 (and k4 k5 k6), in OpenCV's order",
            values.len()
        )));
    }
    let mut distortion = [0.0; 8];
    distortion[..values.len()].copy_from_slice(&values);
    Ok(distortion)
}

fn write_distortion<S: Serializer>(distortion: &[f64; 8], output: S) -> Result<S::Ok, S::Error> {
    let is_rational = distortion[5..].iter().any(|k| *k != 0.0);
    distortion[..if is_rational { 8 } else { 5 }].serialize(output)
}

impl PinholeCamera {
    /// The usual values of a Kinect registered to its colour camera.
    pub fn kinect() -> Self {
        Self {
            width: 640,
            height: 480,
            fx: 525.0,
            fy: 525.0,
            cx: 319.5,
            cy: 239.5,
            depth_units_per_metre: 5000.0,
            distortion: [0.0; 8],
            depth_sensor: DepthSensor::StructuredLight,
        }
    }

    /// Brown's `[k1, k2, p1, p2, k3]` as [`Self::distortion`].
    pub fn brown([k1, k2, p1, p2, k3]: [f64; 5]) -> [f64; 8] {
        [k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]
    }

    /// Logs which values are assumed for a camera that is not described.
    pub fn warn_assumed(&self, source: &str, remedy: &str) {
        tracing::warn!(
            source,
            "nothing tells the camera: assumed are {}x{} pixels, fx {}, fy {}, cx {}, cy {}, {} depth units in a metre, no distortion; {remedy}",
            self.width,
            self.height,
            self.fx,
            self.fy,
            self.cx,
            self.cy,
            self.depth_units_per_metre,
        );
    }

    /// Reads `camera.toml`.
    ///
    /// # Errors
    /// [`CameraError::File`] when it cannot be read, is no TOML or has unknown keys;
    /// [`CameraError::Value`] when a value makes no camera.
    pub fn read(path: &Path) -> Result<Self, CameraError> {
        let file = |reason: String| CameraError::File { path: path.display().to_string(), reason };
        let text = text_table::read(path).map_err(|e| file(e.to_string()))?;
        Self::parse(&text).map_err(file)
    }

    /// Reads the text of a `camera.toml`.
    ///
    /// # Errors
    /// What is wrong with it, in a line.
    pub fn parse(text: &str) -> Result<Self, String> {
        let camera: Self = toml::from_str(text).map_err(|e| one_line(&e.to_string()))?;
        camera.check().map_err(|e| e.to_string())?;
        Ok(camera)
    }

    /// Refuses values that make no camera.
    ///
    /// # Errors
    /// [`CameraError::Value`] names the key, its value and what it must be;
    /// [`CameraError::Distortion`] a distortion that cannot be undone.
    pub fn check(&self) -> Result<(), CameraError> {
        self.check_size()?;
        let value = |key, value, needed| Err(CameraError::Value { key, value, needed });
        let (width, height) = (self.width as f64, self.height as f64);
        for (key, focal, extent) in [("fx", self.fx, width), ("fy", self.fy, height)] {
            if !(focal.is_finite() && focal > 0.0) {
                return value(key, focal, "finite and above 0");
            }
            let degrees = 2.0 * (0.5 * extent / focal).atan().to_degrees();
            if !(FIELD_OF_VIEW_DEG[0]..=FIELD_OF_VIEW_DEG[1]).contains(&degrees) {
                return value(key, focal, "in pixels, and the picture 5 to 150 degrees wide by it");
            }
        }
        if !(ASPECT[0]..=ASPECT[1]).contains(&(self.fx / self.fy)) {
            return value("fy", self.fy, "near fx: pixels are nearly square");
        }
        for (key, center, extent) in [("cx", self.cx, width), ("cy", self.cy, height)] {
            if !(center > BORDER * extent && center < (1.0 - BORDER) * extent) {
                return value(key, center, "inside the picture, in pixels and not at its border");
            }
        }
        let units = self.depth_units_per_metre;
        if !(UNITS_PER_METRE[0]..=UNITS_PER_METRE[1]).contains(&units) {
            let needed = "100 to 100000: 1000 for millimetres, 5000 in the TUM layout";
            return value("depth_units_per_metre", units, needed);
        }
        match self.depth_sensor.fault() {
            Some(reason) => Err(CameraError::DepthSensor(reason)),
            None => self.check_distortion(),
        }
    }

    fn check_size(&self) -> Result<(), CameraError> {
        for (key, side) in [("width", self.width), ("height", self.height)] {
            if side == 0 {
                return Err(CameraError::Value { key, value: 0.0, needed: "above 0" });
            }
        }
        if self.width.checked_mul(self.height).is_some_and(|pixels| pixels <= MAX_PIXELS) {
            return Ok(());
        }
        Err(CameraError::Value {
            key: "width",
            value: self.width as f64,
            needed: "such that width x height is at most 8294400 (3840x2160); shrink the pictures",
        })
    }

    /// Looks at places all over the picture: undistorting must undo distortion, which must keep
    /// the order of pixels and may not move them far.
    fn check_distortion(&self) -> Result<(), CameraError> {
        const STEPS: usize = 16;
        if let Some(&value) = self.distortion.iter().find(|k| !k.is_finite()) {
            return Err(CameraError::Value { key: "distortion", value, needed: "finite" });
        }
        if self.distortion == [0.0; 8] {
            return Ok(());
        }
        for v in 0..=STEPS {
            for u in 0..=STEPS {
                let share = |i: usize, side: usize| i as f64 / STEPS as f64 * (side as f64 - 1.0);
                let (u, v) = (share(u, self.width), share(v, self.height));
                let (xd, yd) = ((u - self.cx) / self.fx, (v - self.cy) / self.fy);
                let (x, y) = self.undistort(xd, yd);
                let there = self.distorted(x, y);
                let error = (there.x - xd).abs() + (there.y - yd).abs();
                let goes_on = there.dx_dx > 0.0 && there.determinant() > 0.0;
                let (there, here) = (xd.hypot(yd), x.hypot(y));
                let is_near = here < STRETCH * there + 1e-3 && there < STRETCH * here + 1e-3;
                if !(error < 1e-6 && goes_on && is_near) {
                    return Err(CameraError::Distortion { u, v });
                }
            }
        }
        Ok(())
    }

    /// Pixel at which a point of the camera frame appears; `None` behind the camera.
    #[inline]
    pub fn project(&self, point_in_camera: &Point3<f64>) -> Option<Point2<f64>> {
        if point_in_camera.z <= 1e-6 {
            return None;
        }
        let x = point_in_camera.x / point_in_camera.z;
        let y = point_in_camera.y / point_in_camera.z;
        let (x, y) = self.distort(x, y);
        Some(Point2::new(self.fx * x + self.cx, self.fy * y + self.cy))
    }

    /// The point of the camera frame at depth `z` metres seen at pixel (`u`, `v`).
    #[inline]
    pub fn back_project(&self, u: f64, v: f64, z: f64) -> Point3<f64> {
        let (x, y) = self.undistort((u - self.cx) / self.fx, (v - self.cy) / self.fy);
        Point3::new(x * z, y * z, z)
    }

    /// True when the pixel lies inside the picture by `margin` pixels.
    #[inline]
    pub fn sees(&self, pixel: &Point2<f64>, margin: f64) -> bool {
        pixel.x >= margin
            && pixel.y >= margin
            && pixel.x <= self.width as f64 - 1.0 - margin
            && pixel.y <= self.height as f64 - 1.0 - margin
    }

    #[inline]
    fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        if self.distortion == [0.0; 8] {
            return (x, y);
        }
        let there = self.distorted(x, y);
        (there.x, there.y)
    }

    /// Where distortion moves a point of the plane one metre ahead, and by which derivatives.
    fn distorted(&self, x: f64, y: f64) -> Distorted {
        let [k1, k2, p1, p2, k3, k4, k5, k6] = self.distortion;
        let r2 = x * x + y * y;
        let over = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let under = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
        let over_slope = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
        let under_slope = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6);
        let radial = over / under;
        // The derivative of the radial factor by r squared.
        let slope = (over_slope - radial * under_slope) / under;
        Distorted {
            x: x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y: y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            dx_dx: radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            dx_dy: 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y,
            dy_dy: radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        }
    }

    /// The point that distortion moves to (`xd`, `yd`), by Newton's method.
    #[inline]
    fn undistort(&self, xd: f64, yd: f64) -> (f64, f64) {
        if self.distortion == [0.0; 8] {
            return (xd, yd);
        }
        let (mut x, mut y) = (xd, yd);
        for _ in 0..20 {
            let there = self.distorted(x, y);
            let (ex, ey) = (xd - there.x, yd - there.y);
            let determinant = there.determinant();
            x += (there.dy_dy * ex - there.dx_dy * ey) / determinant;
            y += (there.dx_dx * ey - there.dx_dy * ex) / determinant;
            if ex.abs() + ey.abs() < 1e-13 {
                break;
            }
        }
        (x, y)
    }
}

/// A distorted point and the symmetric matrix of its derivatives.
struct Distorted {
    x: f64,
    y: f64,
    dx_dx: f64,
    dx_dy: f64,
    dy_dy: f64,
}

impl Distorted {
    fn determinant(&self) -> f64 {
        self.dx_dx * self.dy_dy - self.dx_dy * self.dx_dy
    }
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// An Azure Kinect's usual values, of the rational model.
    const RATIONAL: [f64; 8] = [0.45, -2.6, 0.0006, -0.0002, 1.5, 0.33, -2.4, 1.43];

    proptest! {
        #[test]
        fn projecting_what_was_back_projected_gives_the_same_pixel(
            u in 5.0..635.0, v in 5.0..475.0, z in 0.4..6.0,
            k1 in -0.1..0.1, p1 in -0.005..0.005, is_rational: bool,
        ) {
            let polynomial = PinholeCamera::brown([k1, 0.02, p1, -0.001, 0.0]);
            let camera = PinholeCamera {
                distortion: if is_rational { RATIONAL } else { polynomial },
                ..PinholeCamera::kinect()
            };
            let point = camera.back_project(u, v, z);
            let pixel = camera.project(&point).unwrap();
            prop_assert!((pixel.x - u).abs() < 1e-9 && (pixel.y - v).abs() < 1e-9);
            prop_assert!((point.z - z).abs() < 1e-12);
        }

        #[test]
        fn no_numbers_make_the_check_panic(
            sides in proptest::array::uniform2(0..usize::MAX),
            numbers in proptest::array::uniform5(proptest::num::f64::ANY),
            distortion in proptest::array::uniform8(proptest::num::f64::ANY),
        ) {
            let [width, height] = sides;
            let [fx, fy, cx, cy, depth_units_per_metre] = numbers;
            let camera = PinholeCamera::kinect();
            let _ = PinholeCamera {
                width, height, fx, fy, cx, cy, depth_units_per_metre, distortion, ..camera
            }
            .check();
            let _ = PinholeCamera { distortion, ..PinholeCamera::kinect() }.check();
        }
    }

    #[test]
    fn a_point_behind_the_camera_has_no_pixel() {
        assert_eq!(PinholeCamera::kinect().project(&Point3::new(0.0, 0.0, -1.0)), None);
    }

    /// The error of a Kinect's description in which one line is replaced.
    fn refusal(key: &str, value: &str) -> String {
        let text = toml::to_string(&PinholeCamera::kinect()).unwrap();
        let lines = text.lines().filter(|l| !l.starts_with(&format!("{key} =")));
        let text = lines.collect::<Vec<_>>().join("\n") + &format!("\n{key} = {value}\n");
        PinholeCamera::parse(&text).err().unwrap_or_else(|| panic!("{key} = {value} is taken"))
    }

    #[test]
    fn a_value_that_no_camera_has_is_refused_by_name() {
        for (key, values) in [
            ("width", &["0", "1000000000000", "9223372036854775807", "-640", "5"][..]),
            ("height", &["0", "1000000000000", "48"]),
            ("fx", &["0.0", "-525.0", "nan", "inf", "0.8", "5.25", "1e6", "2100.0"]),
            ("fy", &["0.0", "3.6", "50000.0", "1500.0"]),
            ("cx", &["-1.0", "0.5", "640.0", "nan", "3195.0"]),
            ("cy", &["0.0", "0.5", "479.9", "inf"]),
            ("depth_units_per_metre", &["0.0", "-5000.0", "nan", "0.001", "1.0", "1e9", "inf"]),
        ] {
            for value in values {
                let error = refusal(key, value);
                let told = if key == "fx" && *value == "2100.0" { "fy" } else { key };
                let told = if ["width", "height"].contains(&key) { "" } else { told };
                assert!(error.contains(told), "{key} = {value}: {error}");
            }
        }
        assert_eq!(refusal("fx", "0.0"), "camera fx is 0: it must be finite and above 0");
    }

    #[test]
    fn distortion_of_a_number_of_values_that_no_model_has_is_refused() {
        for count in [0, 1, 2, 3, 6, 7, 9, 12, 14] {
            let error = refusal("distortion", &format!("{:?}", vec![0.01; count]));
            assert!(error.contains(&format!("{count} values")), "{error}");
        }
    }

    #[test]
    fn distortion_that_cannot_be_undone_is_refused() {
        for values in ["[-2.0, 0.0, 0.0, 0.0, 0.0]", "[0.0, 0.0, 5.0, 0.0]", "[1e9, 0, 0, 0, 0]"] {
            let error = refusal("distortion", values);
            assert!(error.contains("cannot be undone"), "{values}: {error}");
        }
        assert!(refusal("distortion", "[nan, 0.0, 0.0, 0.0, 0.0]").contains("finite"));
    }

    #[test]
    fn four_five_and_eight_values_of_distortion_are_read_as_opencv_orders_them() {
        let read = |values: &[f64]| {
            let text = toml::to_string(&PinholeCamera::kinect()).unwrap();
            let text = text.lines().filter(|l| !l.starts_with("distortion"));
            let text = text.collect::<Vec<_>>().join("\n");
            PinholeCamera::parse(&format!("{text}\ndistortion = {values:?}\n")).unwrap()
        };
        for count in [4, 5, 8] {
            let mut expected = [0.0; 8];
            expected[..count].copy_from_slice(&RATIONAL[..count]);
            expected[..2].copy_from_slice(if count == 8 { &RATIONAL[..2] } else { &[0.1, -0.2] });
            expected[4] = if count == 4 { 0.0 } else { expected[4] };
            let camera = read(&expected[..count]);
            assert_eq!(camera.distortion, expected);
            let written = toml::to_string(&camera).unwrap();
            assert_eq!(PinholeCamera::parse(&written).unwrap(), camera);
        }
    }

    #[test]
    fn the_depth_sensor_is_read_and_told_only_where_it_is_not_the_usual_one() {
        let text = toml::to_string(&PinholeCamera::kinect()).unwrap();
        assert!(!text.contains("depth_sensor"));
        let camera = PinholeCamera::parse(&(text.clone() + "depth_sensor = \"stereo\"\n")).unwrap();
        assert_eq!(camera.depth_sensor, DepthSensor::Stereo);
        assert_eq!(PinholeCamera::parse(&toml::to_string(&camera).unwrap()).unwrap(), camera);
        let measured = "depth_sensor = { polynomial = [0.001, 0.0, 0.0019] }\n";
        let camera = PinholeCamera::parse(&(text.clone() + measured)).unwrap();
        assert_eq!(camera.depth_sensor, DepthSensor::Polynomial([0.001, 0.0, 0.0019]));
        assert_eq!(PinholeCamera::parse(&toml::to_string(&camera).unwrap()).unwrap(), camera);
        let wrong = "depth_sensor = { polynomial = [0.001, -1.0, 0.0] }\n";
        let error = PinholeCamera::parse(&(text.clone() + wrong)).unwrap_err();
        assert!(error.contains("depth_sensor") && error.contains("must be above 0"), "{error}");
        let error = PinholeCamera::parse(&(text + "depth_sensor = \"sonar\"\n")).unwrap_err();
        assert!(error.contains("sonar") && error.contains("time_of_flight"), "{error}");
    }

    #[test]
    fn the_rational_model_is_opencvs() {
        // cv2.projectPoints of (0.4, -0.3, 1) with these eight values.
        let camera = PinholeCamera { distortion: RATIONAL, ..PinholeCamera::kinect() };
        let [x, y] = [0.4_f64, -0.3];
        let r2 = x * x + y * y;
        let [k1, k2, p1, p2, k3, k4, k5, k6] = RATIONAL;
        let radial = (1.0 + k1 * r2 + k2 * r2.powi(2) + k3 * r2.powi(3))
            / (1.0 + k4 * r2 + k5 * r2.powi(2) + k6 * r2.powi(3));
        let expected = [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ];
        let pixel = camera.project(&Point3::new(x, y, 1.0)).unwrap();
        assert!((pixel.x - (525.0 * expected[0] + 319.5)).abs() < 1e-9);
        assert!((pixel.y - (525.0 * expected[1] + 239.5)).abs() < 1e-9);
    }
}
