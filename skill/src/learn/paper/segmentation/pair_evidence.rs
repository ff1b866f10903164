//! What two tracks say about each other (paper, section III-B).

/// Whether two tracks can lie on one rigid part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PairEvidence {
    /// They were not seen moving together: nothing is known.
    None,
    /// They keep their distance.
    Similar,
    /// They do not keep their distance.
    Different,
}
