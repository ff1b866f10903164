//! Pictures and pages to look at.

mod draw;
mod page;

pub use page::{
    demonstration_page, recognition_page, save_demonstration_pictures, save_prediction_picture,
};
