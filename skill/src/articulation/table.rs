//! Rows of fields in a text file that some other program wrote.
//!
//! Fields are separated by white space, tabs, `,` or `;`. `#`, `%` and `//` begin a comment,
//! and so does `;` at the beginning of a line.
//! A byte order mark, any of the three line ends, and comments in any encoding are tolerated.

use std::borrow::Cow;

/// One line that is not empty.
#[derive(Debug, Clone, PartialEq)]
pub struct Row<'t> {
    /// Number of the line, from 1.
    pub line: usize,
    /// True where the whole line is a comment; its fields are what stands behind the mark.
    pub is_comment: bool,
    /// The fields, without white space and quotes around them.
    pub fields: Vec<Cow<'t, str>>,
}

impl Row<'_> {
    /// How many fields there are, a separator at the end of the line left out.
    pub fn len_without_end(&self) -> usize {
        let ends = self.fields.len() > 1 && self.fields.last().is_some_and(|f| f.is_empty());
        self.fields.len() - usize::from(ends)
    }

    /// True where the row has `count` fields, or as many and a separator at its end.
    pub fn has(&self, count: usize) -> bool {
        self.fields.len() == count || self.len_without_end() == count
    }
}

/// What stands in a field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// A finite number.
    Number(f64),
    /// Nothing, or what programs write where they have no number (`nan`, `inf`, `null`).
    Missing,
    /// Something else.
    Word,
}

impl Value {
    /// Reads a field.
    pub fn of(field: &str) -> Self {
        const NONE: [&str; 10] =
            ["", "-", "--", "null", "none", "na", "n/a", "-nan", "+nan", "lost"];
        let is_none = |field: &str| {
            let lower = field.to_lowercase();
            // Older C libraries write -1.#IND and 1.#QNAN, newer ones -nan(ind).
            NONE.contains(&lower.as_str()) || lower.contains(".#") || lower.contains("nan(")
        };
        match field.parse::<f64>() {
            Ok(number) if number.is_finite() => Self::Number(number),
            Ok(_) => Self::Missing,
            Err(_) if is_none(field) => Self::Missing,
            Err(_) => Self::Word,
        }
    }
}

/// The text of a file: UTF-16 where its byte order mark says so, else UTF-8. Bytes that are no
/// UTF-8 (a comment in Latin-1) become replacement characters. Line ends become `\n`.
pub fn decoded(bytes: &[u8]) -> String {
    let wide = |to_unit: fn([u8; 2]) -> u16| {
        let units: Vec<u16> =
            bytes[2..].chunks_exact(2).map(|pair| to_unit([pair[0], pair[1]])).collect();
        String::from_utf16_lossy(&units)
    };
    let text = match bytes {
        [0xff, 0xfe, ..] => wide(u16::from_le_bytes),
        [0xfe, 0xff, ..] => wide(u16::from_be_bytes),
        [0xef, 0xbb, 0xbf, rest @ ..] => String::from_utf8_lossy(rest).into_owned(),
        _ => String::from_utf8_lossy(bytes).into_owned(),
    };
    text.replace("\r\n", "\n").replace('\r', "\n")
}

/// All rows of a [`decoded`] text.
pub fn rows(text: &str) -> impl Iterator<Item = Row<'_>> {
    text.lines().enumerate().filter_map(|(i, line)| {
        let line = trimmed(line);
        let behind_mark = ["#", "%", "//"].iter().find_map(|mark| line.strip_prefix(mark));
        let behind_mark = behind_mark.or_else(|| behind_semicolon(line));
        let content = behind_mark.unwrap_or_else(|| before_comment(line));
        let fields = split(trimmed(content.trim_start_matches(['#', '%', '/', ';'])));
        let is_comment = behind_mark.is_some();
        (!fields.is_empty()).then_some(Row { line: i + 1, is_comment, fields })
    })
}

/// What stands behind a semicolon that begins a comment. One that separates fields, the first of which is empty, has
/// others behind it.
fn behind_semicolon(line: &str) -> Option<&str> {
    line.strip_prefix(';').filter(|rest| rest.starts_with(';') || !rest.contains(';'))
}

/// The part of a line before a comment. A mark inside a field (`1.#QNAN`) begins none.
fn before_comment(line: &str) -> &str {
    let is_break = |c: char| c.is_whitespace() || c == ',' || c == ';';
    let mark = line
        .match_indices(['#', '%'])
        .find(|(at, _)| line[..*at].ends_with(is_break))
        .map_or(line.len(), |(at, _)| at);
    trimmed(&line[..mark])
}

/// A line without the white space around it. Tabs at its end stay where something stands before
/// them: they separate fields that are empty.
fn trimmed(line: &str) -> &str {
    let is_padding = |c: char| c.is_whitespace() && c != '\t';
    if line.trim().is_empty() { "" } else { line.trim_start().trim_end_matches(is_padding) }
}

/// Splits at the separator that the line uses. Decimal commas are told by a separator beside
/// them that is no comma.
fn split(line: &str) -> Vec<Cow<'_, str>> {
    if line.is_empty() {
        return Vec::new();
    }
    if line.contains(';') {
        line.split(';').flat_map(pieces).map(decimal_point).collect()
    } else if line.contains('\t') {
        let fields = line.split('\t').map(|field| field.trim().trim_end_matches(','));
        fields.flat_map(pieces).map(decimal_point).collect()
    } else if has_decimal_commas(line) {
        line.split_whitespace().map(decimal_point).collect()
    } else if line.contains(',') {
        line.split(',').flat_map(pieces).map(Cow::from).collect()
    } else {
        line.split_whitespace().map(unquoted).map(Cow::from).collect()
    }
}

/// A field, or the numbers in it where white space separates some of them.
fn pieces(field: &str) -> Vec<&str> {
    let parts: Vec<&str> = field.split_whitespace().collect();
    if parts.len() > 1 && parts.iter().all(|p| Value::of(p) != Value::Word) {
        return parts;
    }
    vec![unquoted(field.trim())]
}

fn unquoted(field: &str) -> &str {
    field.trim_matches(['"', '\'']).trim()
}

fn has_decimal_commas(line: &str) -> bool {
    let mut words = line.split_whitespace();
    let is_decimal = |word: &str| matches!(decimal_point(word), Cow::Owned(_));
    line.split_whitespace().count() > 1 && words.all(is_decimal)
}

/// `0,5` as `0.5`; all else as it is.
fn decimal_point(field: &str) -> Cow<'_, str> {
    match field.split_once(',') {
        Some((whole, part)) if !part.contains(',') => {
            let changed = format!("{whole}.{part}");
            let starts_with_digit = part.starts_with(|c: char| c.is_ascii_digit());
            let is_number = starts_with_digit && matches!(Value::of(&changed), Value::Number(_));
            if is_number { Cow::Owned(changed) } else { Cow::Borrowed(field) }
        }
        _ => Cow::Borrowed(field),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fields(line: &str) -> Vec<String> {
        rows(line).flat_map(|r| r.fields).map(Cow::into_owned).collect()
    }

    #[test]
    fn every_separator_gives_the_same_fields() {
        for line in [
            "0.5 1 -2",
            "0.5,1,-2",
            "0.5;1;-2",
            "0,5;1;-2",
            "0.5\t1\t-2",
            "0,5\t1\t-2",
            "\"0.5\",\"1\",\"-2\"",
            "0.5, 1 -2",
            "  0.5 1\t-2 # the drawer",
            "0.5,1,-2 % the drawer",
        ] {
            assert_eq!(fields(line), ["0.5", "1", "-2"], "{line}");
        }
        assert_eq!(fields("0,5 1,25 -2,0"), ["0.5", "1.25", "-2.0"]);
    }

    #[test]
    fn a_line_that_begins_with_a_comments_mark_is_a_comment() {
        for mark in ["#", "##", "%", "//", ";", ";;"] {
            let text = format!("{mark} made by a tracker\n1 2 3\n");
            let all: Vec<Row> = rows(&text).collect();
            assert_eq!((all[0].is_comment, all[1].is_comment), (true, false), "{mark}");
            assert_eq!(all[0].fields, ["made", "by", "a", "tracker"], "{mark}");
        }
        assert!(!rows(";2;3").next().unwrap().is_comment, "its first field is empty");
    }

    #[test]
    fn an_empty_field_between_others_stays() {
        assert_eq!(fields("1,,3"), ["1", "", "3"]);
        assert_eq!(fields("1,,"), ["1", "", ""]);
    }

    #[test]
    fn a_separator_at_the_end_of_the_line_is_no_field_where_none_is_due() {
        for (line, count) in
            [("1,2,", 2), ("1,2,", 3), ("1;2", 2), ("1,,", 3), ("1\t\t", 3), ("1\t2\t", 2)]
        {
            let row = rows(line).next().unwrap();
            assert!(row.has(count), "{line} {count}");
        }
        assert!(!rows("1,2").next().unwrap().has(3));
    }

    #[test]
    fn marks_of_every_encoding_and_line_end_are_told() {
        let wide = |to_bytes: fn(u16) -> [u8; 2]| -> Vec<u8> {
            "\u{feff}1 2\r\n3 4\r\n".encode_utf16().flat_map(to_bytes).collect()
        };
        for bytes in [
            b"\xef\xbb\xbf1 2\r\n3 4".to_vec(),
            b"# T\xfcr\n1 2\n3 4\n".to_vec(),
            b"1 2\r3 4\r".to_vec(),
            wide(u16::to_le_bytes),
            wide(u16::to_be_bytes),
        ] {
            let text = decoded(&bytes);
            let numbers: Vec<_> = rows(&text).filter(|r| !r.is_comment).collect();
            assert_eq!(numbers.len(), 2, "{text:?}");
            assert_eq!(numbers[1].fields, ["3", "4"]);
        }
    }

    #[test]
    fn what_stands_for_no_number_is_missing() {
        for word in ["nan", "NaN", "-nan", "inf", "-Infinity", "", "null", "N/A", "-1.#IND00"] {
            assert_eq!(Value::of(word), Value::Missing, "{word}");
        }
        assert_eq!(Value::of("1e-3"), Value::Number(1e-3));
        assert_eq!(Value::of("map"), Value::Word);
    }
}
