//! Times of frames as Stray Scanner's `odometry.csv` tells them.
//!
//! In: its text, whose first row names the columns: `timestamp, frame, x, y, z, qx, qy, qz, qw`. Out: a time for each
//! frame that has one, microseconds.

use crate::error::SourceError;
use crate::tum::{check_steps, stamp_utime};
use linkage_frames::text_table::{self, Row};
use std::collections::BTreeMap;
use std::path::Path;

/// Names of the columns that are read.
const TIMESTAMP: &str = "timestamp";
const FRAME: &str = "frame";

/// Times of frames.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Odometry {
    /// Microseconds, by the number of the frame; later numbers have later times.
    pub utimes: BTreeMap<u64, i64>,
    /// The first line that tells a time.
    pub first_line: usize,
    /// How many rows tell no frame or no time, and what is wrong with the first of them.
    pub unusable: Option<(usize, String)>,
}

/// Reads the file.
///
/// # Errors
/// [`SourceError::Recording`] names the file and the line that is wrong.
pub fn read(path: &Path) -> Result<Odometry, SourceError> {
    let broken =
        |reason: String| SourceError::Recording { path: path.display().to_string(), reason };
    let text = text_table::read(path).map_err(|e| broken(e.to_string()))?;
    let odometry = parse_odometry(&text).map_err(broken)?;
    if let Some((rows, first)) = &odometry.unusable {
        tracing::warn!(rows, file = %path.display(), "rows were passed over, the first: {first}");
    }
    Ok(odometry)
}

/// Reads the file's text. A row without a frame or a time, such as one that was cut short, is passed over; where no
/// column is called `frame`, rows count the frames from 0.
///
/// # Errors
/// What is wrong in which line: no column of times, times or frames that run backwards, or no row that can be used.
pub fn parse_odometry(text: &str) -> Result<Odometry, String> {
    let mut rows = text_table::rows(text);
    let columns = Columns::of(rows.next())?;
    let mut odometry = Odometry { utimes: BTreeMap::new(), first_line: 0, unusable: None };
    for (place, row) in (0..).zip(rows) {
        let at = |reason: String| format!("line {}: {reason}", row.number);
        match columns.frame_and_utime(&row, place) {
            Ok((frame, utime)) => {
                if odometry.utimes.last_key_value().is_some_and(|(f, t)| frame <= *f || utime <= *t)
                {
                    let reason = "its frame or its time is not later than that before; sort the rows and remove repeated ones";
                    return Err(at(reason.to_owned()));
                }
                if odometry.utimes.is_empty() {
                    odometry.first_line = row.number;
                }
                odometry.utimes.insert(frame, utime);
            }
            Err(reason) => odometry.unusable.get_or_insert_with(|| (0, at(reason))).0 += 1,
        }
    }
    if odometry.utimes.is_empty() {
        let nothing = || format!("line {}: no row follows it", columns.line);
        return Err(odometry.unusable.map_or_else(nothing, |(_, first)| first));
    }
    check_steps(odometry.utimes.values().copied())?;
    Ok(odometry)
}

/// Where the columns stand.
struct Columns {
    /// The line that names them.
    line: usize,
    timestamp: usize,
    frame: Option<usize>,
}

impl Columns {
    fn of(header: Option<Row<'_>>) -> Result<Self, String> {
        let (line, names) = header.map_or((1, Vec::new()), |row| (row.number, row.fields()));
        let column = |name: &str| names.iter().position(|n| n.eq_ignore_ascii_case(name));
        let timestamp = column(TIMESTAMP).ok_or_else(|| {
            format!(
                "line {line}: names no column \"{TIMESTAMP}\"; the first row must name the columns"
            )
        })?;
        Ok(Self { line, timestamp, frame: column(FRAME) })
    }

    /// Number and time of the frame that a row is about.
    fn frame_and_utime(&self, row: &Row<'_>, place: u64) -> Result<(u64, i64), String> {
        let fields = row.fields();
        let field = |column: usize| fields.get(column).copied().unwrap_or_default();
        let utime = stamp_utime(field(self.timestamp))?;
        let Some(column) = self.frame else { return Ok((place, utime)) };
        let frame = field(column);
        let number = frame.parse().map_err(|_| format!("\"{frame}\" is no number of a frame"))?;
        Ok((number, utime))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn utimes(text: &str) -> Vec<(u64, i64)> {
        parse_odometry(text)
            .unwrap_or_else(|e| panic!("{text:?}: {e}"))
            .utimes
            .into_iter()
            .collect()
    }

    #[test]
    fn columns_are_known_by_their_names() {
        let expected = [(5, 1_500_000), (8, 1_600_000)];
        for text in [
            "timestamp, frame, x, y, z, qx, qy, qz, qw\n1.5, 000005, 0, 0, 0, 0, 0, 0, 1\n1.6, 000008, 0, 0, 0, 0, 0, 0, 1\n",
            "Frame,x,Timestamp\n5,,1.5\n8,,1.6",
            "frame;timestamp\r\n5;1,5\r\n8;1,6\r\n",
        ] {
            assert_eq!(utimes(text), expected, "{text:?}");
        }
        assert_eq!(utimes("timestamp\n1.5\n1.6\n"), [(0, 1_500_000), (1, 1_600_000)]);
    }

    #[test]
    fn rows_without_a_frame_or_a_time_are_passed_over_and_counted() {
        let text = "timestamp, frame\n, 1\n1.5, \n1.6, 3\nlate, 4\n1.8, 5\n1.9";
        let odometry = parse_odometry(text).unwrap();
        assert_eq!(odometry.utimes, BTreeMap::from([(3, 1_600_000), (5, 1_800_000)]));
        let (rows, first) = odometry.unusable.unwrap();
        assert_eq!((odometry.first_line, rows), (4, 4));
        assert!(first.contains("line 2: \"\" is no time in seconds"), "{first}");
    }

    #[test]
    fn what_is_wrong_is_told_with_its_line() {
        for (text, told) in [
            ("", "line 1: names no column"),
            ("# made by hand\n1.5, 0, 0\n", "line 2: names no column"),
            ("timestamp, frame\n", "line 1: no row"),
            ("timestamp, frame\n1.5, first\n", "line 2: \"first\" is no number"),
            ("timestamp, frame\n1.5, 1\n1.4, 2\n", "line 3: its frame or its time"),
            ("timestamp, frame\n1.5, 2\n1.6, 2\n", "line 3: its frame or its time"),
            ("timestamp, frame\n1700000000000, 2\n", "line 2: 1700000000000 is no time in seconds"),
        ] {
            let error = parse_odometry(text).unwrap_err();
            assert!(error.contains(told), "{text:?}: {error}");
        }
    }
}
