//! Our multicast against liblcm's own programs: what we send, `lcm-logger` writes down, and what
//! `lcm-logplayer` sends, we receive.

mod support;

use linkage_lcm::{Lcm, LogReader, LogWriter};
use std::io::BufRead;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use support::{image, listener, next, url};

const CHANNEL: &str = "KINECT_FRAME";
const TIMEOUT: Duration = Duration::from_secs(10);

/// With the channel's 12 bytes and a NUL, 65486 bytes are the longest that go in one piece, and
/// each further piece holds 65487.
const LENGTHS: [usize; 9] =
    [0, 1, 65_485, 65_486, 65_487, 65_487 * 2 - 13, 65_487 * 2 - 12, 300_000, 1_000_000];

/// Ends a program where the test does.
struct Program(Child);

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn read(log: &Path) -> Vec<Vec<u8>> {
    let Ok(mut reader) = LogReader::open(log) else { return Vec::new() };
    std::iter::from_fn(|| reader.next_event().unwrap())
        .filter(|event| event.channel == CHANNEL)
        .map(|event| event.bytes)
        .collect()
}

#[test]
fn liblcm_receives_what_we_send() {
    let (dir, url) = (tempfile::tempdir().unwrap(), url(80));
    let log = dir.path().join("heard.lcmlog");
    // Left alone, it loses images: its socket has the system's default buffer.
    let its_url = format!("{url}&recv_buf_size=4000000");
    let mut logger = Command::new("lcm-logger")
        .args(["--flush-interval=10", "--force", "--lcm-url", &its_url])
        .arg(&log)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("lcm-logger, which tools/setup installs");
    let said = std::io::BufReader::new(logger.stderr.take().unwrap());
    std::thread::spawn(move || said.lines().for_each(drop));
    let _logger = Program(logger);
    let lcm = Lcm::new(&url).unwrap();
    let start = Instant::now();
    // Until it listens; it writes a log of nothing but what it heard.
    while read(&log).is_empty() {
        assert!(start.elapsed() < TIMEOUT, "lcm-logger hears nothing");
        lcm.publish_bytes(CHANNEL, b"are you there").unwrap();
        std::thread::sleep(Duration::from_millis(50));
    }
    for length in LENGTHS {
        lcm.publish_bytes(CHANNEL, &image(length)).unwrap();
        std::thread::sleep(Duration::from_millis(50));
    }
    let heard = |length: &usize| read(&log).contains(&image(*length));
    while !LENGTHS.iter().all(heard) {
        let missing: Vec<_> = LENGTHS.iter().filter(|l| !heard(l)).collect();
        assert!(start.elapsed() < 2 * TIMEOUT, "lcm-logger did not receive {missing:?} bytes");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn we_receive_what_liblcm_sends() {
    let (dir, url) = (tempfile::tempdir().unwrap(), url(81));
    let log = dir.path().join("said.lcmlog");
    let mut writer = LogWriter::create(&log).unwrap();
    for (number, length) in LENGTHS.into_iter().enumerate() {
        writer.write(number as i64 * 50_000, CHANNEL, &image(length)).unwrap();
    }
    writer.flush().unwrap();
    let mut listener = listener(&url);
    let player = Command::new("lcm-logplayer")
        .args(["--lcm-url", &url])
        .arg(&log)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("lcm-logplayer, which tools/setup installs");
    let _player = Program(player);
    for length in LENGTHS {
        let received = next(&mut listener, CHANNEL, TIMEOUT);
        assert!(received.is_some_and(|bytes| bytes == image(length)), "{length} bytes");
    }
    assert_eq!(listener.reception().missing() + listener.reception().refused, 0);
}
