//! Reports for people: HTML pages, pictures and text.

mod animation;
mod band;
mod chart;
mod demo_page;
mod depth_spread;
mod draw;
mod encountered;
mod film_strip;
mod hidden_hinge;
mod layout;
mod learned;
mod motion_warnings;
mod moving_surface;
mod overlay;
mod part_tracks;
mod predicted;
mod range_picture;
mod spread;
mod text;
mod tree;
mod units;
mod veil;
mod words;

pub use demo_page::{DemoPage, DetailLinks};
#[cfg(feature = "view")]
pub use draw::part_colour;
#[cfg(feature = "view")]
pub use encountered::camera_from_part;
pub use encountered::{Asked, recognition_page};
#[cfg(feature = "view")]
pub use learned::deviations_by_frame;
pub use learned::{demonstration_page, save_demonstration_pictures};
pub use predicted::{prediction_page, save_prediction_picture};
pub use text::{describe, describe_stream, summary};
#[cfg(feature = "view")]
pub use units::amount;
