//! `metadata.yaml` of a rosbag2 folder: which files hold the messages, and how.

use crate::error::SourceError;
use linkage_frames::text_table;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Name of the file.
pub const FILE: &str = "metadata.yaml";
/// Largest one that is read, bytes.
const MAX_BYTES: u64 = 16 << 20;
/// Most files of a bag.
const MAX_FILES: usize = 100_000;

/// What is read of it.
#[derive(Debug, Deserialize)]
struct Document {
    rosbag2_bagfile_information: Information,
}

#[derive(Debug, Deserialize)]
struct Information {
    #[serde(default)]
    storage_identifier: String,
    #[serde(default)]
    relative_file_paths: Vec<String>,
    #[serde(default)]
    compression_format: String,
    #[serde(default)]
    compression_mode: String,
}

/// How the messages are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Storage {
    /// SQLite databases.
    Sqlite,
    /// MCAP files.
    Mcap,
}

/// What a folder holds.
#[derive(Debug, PartialEq, Eq)]
pub struct Metadata {
    /// How.
    pub storage: Storage,
    /// Files in the order of time.
    pub files: Vec<PathBuf>,
    /// Each message is compressed by zstd.
    pub has_compressed_messages: bool,
}

/// Reads a folder's description.
///
/// # Errors
/// [`SourceError::Recording`] when it is missing, damaged, or names what is not read.
pub fn read(dir: &Path) -> Result<Metadata, SourceError> {
    let path = dir.join(FILE);
    let broken =
        |reason: String| SourceError::Recording { path: path.display().to_string(), reason };
    let size = std::fs::metadata(&path).map_err(|e| broken(e.to_string()))?.len();
    if size > MAX_BYTES {
        return Err(broken(format!("has {size} bytes, more than {MAX_BYTES}")));
    }
    let text = text_table::read(&path).map_err(|e| broken(e.to_string()))?;
    parse(&text, dir).map_err(broken)
}

/// Reads the text of a folder's description.
///
/// # Errors
/// What is wrong, in a line.
pub fn parse(text: &str, dir: &Path) -> Result<Metadata, String> {
    let document: Document = serde_saphyr::from_str(text)
        .map_err(|e| e.to_string().lines().next().unwrap_or_default().to_owned())?;
    let information = document.rosbag2_bagfile_information;
    let storage = match information.storage_identifier.as_str() {
        "sqlite3" => Storage::Sqlite,
        "mcap" => Storage::Mcap,
        other => {
            return Err(format!("storage \"{other}\" is not read; sqlite3 and mcap are"));
        }
    };
    let has_compressed_messages = match information.compression_mode.to_uppercase().as_str() {
        "" | "NONE" | "STORAGE" => false,
        "MESSAGE" if information.compression_format == "zstd" => true,
        mode => {
            return Err(format!(
                "compression \"{}\" of each {mode} is not read; unpack the files with zstd -d, then run ros2 bag reindex on the folder",
                information.compression_format
            ));
        }
    };
    // Old versions write the folder's name before the file's. Nothing outside the folder is read.
    let files: Vec<PathBuf> = information
        .relative_file_paths
        .iter()
        .filter_map(|file| Path::new(file).file_name())
        .map(|file| dir.join(file))
        .collect();
    if files.is_empty() || files.len() > MAX_FILES {
        return Err(format!("names {} files in relative_file_paths", files.len()));
    }
    Ok(Metadata { storage, files, has_compressed_messages })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(storage: &str, compression: &str) -> String {
        format!(
            "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: {storage}\n  duration:\n    nanoseconds: 3\n  relative_file_paths:\n    - old/bag_0.db3\n    - ../../etc/passwd\n{compression}  topics_with_message_count: []\n"
        )
    }

    #[test]
    fn files_lie_in_the_folder_whatever_their_paths_say() {
        let found = parse(&text("sqlite3", ""), Path::new("bag")).unwrap();
        assert_eq!(found.storage, Storage::Sqlite);
        assert_eq!(found.files, [Path::new("bag/bag_0.db3"), Path::new("bag/passwd")]);
        assert!(!found.has_compressed_messages);
    }

    #[test]
    fn what_is_not_read_is_named() {
        let error = parse(&text("rocksdb", ""), Path::new("bag")).unwrap_err();
        assert!(error.contains("\"rocksdb\""), "{error}");
        let files = "  compression_format: zstd\n  compression_mode: FILE\n";
        let error = parse(&text("sqlite3", files), Path::new("bag")).unwrap_err();
        assert!(error.contains("zstd -d"), "{error}");
        let messages = "  compression_format: zstd\n  compression_mode: MESSAGE\n";
        assert!(parse(&text("mcap", messages), Path::new("bag")).unwrap().has_compressed_messages);
        for damaged in ["", "a: [", "rosbag2_bagfile_information: 3", "{{{{{{"] {
            assert!(parse(damaged, Path::new("bag")).is_err(), "{damaged}");
        }
    }
}
