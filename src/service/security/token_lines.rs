//! The lines of a file of tokens.

use super::{
    reloaded::{LoadError, SettingFile},
    tokens::TokenList,
};
use crate::{budget::is_reserved_name, size::ByteSize};

/// The longest name of a token, in bytes.
const NAME_BYTES: usize = 32;

/// The longest token, in bytes: half of the limit on all headers of a call.
const TOKEN_BYTES: usize = 8 << 10;

/// The lists of tokens. An unnamed token is called by its list and its line, as in `query.3`, so no
/// line may give such a name.
const LISTS: [&str; 2] = ["query", "register"];

/// Reads a list. A line is `token` or `name: token`. A comment begins with `#` at the start of the
/// line or after white space. A token without a name is named by its list and line number.
///
/// # Errors
/// The list has no token, a line has a token that no call can send, or a line has a reserved name. The
/// text names the line.
pub(super) fn read(contents: &[(&SettingFile, Vec<u8>)], list: &str) -> Result<TokenList, LoadError> {
    let mut tokens = TokenList::default();
    for (file, bytes) in contents {
        if let Some(kind) = other_kind(bytes) {
            return Err(LoadError::new(file, format!("it is {kind}, expected one token per line")));
        }
        for (line, number) in bytes.split(|&byte| byte == b'\n').zip(1..) {
            let refused = |why: String| LoadError::new(file, format!("line {number}: {why}"));
            let line = std::str::from_utf8(line).map_err(|error| refused(error.to_string()))?;
            let Some((name, token)) = parts(line).map_err(refused)? else { continue };
            let name = name.map_or_else(|| format!("{list}.{number}").into(), Into::into);
            tokens.add(token.as_bytes(), name);
        }
        if tokens.is_empty() {
            return Err(LoadError::new(file, "no token in it"));
        }
    }
    Ok(tokens)
}

/// The kind of a file that is clearly no list of tokens. Without this check, each of its lines would be
/// accepted as a token.
fn other_kind(bytes: &[u8]) -> Option<&'static str> {
    const BEGINNINGS: [(&str, &[u8]); 7] = [
        ("JSON", b"{\""),
        ("JSON", b"[{"),
        ("JSON", b"[\""),
        ("XML", b"<?xml"),
        ("HTML", b"<!DOCTYPE"),
        ("HTML", b"<html"),
        ("a PEM file, of a certificate or key", b"-----BEGIN "),
    ];
    let start = bytes.trim_ascii_start();
    let first_line = start.split(|&byte| byte == b'\n').next().unwrap_or_default().trim_ascii();
    if [&b"{"[..], b"["].contains(&first_line) {
        return Some("JSON");
    }
    BEGINNINGS.iter().find(|(_, first)| start.starts_with(first)).map(|&(kind, _)| kind)
}

/// The name, if there is one, and the token of a line, or `None` for a line without a token.
fn parts(line: &str) -> Result<Option<(Option<&str>, &str)>, String> {
    // An editor shows the text after such a character on a new line, so a token in it would look
    // valid although it is part of a comment.
    let ends_a_line = |c: char| (c.is_control() && c != '\t') || matches!(c, '\u{2028}' | '\u{2029}');
    if let Some(c) = line.trim().chars().find(|&c| ends_a_line(c)) {
        return Err(format!("it has {}: end each line with a line feed (U+000A)", named_character(c)));
    }
    let line = without_comment(line).trim();
    if line.is_empty() {
        return Ok(None);
    }
    let (name, token) = match named(line)? {
        Some((name, token)) => (Some(name), token),
        None => (None, line),
    };
    if let Some(c) = token.chars().find(|c| !c.is_ascii_graphic()) {
        let which = if c == ' ' { "a space".into() } else { named_character(c) };
        return Err(format!(
            "the token has {which}, which no client can send: use visible ASCII characters only; in NAME: TOKEN \
             the name has at most {NAME_BYTES} letters, digits, `_`, `.` and `-`"
        ));
    }
    if token.len() > TOKEN_BYTES {
        let (has, most) = (ByteSize(token.len() as u64), ByteSize(TOKEN_BYTES as u64));
        return Err(format!("the token has {has}, must have at most {most}"));
    }
    Ok(Some((name, token)))
}

fn named_character(c: char) -> String {
    let hint = if c == '\u{feff}' { " (a byte order mark: save the file without it)" } else { "" };
    format!("the character U+{:04X}{hint}", u32::from(c))
}

fn without_comment(line: &str) -> &str {
    let begins = |&(at, _): &(usize, &str)| line[..at].chars().next_back().is_none_or(char::is_whitespace);
    let comment = line.match_indices('#').find(begins);
    comment.map_or(line, |(at, _)| &line[..at])
}

/// The parts of `name: token`, or `None` if the line is only a token. A colon without white space after
/// it belongs to a token.
fn named(line: &str) -> Result<Option<(&str, &str)>, String> {
    let Some((name, rest)) = line.split_once(':') else { return Ok(None) };
    let is_name = (1..=NAME_BYTES).contains(&name.len())
        && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"_.-".contains(&byte));
    if !is_name {
        return Ok(None);
    }
    if rest.is_empty() {
        return Err(format!("there is no token after the name {name}: write NAME: TOKEN"));
    }
    let Some(token) = rest.strip_prefix(char::is_whitespace) else { return Ok(None) };
    if is_of_an_unnamed_token(name) {
        let lists = LISTS.join(".N and ");
        return Err(format!(
            "the name {name} is kept for a token without a name ({lists}.N): choose another"
        ));
    }
    if is_reserved_name(name) {
        return Err(format!("the name {name} is kept for callers without a token: choose another"));
    }
    Ok(Some((name, token.trim())))
}

/// Whether this is the name of a token without a name.
fn is_of_an_unnamed_token(name: &str) -> bool {
    let number = LISTS.iter().find_map(|list| name.strip_prefix(list)?.strip_prefix('.'));
    number.is_some_and(|number| !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit()))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn error(text: &str) -> String {
        let file = SettingFile::new("query_tokens", Path::new("list"));
        read(&[(&file, text.as_bytes().to_vec())], "query").map(|_| ()).expect_err(text).to_string()
    }

    /// Catches a line that is accepted although no call can send its token, or although it hides
    /// another token. Also catches an error that does not name setting, file and line.
    #[test]
    fn lines_that_make_no_usable_token_are_refused_by_number() {
        let long = format!("a\n{}", "b".repeat(TOKEN_BYTES + 1));
        let wide = format!("{}: two", "n".repeat(NAME_BYTES + 1));
        for (text, line, what) in [
            ("\u{feff}abc\n", 1, "U+FEFF (a byte order mark"),
            ("\u{feff}name: abc\n", 1, "U+FEFF"),
            ("\u{feff}# a comment\nabc", 1, "U+FEFF"),
            ("one\nabc\0def\n", 2, "U+0000"),
            ("one\r\nabc\rdef\r\n", 2, "U+000D"),
            ("one\n# of May\rtwo\n", 2, "U+000D"),
            ("one\u{2028}two", 1, "U+2028"),
            ("# one\u{2029}two\nthree", 1, "U+2029"),
            ("one\u{85}two", 1, "U+0085"),
            ("one\u{b}two", 1, "U+000B"),
            ("a\nb\nname: \u{e9}", 3, "U+00E9"),
            ("one two", 1, "the token has a space, which no client can send"),
            ("one\nname: two words", 2, "the token has a space"),
            ("white name: two", 1, "in NAME: TOKEN the name has at most 32 letters"),
            (&wide, 1, "in NAME: TOKEN the name has at most 32 letters"),
            ("one\ttwo", 1, "U+0009"),
            ("a\u{a0}b", 1, "U+00A0"),
            ("\u{200b}a", 1, "U+200B"),
            ("a\nname:\n", 2, "no token after the name name"),
            ("name:   # later\n", 1, "no token after the name name"),
            (&long, 2, "8193 bytes (8.0 KiB), must have at most 8 KiB"),
        ] {
            let said = error(text);
            assert!(said.starts_with(&format!("query_tokens list: line {line}: ")), "{text:?}: {said}");
            assert!(said.contains(what), "{text:?}: {said}");
        }
        assert_eq!(error("# none\n\n"), "query_tokens list: no token in it");
    }

    /// Catches a file of another kind whose lines are all accepted as tokens, such as `{`.
    #[test]
    fn a_file_of_another_kind_is_refused() {
        for (text, kind) in [
            ("{\n\"format\": \"hullcast.scene.v1\"\n}\n", "JSON"),
            ("\n {\"a\": 1}", "JSON"),
            ("[\r\n\"a\"\r\n]", "JSON"),
            ("[\"a\"]", "JSON"),
            ("-----BEGIN CERTIFICATE-----\nAAAA\n", "a PEM file, of a certificate or key"),
            ("<?xml version=\"1.0\"?>", "XML"),
            ("<!DOCTYPE html>", "HTML"),
        ] {
            let expected = format!("query_tokens list: it is {kind}, expected one token per line");
            assert_eq!(error(text), expected, "{text:?}");
        }
        let file = SettingFile::new("query_tokens", Path::new("list"));
        for text in ["{a", "[a]", "<a>", "-----", "# {\nabc"] {
            assert!(read(&[(&file, text.as_bytes().to_vec())], "query").is_ok(), "{text:?}");
        }
    }

    /// Catches two tokens with the same name if one of the names is implied by the line number: two
    /// callers would share one budget. Also catches names that are refused without reason.
    #[test]
    fn no_line_takes_the_name_of_an_unnamed_token() {
        for name in ["query.2", "register.1", "query.007"] {
            let said = error(&format!("{name}: abc\ndef\n"));
            assert!(said.contains(&format!("line 1: the name {name} is kept")), "{said}");
        }
        // Metrics and logs call callers without a token so.
        for name in ["everyone", "EVERYONE", "anonymous", "10.0.0.1", "uid", "uid-7", "connection_3"] {
            let said = error(&format!("def\n{name}: abc\n"));
            assert!(said.contains(&format!("line 2: the name {name} is kept for callers without")), "{said}");
        }
        let file = SettingFile::new("query_tokens", Path::new("list"));
        for name in
            ["query.a", "query.", "query", "query.2a", "a.query.2", "reader.2", "guide", "10.0.0", "uids"]
        {
            let text = format!("{name}: abc\ndef\n").into_bytes();
            let tokens = read(&[(&file, text)], "query").unwrap();
            assert_eq!(
                [b"abc", b"def"].map(|token| tokens.name(token).unwrap()),
                [name, "query.2"].map(Into::into)
            );
        }
    }
}
