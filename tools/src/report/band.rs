//! The band round a configuration's curve in words: whose standard deviation it is, and where none can
//! be told.

use super::units::amount;
use linkage_skill::internals::median;
use linkage_skill::object::JointKind;

/// Where a curve has a band.
#[derive(Debug, Clone, Copy)]
pub struct Band<'c> {
    /// Type of the joint.
    pub kind: JointKind,
    /// Standard deviation of each point of the curve, radians or metres, where it is known.
    pub deviations: &'c [Option<f64>],
    /// Tracked features tell it, not depth.
    pub has_tracks: bool,
}

/// What a reader is told of the band.
pub fn in_words(of: Band) -> String {
    let Band { kind, deviations, has_tracks } = of;
    let mut known: Vec<f64> = deviations.iter().copied().flatten().collect();
    let (of_what, else_none) = match has_tracks {
        true => ("tracked feature", "fewer than three of its features are seen"),
        false => (
            "depth reading of its surface",
            "most of its surface is hidden, is seen from its edge, or moves within itself, \
             which depth does not tell",
        ),
    };
    let without = deviations.len() - known.len();
    let Some(middle) = median(&mut known) else {
        return format!(
            "No band is drawn, for how exact single frames are cannot be told: {else_none}."
        );
    };
    // A band may be narrower than the line of the curve.
    let middle = amount(kind, middle);
    let band =
        format!("The band is the standard deviation of a single {of_what}, mostly ± {middle}");
    match without {
        0 => format!("{band}."),
        _ => format!(
            "{band}; {without} of {} frames have none, where {else_none}.",
            deviations.len()
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reader_is_told_whose_deviation_it_is_and_where_there_is_none() {
        let told = |known: usize, has_tracks| {
            let deviations = [vec![Some(0.004); known], vec![None; 30 - known]].concat();
            in_words(Band { kind: JointKind::Prismatic, deviations: &deviations, has_tracks })
        };
        assert_eq!(
            told(30, true),
            "The band is the standard deviation of a single tracked feature, mostly ± 4 mm."
        );
        assert!(told(20, false).contains("reading of its surface, mostly ± 4 mm; 10 of 30 frames"));
        assert!(told(0, false).starts_with("No band is drawn"));
        assert!(told(0, false).ends_with("which depth does not tell."));
    }
}
