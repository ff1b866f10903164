//! Evidence on whether two tracks lie on one rigid part (paper, section III-B).

/// Evidence on whether two tracks lie on one rigid part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PairEvidence {
    /// No evidence: the two tracks were not seen moving together.
    None,
    /// The two tracks keep their distance and angle.
    Similar,
    /// The two tracks do not keep their distance or angle.
    Different,
}
