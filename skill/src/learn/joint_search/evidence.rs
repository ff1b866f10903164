//! What depth pictures, tracks and the parent part say for or against a joint.

/// The result of one verification of a joint. It is replaced as a whole, never changed in parts.
#[derive(Debug, Clone, PartialEq)]
pub struct Evidence {
    /// Share of the joint's points, 0 to 1, that depth pictures see through: something behind them is
    /// seen. Where the configuration is not known, the one that fits the picture best is taken.
    pub free_space_violation: f64,
    /// Share of its points that would be seen through if the part stood half its range aside. Points
    /// on a wall agree with the pictures wherever they are: then the pictures discriminate nothing.
    pub discriminability: f64,
    /// Share of its points that are not found in pictures in which its configuration is unknown.
    pub unobserved_ratio: f64,
    /// Share of a hinge's line beside its part that pictures show to be in the air, or do not show at
    /// all; 0 for a slide.
    pub unattached_ratio: f64,
    /// Share of the variance of its configuration that its parent's configuration explains; negative
    /// where the parent rests whenever the joint is known.
    pub parent_correlation: f64,
    /// Share of its tracks' observations in frames in which its configuration is unknown. What moves
    /// on where the joint does not explain it is a hand.
    pub uncovered_ratio: f64,
    /// By frame: its configuration at keyframes, from depth alone where tracks do not give it; NaN in
    /// other frames.
    pub configuration_from_depth: Vec<f64>,
    /// Frames in which the depth pictures contradict it.
    pub contradicted_frames: Vec<usize>,
}

impl Evidence {
    /// Nothing is known yet, of a recording of so many frames.
    pub fn none(frames: usize) -> Self {
        Self {
            free_space_violation: 0.0,
            discriminability: 0.0,
            unobserved_ratio: 0.0,
            unattached_ratio: 0.0,
            parent_correlation: 0.0,
            uncovered_ratio: 0.0,
            configuration_from_depth: vec![f64::NAN; frames],
            contradicted_frames: Vec::new(),
        }
    }

    /// Pictures show nearly all of the part where the joint puts it, and would not show it elsewhere.
    pub fn is_found_everywhere(&self) -> bool {
        self.free_space_violation <= 0.1
            && self.unobserved_ratio <= 0.3
            && self.discriminability >= 0.3
    }

    /// The joint covers all that its tracks do and is never seen through. Round things look the same
    /// wherever they are turned to, so that pictures discriminate nothing.
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
