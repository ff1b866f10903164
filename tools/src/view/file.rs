//! A file that remembers the first fault of writing it: the library that writes the messages only
//! logs such faults.

use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// The first fault of a file, once there is one.
#[derive(Debug, Clone, Default)]
pub struct Fault(Arc<Mutex<Option<io::Error>>>);

impl Fault {
    /// Takes it out.
    pub fn take(&self) -> Option<io::Error> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    fn is_set(&self) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }

    /// Keeps the first one; hands on what came.
    fn keep<T>(&self, result: io::Result<T>) -> io::Result<T> {
        if let Err(e) = &result {
            let mut first = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            if first.is_none() {
                tracing::warn!("the view's file ends here, it cannot be written: {e}");
                *first = Some(io::Error::new(e.kind(), e.to_string()));
            }
        }
        result
    }
}

/// A file that is removed where it is not finished: a command that fails leaves nothing half done.
#[derive(Debug)]
pub struct Unfinished(Option<PathBuf>);

impl Unfinished {
    /// A file that was just made.
    pub fn new(path: &Path) -> Self {
        Self(Some(path.to_owned()))
    }

    /// It stays.
    pub fn finish(mut self) {
        self.0 = None;
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        // What a fault of this program left is kept: it may tell why.
        if let Some(path) = self.0.take().filter(|_| !std::thread::panicking()) {
            let removed = std::fs::remove_file(&path);
            removed.unwrap_or_else(|e| tracing::warn!("{}: stays half done: {e}", path.display()));
        }
    }
}

/// A buffered file. After its first fault it takes what is written and drops it: the library would
/// log a warning for each message else, hundreds in a second.
pub struct CheckedFile {
    file: BufWriter<File>,
    fault: Fault,
}

impl CheckedFile {
    /// Writes to a file; what goes wrong is told to `fault` too.
    pub fn new(file: File, fault: Fault) -> Self {
        Self { file: BufWriter::new(file), fault }
    }
}

impl Write for CheckedFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.fault.is_set() {
            return Ok(bytes.len());
        }
        self.fault.keep(self.file.write(bytes))
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.fault.is_set() {
            return Ok(());
        }
        self.fault.keep(self.file.flush())
    }
}

impl Seek for CheckedFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        if self.fault.is_set() {
            return Ok(0);
        }
        self.fault.keep(self.file.seek(to))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_stays_once_it_is_finished() {
        let dir = tempfile::tempdir().unwrap();
        for is_finished in [true, false] {
            let path = dir.path().join("file");
            std::fs::write(&path, "half").unwrap();
            let unfinished = Unfinished::new(&path);
            if is_finished {
                unfinished.finish()
            } else {
                drop(unfinished)
            }
            assert_eq!(path.exists(), is_finished);
        }
    }

    #[test]
    fn a_full_device_is_remembered() {
        let fault = Fault::default();
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let mut file = CheckedFile::new(full, fault.clone());
        let written = file.write_all(&[0; 100]).and_then(|()| file.flush());
        assert!(written.is_err());
        assert!(file.write_all(&[0; 100]).is_ok(), "what comes later is dropped in silence");
        assert_eq!(fault.take().unwrap().kind(), io::ErrorKind::StorageFull);
        assert!(fault.take().is_none());
    }
}
