//! What commands write: whole or not at all.

use crate::outcome::Outcome;
use anyhow::Context;
use std::fs::{self, OpenOptions, Permissions};
use std::io::{self, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

/// Writes JSON to a file, or to standard output for `-`.
pub fn write_json(path: &Path, value: &impl serde::Serialize) -> Outcome {
    let text = serde_json::to_string_pretty(value)? + "\n";
    write_text(path, &text)
}

/// Writes text to a file, or to standard output for `-`. A file is replaced whole or not at
/// all; a device or a pipe, such as `/dev/null`, is written to.
pub fn write_text(path: &Path, text: &str) -> Outcome {
    let written = if path == Path::new("-") {
        io::stdout().write_all(text.as_bytes())
    } else {
        match fs::canonicalize(path) {
            Ok(at) if at.is_file() => replace(&at, text),
            Ok(at) => OpenOptions::new()
                .write(true)
                .open(at)
                .and_then(|mut device| device.write_all(text.as_bytes())),
            Err(_) => replace(path, text),
        }
    };
    written.with_context(|| format!("{}: cannot be written", path.display()))?;
    Ok(())
}

/// Puts a new file in the place of the old one, if there is one, and keeps its permissions.
fn replace(path: &Path, text: &str) -> io::Result<()> {
    let dir = path.parent().filter(|d| !d.as_os_str().is_empty()).unwrap_or(Path::new("."));
    fs::create_dir_all(dir)?;
    let as_any_new_file = Permissions::from_mode(0o666);
    let mut file = tempfile::Builder::new().permissions(as_any_new_file).tempfile_in(dir)?;
    file.write_all(text.as_bytes())?;
    if let Ok(old) = fs::metadata(path) {
        file.as_file().set_permissions(old.permissions())?;
    }
    file.as_file().sync_all()?;
    file.persist(path)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::{FileTypeExt, symlink};

    fn write(path: &Path, text: &str) {
        assert!(write_text(path, text).is_ok(), "{}", path.display());
    }

    #[test]
    fn a_full_device_is_told() {
        let full = write_text(Path::new("/dev/full"), "too much");
        let cause = format!("{:#}", full.err().unwrap().cause);
        assert!(cause.contains("/dev/full: cannot be written"), "{cause}");
        assert!(cause.contains("No space left"), "{cause}");
    }

    #[test]
    fn a_pipe_is_written_to() {
        let dir = tempfile::tempdir().unwrap();
        let pipe = dir.path().join("pipe");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status().unwrap();
        assert!(made.success());
        let reader = std::thread::spawn({
            let pipe = pipe.clone();
            move || fs::read_to_string(pipe).unwrap()
        });
        write(&pipe, "through");
        assert_eq!(reader.join().unwrap(), "through");
        assert!(fs::metadata(&pipe).unwrap().file_type().is_fifo());
    }

    #[test]
    fn a_link_stays_a_link() {
        let dir = tempfile::tempdir().unwrap();
        let (file, link) = (dir.path().join("file"), dir.path().join("link"));
        fs::write(&file, "old").unwrap();
        symlink(&file, &link).unwrap();
        write(&link, "new");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read_to_string(&file).unwrap(), "new");
    }

    #[test]
    fn permissions_are_those_of_any_file_and_are_kept() {
        let dir = tempfile::tempdir().unwrap();
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
        let (ours, any) = (dir.path().join("deep/ours"), dir.path().join("any"));
        write(&ours, "new");
        fs::write(&any, "any").unwrap();
        assert_eq!(mode(&ours), mode(&any));
        fs::set_permissions(&ours, Permissions::from_mode(0o640)).unwrap();
        write(&ours, "newer");
        assert_eq!(mode(&ours), 0o640);
    }
}
