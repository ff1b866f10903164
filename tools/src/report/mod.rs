//! Pictures and pages to look at.

mod draw;
mod page;
mod text;

pub use page::{
    demonstration_page, recognition_page, save_demonstration_pictures, save_prediction_picture,
};
pub use text::{describe, describe_stream, summary};
