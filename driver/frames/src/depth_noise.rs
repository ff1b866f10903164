//! How exact a depth camera's readings are: one model for learning, recognition and following. All depths `z` and
//! standard deviations are in metres.

use serde::{Deserialize, Serialize};

/// Focal length for which the noise across the ray was measured, pixels.
const NOMINAL_FOCAL_PX: f64 = 525.0;

/// How a depth camera measures, which decides how its noise grows with depth. `depth_sensor` in camera.toml.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthSensor {
    /// A pattern is projected and seen from beside (Kinect v1, Asus Xtion, Orbbec Astra).
    #[default]
    StructuredLight,
    /// Light is sent out, and its way back takes time (Kinect v2, Azure Kinect, LiDAR of phones).
    TimeOfFlight,
    /// Two pictures are matched (RealSense D400, OAK-D, ZED).
    Stereo,
    /// Another one, whose noise was measured: `[a, b, c]` where the standard deviation of a reading at depth `z` is
    /// `a + b z + c z²`. In camera.toml: `depth_sensor = { polynomial = [0.001, 0.0, 0.0019] }`.
    Polynomial([f64; 3]),
}

/// Standard deviations at a metre that a sensor can have, metres.
const SIGMA_AT_1_M: std::ops::RangeInclusive<f64> = 1e-5..=0.1;

impl DepthSensor {
    /// True for what is assumed where nothing tells the sensor.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// What is wrong with the coefficients, if anything is.
    pub(crate) fn fault(&self) -> Option<String> {
        let Self::Polynomial(coefficients) = self else { return None };
        if !coefficients.iter().all(|k| k.is_finite() && *k >= 0.0) || coefficients[0] <= 0.0 {
            return Some(format!(
                "its polynomial is {coefficients:?}; the first must be above 0, the others 0 or above"
            ));
        }
        let at_1_m = self.reading_sigma(1.0);
        (!SIGMA_AT_1_M.contains(&at_1_m)).then(|| {
            format!(
                "its polynomial gives a standard deviation of {at_1_m} m at 1 m; a sensor has {} to {} m: are the \
                 coefficients of metres?",
                SIGMA_AT_1_M.start(),
                SIGMA_AT_1_M.end()
            )
        })
    }

    /// Standard deviation of a reading at depth `z`.
    ///
    /// - Structured light: noise of the match plus the step of the disparity; it grows with the square of the depth
    ///   (Khoshelham & Elberink 2012; constants measured on Kinect-like recordings).
    /// - Time of flight: 1.2 mm near, 4 mm at 3 m (Tölgyessy et al. 2021, Azure Kinect and Kinect v2).
    /// - Stereo: 0.08 pixels of disparity at a focal length of 447 pixels and a baseline of 50 mm (RealSense D435,
    ///   whose maker's formula this is), and a millimetre of its filters.
    #[inline]
    pub fn reading_sigma(self, z: f64) -> f64 {
        match self {
            Self::StructuredLight => {
                let disparity_step = z * z / (580.0 * 0.075) / 8.0 / 3.5;
                0.0012 + 0.0019 * (z - 0.4) * (z - 0.4) + disparity_step
            }
            Self::TimeOfFlight => 0.0012 + 0.0003 * z * z,
            Self::Stereo => 0.001 + z * z * 0.08 / (447.0 * 0.05),
            Self::Polynomial([a, b, c]) => a + z * (b + z * c),
        }
    }

    /// How far a reading may lie from a surface at depth `z` whose normal has this cosine to the line of sight.
    pub fn tolerance(self, z: f64, cosine: f64) -> f64 {
        let slant = (1.0 / cosine.max(0.2).powi(2) - 1.0).max(0.0).sqrt();
        0.006 + 3.0 * self.reading_sigma(z) + 0.004 * slant
    }

    /// Standard deviation along the viewing ray of a feature at depth `z`, whose depth is a mean of readings around
    /// it. Measured with structured light: 0.9 mm at 0.75 m, 2.0 mm at 1.4 m, 4.1 mm at 2.3 m.
    pub fn feature_ray_sigma(self, z: f64) -> f64 {
        self.relative(z) * (0.0008 + 0.0009 * z * z)
    }

    /// One figure for the noise of a feature at depth `z`, along and across the ray.
    #[inline]
    pub fn feature_sigma(self, z: f64) -> f64 {
        (self.relative(z) * (0.002 + 0.0012 * z * z)).max(feature_across_sigma(z))
    }

    /// Noise of a reading relative to that of structured light.
    #[inline]
    fn relative(self, z: f64) -> f64 {
        match self {
            Self::StructuredLight => 1.0,
            _ => self.reading_sigma(z) / Self::StructuredLight.reading_sigma(z),
        }
    }
}

/// Standard deviation of a feature's place across the viewing ray at depth `z`: that of the colour picture, whatever
/// the depth sensor.
#[inline]
pub fn feature_across_sigma(z: f64) -> f64 {
    0.0003 + 0.7 * z / NOMINAL_FOCAL_PX
}

#[cfg(test)]
mod tests {
    use super::*;
    use DepthSensor::{Polynomial, Stereo, StructuredLight, TimeOfFlight};

    const KINDS: [DepthSensor; 3] = [StructuredLight, TimeOfFlight, Stereo];
    const ALL: [DepthSensor; 4] =
        [StructuredLight, TimeOfFlight, Stereo, Polynomial([0.001, 0.0005, 0.002])];

    #[test]
    fn noise_grows_with_the_square_of_the_depth() {
        let at = |z| StructuredLight.reading_sigma(z);
        let ratio = (at(4.0) - at(2.0)) / (at(3.0) - at(2.0));
        assert!((2.0..3.5).contains(&ratio), "{ratio}");
        assert!((0.001..0.003).contains(&at(0.8)), "{}", at(0.8));
        for sensor in ALL {
            assert!(sensor.reading_sigma(4.0) > sensor.reading_sigma(1.0));
        }
    }

    #[test]
    fn far_off_time_of_flight_is_the_most_exact_and_near_stereo_the_least() {
        let sigmas = |z: f64| KINDS.map(|s| s.reading_sigma(z));
        let [light, time, stereo] = sigmas(3.0);
        assert!(time < 0.3 * light && time < 0.3 * stereo);
        let [light, time, stereo] = sigmas(1.0);
        assert!(stereo > light && stereo > time);
    }

    #[test]
    fn a_polynomial_is_the_noise_that_was_measured() {
        let sensor = Polynomial([0.001, 0.0005, 0.002]);
        assert!((sensor.reading_sigma(2.0) - 0.010).abs() < 1e-12);
        let same = Polynomial([0.0012, 0.0, 0.0003]);
        for z in [0.5, 1.0, 3.0] {
            assert!((same.feature_sigma(z) - TimeOfFlight.feature_sigma(z)).abs() < 1e-12);
        }
    }

    #[test]
    fn coefficients_that_no_sensor_has_are_told() {
        assert_eq!(ALL.map(|sensor| sensor.fault()), [const { None }; 4]);
        for wrong in
            [[0.0, 0.0, 0.0], [0.001, -1.0, 0.0], [f64::NAN, 0.0, 0.0], [0.001, f64::INFINITY, 0.0]]
        {
            let told = Polynomial(wrong).fault().expect("it is told");
            assert!(told.contains("must be above 0"), "{told}");
        }
        assert!(Polynomial([1.0, 0.0, 2.0]).fault().expect("millimetres").contains("of metres?"));
    }

    #[test]
    fn a_slanted_surface_may_lie_farther_off() {
        for sensor in ALL {
            let head_on = sensor.tolerance(1.0, 1.0);
            assert!((head_on - 0.006 - 3.0 * sensor.reading_sigma(1.0)).abs() < 1e-12);
            assert!(sensor.tolerance(1.0, 0.5) > head_on);
            let grazing = [0.1, 0.0].map(|cosine| sensor.tolerance(1.0, cosine));
            assert_eq!(grazing[0], grazing[1], "the slant is bounded");
        }
    }

    #[test]
    fn noise_of_a_feature_along_the_ray_is_near_what_was_measured() {
        for (z, measured) in [(0.75, 0.0009), (1.4, 0.0020), (2.3, 0.0041)] {
            let sigma = StructuredLight.feature_ray_sigma(z);
            assert!((sigma - measured).abs() < 0.0016, "{z} m: {sigma}");
        }
    }

    #[test]
    fn the_one_figure_of_a_feature_is_above_both_directions() {
        for sensor in ALL {
            for z in [0.5, 1.0, 2.0, 4.0] {
                let one = sensor.feature_sigma(z);
                assert!(one > sensor.feature_ray_sigma(z) || one >= feature_across_sigma(z));
                assert!(one > feature_across_sigma(z) / 2.0);
            }
        }
    }
}
