//! Pictures and pages to look at.

mod chart;
mod draw;
mod encountered;
mod film_strip;
mod layout;
mod learned;
mod overlay;
mod predicted;
mod spread;
mod text;
mod tree;
mod units;
mod words;

pub use encountered::{Asked, recognition_page};
pub use learned::{demonstration_page, save_demonstration_pictures};
pub use predicted::{prediction_page, save_prediction_picture};
pub use text::{describe, describe_stream, summary};
