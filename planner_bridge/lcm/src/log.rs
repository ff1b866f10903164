//! LCM event logs, as lcm-logger writes them: events one after the other, each with a sync
//! word, its number, time, channel and bytes, all big-endian.
//!
//! A damaged stretch is skipped to the next sync word and counted; an event that claims more
//! bytes than a message can have is damage.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::Path;

/// First word of every event.
const SYNC: u32 = 0xEDA1_DA01;
/// Bytes after the sync word and before the channel: number, time, two lengths.
const HEADER: usize = 8 + 8 + 4 + 4;
/// Longest channel name that liblcm knows.
const MAX_CHANNEL: usize = 63;
/// Largest message that is believed: a camera frame is 2 MB.
pub const MAX_EVENT_BYTES: usize = 64 << 20;

/// One recorded message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Event {
    /// Number in the log.
    pub number: i64,
    /// When it was received, microseconds.
    pub utime: i64,
    /// Channel.
    pub channel: String,
    /// The message, its fingerprint first.
    pub bytes: Vec<u8>,
}

/// Reads events in order.
pub struct LogReader<R> {
    input: R,
    skipped_bytes: u64,
}

impl LogReader<BufReader<File>> {
    /// Opens a log.
    ///
    /// # Errors
    /// Those of opening the file.
    pub fn open(path: &Path) -> io::Result<Self> {
        Ok(Self::new(BufReader::with_capacity(1 << 20, File::open(path)?)))
    }
}

impl<R: Read> LogReader<R> {
    /// Reads from any stream.
    pub fn new(input: R) -> Self {
        Self { input, skipped_bytes: 0 }
    }

    /// Bytes that belonged to no event so far.
    pub fn skipped_bytes(&self) -> u64 {
        self.skipped_bytes
    }

    /// The next whole event; `None` at the end. A last event that is cut short counts as
    /// skipped.
    ///
    /// # Errors
    /// Those of reading; damage is none.
    pub fn next_event(&mut self) -> io::Result<Option<Event>> {
        while self.find_sync()? {
            let mut header = [0; HEADER];
            if !self.fill(&mut header)? {
                return Ok(None);
            }
            let channel_length = be_u32(&header[16..20]) as usize;
            let length = be_u32(&header[20..24]) as usize;
            if channel_length == 0 || channel_length > MAX_CHANNEL || length > MAX_EVENT_BYTES {
                self.skipped_bytes += 4 + HEADER as u64;
                continue;
            }
            let mut channel = vec![0; channel_length];
            if !self.fill(&mut channel)? {
                return Ok(None);
            }
            let Ok(channel) = String::from_utf8(channel) else {
                self.skipped_bytes += (4 + HEADER + channel_length) as u64;
                continue;
            };
            let Some(bytes) = self.take(length)? else { return Ok(None) };
            let number = i64::from_be_bytes(header[..8].try_into().expect("eight bytes"));
            let utime = i64::from_be_bytes(header[8..16].try_into().expect("eight bytes"));
            return Ok(Some(Event { number, utime, channel, bytes }));
        }
        Ok(None)
    }

    /// Reads up to and with the next sync word.
    fn find_sync(&mut self) -> io::Result<bool> {
        let mut window: u32 = 0;
        let mut read = 0_u64;
        let mut byte = [0; 1];
        while self.input.read(&mut byte)? == 1 {
            window = (window << 8) | u32::from(byte[0]);
            read += 1;
            if read >= 4 && window == SYNC {
                self.skipped_bytes += read - 4;
                return Ok(true);
            }
        }
        self.skipped_bytes += read;
        Ok(false)
    }

    /// Fills a buffer; false when the log ends before.
    fn fill(&mut self, buffer: &mut [u8]) -> io::Result<bool> {
        match self.input.read_exact(buffer) {
            Ok(()) => Ok(true),
            Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => {
                self.skipped_bytes += buffer.len() as u64;
                Ok(false)
            }
            Err(e) => Err(e),
        }
    }

    /// So many bytes, without believing that they are there.
    fn take(&mut self, length: usize) -> io::Result<Option<Vec<u8>>> {
        let mut bytes = Vec::new();
        (&mut self.input).take(length as u64).read_to_end(&mut bytes)?;
        if bytes.len() < length {
            self.skipped_bytes += bytes.len() as u64;
            return Ok(None);
        }
        Ok(Some(bytes))
    }
}

fn be_u32(bytes: &[u8]) -> u32 {
    u32::from_be_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])
}

/// Writes events that lcm-logplayer plays.
pub struct LogWriter<W: Write> {
    output: W,
    events: i64,
}

impl LogWriter<BufWriter<File>> {
    /// Creates a log; an older one of that name is replaced.
    ///
    /// # Errors
    /// Those of creating the file.
    pub fn create(path: &Path) -> io::Result<Self> {
        Ok(Self::new(BufWriter::new(File::create(path)?)))
    }
}

impl<W: Write> LogWriter<W> {
    /// Writes to any stream.
    pub fn new(output: W) -> Self {
        Self { output, events: 0 }
    }

    /// Appends a message.
    ///
    /// # Errors
    /// Those of writing; [`io::ErrorKind::InvalidInput`] for a channel that LCM does not know
    /// or more bytes than a reader takes.
    pub fn write(&mut self, utime: i64, channel: &str, bytes: &[u8]) -> io::Result<()> {
        if channel.is_empty() || channel.len() > MAX_CHANNEL || bytes.len() > MAX_EVENT_BYTES {
            return Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                format!("an event of {} bytes on channel \"{channel}\"", bytes.len()),
            ));
        }
        self.output.write_all(&SYNC.to_be_bytes())?;
        self.output.write_all(&self.events.to_be_bytes())?;
        self.output.write_all(&utime.to_be_bytes())?;
        self.output.write_all(&(channel.len() as u32).to_be_bytes())?;
        self.output.write_all(&(bytes.len() as u32).to_be_bytes())?;
        self.output.write_all(channel.as_bytes())?;
        self.output.write_all(bytes)?;
        self.events += 1;
        Ok(())
    }

    /// Hands everything to the system.
    ///
    /// # Errors
    /// Those of writing.
    pub fn flush(&mut self) -> io::Result<()> {
        self.output.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn log(events: &[(i64, &str, &[u8])]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut writer = LogWriter::new(&mut bytes);
        for (utime, channel, message) in events {
            writer.write(*utime, channel, message).unwrap();
        }
        bytes
    }

    fn read(bytes: &[u8]) -> (Vec<Event>, u64) {
        let mut reader = LogReader::new(bytes);
        let mut events = Vec::new();
        while let Some(event) = reader.next_event().unwrap() {
            events.push(event);
        }
        (events, reader.skipped_bytes())
    }

    #[test]
    fn what_was_written_is_read_in_order() {
        let (events, skipped) = read(&log(&[(5, "A", b"one"), (9, "KINECT_FRAME", b"")]));
        assert_eq!(events.len(), 2);
        assert_eq!((events[1].number, events[1].utime), (1, 9));
        assert_eq!((events[0].channel.as_str(), events[0].bytes.as_slice()), ("A", &b"one"[..]));
        assert_eq!(skipped, 0);
    }

    #[test]
    fn damage_costs_only_the_event_it_is_in() {
        let whole = log(&[(1, "A", b"first"), (2, "A", b"second"), (3, "A", b"third")]);
        let mut damaged = whole.clone();
        let second = 4 + HEADER + 1 + 5;
        damaged[second] ^= 0xff;
        let (events, skipped) = read(&damaged);
        let times: Vec<i64> = events.iter().map(|e| e.utime).collect();
        assert_eq!(times, [1, 3]);
        assert_eq!(skipped, (4 + HEADER + 1 + 6) as u64);
    }

    #[test]
    fn a_log_that_is_cut_gives_all_whole_events() {
        let whole = log(&[(1, "A", b"first"), (2, "A", b"second")]);
        let (events, skipped) = read(&whole[..whole.len() - 3]);
        assert_eq!(events.len(), 1);
        assert!(skipped > 0);
    }

    #[test]
    fn an_event_that_claims_two_gigabytes_is_damage() {
        let mut bytes = log(&[(1, "A", b"first"), (2, "A", b"second")]);
        bytes[4 + 20..4 + 24].copy_from_slice(&0x7fff_ffff_u32.to_be_bytes());
        let (events, _) = read(&bytes);
        assert_eq!(events.iter().map(|e| e.utime).collect::<Vec<_>>(), [2]);
    }

    proptest! {
        #[test]
        fn no_bytes_make_the_reader_fail(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            let (events, skipped) = read(&bytes);
            let used: u64 = events.iter().map(|e| (4 + HEADER + e.channel.len() + e.bytes.len()) as u64).sum();
            prop_assert!(used + skipped <= bytes.len() as u64 + HEADER as u64 + 64);
        }
    }
}
