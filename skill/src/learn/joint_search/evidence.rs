//! Evidence for and against a joint, from depth images, tracks and the parent part.

/// Result of one verification of a joint. A joint's evidence is replaced as a whole, never changed
/// in parts.
#[derive(Debug, Clone, PartialEq)]
pub struct Evidence {
    /// Share of the joint's observed points, 0 to 1, that depth images see through, because they
    /// show something behind the point. Where the configuration is unknown, the one that fits the
    /// image best is taken.
    pub free_space_violation: f64,
    /// Share of the joint's observed points, 0 to 1, that would be seen through if the part stood
    /// half its range aside. Near 0, depth does not discriminate the configuration: points on a
    /// wall agree with the images wherever they are put.
    pub discriminability: f64,
    /// Share of the joint's points, 0 to 1, that depth images do not show in frames of unknown
    /// configuration.
    pub unobserved_ratio: f64,
    /// Share of a hinge's line beside its part, 0 to 1, that is in the air or outside the images; 0
    /// for a slide.
    pub unattached_ratio: f64,
    /// Share of the variance of the configuration, 0 to 1, that the parent's configuration
    /// explains; negative where the parent rests in all frames in which the joint is known.
    pub parent_correlation: f64,
    /// Share of the tracks' observations, 0 to 1, in frames of unknown configuration. It is high
    /// for a hand, which moves on where the joint does not explain it.
    pub uncovered_ratio: f64,
    /// Share of the comparisons of images, 0 to 1, in which the texture of the joint's tracks is still at its former
    /// place; 0 for a joint that other limits reject, and before the last frame.
    pub still_there_ratio: f64,
    /// True if the joint was searched as a sibling of an adopted joint, and their lines are parallel as exactly as they
    /// can be measured.
    pub is_parallel_sibling: bool,
    /// By frame: configuration at keyframes, radians or metres, from depth alone where tracks do
    /// not give it; NaN in other frames.
    pub configuration_from_depth: Vec<f64>,
    /// Frames in which the depth images contradict the joint.
    pub contradicted_frames: Vec<usize>,
}

impl Evidence {
    /// Evidence of a joint that was not verified yet, for a recording of `frames` frames.
    pub fn none(frames: usize) -> Self {
        Self {
            free_space_violation: 0.0,
            discriminability: 0.0,
            unobserved_ratio: 0.0,
            unattached_ratio: 0.0,
            parent_correlation: 0.0,
            uncovered_ratio: 0.0,
            still_there_ratio: 0.0,
            is_parallel_sibling: false,
            configuration_from_depth: vec![f64::NAN; frames],
            contradicted_frames: Vec::new(),
        }
    }

    /// True if depth images show nearly all of the part where the joint puts it and would not show
    /// it elsewhere.
    pub fn is_found_everywhere(&self) -> bool {
        self.free_space_violation <= 0.1
            && self.unobserved_ratio <= 0.3
            && self.discriminability >= 0.3
    }

    /// True if the joint covers nearly all observations of its tracks and is hardly ever seen
    /// through or missing. Discriminability is not needed: round parts look alike at every angle.
    pub fn is_there_throughout(&self) -> bool {
        self.free_space_violation <= 0.05
            && self.unobserved_ratio <= 0.05
            && self.uncovered_ratio <= 0.05
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_is_found_everywhere_only_where_pictures_discriminate() {
        let seen = Evidence { discriminability: 0.5, ..Evidence::none(3) };
        assert!(seen.is_found_everywhere());
        assert!(!Evidence::none(3).is_found_everywhere());
        assert!(!Evidence { free_space_violation: 0.2, ..seen }.is_found_everywhere());
    }
}
