//! Counts with their nouns, for messages.

use std::fmt::Display;

/// A count with its noun, given in the singular: `1 pair`, `2 pairs`, `2 batches`, `2 bodies`.
pub fn counted(count: impl Display, noun: &str) -> String {
    let count = count.to_string();
    match noun.strip_suffix('y') {
        _ if count == "1" => format!("{count} {noun}"),
        Some(stem) => format!("{count} {stem}ies"),
        None if noun.ends_with("ch") => format!("{count} {noun}es"),
        None => format!("{count} {noun}s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches "1 pairs" and "0 pair".
    #[test]
    fn one_is_singular() {
        let counts: Vec<String> = (0..3).map(|count| counted(count, "pair")).collect();
        assert_eq!(counts, ["0 pairs", "1 pair", "2 pairs"]);
        assert_eq!((counted(1, "body"), counted(2, "body")), ("1 body".into(), "2 bodies".into()));
        assert_eq!((counted(1, "batch"), counted(2, "batch")), ("1 batch".into(), "2 batches".into()));
    }
}
