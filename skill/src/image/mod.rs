//! Pictures as the other modules need them: intensities and CIE L*a*b* colour.

pub(crate) mod cielab;
pub(crate) mod gray;
