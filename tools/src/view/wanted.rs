//! What view is asked for on the command line.

use std::path::PathBuf;

/// A file, a server, both or none.
#[derive(Debug, Clone, Default)]
pub struct Wanted {
    /// A file that does not exist yet.
    pub mcap: Option<PathBuf>,
    /// `HOST:PORT` of the server.
    pub address: Option<String>,
}
