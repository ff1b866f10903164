//! Frames that travel over LCM: as messages, live from a network, or from an event log.

mod live;
mod log;
mod message;

pub use live::LcmCamera;
pub use log::LogRecording;
pub(crate) use message::LCM_UNITS_PER_METRE;
pub use message::{MessageError, Packing, decode_frame, encode_frame};

/// The channel that the original system's cameras publish on.
pub const DEFAULT_CHANNEL: &str = "KINECT_FRAME";
