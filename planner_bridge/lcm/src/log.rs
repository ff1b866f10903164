//! LCM event logs, as lcm-logger writes them: events one after the other, each with a sync
//! word, its number, time, channel and bytes, all big-endian.
//!
//! A damaged stretch is skipped and counted, and costs no whole event that follows it: a length is
//! accepted where the next event or the end of the log follows it, or where no other event begins
//! within it.

use std::fs::File;
use std::io::{self, BufWriter, Read, Write};
use std::path::Path;

/// First word of every event.
const SYNC: u32 = 0xEDA1_DA01;
const SYNC_BYTES: usize = 4;
/// Bytes of the sync word, number, time, and two lengths.
const HEADER: usize = SYNC_BYTES + 8 + 8 + 4 + 4;
/// Longest channel name that liblcm knows.
const MAX_CHANNEL: usize = 63;
/// Largest message that is accepted: a camera frame is 2 MB.
pub const MAX_EVENT_BYTES: usize = 64 << 20;
/// Bytes that are read at a time.
const CHUNK: usize = 1 << 20;

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
    input: Window<R>,
    skipped_bytes: u64,
    damaged_stretches: u64,
    is_in_damage: bool,
}

impl LogReader<File> {
    /// Opens a log.
    ///
    /// # Errors
    /// Those of opening the file.
    pub fn open(path: &Path) -> io::Result<Self> {
        Ok(Self::new(File::open(path)?))
    }
}

impl<R: Read> LogReader<R> {
    /// Reads from any stream; it is read in large pieces and needs no buffer of its own.
    pub fn new(input: R) -> Self {
        Self {
            input: Window::new(input),
            skipped_bytes: 0,
            damaged_stretches: 0,
            is_in_damage: false,
        }
    }

    /// Bytes that belonged to no event so far.
    pub fn skipped_bytes(&self) -> u64 {
        self.skipped_bytes
    }

    /// Stretches of such bytes so far: about as many events were lost.
    pub fn damaged_stretches(&self) -> u64 {
        self.damaged_stretches
    }

    /// The next whole event; `None` at the end. A last event that is cut short counts as
    /// skipped.
    ///
    /// # Errors
    /// Those of reading; damage is none.
    pub fn next_event(&mut self) -> io::Result<Option<Event>> {
        loop {
            self.input.have(HEADER + MAX_CHANNEL)?;
            let Some(header) = Header::of(self.input.bytes()) else {
                let next = next_sync(self.input.bytes(), 1);
                self.skip(next);
                if next == 0 {
                    return Ok(None);
                }
                continue;
            };
            let end = header.end();
            self.input.have(end + HEADER + MAX_CHANNEL)?;
            if !self.is_whole(end) {
                // The length is wrong, or the log was cut here: go on behind the sync word.
                self.skip(SYNC_BYTES);
                continue;
            }
            let event = header.event(self.input.bytes());
            self.input.advance(end);
            self.is_in_damage = false;
            return Ok(Some(event));
        }
    }

    /// Whether an event that claims to end here can be accepted.
    fn is_whole(&self, end: usize) -> bool {
        let bytes = self.input.bytes();
        if bytes.len() < end {
            return false;
        }
        let rest = &bytes[end..];
        rest.is_empty() || starts_with_sync(rest) || !header_begins(bytes, SYNC_BYTES, end)
    }

    fn skip(&mut self, count: usize) {
        self.input.advance(count);
        self.skipped_bytes += count as u64;
        if count > 0 && !self.is_in_damage {
            self.is_in_damage = true;
            self.damaged_stretches += 1;
        }
    }
}

/// What stands before an event's channel.
struct Header {
    number: i64,
    utime: i64,
    channel_length: usize,
    length: usize,
    channel: String,
}

impl Header {
    /// The header at the start of these bytes; `None` where there is none that can be.
    fn of(bytes: &[u8]) -> Option<Self> {
        let (header, rest) = bytes.split_first_chunk::<HEADER>()?;
        let word = |at: usize| {
            u32::from_be_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]])
        };
        let long = |at: usize| (i64::from(word(at)) << 32) | i64::from(word(at + 4));
        let (channel_length, length) = (word(20) as usize, word(24) as usize);
        let can_be = word(0) == SYNC
            && (1..=MAX_CHANNEL).contains(&channel_length)
            && length <= MAX_EVENT_BYTES;
        let channel = can_be.then(|| rest.get(..channel_length)).flatten()?;
        let channel = std::str::from_utf8(channel).ok()?;
        (!channel.contains(char::is_control)).then(|| Self {
            number: long(4),
            utime: long(12),
            channel_length,
            length,
            channel: channel.to_owned(),
        })
    }

    /// Bytes from the sync word to the event's end.
    fn end(&self) -> usize {
        HEADER + self.channel_length + self.length
    }

    fn event(self, bytes: &[u8]) -> Event {
        let body = &bytes[HEADER + self.channel_length..self.end()];
        Event {
            number: self.number,
            utime: self.utime,
            bytes: body.to_vec(),
            channel: self.channel,
        }
    }
}

fn starts_with_sync(bytes: &[u8]) -> bool {
    bytes.starts_with(&SYNC.to_be_bytes())
}

/// Place of the next sync word from a place on, or of what may be its beginning at the end of
/// the bytes.
fn next_sync(bytes: &[u8], from: usize) -> usize {
    let sync = SYNC.to_be_bytes();
    (from..bytes.len())
        .find(|&at| {
            let here = &bytes[at..bytes.len().min(at + SYNC_BYTES)];
            sync.starts_with(here)
        })
        .unwrap_or(bytes.len())
}

/// True where an event begins from one place on and before another.
fn header_begins(bytes: &[u8], from: usize, to: usize) -> bool {
    let mut at = next_sync(bytes, from);
    while at < to {
        if Header::of(&bytes[at..]).is_some() {
            return true;
        }
        at = next_sync(bytes, at + 1);
    }
    false
}

/// What is read of a stream and not yet used.
struct Window<R> {
    input: R,
    buffer: Vec<u8>,
    /// Where the unused bytes begin.
    start: usize,
    has_ended: bool,
}

impl<R: Read> Window<R> {
    fn new(input: R) -> Self {
        Self { input, buffer: Vec::new(), start: 0, has_ended: false }
    }

    fn bytes(&self) -> &[u8] {
        &self.buffer[self.start..]
    }

    /// Reads until this many unused bytes are there, or the stream has ended.
    fn have(&mut self, count: usize) -> io::Result<()> {
        while self.bytes().len() < count && !self.has_ended {
            self.buffer.drain(..self.start);
            self.start = 0;
            let length = self.buffer.len();
            self.buffer.resize(length + CHUNK, 0);
            let read = self.input.read(&mut self.buffer[length..]);
            self.buffer.truncate(length + read.as_ref().map_or(0, |&n| n));
            match read {
                Ok(n) => self.has_ended = n == 0,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        Ok(())
    }

    fn advance(&mut self, count: usize) {
        self.start += count;
    }
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

    /// A stream that gives a few bytes at a time, as a pipe may.
    struct Drip<'b>(&'b [u8]);

    impl Read for Drip<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            let count = buffer.len().min(7);
            self.0.read(&mut buffer[..count])
        }
    }

    fn read(bytes: &[u8]) -> (Vec<Event>, u64) {
        let mut reader = LogReader::new(bytes);
        let mut events = Vec::new();
        while let Some(event) = reader.next_event().unwrap() {
            events.push(event);
        }
        (events, reader.skipped_bytes())
    }

    fn utimes(bytes: &[u8]) -> Vec<i64> {
        read(bytes).0.iter().map(|e| e.utime).collect()
    }

    /// Five events; the place of each and of the end.
    fn five() -> (Vec<u8>, [usize; 6]) {
        let messages: [&[u8]; 5] = [b"first", b"second", b"third", b"fourth", b"fifth"];
        let mut places = [0; 6];
        let mut events = Vec::new();
        for (i, message) in messages.into_iter().enumerate() {
            places[i + 1] = places[i] + HEADER + 1 + message.len();
            events.push((i as i64 + 1, "A", message));
        }
        (log(&events), places)
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
        let second = HEADER + 1 + 5;
        damaged[second] ^= 0xff;
        let (events, skipped) = read(&damaged);
        let times: Vec<i64> = events.iter().map(|e| e.utime).collect();
        assert_eq!(times, [1, 3]);
        assert_eq!(skipped, (HEADER + 1 + 6) as u64);
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
        bytes[24..28].copy_from_slice(&0x7fff_ffff_u32.to_be_bytes());
        let (events, _) = read(&bytes);
        assert_eq!(events.iter().map(|e| e.utime).collect::<Vec<_>>(), [2]);
    }

    #[test]
    fn one_wrong_bit_of_a_length_costs_one_event() {
        let (whole, places) = five();
        for lengths in [20..24, 24..28] {
            for bit in 0..32 {
                for event in 0..5 {
                    let mut bytes = whole.clone();
                    bytes[places[event] + lengths.start + bit / 8] ^= 0x80 >> (bit % 8);
                    let others: Vec<i64> = (1..=5).filter(|&t| t != event as i64 + 1).collect();
                    // Where a length became shorter, the event comes, cut short.
                    let mut found = utimes(&bytes);
                    found.retain(|&t| t != event as i64 + 1);
                    assert_eq!(found, others, "bit {bit} of {lengths:?} of event {event}");
                }
            }
        }
    }

    #[test]
    fn a_log_that_was_cut_and_appended_to_gives_all_whole_events() {
        let (whole, places) = five();
        for cut in places[1] + 1..places[2] {
            let bytes = [&whole[..cut], &whole[places[2]..]].concat();
            let mut reader = LogReader::new(&bytes[..]);
            let mut found = Vec::new();
            while let Some(event) = reader.next_event().unwrap() {
                found.push(event.utime);
            }
            assert_eq!(found, [1, 3, 4, 5], "cut to {cut} bytes");
            assert_eq!(reader.damaged_stretches(), 1);
            assert_eq!(reader.skipped_bytes(), (cut - places[1]) as u64);
        }
    }

    #[test]
    fn a_damaged_sync_word_costs_its_own_event_alone() {
        let (whole, places) = five();
        for (event, place) in places[..5].iter().enumerate() {
            for byte in 0..SYNC_BYTES {
                let mut bytes = whole.clone();
                bytes[place + byte] ^= 0xff;
                let others: Vec<i64> = (1..=5).filter(|&t| t != event as i64 + 1).collect();
                assert_eq!(utimes(&bytes), others);
            }
        }
    }

    #[test]
    fn a_message_may_hold_a_sync_word() {
        let inner = log(&[(7, "B", b"inner")]);
        let whole = log(&[(1, "A", &inner), (2, "A", b"second")]);
        let (events, skipped) = read(&whole);
        assert_eq!((events.len(), skipped), (2, 0));
        assert_eq!(events[0].bytes, inner);
    }

    #[test]
    fn many_events_that_claim_more_than_there_is_are_passed_over_in_time() {
        let start = std::time::Instant::now();
        let mut event = log(&[(1, "A", b"")]);
        event[24..28].copy_from_slice(&(MAX_EVENT_BYTES as u32).to_be_bytes());
        let bytes = event.repeat(300_000);
        let (events, skipped) = read(&bytes);
        assert_eq!((events.len(), skipped), (0, bytes.len() as u64));
        assert!(start.elapsed().as_secs() < 20, "{:?}", start.elapsed());
    }

    #[test]
    fn channels_that_cannot_be_are_damage() {
        let (whole, places) = five();
        for length in [0, 64, 65_536, u32::MAX] {
            let mut bytes = whole.clone();
            bytes[places[2] + 20..places[2] + 24].copy_from_slice(&length.to_be_bytes());
            assert_eq!(utimes(&bytes), [1, 2, 4, 5], "channel of {length} bytes");
        }
        let mut bytes = whole;
        bytes[places[2] + HEADER] = 7;
        assert_eq!(utimes(&bytes), [1, 2, 4, 5], "a control character");
    }

    proptest! {
        #[test]
        fn no_bytes_make_the_reader_fail(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            let (events, skipped) = read(&bytes);
            let used: usize =
                events.iter().map(|e| HEADER + e.channel.len() + e.bytes.len()).sum();
            prop_assert_eq!(used as u64 + skipped, bytes.len() as u64);
        }

        #[test]
        fn a_stream_in_small_pieces_gives_the_same_events(
            flips in proptest::collection::vec((0..170_usize, any::<u8>()), 0..4),
        ) {
            let (mut bytes, _) = five();
            let length = bytes.len();
            for (at, flip) in flips {
                bytes[at % length] ^= flip;
            }
            let mut reader = LogReader::new(Drip(&bytes));
            let mut events = Vec::new();
            while let Some(event) = reader.next_event().unwrap() {
                events.push(event);
            }
            prop_assert_eq!((events, reader.skipped_bytes()), read(&bytes));
        }
    }
}
