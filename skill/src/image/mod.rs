//! Pictures as the other modules need them: intensities and CIE L*a*b* colour.

pub mod cielab;
pub mod gray;
