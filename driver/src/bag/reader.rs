//! What every reader of a bag offers: topics, and messages one after the other.

use super::message_format::MessageFormat;
use crate::error::SourceError;

/// Largest message that is read, bytes: an uncompressed picture of 3840x2160 pixels with four
/// channels has 33 MB.
pub const MAX_MESSAGE_BYTES: usize = 64 << 20;

/// Most topics of a bag.
pub const MAX_TOPICS: usize = 10_000;

/// A topic of a bag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topic {
    /// Its name, `/camera/color/image_raw`.
    pub name: String,
    /// The type of its messages, as `package/Type`, where ROS 2's `msg` in the middle is left out, or
    /// as `foxglove.Type`.
    pub message_type: String,
    /// How its messages are written; `None` for a format that is not read.
    pub format: Option<MessageFormat>,
}

impl Topic {
    /// A topic whose type is named in the way of ROS 1 or ROS 2. Messages of the package `foxglove_msgs`
    /// are Foxglove's.
    pub fn new(name: &str, message_type: &str, format: Option<MessageFormat>) -> Self {
        let message_type = message_type.replace("/msg/", "/");
        if let (Some(kind), Some(MessageFormat::Ros(ros))) =
            (message_type.strip_prefix("foxglove_msgs/"), format)
        {
            let format = Some(MessageFormat::FoxgloveRos(ros));
            return Self {
                name: name.to_owned(),
                message_type: format!("foxglove.{kind}"),
                format,
            };
        }
        Self { name: name.to_owned(), message_type, format }
    }
}

/// A message of a bag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BagMessage {
    /// Its topic, by its place in [`BagReader::topics`].
    pub topic: usize,
    /// When it was recorded, microseconds.
    pub log_utime: i64,
    /// The message as it was sent.
    pub bytes: Vec<u8>,
}

/// Reads a bag from its beginning.
pub trait BagReader: Send {
    /// All topics.
    fn topics(&self) -> &[Topic];

    /// Asks for the messages of some topics alone, by their places in [`Self::topics`]; before the
    /// first message.
    ///
    /// # Errors
    /// [`SourceError`] names what could not be read.
    fn select(&mut self, topics: &[usize]) -> Result<(), SourceError>;

    /// The next message of the topics that were asked for; `None` at the end.
    ///
    /// # Errors
    /// [`SourceError`] names what could not be read.
    fn next_message(&mut self) -> Result<Option<BagMessage>, SourceError>;
}
