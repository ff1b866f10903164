//! Logs of one moving part's poses: a line a sample, metres.
//!
//! A file with a row of names is read by them. Without names it holds `x y z`,
//! `x y z qx qy qz qw`, either with `width height` behind it (a tracked rectangle), or TUM's
//! `t x y z qx qy qz qw`. A line without a pose (`nan`, nothing between two separators) is a
//! sample that the tracker lost: it is left out and counted.

use super::columns::{Columns, TimeColumn, has_words, how_to_name};
use super::fit::FitError;
use super::pose_sample::PoseSample;
use super::table::{Row, Value, decoded, rows};
use linkage_frames::text_table::{MAX_TEXT_BYTES, read_up_to};
use nalgebra::{Point3, Quaternion, UnitQuaternion};
use std::fs::File;
use std::path::Path;

/// Largest deviation of a quaternion's length from 1: numbers are written with few digits.
const QUATERNION_TOLERANCE: f64 = 0.05;

/// A log that cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PoseLogError {
    /// The file cannot be read.
    #[error("{path}: cannot be read")]
    Read {
        /// The log.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// A line that is no sample.
    #[error("{path}: line {line}: {reason}")]
    Line {
        /// The log.
        path: String,
        /// Number of the line, from 1.
        line: usize,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// No joint can be fitted to it.
    #[error("{path}: {source}{}", .lost.as_ref().map_or_else(String::new, |l| format!("; {l}")))]
    Fit {
        /// The log.
        path: String,
        /// Why.
        source: FitError,
        /// What [`PoseLog::describe_lost`] says.
        lost: Option<String>,
    },
}

/// What a log holds.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseLog {
    /// Its poses.
    pub samples: Vec<PoseSample>,
    /// Lines that hold no pose.
    pub lost: Vec<LostLine>,
}

/// A line in which the tracker had no pose.
#[derive(Debug, Clone, PartialEq)]
pub struct LostLine {
    /// Number of the line, from 1.
    pub line: usize,
    /// What stands there instead of a number.
    pub word: String,
}

impl PoseLog {
    /// How many lines hold no pose, for people; `None` where all do.
    pub fn describe_lost(&self) -> Option<String> {
        let first = self.lost.first()?;
        let (count, line, word) = (self.lost.len(), first.line, &first.word);
        Some(match count {
            1 => format!("1 line without a pose was left out (line {line}: \"{word}\")"),
            n => format!(
                "{n} lines without a pose were left out (the first: line {line}: \"{word}\")"
            ),
        })
    }
}

/// Reads a pose log; `columns` say what its columns hold, else its names or their number do.
///
/// # Errors
/// [`PoseLogError`] names the file and the line: columns that cannot be told, unreadable
/// numbers, a changing number of columns, a quaternion whose length is not 1, time running
/// backwards.
pub fn read_pose_log(path: &Path, columns: Option<&Columns>) -> Result<PoseLog, PoseLogError> {
    let name = path.display().to_string();
    let bytes = File::open(path)
        .and_then(|file| read_up_to(MAX_TEXT_BYTES, file))
        .map_err(|source| PoseLogError::Read { path: name.clone(), source })?;
    parse_pose_log(&name, &bytes, columns)
}

/// As [`read_pose_log`], of a file's bytes; `name` is what errors call it.
///
/// # Errors
/// As [`read_pose_log`].
pub fn parse_pose_log(
    name: &str,
    bytes: &[u8],
    columns: Option<&Columns>,
) -> Result<PoseLog, PoseLogError> {
    let fail =
        |line: usize, reason: String| PoseLogError::Line { path: name.to_owned(), line, reason };
    let text = decoded(bytes);
    let rows: Vec<Row> = rows(&text).collect();
    let (columns, first) = told_columns(&rows, columns).map_err(|(line, why)| fail(line, why))?;
    let mut log = PoseLog { samples: Vec::new(), lost: Vec::new() };
    let data = rows[first..].iter().filter(|r| !r.is_comment);
    for (number, row) in data.enumerate() {
        match sample_of(row, number, &columns).map_err(|why| fail(row.line, why))? {
            Err(word) => log.lost.push(LostLine { line: row.line, word }),
            Ok(sample) => {
                if let Some(before) = log.samples.last()
                    && sample.t <= before.t
                {
                    let why = format!("time runs backwards ({} after {})", sample.t, before.t);
                    return Err(fail(row.line, why));
                }
                log.samples.push(sample);
            }
        }
    }
    Ok(log)
}

/// The columns of a file, and its first row of data. The error carries its line.
fn told_columns(
    rows: &[Row],
    given: Option<&Columns>,
) -> Result<(Columns, usize), (usize, String)> {
    let Some(first) = rows.iter().position(|r| !r.is_comment) else {
        return Err((1, "the file holds no sample".to_owned()));
    };
    let named = has_words(&rows[first].fields);
    if let Some(columns) = given {
        // Names in the file are passed over where they are given; so are words in columns that
        // are not used.
        let is_header = named && sample_of(&rows[first], 0, columns).is_err();
        return Ok((columns.clone(), first + usize::from(is_header)));
    }
    if named {
        return header(&rows[first], rows.get(first + 1..).unwrap_or_default())
            .map(|columns| (columns, first + 1));
    }
    let count = rows[first].len_without_end();
    // Many programs write the names as a comment.
    let commented = rows[..first].iter().rev().find(|r| {
        let names = names_of(r);
        names.len() == count && Columns::are_named_by(&names)
    });
    let columns = match commented {
        Some(row) => {
            Columns::from_names(&names_of(row)).map_err(|why| (row.line, unclear(&why, count)))?
        }
        None => by_count(count, &rows[first..]).map_err(|why| (rows[first].line, why))?,
    };
    Ok((columns, first))
}

fn header(row: &Row, data: &[Row]) -> Result<Columns, (usize, String)> {
    let names = names_of(row);
    if !Columns::are_named_by(&names) && data.is_empty() {
        return Err((row.line, not_a_number(row)));
    }
    let columns = Columns::from_names(&names).map_err(|why| {
        let is_header =
            names.iter().filter(|n| Value::of(n) == Value::Word).count() * 2 > names.len();
        let why = if is_header { unclear(&why, names.len()) } else { not_a_number(row) };
        (row.line, why)
    })?;
    Ok(columns)
}

fn unclear(why: &str, count: usize) -> String {
    format!("this line names the columns, but {why}; {}", how_to_name(count))
}

fn not_a_number(row: &Row) -> String {
    let word = row.fields.iter().find(|f| Value::of(f) == Value::Word);
    let word = word.map_or("", |w| w.as_ref());
    format!("\"{word}\" is no finite number; remove or repair the line")
}

/// The names in a row; a unit that stands alone belongs to the name before it.
fn names_of<'r>(row: &'r Row) -> Vec<&'r str> {
    let names = row.fields.iter().map(|f| f.as_ref());
    names.filter(|n| !n.is_empty() && !n.starts_with(['[', '('])).collect()
}

/// Columns by their number. Nine without names are a pose and a rectangle, unless the last four
/// may as well be a rotation: then they are asked for.
fn by_count(count: usize, data: &[Row]) -> Result<Columns, String> {
    let columns = Columns::from_count(count)?;
    let length = |row: &Row, first: usize| {
        let number = |f: &str| match Value::of(f) {
            Value::Number(x) => Some(x),
            _ => None,
        };
        let squares = (first..first + 4).map(|i| Some(number(row.fields.get(i)?)?.powi(2)));
        Some(squares.sum::<Option<f64>>()?.sqrt())
    };
    let mut lengths =
        data.iter().filter(|r| !r.is_comment).filter_map(|r| length(r, count.checked_sub(4)?));
    if count == 9 && lengths.all(is_unit) {
        return Err(format!(
            "9 columns without names, of which the last four may be qx qy qz qw; {}",
            how_to_name(count)
        ));
    }
    Ok(columns)
}

fn is_unit(length: f64) -> bool {
    (length - 1.0).abs() <= QUATERNION_TOLERANCE
}

/// The sample of a row. Within it, `Err` is what stands where a lost pose would.
fn sample_of(
    row: &Row,
    number: usize,
    columns: &Columns,
) -> Result<Result<PoseSample, String>, String> {
    if !row.has(columns.count) {
        let found = row.len_without_end();
        return Err(format!("{found} columns, where {} are expected", columns.count));
    }
    let mut lost: Option<&str> = None;
    let mut value = |index: usize| match Value::of(&row.fields[index]) {
        Value::Number(x) => Ok(x),
        Value::Missing => {
            lost.get_or_insert(&row.fields[index]);
            Ok(f64::NAN)
        }
        Value::Word => {
            let word = &row.fields[index];
            Err(format!("\"{word}\" is no finite number; remove or repair the line"))
        }
    };
    let t = match columns.time {
        None => number as f64,
        Some(time) => time_of(&time, &mut value)?,
    };
    let mut position = Point3::origin();
    for (to, (index, scale)) in position.coords.iter_mut().zip(columns.position) {
        *to = value(index)? * scale;
    }
    let mut turn = [0.0, 0.0, 0.0, 1.0];
    for (to, index) in turn.iter_mut().zip(columns.orientation.iter().flatten()) {
        *to = value(*index)?;
    }
    if let Some(word) = lost {
        return Ok(Err(word.to_owned()));
    }
    let q = Quaternion::new(turn[3], turn[0], turn[1], turn[2]);
    if !is_unit(q.norm()) {
        return Err(format!(
            "the quaternion has the length {:.3}, not 1; the columns were read as {}. Repair the \
             line, or name the columns with --columns",
            q.norm(),
            columns.names()
        ));
    }
    let orientation = columns.orientation.map(|_| UnitQuaternion::from_quaternion(q));
    Ok(Ok(PoseSample { t, position, orientation }))
}

/// Seconds. Where no unit is named, the size of a number tells it: seconds since 1970 have ten
/// digits, milliseconds thirteen, microseconds sixteen, nanoseconds nineteen.
fn time_of(
    time: &TimeColumn,
    value: &mut impl FnMut(usize) -> Result<f64, String>,
) -> Result<f64, String> {
    let stamp = value(time.index)?;
    let scale = time.scale.unwrap_or(match stamp.abs() {
        t if t >= 1e17 => 1e-9,
        t if t >= 1e14 => 1e-6,
        t if t >= 1e11 => 1e-3,
        _ => 1.0,
    });
    let nanoseconds = time.nanoseconds.map(&mut *value).transpose()?.unwrap_or(0.0);
    Ok(stamp * scale + nanoseconds * 1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<PoseLog, PoseLogError> {
        parse_pose_log("door.log", text.as_bytes(), None)
    }

    fn refusal(text: &str) -> String {
        read(text).unwrap_err().to_string()
    }

    #[test]
    fn a_lost_sample_is_left_out_and_counted() {
        let log = read("0 0 0\n0.1 nan 0\n0.2 0 0\n,,\n0.4 0 0").unwrap();
        assert_eq!(log.samples.len(), 3);
        assert_eq!(log.samples[2].t, 4.0, "lost samples keep their place in time");
        let said = log.describe_lost().unwrap();
        assert!(said.contains("2 lines") && said.contains("line 2: \"nan\""), "{said}");
    }

    #[test]
    fn tum_lines_carry_their_time() {
        let samples = read("1.5 1 2 3 0 0 0 1\n1.6 1 2 3 0 0 0 1\n").unwrap().samples;
        assert_eq!(samples[1].t, 1.6);
        assert_eq!(samples[1].position, Point3::new(1.0, 2.0, 3.0));
    }

    #[test]
    fn time_running_backwards_is_refused() {
        let message = refusal("2 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n");
        assert!(message.contains("backwards"), "{message}");
    }

    #[test]
    fn the_same_log_is_read_alike_in_every_dress() {
        let plain = read("1.5 1 2 3 0 0 0.6 0.8\n1.6 1.1 2 3 0 0 0.6 0.8\n").unwrap();
        for text in [
            "\u{feff}1.5,1,2,3,0,0,0.6,0.8\r\n1.6,1.1,2,3,0,0,0.6,0.8\r\n",
            "timestamp,x,y,z,qx,qy,qz,qw\n1.5,1,2,3,0,0,0.6,0.8\n1.6,1.1,2,3,0,0,0.6,0.8\n",
            "# timestamp tx ty tz qx qy qz qw\n1.5 1 2 3 0 0 0.6 0.8\n1.6 1.1 2 3 0 0 0.6 0.8",
            "% of the door\nqw;qx;qy;qz;t;x;y;z\n0,8;0;0;0,6;1,5;1;2;3\n0,8;0;0;0,6;1,6;1,1;2;3\n",
            "#num,t,x,y,z,qx,qy,qz,qw\n0,1.5,1,2,3,0,0,0.6,0.8,\n1,1.6,1.1,2,3,0,0,0.6,0.8,\n",
            "frame\tt\tx\ty\tz\tqx\tqy\tqz\tqw\nmap\t1.5\t1\t2\t3\t0\t0\t0.6\t0.8\nmap\t1.6\t1.1\t2\t3\t0\t0\t0.6\t0.8\n",
            "time_ms,x_mm,y_mm,z_mm,qx,qy,qz,qw\n1500,1000,2000,3000,0,0,0.6,0.8\n1600,1100,2000,3000,0,0,0.6,0.8\n",
        ] {
            let log = read(text).unwrap();
            assert_eq!(log.samples.len(), 2, "{text}");
            for (a, b) in log.samples.iter().zip(&plain.samples) {
                assert!((a.t - b.t).abs() < 1e-9, "{text}");
                assert!((a.position - b.position).norm() < 1e-12, "{text}");
                assert_eq!(a.orientation, b.orientation, "{text}");
            }
        }
    }

    #[test]
    fn stamps_since_1970_are_read_whatever_their_unit() {
        for (first, second) in [
            ("1300000000.5", "1300000000.6"),
            ("1300000000500", "1300000000600"),
            ("1300000000500000", "1300000000600000"),
            ("1300000000500000000", "1300000000600000000"),
        ] {
            let text = format!("{first} 1 2 3 0 0 0 1\n{second} 1 2 3 0 0 0 1\n");
            let samples = read(&text).unwrap().samples;
            assert!((samples[0].t - 1_300_000_000.5).abs() < 1e-5, "{first}");
            assert!((samples[1].t - samples[0].t - 0.1).abs() < 1e-5, "{first}");
        }
    }

    #[test]
    fn a_quaternion_whose_length_is_not_one_is_refused_with_its_line() {
        for q in ["0 0 0 0", "0 0 0.5 0.5", "0 0 1 1", "0 0 0 100"] {
            let message = refusal(&format!("1 2 3 0 0 0 1\n1 2 3 {q}\n"));
            assert!(message.contains("line 2") && message.contains("length"), "{message}");
        }
        assert_eq!(read("1 2 3 0 0 0.71 0.71\n").unwrap().samples.len(), 1);
    }

    #[test]
    fn columns_that_cannot_be_told_are_asked_for() {
        for text in [
            // A row number, a time and a pose; a rectangle and a rotation at once; a timed place.
            "0 0.0 0.9 0.1 1.4 0 0 0 1\n1 0.1 0.9 0.1 1.4 0 0 0 1\n",
            "0 0.0 0.0 0.0 1.0 0 0 0 1\n1 0.1 0.0 0.0 1.0 0 0 0 1\n",
            "0.1 1 2 3\n",
            "t,x,y,z,x,y,z\n0,1,2,3,4,5,6\n",
            "t,x,y,depth\n0,1,2,3\n",
        ] {
            assert!(refusal(text).contains("--columns"), "{}", refusal(text));
        }
        let columns: Columns = "_,t,x,y,z,qx,qy,qz,qw".parse().unwrap();
        let text = b"num,s,a,b,c,d,e,f,g\n0 0.5 0.9 0.1 1.4 0 0 0 1\n";
        let log = parse_pose_log("numbered.log", text, Some(&columns)).unwrap();
        assert_eq!(log.samples[0].t, 0.5);
        assert_eq!(log.samples[0].position.z, 1.4);
    }

    #[test]
    fn a_word_among_numbers_is_refused_with_its_line() {
        for text in ["1 2 3\n1 two 3\n", "1 two 3\n1 2 3\n"] {
            let message = refusal(text);
            assert!(message.contains("\"two\"") && message.contains("line "), "{message}");
        }
        assert!(refusal("1 2 3\n1 2\n").contains("line 2: 2 columns"));
        assert!(refusal("# nothing\n").contains("no sample"));
    }

    proptest::proptest! {
        #[test]
        fn no_bytes_make_the_parser_panic(bytes: Vec<u8>, text in "[-0-9a-z.,;%#\t \n\\[\\]]{0,200}") {
            let _ = parse_pose_log("any", &bytes, None);
            let _ = parse_pose_log("any", text.as_bytes(), None);
        }
    }
}
