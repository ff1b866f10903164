//! Text tables of foreign programs: lists of pictures, pose logs, CSV files.
//!
//! One reader for all of them, so that all tolerate the same: a byte order mark, UTF-16,
//! Latin-1 in comments, line ends of any system, comments that begin with `#`, `%`, `;` or
//! `//`, and fields that white space, commas or semicolons separate.

use std::io::{self, Read};
use std::path::Path;

/// Largest text that is read, bytes: a list of some days of frames.
pub const MAX_TEXT_BYTES: u64 = 256 << 20;

/// Largest file of settings that is read, bytes; the longest of ours has some 10 000.
pub const MAX_SETTINGS_BYTES: u64 = 1 << 20;

/// Reads a whole text file in any of the encodings that [`decode`] knows.
///
/// # Errors
/// Those of reading; [`io::ErrorKind::InvalidInput`] for what is no regular file (a folder, a
/// pipe, a device), [`io::ErrorKind::InvalidData`] for one above [`MAX_TEXT_BYTES`].
pub fn read(path: &Path) -> io::Result<String> {
    Ok(decode(&read_up_to(MAX_TEXT_BYTES, regular_file(path)?)?))
}

/// Reads a file of settings, or a pipe, in any of the encodings that [`decode`] knows.
///
/// # Errors
/// Those of reading; [`io::ErrorKind::InvalidData`] for one above [`MAX_SETTINGS_BYTES`].
pub fn read_settings(path: &Path) -> io::Result<String> {
    Ok(decode(&read_up_to(MAX_SETTINGS_BYTES, std::fs::File::open(path)?)?))
}

/// Reads everything, but no more than what fits: a device may never end.
///
/// # Errors
/// Those of reading; [`io::ErrorKind::InvalidData`] for more than `limit` bytes.
pub fn read_up_to(limit: u64, from: impl Read) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    from.take(limit + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit {
        let reason = format!("is larger than {limit} bytes: is it the right file?");
        return Err(io::Error::new(io::ErrorKind::InvalidData, reason));
    }
    Ok(bytes)
}

/// Opens a regular file. Opening a pipe would wait for its writer, and a device may never end.
///
/// # Errors
/// Those of opening; [`io::ErrorKind::InvalidInput`] for what is no regular file.
pub fn regular_file(path: &Path) -> io::Result<std::fs::File> {
    if std::fs::metadata(path)?.is_file() {
        return std::fs::File::open(path);
    }
    Err(io::Error::new(io::ErrorKind::InvalidInput, "is no regular file"))
}

/// Text of bytes: UTF-8 or UTF-16 with a byte order mark, else UTF-8, else Latin-1. The mark
/// itself is left out.
pub fn decode(bytes: &[u8]) -> String {
    let utf_16 = |rest: &[u8], order: fn([u8; 2]) -> u16| {
        let units: Vec<u16> = rest.chunks_exact(2).map(|b| order([b[0], b[1]])).collect();
        String::from_utf16_lossy(&units)
    };
    match bytes {
        [0xef, 0xbb, 0xbf, rest @ ..] => utf_8_or_latin_1(rest),
        [0xff, 0xfe, rest @ ..] => utf_16(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => utf_16(rest, u16::from_be_bytes),
        _ => utf_8_or_latin_1(bytes),
    }
}

fn utf_8_or_latin_1(bytes: &[u8]) -> String {
    // Latin-1's 256 characters are Unicode's first.
    std::str::from_utf8(bytes)
        .map_or_else(|_| bytes.iter().map(|&b| char::from(b)).collect(), str::to_owned)
}

/// Rows of a text that hold something: neither empty nor a comment.
pub fn rows(text: &str) -> impl Iterator<Item = Row<'_>> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut number = 0;
    let mut before = None;
    // A lone carriage return ends a line too; "\r\n" ends one, not two.
    let lines = text.split(move |c| {
        let ends = c == '\n' && before != Some('\r') || c == '\r';
        before = Some(c);
        ends
    });
    lines.filter_map(move |line| {
        number += 1;
        let text = line.trim();
        let is_comment = text.starts_with(['#', '%', ';']) || text.starts_with("//");
        (!text.is_empty() && !is_comment).then_some(Row { number, text })
    })
}

/// A row of a text table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Row<'t> {
    /// Number of the line in the file, from 1.
    pub number: usize,
    /// The line without white space around it.
    pub text: &'t str,
}

impl<'t> Row<'t> {
    /// All fields, without the white space and the double quotes around them. A comment behind
    /// them (`#` or `%`) is left out. An empty field between two commas or semicolons stays, so
    /// that those behind it keep their columns; a separator at the end of the row adds none.
    pub fn fields(&self) -> Vec<&'t str> {
        let text = self.text.split(['#', '%']).next().unwrap_or_default().trim();
        let separator = separator(text);
        let mut fields: Vec<&str> = match separator {
            Some(c) => text.split(c).flat_map(inner_fields).collect(),
            None => text.split_whitespace().collect(),
        };
        if separator.is_some() && fields.last() == Some(&"") {
            fields.pop();
        }
        fields.into_iter().map(unquoted).collect()
    }

    /// All fields as finite numbers. A comma inside a field is a decimal comma, which is
    /// possible where semicolons or white space alone separate the fields.
    ///
    /// # Errors
    /// Names the field that is none.
    pub fn numbers(&self) -> Result<Vec<f64>, String> {
        self.fields()
            .into_iter()
            .map(|field| {
                number(field).ok_or_else(|| {
                    format!("\"{field}\" is no finite number; remove or repair the line")
                })
            })
            .collect()
    }

    /// The first field, and the rest of the row as it is except for quotes around it: a name may
    /// hold spaces, commas and comment signs, see [`possible_names`]. `None` where nothing follows
    /// the first field, which may be a number with a decimal comma.
    pub fn split_first(&self) -> Option<(&'t str, &'t str)> {
        let before_space = self.text.find(|c: char| c.is_whitespace() || c == ';');
        let is_number = |end: &usize| number(unquoted(&self.text[..*end])).is_some();
        let end = before_space.filter(is_number).or_else(|| self.text.find(is_separator))?;
        let (first, rest) = self.text.split_at(end);
        let rest = unquoted(rest.trim_start_matches(is_separator));
        (!rest.is_empty()).then(|| (unquoted(first), rest))
    }

    /// True for a row of names, as a table's first row may be: its first field begins with a
    /// letter and is no number.
    pub fn is_header(&self) -> bool {
        let first = self.fields().first().copied().unwrap_or_default();
        first.starts_with(|c: char| c.is_alphabetic() || c == '_') && first.parse::<f64>().is_err()
    }
}

/// What the rest of a row may name, the likeliest first: all of it, or what is left without
/// separators at its end and without a comment (`#` or `%`). A name may hold all of these: the one
/// that there is counts.
pub fn possible_names(rest: &str) -> Vec<&str> {
    let comments = || rest.match_indices(['#', '%']).map(|(start, _)| start);
    let stands_apart = |start: &usize| rest[..*start].ends_with(is_separator);
    let ends = [Some(rest.len()), comments().find(stands_apart), comments().next()];
    let cut = ends.into_iter().flatten().map(|end| &rest[..end]);
    let cut = cut.map(|name| unquoted(name.trim_end_matches(is_separator)));
    let mut names: Vec<&str> = std::iter::once(rest).chain(cut).collect();
    names.retain(|name| !name.is_empty());
    names.dedup();
    names
}

fn is_separator(c: char) -> bool {
    c.is_whitespace() || c == ',' || c == ';'
}

/// What separates the fields of a row besides white space.
fn separator(row: &str) -> Option<char> {
    if row.contains(';') {
        return Some(';');
    }
    (row.contains(',') && !has_decimal_commas(row)).then_some(',')
}

/// White space separates several fields, and each comma stands inside a number: "1,5 2,25",
/// "1,5 rgb/a.png".
fn has_decimal_commas(row: &str) -> bool {
    let fields: Vec<&str> = row.split_whitespace().collect();
    let mut with_comma = fields.iter().filter(|field| field.contains(','));
    fields.len() > 1 && with_comma.all(|field| number(field).is_some())
}

/// Fields within a separated field that white space separates, as in "1, 2 3"; an empty one
/// stays.
fn inner_fields(part: &str) -> Vec<&str> {
    let part = part.trim();
    if part.is_empty() || part.starts_with('"') {
        return vec![part];
    }
    part.split_whitespace().collect()
}

fn unquoted(field: &str) -> &str {
    let field = field.trim();
    field.strip_prefix('"').and_then(|f| f.strip_suffix('"')).unwrap_or(field)
}

/// A finite number, with a decimal point or a decimal comma.
pub fn number(field: &str) -> Option<f64> {
    let parsed = match field.split_once(',') {
        None => field.parse(),
        Some((whole, fraction))
            if !whole.contains('.') && fraction.starts_with(|c: char| c.is_ascii_digit()) =>
        {
            format!("{whole}.{fraction}").parse()
        }
        Some(_) => return None,
    };
    parsed.ok().filter(|x: &f64| x.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn table(text: &str) -> Vec<Vec<f64>> {
        rows(text).map(|row| row.numbers().unwrap()).collect()
    }

    #[test]
    fn what_never_ends_is_refused() {
        let refused = read_settings(Path::new("/dev/zero")).unwrap_err();
        assert_eq!(refused.kind(), io::ErrorKind::InvalidData);
        assert_eq!(read_up_to(3, &b"abc"[..]).unwrap(), b"abc");
        assert!(read_up_to(3, &b"abcd"[..]).is_err());
    }

    const EXPECTED: [[f64; 3]; 2] = [[0.5, -1.0, 2.0], [0.25, 3.0, 4.5]];

    #[test]
    fn the_separators_of_all_programs_give_the_same_numbers() {
        for text in [
            "0.5 -1 2\n0.25 3 4.5\n",
            "0.5\t-1\t2\n0.25\t3\t4.5",
            "0.5,-1,2\n0.25,3,4.5\n",
            "0.5, -1, 2,\n0.25, 3, 4.5,\n",
            "0.5;-1;2\n0.25;3;4.5;\n",
            "0,5;-1;2\n0,25;3;4,5\n",
            "0,5 -1,0 2\n0,25 3 4,5\n",
            "\"0.5\",\"-1\",\"2\"\n\"0.25\",\"3\",\"4.5\"\n",
            "0.5 , -1 2\r\n0.25 , 3 4.5\r\n",
        ] {
            assert_eq!(table(text), EXPECTED, "{text:?}");
        }
    }

    #[test]
    fn comments_of_all_programs_are_passed_over() {
        let text = "# x y z\n% x y z\n; x y z\n// x y z\n\n0.5 -1 2 # first\n  0.25 3 4.5 % next\n";
        assert_eq!(table(text), EXPECTED);
        assert_eq!(rows(text).map(|row| row.number).collect::<Vec<_>>(), [6, 7]);
    }

    #[test]
    fn the_line_ends_of_all_systems_count_the_same() {
        for end in ["\n", "\r\n", "\r"] {
            let text = ["# a comment", "0.5 -1 2", "", "0.25 3 4.5", ""].join(end);
            assert_eq!(table(&text), EXPECTED, "{end:?}");
            assert_eq!(rows(&text).map(|row| row.number).collect::<Vec<_>>(), [2, 4], "{end:?}");
        }
    }

    #[test]
    fn a_text_in_any_encoding_is_read() {
        let text = "# caf\u{e9} \u{b0}\n0.5 -1 2\n0.25 3 4.5\n";
        let latin_1: Vec<u8> = text.chars().map(|c| c as u8).collect();
        let utf_16 = |order: fn(u16) -> [u8; 2]| -> Vec<u8> {
            "\u{feff}".encode_utf16().chain(text.encode_utf16()).flat_map(order).collect()
        };
        for bytes in [
            text.as_bytes().to_vec(),
            [b"\xef\xbb\xbf", text.as_bytes()].concat(),
            [&b"\xef\xbb\xbf"[..], &latin_1].concat(),
            latin_1,
            utf_16(u16::to_le_bytes),
            utf_16(u16::to_be_bytes),
        ] {
            assert_eq!(table(&decode(&bytes)), EXPECTED);
        }
    }

    #[test]
    fn an_empty_field_keeps_its_column() {
        for text in ["1,,3", "1;;3", "1, ,3"] {
            let row = rows(text).next().unwrap();
            assert_eq!(row.fields(), ["1", "", "3"], "{text}");
            assert!(row.numbers().unwrap_err().contains("\"\""));
        }
    }

    #[test]
    fn a_name_may_hold_what_separates_fields() {
        let name = |text| rows(text).next().unwrap().split_first();
        assert_eq!(name("1.5 rgb/a b,c#1;2.png"), Some(("1.5", "rgb/a b,c#1;2.png")));
        assert_eq!(name("1.5, \"rgb/a b.png\""), Some(("1.5", "rgb/a b.png")));
        assert_eq!(name("1.5;rgb/a.png"), Some(("1.5", "rgb/a.png")));
        assert_eq!((name("1.5"), name("1.5 \"\"")), (None, None));
        assert_eq!(name("1,5;rgb/a.png"), Some(("1,5", "rgb/a.png")));
        assert_eq!(name("1,5 rgb/a.png"), Some(("1,5", "rgb/a.png")));
        assert_eq!(name("1,rgb/a b.png"), Some(("1", "rgb/a b.png")));
    }

    #[test]
    fn a_name_is_sought_as_it_is_written_before_anything_is_cut_off() {
        for (rest, names) in [
            ("a.png", &["a.png"][..]),
            ("a.png,", &["a.png,", "a.png"]),
            ("a#1.png, # c", &["a#1.png, # c", "a#1.png", "a"]),
            ("\"a b.png\"; % c", &["\"a b.png\"; % c", "a b.png"]),
            ("# c", &["# c"]),
        ] {
            assert_eq!(possible_names(rest), names, "{rest}");
        }
    }

    #[test]
    fn a_header_is_told_from_numbers() {
        let is_header = |text| rows(text).next().unwrap().is_header();
        assert!(is_header("timestamp filename") && is_header("\"x\",y") && is_header("t [s];x"));
        assert!(!is_header("1.5 rgb/a.png") && !is_header("nan 1 2") && !is_header("-1,2"));
    }

    #[test]
    fn what_is_no_regular_file_is_refused_by_its_kind() {
        let error = read(Path::new("/dev/zero")).unwrap_err();
        assert!(error.to_string().contains("no regular file"), "{error}");
        let dir = tempfile::tempdir().unwrap();
        assert!(read(dir.path()).unwrap_err().to_string().contains("no regular file"));
    }

    proptest! {
        #[test]
        fn no_bytes_make_the_reader_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            for row in rows(&decode(&bytes)) {
                let _ = (row.fields(), row.numbers(), row.split_first(), row.is_header());
                let _ = possible_names(row.text);
            }
        }

        #[test]
        fn numbers_come_back(values in proptest::collection::vec(-1e6..1e6_f64, 1..9)) {
            for separator in [" ", "\t", ",", ";", ", "] {
                let text = values.iter().map(f64::to_string).collect::<Vec<_>>().join(separator);
                prop_assert_eq!(&rows(&text).next().unwrap().numbers().unwrap(), &values);
            }
        }
    }
}
