//! Which channels are wanted, and how large their messages may be.

use regex::{Regex, RegexBuilder};

/// Largest compiled regular expression, bytes.
const MAX_COMPILED: usize = 1 << 20;

/// Regular expressions of channels, each with the size that a message of it may have.
#[derive(Debug, Clone, Default)]
pub struct Subscriptions {
    wanted: Vec<(Regex, usize)>,
}

impl Subscriptions {
    /// Adds the channels that match a regular expression as a whole, with messages of at most
    /// `max_bytes`.
    ///
    /// # Errors
    /// [`regex::Error`] for an expression that is not valid, or too large.
    pub fn add(&mut self, channel: &str, max_bytes: usize) -> Result<(), regex::Error> {
        let compiled = |text: &str| RegexBuilder::new(text).size_limit(MAX_COMPILED).build();
        // Alone first: an expression with a loose parenthesis must not become a sound one.
        compiled(channel)?;
        let expression = compiled(&format!("^(?:{channel})$"))?;
        self.wanted.push((expression, max_bytes));
        Ok(())
    }

    /// How large a message of a channel may be, bytes; `None` when nobody wants it.
    pub fn limit_of(&self, channel: &str) -> Option<usize> {
        self.wanted.iter().filter(|(wanted, _)| wanted.is_match(channel)).map(|(_, l)| *l).max()
    }

    /// The size that no wanted message exceeds, bytes.
    pub fn largest_limit(&self) -> usize {
        self.wanted.iter().map(|(_, limit)| *limit).max().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_channel_matches_as_a_whole() {
        let mut wanted = Subscriptions::default();
        wanted.add("LINKAGE_(STATUS|PLAN)", 10).unwrap();
        wanted.add("A|B", 20).unwrap();
        wanted.add("LINKAGE_.*", 5).unwrap();
        assert_eq!(wanted.limit_of("LINKAGE_STATUS"), Some(10));
        assert_eq!(wanted.limit_of("LINKAGE_MODEL"), Some(5));
        assert_eq!(wanted.limit_of("XLINKAGE_PLAN"), None);
        assert_eq!((wanted.limit_of("B"), wanted.limit_of("AB")), (Some(20), None));
        assert_eq!(wanted.largest_limit(), 20);
    }

    #[test]
    fn an_expression_that_is_none_or_too_large_is_refused() {
        let mut wanted = Subscriptions::default();
        for wrong in ["(", "a{9999}{9999}", "[z-a]", ")|("] {
            assert!(wanted.add(wrong, 1).is_err(), "{wrong}");
        }
        assert_eq!(wanted.largest_limit(), 0);
    }
}
