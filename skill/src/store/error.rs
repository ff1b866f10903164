//! Why a store cannot be used.

use rusqlite::ErrorCode;
use std::path::Path;

/// A store that cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// It is not there.
    #[error("{path}: no such store; learn an object with --store first")]
    Missing {
        /// The file.
        path: String,
    },
    /// The name stands for no file that a store can be.
    #[error("\"{path}\" cannot be a store: {reason}; give the name of a file")]
    NotAFile {
        /// The name.
        path: String,
        /// Why.
        reason: &'static str,
    },
    /// The system does not let it be opened: no permission, no such folder.
    #[error("{path}: {reason}")]
    Unreachable {
        /// The file.
        path: String,
        /// Why.
        reason: std::io::Error,
    },
    /// It is something else.
    #[error("{path}: not a Linkage store; give another file name")]
    NotAStore {
        /// The file.
        path: String,
    },
    /// It was written by a newer version.
    #[error(
        "{path}: schema {found} is newer than {known}, the newest that this version knows; update linkage"
    )]
    Newer {
        /// The file.
        path: String,
        /// Its schema.
        found: i64,
        /// Ours.
        known: i64,
    },
    /// It can be read, not written.
    #[error(
        "{path}: this store can only be read: the file or its folder is read-only, or the disk is full"
    )]
    ReadOnly {
        /// The file.
        path: String,
    },
    /// No object goes by that name.
    #[error("{path}: no object \"{object}\"; it holds: {known}")]
    UnknownObject {
        /// The file.
        path: String,
        /// As asked.
        object: String,
        /// What there is.
        known: String,
    },
    /// An object that nothing could read again.
    #[error("object \"{object}\" cannot be stored: {reason}")]
    Invalid {
        /// Which.
        object: String,
        /// Why.
        reason: String,
    },
    /// Another process stored or removed the object meanwhile.
    #[error("{path}: object \"{object}\" was changed by another program meanwhile")]
    Changed {
        /// The file.
        path: String,
        /// Which.
        object: String,
    },
    /// An object that cannot be decoded, or is not what was stored.
    #[error("{path}: object \"{object}\" is damaged: {reason}; remove it and learn it again")]
    Damaged {
        /// The file.
        path: String,
        /// Which.
        object: String,
        /// Why.
        reason: String,
    },
    /// The file itself is not what was written.
    #[error(
        "{path}: the file is damaged: {reason}; take a copy of it from before, or learn its objects again"
    )]
    DamagedFile {
        /// The file.
        path: String,
        /// Why.
        reason: String,
    },
    /// SQLite's own errors: disk full, locked.
    #[error("{path}: {reason}")]
    Database {
        /// The file.
        path: String,
        /// Why.
        reason: DatabaseError,
    },
}

/// An error of the database below a store.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct DatabaseError(pub(super) rusqlite::Error);

/// What goes wrong below the store, where the file's name is not known.
#[derive(Debug, thiserror::Error)]
pub enum Fault {
    /// SQLite's own errors.
    #[error(transparent)]
    Sql(#[from] rusqlite::Error),
    /// A row of an object that is not what was written.
    #[error("object \"{object}\": {reason}")]
    Object {
        /// Which.
        object: String,
        /// Why.
        reason: String,
    },
    /// Another row that is not what was written, or is not there.
    #[error("{0}")]
    File(String),
}

impl Fault {
    /// With the file's name.
    pub fn in_file(self, path: &Path) -> StoreError {
        let name = path.display().to_string();
        match self {
            Self::Sql(error) => explain(path, error),
            Self::Object { object, reason } => StoreError::Damaged { path: name, object, reason },
            Self::File(reason) => StoreError::DamagedFile { path: name, reason },
        }
    }
}

/// An error of SQLite with the file's name.
pub fn explain(path: &Path, reason: rusqlite::Error) -> StoreError {
    let path = path.display().to_string();
    match reason.sqlite_error_code() {
        Some(ErrorCode::NotADatabase) => StoreError::NotAStore { path },
        Some(ErrorCode::DatabaseCorrupt) => {
            StoreError::DamagedFile { path, reason: reason.to_string() }
        }
        Some(ErrorCode::ReadOnly) => StoreError::ReadOnly { path },
        _ => StoreError::Database { path, reason: DatabaseError(reason) },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rusqlite::ffi;

    /// The store's error for an SQLite error with this code.
    fn told(code: i32) -> StoreError {
        let error = rusqlite::Error::SqliteFailure(ffi::Error::new(code), None);
        Fault::Sql(error).in_file(Path::new("kitchen.linkage"))
    }

    #[test]
    fn errors_of_sqlite_are_told_as_what_they_mean_for_a_store() {
        assert!(matches!(told(ffi::SQLITE_NOTADB), StoreError::NotAStore { .. }));
        assert!(matches!(told(ffi::SQLITE_CORRUPT), StoreError::DamagedFile { .. }));
        assert!(matches!(told(ffi::SQLITE_READONLY), StoreError::ReadOnly { .. }));
        assert!(matches!(told(ffi::SQLITE_FULL), StoreError::Database { .. }));
    }

    #[test]
    fn every_error_names_the_file() {
        let object = Fault::Object { object: "door".to_owned(), reason: "cut off".to_owned() };
        let errors = [
            told(ffi::SQLITE_FULL),
            object.in_file(Path::new("kitchen.linkage")),
            Fault::File("no index".to_owned()).in_file(Path::new("kitchen.linkage")),
        ];
        for error in errors {
            assert!(error.to_string().contains("kitchen.linkage"), "{error}");
        }
    }
}
