//! Which web pages may look.
//!
//! Any page that a browser shows can open a WebSocket to its own machine, and would see what the camera
//! sees. Browsers tell in the header `Origin` where a page is from; other programs send none, and a page
//! cannot leave it out.

/// Bytes of the request that opens a WebSocket: more is no request.
pub const MOST_REQUEST_BYTES: usize = 16 << 10;
/// Foxglove's own pages.
const FOXGLOVE: &str = "foxglove.dev";

/// True where a request for a WebSocket at a host is from a program, from a page of this machine or of
/// that host, or from Foxglove's page.
pub fn may_look(request: &[u8], own_host: &str) -> Result<(), String> {
    let text = String::from_utf8_lossy(request);
    let headers = text.lines().skip(1).filter_map(|line| line.split_once(':'));
    let mut origins = headers.filter(|(name, _)| name.trim().eq_ignore_ascii_case("origin"));
    match origins.find(|(_, origin)| !is_known(origin.trim(), own_host)) {
        None => Ok(()),
        Some((_, origin)) => Err(origin.trim().chars().filter(|c| !c.is_control()).collect()),
    }
}

fn is_known(origin: &str, own_host: &str) -> bool {
    let Some((scheme, rest)) = origin.split_once("://") else { return false };
    let is_page_of_the_web = ["http", "https"].iter().any(|s| scheme.eq_ignore_ascii_case(s));
    // A program with pages of its own, or a file that somebody opened.
    if !is_page_of_the_web {
        return true;
    }
    let host = host_of(rest).to_ascii_lowercase();
    let is_loopback = host.parse::<std::net::IpAddr>().is_ok_and(|ip| ip.is_loopback());
    let is_foxglove = host.strip_suffix(FOXGLOVE).is_some_and(|s| s.is_empty() || s.ends_with('.'));
    host == "localhost"
        || is_loopback
        || host.eq_ignore_ascii_case(own_host)
        || is_foxglove && scheme.eq_ignore_ascii_case("https")
}

/// Of `HOST`, `HOST:PORT` or `[IPV6]:PORT`.
fn host_of(authority: &str) -> &str {
    match authority.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((host, _)) => host,
        None => authority.split_once(':').map_or(authority, |(host, _)| host),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked_by(origin: &str) -> Result<(), String> {
        let request = format!("GET / HTTP/1.1\r\nHost: 127.0.0.1:8765\r\nORIGIN: {origin}\r\n\r\n");
        may_look(request.as_bytes(), "robot.lan")
    }

    #[test]
    fn programs_and_pages_of_this_machine_of_the_view_s_host_and_of_foxglove_may_look() {
        assert_eq!(may_look(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", "127.0.0.1"), Ok(()));
        for origin in [
            "http://localhost:8080",
            "http://127.0.0.1",
            "http://[::1]:3000",
            "http://robot.lan:8080",
            "https://app.foxglove.dev",
            "https://foxglove.dev",
            "file://",
        ] {
            assert_eq!(asked_by(origin), Ok(()), "{origin}");
        }
    }

    #[test]
    fn other_pages_may_not_however_they_are_called() {
        for origin in [
            "https://example.org",
            "null",
            "",
            "http://app.foxglove.dev",
            "https://foxglove.dev.example.org",
            "https://notfoxglove.dev",
            "http://localhost.example.org",
            "http://127.0.0.1.example.org",
            "http://robot.lan.example.org",
        ] {
            assert_eq!(asked_by(origin), Err(origin.to_owned()));
        }
        let two = b"GET / HTTP/1.1\r\nOrigin: http://localhost\r\nOrigin: https://evil\r\n\r\n";
        assert_eq!(may_look(two, "x"), Err("https://evil".to_owned()));
    }
}
