//! How exact a depth camera's readings are.

/// Standard deviation of a structured-light sensor's depth in metres at depth `z` metres:
/// noise of the match plus the step of the disparity. It grows with the square of the
/// depth (Khoshelham & Elberink 2012; constants measured on Kinect-like recordings).
pub fn depth_sigma(z: f64) -> f64 {
    let disparity_step = z * z / (580.0 * 0.075) / 8.0 / 3.5;
    0.0012 + 0.0019 * (z - 0.4) * (z - 0.4) + disparity_step
}

/// How far a reading may lie from a surface at depth `z` whose normal has this cosine to the
/// line of sight, metres.
pub fn depth_tolerance(z: f64, cosine: f64) -> f64 {
    let slant = (1.0 / cosine.max(0.2).powi(2) - 1.0).max(0.0).sqrt();
    0.006 + 3.0 * depth_sigma(z) + 0.004 * slant
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_grows_with_the_square_of_the_depth() {
        let ratio = (depth_sigma(4.0) - depth_sigma(2.0)) / (depth_sigma(3.0) - depth_sigma(2.0));
        assert!((2.0..3.5).contains(&ratio), "{ratio}");
        assert!((0.001..0.003).contains(&depth_sigma(0.8)), "{}", depth_sigma(0.8));
    }

    #[test]
    fn a_slanted_surface_may_lie_farther_off() {
        let head_on = depth_tolerance(1.0, 1.0);
        assert!((head_on - 0.006 - 3.0 * depth_sigma(1.0)).abs() < 1e-12);
        assert!(depth_tolerance(1.0, 0.5) > head_on);
        assert_eq!(depth_tolerance(1.0, 0.1), depth_tolerance(1.0, 0.0), "the slant is bounded");
    }
}
