//! The address that viewers find: it passes connections on to the server, but for those of web pages that
//! may not look (`origin.rs`). The server itself has no say in that.
//!
//! The server listens at a loopback address that is drawn anew each time, which a page cannot guess.

use super::origin::{MOST_REQUEST_BYTES, may_look};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{self, Read, Write};
use std::net::{IpAddr, Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Viewers at once.
const MOST_VIEWERS: usize = 32;
/// Wait after a connection that could not be taken: this process has too many open files.
const AFTER_FAILURE: Duration = Duration::from_millis(100);
/// Longest wait for the whole request of a connection, in however many pieces it comes.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(5);

/// An open door; closed when dropped.
pub struct Door {
    address: SocketAddr,
    is_closed: Arc<AtomicBool>,
}

impl Door {
    /// Listens at an address.
    ///
    /// # Errors
    /// Where that is taken or none of this machine.
    pub fn open(host: &str, port: u16) -> io::Result<(Self, TcpListener)> {
        let listener = TcpListener::bind((host, port))?;
        let (address, is_closed) = (listener.local_addr()?, Arc::default());
        Ok((Self { address, is_closed }, listener))
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Lets viewers in to a server. `host`: as the user named it.
    pub fn lead_to(&self, listener: TcpListener, server: SocketAddr, host: &str) {
        let (is_closed, host) = (Arc::clone(&self.is_closed), host.to_owned());
        let viewers = Arc::new(AtomicUsize::new(0));
        std::thread::spawn(move || {
            for viewer in listener.incoming() {
                if is_closed.load(Ordering::Relaxed) {
                    return;
                }
                let Ok(viewer) = viewer else {
                    std::thread::sleep(AFTER_FAILURE);
                    continue;
                };
                let place = Place::taken(&viewers);
                let host = host.clone();
                std::thread::spawn(move || {
                    let passed = place.is_some().then(|| pass(viewer, server, &host));
                    if let Some(Err(e)) = passed {
                        tracing::debug!("a viewer went away: {e}");
                    }
                    drop(place);
                });
            }
        });
    }
}

impl Drop for Door {
    fn drop(&mut self) {
        self.is_closed.store(true, Ordering::Relaxed);
        // Wakes the thread that waits for viewers.
        drop(TcpStream::connect(self.address));
    }
}

/// A loopback address that nobody guesses, for the server. Other systems than Linux have but one.
pub fn hidden_address() -> IpAddr {
    let drawn = RandomState::new().build_hasher().finish().to_le_bytes();
    let [_, b, c, d, ..] = drawn;
    let hidden = IpAddr::V4(Ipv4Addr::new(127, b, c, d.clamp(1, 254)));
    match TcpListener::bind((hidden, 0)) {
        Ok(_) => hidden,
        Err(_) => IpAddr::V4(Ipv4Addr::LOCALHOST),
    }
}

/// One of the viewers at once.
struct Place(Arc<AtomicUsize>);

impl Place {
    fn taken(of: &Arc<AtomicUsize>) -> Option<Self> {
        let place = Self(Arc::clone(of));
        (of.fetch_add(1, Ordering::Relaxed) < MOST_VIEWERS).then_some(place)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Passes a viewer on until it goes, unless it may not look.
fn pass(mut viewer: TcpStream, server: SocketAddr, host: &str) -> io::Result<()> {
    let request = request(&mut viewer, REQUEST_TIMEOUT)?;
    if let Err(origin) = may_look(&request, host) {
        tracing::warn!(origin, "a web page was kept from the view");
        let told = format!("Pages of {origin} may not look; open one of this host.\n");
        let length = told.len();
        return write!(
            viewer,
            "HTTP/1.1 403 Forbidden\r\nContent-Type: text/plain\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n{told}"
        );
    }
    viewer.set_read_timeout(None)?;
    viewer.set_nodelay(true)?;
    let mut inside = TcpStream::connect(server)?;
    inside.set_nodelay(true)?;
    inside.write_all(&request)?;
    let (mut from_viewer, mut into_server) = (viewer.try_clone()?, inside.try_clone()?);
    std::thread::spawn(move || {
        let copied = io::copy(&mut from_viewer, &mut into_server);
        drop(into_server.shutdown(Shutdown::Both));
        copied
    });
    let copied = io::copy(&mut inside, &mut viewer).map(drop);
    drop(viewer.shutdown(Shutdown::Both));
    copied
}

/// What a viewer sends first, up to the empty line, where all of that comes in time.
fn request(viewer: &mut TcpStream, timeout: Duration) -> io::Result<Vec<u8>> {
    let end = Instant::now() + timeout;
    let (mut request, mut some) = (Vec::new(), [0; 1024]);
    while !request.windows(4).any(|bytes| bytes == b"\r\n\r\n") {
        let left = end.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(io::Error::other("its request did not come in time"));
        }
        viewer.set_read_timeout(Some(left))?;
        let count = viewer.read(&mut some)?;
        if count == 0 || request.len() + count > MOST_REQUEST_BYTES {
            return Err(io::Error::other("it sent no request"));
        }
        request.extend_from_slice(&some[..count]);
    }
    Ok(request)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A server that says what was asked of it, in capitals, and a door before it.
    fn behind_a_door() -> Door {
        let server = TcpListener::bind((hidden_address(), 0)).unwrap();
        let inside = server.local_addr().unwrap();
        std::thread::spawn(move || {
            for mut viewer in server.incoming().flatten() {
                let asked = request(&mut viewer, REQUEST_TIMEOUT).unwrap().to_ascii_uppercase();
                viewer.write_all(&asked).unwrap();
            }
        });
        let (door, listener) = Door::open("127.0.0.1", 0).unwrap();
        door.lead_to(listener, inside, "127.0.0.1");
        door
    }

    fn answer(door: &Door, request: &[u8]) -> String {
        let mut viewer = TcpStream::connect(door.address()).unwrap();
        viewer.write_all(request).unwrap();
        let mut answer = String::new();
        viewer.read_to_string(&mut answer).unwrap();
        answer
    }

    #[test]
    fn a_program_gets_through_and_a_stranger_s_page_does_not() {
        let door = behind_a_door();
        assert_eq!(
            answer(&door, b"GET / HTTP/1.1\r\nHost: a\r\n\r\n"),
            "GET / HTTP/1.1\r\nHOST: A\r\n\r\n"
        );
        let page = answer(&door, b"GET / HTTP/1.1\r\nOrigin: https://example.org\r\n\r\n");
        assert!(page.starts_with("HTTP/1.1 403 "), "{page}");
        assert!(page.contains("https://example.org may not look"), "{page}");
    }

    #[test]
    fn a_stranger_who_sends_a_request_in_drops_does_not_hold_a_place_for_long() {
        let listener = TcpListener::bind((hidden_address(), 0)).unwrap();
        let mut stranger = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let (mut viewer, _) = listener.accept().unwrap();
        let drips = std::thread::spawn(move || {
            while stranger.write_all(b"x").is_ok() {
                std::thread::sleep(Duration::from_millis(10));
            }
        });
        let begin = Instant::now();
        let answer = request(&mut viewer, Duration::from_millis(200));
        assert!(answer.is_err() && begin.elapsed() >= Duration::from_millis(200));
        // A busy machine may be late; without the deadline it would wait for 16 KiB of drops.
        assert!(begin.elapsed() < Duration::from_secs(5), "{:?}", begin.elapsed());
        drop(viewer);
        drips.join().unwrap();
    }

    #[test]
    fn a_closed_door_lets_nobody_in_and_what_is_no_request_is_not_waited_for() {
        let door = behind_a_door();
        let mut endless = TcpStream::connect(door.address()).unwrap();
        let sent = (0..64).try_for_each(|_| endless.write_all(&[b'x'; 1024]));
        let mut answer = Vec::new();
        assert!(sent.is_err() || endless.read_to_end(&mut answer).is_err() || answer.is_empty());
        let address = door.address();
        drop(door);
        // The thread that waited for viewers ends with the listener.
        let is_shut = (0..100).any(|_| {
            std::thread::sleep(Duration::from_millis(20));
            TcpStream::connect(address).is_err()
        });
        assert!(is_shut);
    }
}
