//! Opening a store's file: to read and write, or where that cannot be, to read alone.

use super::error::{StoreError, explain};
use super::schema::{self, State};
use super::transaction::wait_for_turn;
use rusqlite::backup::{Backup, StepResult};
use rusqlite::{Connection, ErrorCode, MAIN_DB, OpenFlags};
use rustix::fs::{Access, access};
use std::ffi::OsString;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::time::Duration;
use std::{fs, io};

/// An open file, its tables made and brought up to date.
pub struct Opened {
    pub connection: Connection,
    /// It can be read alone.
    pub is_read_only: bool,
}

/// What is done where there is no store yet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Absent {
    /// It is an error.
    Refuse,
    /// An empty store is made.
    Create,
}

/// Opens a store.
pub fn open(path: &Path, absent: Absent) -> Result<Opened, StoreError> {
    check_path(path, absent)?;
    let mut flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    flags.set(OpenFlags::SQLITE_OPEN_CREATE, absent == Absent::Create);
    match open_to_write(path, flags, absent) {
        Err(error) if needs_no_writing(&error) => {
            // Where it cannot be read either, or is empty as there is no room to make it, the first
            // error is returned.
            let Some(connection) = readers(path).find_map(|reader| reader().ok()) else {
                return Err(error);
            };
            match up_to_date(path, connection) {
                Err(StoreError::NotAStore { .. }) if absent == Absent::Create => Err(error),
                read => Ok(Opened { connection: read?, is_read_only: true }),
            }
        }
        opened => opened,
    }
}

/// Refuses names that SQLite would take for something else than a file, and what is no file.
fn check_path(path: &Path, absent: Absent) -> Result<(), StoreError> {
    let name = path.as_os_str().as_bytes();
    let refuse = |reason| Err(StoreError::NotAFile { path: path.display().to_string(), reason });
    if name.is_empty() {
        return refuse("it is empty");
    }
    if name.starts_with(b":") {
        return refuse("what begins with a colon lies in memory and is lost at once");
    }
    if name.starts_with(b"file:") {
        return refuse("it is a URI");
    }
    let unreachable = |reason| StoreError::Unreachable { path: path.display().to_string(), reason };
    match fs::metadata(path) {
        Ok(there) if there.is_dir() => refuse("it is a folder"),
        Ok(there) if !there.is_file() => refuse("it is a device or a pipe"),
        // It is not opened to see whether it can be: to close it again would take away the locks
        // that this process has on it.
        Ok(_) => access(path, Access::READ_OK).map_err(|e| unreachable(e.into())),
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(unreachable(error)),
        Err(_) if absent == Absent::Refuse => {
            Err(StoreError::Missing { path: path.display().to_string() })
        }
        Err(_) if folder_of(path).is_dir() => Ok(()),
        Err(error) => Err(unreachable(error)),
    }
}

/// The folder that a file lies in.
fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|dir| !dir.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// How often, and after how long, a file that is still empty is looked at again: another process
/// may be about to make it.
const LOOKS: u32 = 50;
const LOOK_AGAIN: Duration = Duration::from_millis(10);

fn open_to_write(path: &Path, flags: OpenFlags, absent: Absent) -> Result<Opened, StoreError> {
    let sql = |e| explain(path, e);
    let mut connection = Connection::open_with_flags(path, flags).map_err(sql)?;
    connection.busy_handler(Some(wait_for_turn)).map_err(sql)?;
    let mut state = schema::state(path, &connection)?;
    if connection.is_readonly(MAIN_DB).map_err(sql)? {
        return Ok(Opened { connection: up_to_date(path, connection)?, is_read_only: true });
    }
    for _ in 0..LOOKS {
        if state != State::Empty || absent == Absent::Create {
            break;
        }
        std::thread::sleep(LOOK_AGAIN);
        state = schema::state(path, &connection)?;
    }
    if state == State::Empty && absent == Absent::Refuse {
        return Err(StoreError::NotAStore { path: path.display().to_string() });
    }
    schema::prepare(path, &connection)?;
    Ok(Opened { connection, is_read_only: false })
}

/// Errors of a folder or disk to which nothing can be written: SQLite keeps what readers and
/// writers agree on in files beside the store.
fn needs_no_writing(error: &StoreError) -> bool {
    let cannot_write = |reason: &rusqlite::Error| {
        matches!(
            reason.sqlite_error_code(),
            Some(
                ErrorCode::CannotOpen
                    | ErrorCode::ReadOnly
                    | ErrorCode::DiskFull
                    | ErrorCode::SystemIoFailure
                    | ErrorCode::PermissionDenied
            )
        )
    };
    match error {
        StoreError::ReadOnly { .. } => true,
        StoreError::Database { reason, .. } => cannot_write(&reason.0),
        _ => false,
    }
}

type Reader<'p> = Box<dyn Fn() -> rusqlite::Result<Connection> + 'p>;

/// Ways to read a file without writing beside it, the safest first: beside a process that writes;
/// with changes that one left in a journal when it was killed; alone.
fn readers(path: &Path) -> impl Iterator<Item = Reader<'_>> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let checked = |mut connection: Connection| {
        connection.busy_handler(Some(wait_for_turn))?;
        connection.query_row("SELECT count(*) FROM sqlite_master", [], |_| Ok(()))?;
        Ok(connection)
    };
    let beside_others: Reader =
        Box::new(move || checked(Connection::open_with_flags(path, flags)?));
    let with_journal: Reader = Box::new(move || {
        // Without locks, the journal's index can be kept in memory.
        let connection = Connection::open_with_flags_and_vfs(path, flags, "unix-none")?;
        connection.pragma_update(None, "locking_mode", "EXCLUSIVE")?;
        checked(connection)
    });
    let alone: Reader = Box::new(move || {
        let uri = immutable(path);
        checked(Connection::open_with_flags(uri, flags | OpenFlags::SQLITE_OPEN_URI)?)
    });
    let has_journal = fs::metadata(journal_of(path)).is_ok_and(|journal| journal.len() > 0);
    [Some(beside_others), Some(if has_journal { with_journal } else { alone })]
        .into_iter()
        .flatten()
}

/// The journal that SQLite keeps beside a file. It lies where the file itself does, not where a
/// link to it is.
fn journal_of(path: &Path) -> PathBuf {
    let mut name: OsString = fs::canonicalize(path).unwrap_or(path.to_owned()).into();
    name.push("-wal");
    name.into()
}

/// The URI of a file that nobody changes.
fn immutable(path: &Path) -> String {
    let path = fs::canonicalize(path).unwrap_or(path.to_owned());
    let mut uri = String::from("file:");
    for &byte in path.as_os_str().as_bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'.' | b'_' | b'-' => {
                uri.push(char::from(byte));
            }
            _ => uri += &format!("%{byte:02x}"),
        }
    }
    uri + "?immutable=1"
}

/// Pages that are copied at a time.
const PAGES_AT_ONCE: i32 = 4_096;

/// A store that cannot be written, or where its schema is an earlier one, a copy of it that is
/// brought up to date and is gone when it is closed.
fn up_to_date(path: &Path, connection: Connection) -> Result<Connection, StoreError> {
    let state = schema::state(path, &connection)?;
    if state == State::Empty {
        return Err(StoreError::NotAStore { path: path.display().to_string() });
    }
    if state.is_newest() {
        return Ok(connection);
    }
    let copied = || {
        // SQLite's own name for a temporary file.
        let mut copy = Connection::open("")?;
        let backup = Backup::new(&connection, &mut copy)?;
        while backup.step(PAGES_AT_ONCE)? != StepResult::Done {}
        drop(backup);
        Ok(copy)
    };
    let copy = copied().map_err(|e| explain(path, e))?;
    schema::prepare(path, &copy)?;
    Ok(copy)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::ffi::OsStringExt;

    fn refused(path: impl AsRef<Path>, absent: Absent) -> String {
        open(path.as_ref(), absent).err().expect("it is refused").to_string()
    }

    #[test]
    fn names_that_the_library_would_take_for_something_else_are_refused() {
        for absent in [Absent::Refuse, Absent::Create] {
            assert!(refused("", absent).contains("it is empty"));
            assert!(refused(":memory:", absent).contains("lies in memory"));
            assert!(refused("file:s.linkage?mode=ro", absent).contains("it is a URI"));
        }
    }

    #[test]
    fn folders_devices_and_files_below_no_folder_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        assert!(refused(dir.path(), Absent::Create).contains("it is a folder"));
        assert!(refused("/dev/null", Absent::Create).contains("it is a device or a pipe"));
        let nowhere = dir.path().join("no/such/s.linkage");
        assert!(matches!(open(&nowhere, Absent::Create), Err(StoreError::Unreachable { .. })));
    }

    #[test]
    fn a_store_is_made_only_where_that_is_asked_for() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.linkage");
        assert!(matches!(open(&path, Absent::Refuse), Err(StoreError::Missing { .. })));
        assert!(!path.exists(), "asking for it makes none");
        assert!(!open(&path, Absent::Create).unwrap().is_read_only);
        assert!(open(&path, Absent::Refuse).is_ok());
    }

    #[test]
    fn an_empty_file_is_no_store_until_one_is_made_of_it() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.linkage");
        fs::write(&path, "").unwrap();
        assert!(matches!(open(&path, Absent::Refuse), Err(StoreError::NotAStore { .. })));
        assert!(open(&path, Absent::Create).is_ok());
        assert!(open(&path, Absent::Refuse).is_ok());
    }

    #[test]
    fn a_file_that_is_no_store_is_refused_and_left_as_it_is() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("notes.txt");
        let text = "hello, this is no database. ".repeat(100);
        fs::write(&path, &text).unwrap();
        for absent in [Absent::Refuse, Absent::Create] {
            assert!(matches!(open(&path, absent), Err(StoreError::NotAStore { .. })));
        }
        assert_eq!(fs::read_to_string(&path).unwrap(), text);
    }

    #[test]
    fn the_folder_of_a_bare_name_is_the_one_where_one_is() {
        assert_eq!(folder_of(Path::new("s.linkage")), Path::new("."));
        assert_eq!(folder_of(Path::new("a/s.linkage")), Path::new("a"));
    }

    #[test]
    fn a_uri_has_no_sign_of_its_own_in_a_name() {
        let odd = PathBuf::from(OsString::from_vec(b"/no/a b?c#d%e\xff.linkage".to_vec()));
        assert_eq!(immutable(&odd), "file:/no/a%20b%3fc%23d%25e%ff.linkage?immutable=1");
    }

    #[test]
    fn the_journal_lies_beside_the_file_that_a_link_leads_to() {
        let dir = tempfile::tempdir().unwrap();
        let (target, link) = (dir.path().join("s.linkage"), dir.path().join("link"));
        fs::write(&target, "").unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();
        let beside = journal_of(&fs::canonicalize(&target).unwrap());
        assert_eq!(journal_of(&link), beside);
        assert!(beside.to_string_lossy().ends_with("s.linkage-wal"));
    }

    #[test]
    fn only_what_cannot_be_written_is_opened_to_read() {
        let code = |code| {
            let sqlite = rusqlite::ffi::Error { code, extended_code: 0 };
            explain(Path::new("s.linkage"), rusqlite::Error::SqliteFailure(sqlite, None))
        };
        for cannot in [ErrorCode::CannotOpen, ErrorCode::ReadOnly, ErrorCode::PermissionDenied] {
            assert!(needs_no_writing(&code(cannot)), "{cannot:?}");
        }
        for other in [ErrorCode::DatabaseCorrupt, ErrorCode::NotADatabase, ErrorCode::DatabaseBusy]
        {
            assert!(!needs_no_writing(&code(other)), "{other:?}");
        }
        assert!(!needs_no_writing(&StoreError::Missing { path: String::new() }));
    }
}
