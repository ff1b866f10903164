//! What a store holds, object by object: numbers, names and words, each row with a checksum. The
//! totals of all rows are kept too, so that a row that is lost or altered does not go unnoticed.

use super::error::Fault;
use super::record::Checksum;
use rusqlite::{Connection, params};

/// A row of the words.
#[derive(Debug, Clone)]
pub struct Entry {
    /// The object's number. It is never used again: what replaces an object gets another.
    pub number: u32,
    /// Its name.
    pub object: String,
    /// Its words as they are kept; `None` once they are listed.
    pub words: Option<Vec<u8>>,
    /// Checksum of what is kept of the object.
    pub content: u32,
}

impl Entry {
    /// Checksum of the row.
    pub fn checksum(&self) -> u32 {
        let mut sum = Checksum::default();
        sum.field(&self.number.to_le_bytes());
        sum.field(self.object.as_bytes());
        sum.field(&self.content.to_le_bytes());
        if let Some(words) = &self.words {
            sum.field(words);
        }
        sum.finish()
    }
}

/// All rows of a query.
pub fn all_rows<T>(
    connection: &Connection,
    query: &str,
    of_row: impl FnMut(&rusqlite::Row) -> rusqlite::Result<T>,
) -> rusqlite::Result<Vec<T>> {
    connection.prepare(query)?.query_map([], of_row)?.collect()
}

/// Columns of [`Entry`], in the order in which [`checked`] reads them.
const COLUMNS: &str = "number, object, words, content, checksum";

/// All rows, checked one by one and as a whole, in the order of their numbers.
pub fn entries(connection: &Connection) -> Result<Vec<Entry>, Fault> {
    let entries = select(connection, "")?;
    let (objects, checksum): (i64, i64) =
        connection.query_row("SELECT objects, checksum FROM total", [], |row| row.try_into())?;
    let sum: i64 = entries.iter().map(|e| i64::from(e.checksum())).sum();
    if objects != entries.len() as i64 {
        let reason = format!("of {objects} objects {} are found", entries.len());
        return Err(Fault::File(reason));
    }
    if checksum != sum {
        return Err(Fault::File("its list of objects does not match its checksum".to_owned()));
    }
    Ok(entries)
}

/// Rows whose words are not listed, in the order of their numbers.
pub fn unlisted(connection: &Connection) -> Result<Vec<Entry>, Fault> {
    select(connection, "WHERE words IS NOT NULL")
}

/// The row of an object.
pub fn entry(connection: &Connection, object: &str) -> Result<Option<Entry>, Fault> {
    let query = format!("SELECT {COLUMNS} FROM words WHERE object = ?1");
    let mut statement = connection.prepare_cached(&query)?;
    let mut rows = statement.query([object])?;
    rows.next()?.map(checked).transpose()
}

fn select(connection: &Connection, of: &str) -> Result<Vec<Entry>, Fault> {
    let mut statement =
        connection.prepare(&format!("SELECT {COLUMNS} FROM words {of} ORDER BY number"))?;
    let mut rows = statement.query([])?;
    let mut entries = Vec::new();
    while let Some(row) = rows.next()? {
        entries.push(checked(row)?);
    }
    Ok(entries)
}

fn checked(row: &rusqlite::Row) -> Result<Entry, Fault> {
    let entry = Entry {
        number: row.get(0)?,
        object: row.get(1)?,
        words: row.get(2)?,
        content: row.get(3)?,
    };
    if entry.checksum() != row.get::<_, u32>(4)? {
        let reason = "its row in the list of objects does not match its checksum".to_owned();
        return Err(Fault::Object { object: entry.object, reason });
    }
    Ok(entry)
}

/// Writes what was changed in a row: its words, and its checksum.
pub fn update(connection: &Connection, entry: &Entry) -> rusqlite::Result<()> {
    let mut statement = connection.prepare_cached(
        "UPDATE words SET words = ?2, content = ?3, checksum = ?4 WHERE number = ?1",
    )?;
    let row = params![entry.number, entry.words, entry.content, entry.checksum()];
    statement.execute(row).map(drop)
}

/// Writes a new row.
pub fn insert(
    connection: &Connection,
    object: &str,
    words: &[u8],
    content: u32,
) -> rusqlite::Result<()> {
    // The number, which the checksum is over too, is known once the row is there.
    connection
        .prepare_cached(
            "INSERT INTO words (object, words, content, checksum) VALUES (?1, x'', ?2, 0)",
        )?
        .execute(params![object, content])?;
    let number = u32::try_from(connection.last_insert_rowid())
        .map_err(|e| rusqlite::Error::ToSqlConversionFailure(e.into()))?;
    let (object, words) = (object.to_owned(), Some(words.to_vec()));
    update(connection, &Entry { number, object, words, content })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row() -> Entry {
        Entry { number: 3, object: "door".into(), words: Some(vec![1, 2, 3]), content: 77 }
    }

    #[test]
    fn a_checksum_tells_every_change_of_a_row() {
        let sum = row().checksum();
        let changed = [
            Entry { number: 4, ..row() },
            Entry { object: "doot".into(), ..row() },
            Entry { words: Some(vec![1, 2, 4]), ..row() },
            Entry { words: None, ..row() },
            Entry { content: 78, ..row() },
        ];
        assert!(changed.iter().all(|entry| entry.checksum() != sum));
        assert_eq!(row().checksum(), sum);
    }

    #[test]
    fn bytes_that_go_from_one_field_to_the_next_change_the_checksum() {
        let of = |object: &str, words: &[u8]| {
            Entry { object: object.into(), words: Some(words.to_vec()), ..row() }.checksum()
        };
        assert_ne!(of("ab", b"c"), of("a", b"bc"));
    }
}
