//! Text of files and networks that is shown to people.
//!
//! In: any text. Out: one line that does nothing to a terminal, and reads in the order in which it
//! is written.

/// What is not shown but does something: control characters, ends of lines and paragraphs, what
/// turns the direction of reading, and what makes two names look the same: soft hyphens, spaces and marks
/// of no width, tags. Joiners and selectors of variants are allowed: words of many languages need them.
pub fn is_control(c: char) -> bool {
    let turns_direction = matches!(
        c,
        '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}'
    );
    let is_filler = matches!(c, '\u{115f}' | '\u{1160}' | '\u{3164}' | '\u{ffa0}');
    let is_mark_of_format = matches!(
        c,
        '\u{ad}' | '\u{34f}' | '\u{180e}' | '\u{200b}' | '\u{2060}'..='\u{2064}' | '\u{206a}'..='\u{206f}' | '\u{feff}'
    );
    let is_tag = matches!(c, '\u{e0000}'..='\u{e007f}');
    let is_invisible = is_filler || is_mark_of_format || is_tag;
    c.is_control() || matches!(c, '\u{2028}' | '\u{2029}') || turns_direction || is_invisible
}

/// A text whose control characters are written as their escapes; one of more than `most` bytes is
/// cut, which an ellipsis tells.
pub fn harmless(text: &str, most: usize) -> String {
    let mut out = String::new();
    for c in text.chars() {
        if out.len() >= most {
            out.push('…');
            break;
        }
        match is_control(c) {
            true => out.extend(c.escape_default()),
            false => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_acts_on_a_terminal_is_written_as_its_escape() {
        let acts = "a\u{1b}[31m\r\n\0\u{9b}\u{202e}\u{2066}\u{2028}z";
        let shown = harmless(acts, 100);
        assert!(!shown.contains(is_control), "{shown}");
        assert_eq!(shown, r"a\u{1b}[31m\r\n\u{0}\u{9b}\u{202e}\u{2066}\u{2028}z");
    }

    #[test]
    fn what_cannot_be_seen_is_a_control_character() {
        let fillers = "\u{115f}\u{1160}\u{3164}\u{ffa0}";
        let marks = "\u{ad}\u{34f}\u{180e}\u{200b}\u{2060}\u{2064}\u{206a}\u{feff}";
        let tags = "\u{e0000}\u{e0041}\u{e007f}";
        assert!([fillers, marks, tags].concat().chars().all(is_control));
        assert_eq!(harmless("fri\u{200b}dge", 100), r"fri\u{200b}dge");
        assert!(!"\u{a0}\u{2010}\u{200a}\u{200c}\u{200d}\u{fe0f}\u{e0100}".contains(is_control));
    }

    #[test]
    fn words_of_any_language_stay_as_they_are_and_long_ones_are_cut() {
        for text in ["tiroir n° 2", "抽屉", "درج", "ดลิ้นชัก", "𝕏"] {
            assert_eq!(harmless(text, 100), text);
        }
        assert_eq!(harmless(&"x".repeat(1000), 10), format!("{}…", "x".repeat(10)));
    }
}
