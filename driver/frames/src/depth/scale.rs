//! Checks the scale of depth: where millimetres are read at 5000 units a metre, a door appears 0.2 m
//! before the camera.

use crate::frame::DepthImage;

/// Medians of depth that a scene of a depth camera has, metres.
const USUAL_METRES: std::ops::RangeInclusive<f32> = 0.4..=8.0;
/// Nearer than this a Kinect, whose scale is assumed where none is given, sees nothing, metres.
const NEAREST_METRES: f32 = 0.3;
/// Frames that are checked.
const FRAMES: usize = 3;
/// About this many readings of a frame are checked.
const SAMPLES: usize = 10_000;
/// Fewest readings from which a scale is estimated.
const FEWEST: usize = 50;
/// Scales that are in use, units in a metre.
const SCALES: [f64; 4] = [1000.0, 5000.0, 10_000.0, 4000.0];

/// Checks the first frames of a source.
#[derive(Debug, Clone)]
pub struct ScaleCheck {
    units_per_metre: f64,
    is_assumed: bool,
    frames_left: usize,
}

/// What is wrong with the scale of depth, in words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ScaleIssue {
    /// The scale is assumed, and the scene contradicts it: an error.
    Wrong(String),
    /// The scale is given, or the scene allows it: a warning.
    Odd(String),
}

impl ScaleCheck {
    /// Checks depth that is read at this many units a metre, which are given or assumed.
    pub fn new(units_per_metre: f64, is_assumed: bool) -> Self {
        Self { units_per_metre, is_assumed, frames_left: FRAMES }
    }

    /// Checks the next frame's depth. At most one issue is returned.
    pub fn look(&mut self, depth: &DepthImage) -> Option<ScaleIssue> {
        if self.frames_left == 0 {
            return None;
        }
        let step = (depth.as_metres().len() / SAMPLES).max(1);
        let readings = depth.as_metres().iter().step_by(step).copied();
        let mut readings: Vec<f32> = readings.filter(|z| !z.is_nan()).collect();
        if readings.len() < FEWEST {
            return None;
        }
        self.frames_left -= 1;
        let mut quantile = |share: usize| {
            let place = readings.len() * share / 100;
            *readings.select_nth_unstable_by(place, f32::total_cmp).1
        };
        let (near, median) = (quantile(5), quantile(50));
        let too_near = self.is_assumed && near < NEAREST_METRES;
        if USUAL_METRES.contains(&median) && !too_near {
            return None;
        }
        self.frames_left = 0;
        Some(self.issue(near, median))
    }

    fn issue(&self, near: f32, median: f32) -> ScaleIssue {
        let units = self.units_per_metre;
        let seen = format!(
            "half of its depth is nearer than {median:.2} m and a twentieth nearer than {near:.2} m at {units} units in a metre"
        );
        let fits = SCALES
            .into_iter()
            .filter(|scale| (scale / units - 1.0).abs() > 0.01)
            .map(|scale| (scale, f64::from(median) * units / scale))
            .find(|(_, metres)| (0.6..=4.0).contains(metres));
        let instead = fits.map_or_else(String::new, |(scale, metres)| {
            format!("; at {scale} units in a metre the median would be {metres:.2} m")
        });
        if self.is_assumed {
            return ScaleIssue::Wrong(format!(
                "{seen}, which are assumed{instead}: write the camera's depth_units_per_metre into camera.toml"
            ));
        }
        ScaleIssue::Odd(format!("{seen}{instead}: is depth_units_per_metre right?"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Depth from 0.75 to 1.25 of a distance.
    fn around(metres: f32) -> DepthImage {
        let values = (0..2000).map(|i| metres * (0.75 + 0.5 * i as f32 / 2000.0));
        DepthImage::from_metres(50, 40, values.collect()).unwrap()
    }

    #[test]
    fn millimetres_read_at_an_assumed_5000_units_a_metre_are_wrong() {
        for metres in [0.5, 1.0, 1.5, 1.9] {
            let issue = ScaleCheck::new(5000.0, true).look(&around(metres / 5.0));
            let Some(ScaleIssue::Wrong(words)) = issue else { panic!("{metres} m: {issue:?}") };
            assert!(words.contains("5000 units") && words.contains("depth_units_per_metre"));
            assert_eq!(words.contains("at 1000 units"), metres > 0.6, "{words}");
        }
    }

    #[test]
    fn an_odd_scale_that_is_given_is_told() {
        for (metres, suggestion) in [(0.2, "at 1000 units"), (12.0, "at 10000 units")] {
            let units = if metres < 1.0 { 5000.0 } else { 1000.0 };
            let issue = ScaleCheck::new(units, false).look(&around(metres));
            let Some(ScaleIssue::Odd(words)) = issue else { panic!("{metres} m: {issue:?}") };
            assert!(words.contains(&format!("{metres:.2} m")), "{words}");
            assert!(words.contains(suggestion) || metres > 1.0, "{words}");
        }
    }

    #[test]
    fn usual_scenes_raise_no_issue() {
        for metres in [0.6, 1.0, 2.5, 6.0] {
            for is_assumed in [true, false] {
                let mut watch = ScaleCheck::new(5000.0, is_assumed);
                assert!((0..5).all(|_| watch.look(&around(metres)).is_none()), "{metres} m");
            }
        }
    }

    #[test]
    fn an_issue_is_returned_once_and_later_frames_are_not_looked_at() {
        let mut watch = ScaleCheck::new(5000.0, false);
        assert!(watch.look(&around(0.1)).is_some() && watch.look(&around(0.1)).is_none());
        let mut watch = ScaleCheck::new(5000.0, false);
        for _ in 0..FRAMES {
            assert_eq!(watch.look(&around(1.0)), None);
        }
        assert_eq!(watch.look(&around(0.1)), None);
    }

    #[test]
    fn frames_almost_without_depth_tell_nothing() {
        let mut values = vec![f32::NAN; 2000];
        values[..20].fill(0.1);
        let sparse = DepthImage::from_metres(50, 40, values).unwrap();
        let mut watch = ScaleCheck::new(5000.0, true);
        assert!((0..10).all(|_| watch.look(&sparse).is_none()));
        assert!(watch.look(&around(0.1)).is_some());
    }
}
