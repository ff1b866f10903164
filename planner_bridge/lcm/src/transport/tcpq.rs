//! Asks for a server of `tcpq://` before liblcm does.
//!
//! liblcm 1.3 hands out a connection without a socket where nobody listens, and waits without end
//! for the answer of a peer that is no server.

use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, TcpStream};
use std::time::Duration;

/// The server that a URL without an address means, as liblcm has it.
const DEFAULT_SERVER: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::LOCALHOST, 7700);
/// What a client and a server say first, and the version that follows.
const HELLO_OF_CLIENT: u32 = 0x2876_17fb;
const HELLO_OF_SERVER: u32 = 0x2876_17fa;
const VERSION: u32 = 0x0100;
/// Longest wait for a connection, for the answer, and for a server that takes or sends no more bytes.
pub const TIMEOUT: Duration = Duration::from_secs(2);

/// Connects, exchanges the first messages, and disconnects.
///
/// # Errors
/// Why there is no LCM server at `ADDRESS:PORT`.
pub fn handshake(address: &str) -> Result<(), String> {
    let said = |e: io::Error| format!("no LCM server answers at {address}: {e}");
    let mut server = TcpStream::connect_timeout(&server_of(address)?, TIMEOUT).map_err(said)?;
    server.set_read_timeout(Some(TIMEOUT)).map_err(said)?;
    let hello = [HELLO_OF_CLIENT.to_be_bytes(), VERSION.to_be_bytes()].concat();
    server.write_all(&hello).map_err(said)?;
    let mut answer = [0; 8];
    server.read_exact(&mut answer).map_err(said)?;
    if answer[..4] != HELLO_OF_SERVER.to_be_bytes() {
        return Err(format!("what answers at {address} is no LCM server"));
    }
    Ok(())
}

/// liblcm takes addresses in numbers alone, with port 7700 where none is given.
fn server_of(address: &str) -> Result<SocketAddr, String> {
    let server = if address.is_empty() {
        Some(DEFAULT_SERVER)
    } else if address.contains(':') {
        address.parse().ok()
    } else {
        address.parse().ok().map(|ip| SocketAddrV4::new(ip, DEFAULT_SERVER.port()))
    };
    server
        .map(SocketAddr::V4)
        .ok_or_else(|| format!("\"{address}\" is no address; try tcpq://127.0.0.1:7700"))
}
