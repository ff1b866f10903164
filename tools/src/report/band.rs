//! The band round a configuration's curve in words: whose standard deviation it is, and where none can
//! be told.

/// Where a curve has a band.
#[derive(Debug, Clone, Copy)]
pub struct Band {
    /// Points of the curve whose deviation is known.
    pub known: usize,
    /// Points of the curve.
    pub all: usize,
    /// Tracked features tell it, not depth.
    pub has_tracks: bool,
}

/// What a reader is told of the band.
pub fn in_words(of: Band) -> String {
    let Band { known, all, has_tracks } = of;
    let (of_what, else_none) = match has_tracks {
        true => ("tracked feature", "fewer than three of its features are seen"),
        false => (
            "depth reading of its surface",
            "most of its surface is hidden, is seen from its edge, or moves within itself, \
             which depth does not tell",
        ),
    };
    if known == 0 {
        return format!(
            "No band is drawn, for how exact single frames are cannot be told: {else_none}."
        );
    }
    let band = format!("The band is the standard deviation of a single {of_what}");
    match all - known {
        0 => format!("{band}."),
        without => format!("{band}; {without} of {all} frames have none, where {else_none}."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reader_is_told_whose_deviation_it_is_and_where_there_is_none() {
        let told = |known, has_tracks| in_words(Band { known, all: 30, has_tracks });
        assert_eq!(
            told(30, true),
            "The band is the standard deviation of a single tracked feature."
        );
        assert!(
            told(20, false).contains("depth reading of its surface; 10 of 30 frames have none")
        );
        assert!(told(0, false).starts_with("No band is drawn"));
        assert!(told(0, false).ends_with("which depth does not tell."));
    }
}
