//! Bearer tokens: lists of valid tokens, each list with a role.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use http::{HeaderMap, header::AUTHORIZATION};
use sha2::{Digest, Sha256};
use subtle::{ConditionallySelectable, ConstantTimeEq};

use super::{
    SecurityFiles,
    reloaded::{LoadError, Reloaded},
};
use crate::service::ServiceError;

/// The role of a token.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// May make every call that changes nothing.
    Query,
    /// May also register and delete.
    Register,
}

/// The lists of tokens; a list without a file is empty.
#[derive(Debug)]
pub(super) struct Tokens {
    query: Option<Reloaded<List>>,
    register: Option<Reloaded<List>>,
}

/// The tokens of one list.
#[derive(Debug)]
struct List(Vec<Token>);

/// A token's SHA-256, so that tokens are not kept in memory and all have the same length, and the
/// token's name in metrics and logs.
#[derive(Debug)]
struct Token {
    hash: [u8; 32],
    name: Arc<str>,
}

impl Tokens {
    /// None if no list is named: then every call is allowed.
    ///
    /// # Errors
    /// A list cannot be read or has no token.
    pub(super) fn open(files: &SecurityFiles) -> Result<Option<Self>, LoadError> {
        let list = |path: &PathBuf, read| match path.as_os_str().is_empty() {
            true => Ok(None),
            false => Reloaded::open(vec![path.clone()], read).map(Some),
        };
        let tokens = Self {
            query: list(&files.query_tokens, |contents| read(contents, "query"))?,
            register: list(&files.register_tokens, |contents| read(contents, "register"))?,
        };
        Ok((tokens.query.is_some() || tokens.register.is_some()).then_some(tokens))
    }

    pub(super) fn reload(&self) {
        [&self.query, &self.register].into_iter().flatten().for_each(Reloaded::reload);
    }

    /// The name of the call's token, if the token has the role `needed`.
    ///
    /// # Errors
    /// UNAUTHENTICATED, PERMISSION_DENIED.
    pub(super) fn check(&self, needed: Role, headers: &HeaderMap) -> Result<Arc<str>, ServiceError> {
        let token = bearer(headers).ok_or_else(|| {
            ServiceError::unauthenticated("MISSING_TOKEN", "the call needs `authorization: Bearer TOKEN`")
        })?;
        let hash: [u8; 32] = Sha256::digest(token).into();
        let name = |list: &Option<Reloaded<List>>| list.as_ref().and_then(|list| list.get().name(&hash));
        match (name(&self.register), name(&self.query), needed) {
            (Some(name), _, _) | (_, Some(name), Role::Query) => Ok(name),
            (None, Some(_), Role::Register) => {
                Err(ServiceError::forbidden("TOKEN_MAY_NOT", "this token may query, not register or delete"))
            }
            (None, None, _) => Err(ServiceError::unauthenticated("UNKNOWN_TOKEN", "the token is not known")),
        }
    }
}

impl List {
    /// The name of the token with this hash. The time of the search depends only on the number of
    /// tokens.
    fn name(&self, hash: &[u8; 32]) -> Option<Arc<str>> {
        let found = (0..).zip(&self.0).fold(u64::MAX, |found, (index, token)| {
            u64::conditional_select(&found, &index, token.hash.ct_eq(hash))
        });
        self.0.get(usize::try_from(found).ok()?).map(|token| token.name.clone())
    }
}

/// Reads a list. A line is `token` or `name: token`. A comment begins with `#` at the start of the
/// line or after white space. A token without a name is named by its list and line number.
fn read(contents: &[(&Path, Vec<u8>)], list: &str) -> Result<List, LoadError> {
    let mut tokens = Vec::new();
    for (path, bytes) in contents {
        let text = std::str::from_utf8(bytes).map_err(|error| LoadError::new(path, error))?;
        for (line, number) in text.lines().zip(1..) {
            let line = without_comment(line).trim();
            if line.is_empty() {
                continue;
            }
            let (name, token) = match named(line) {
                Some((name, token)) => (name.into(), token),
                None => (format!("{list}.{number}").into(), line),
            };
            tokens.push(Token { hash: Sha256::digest(token).into(), name });
        }
        if tokens.is_empty() {
            return Err(LoadError::new(path, "no token in it"));
        }
    }
    Ok(List(tokens))
}

fn without_comment(line: &str) -> &str {
    let begins = |&(at, _): &(usize, &str)| line[..at].chars().next_back().is_none_or(char::is_whitespace);
    let comment = line.match_indices('#').find(begins);
    comment.map_or(line, |(at, _)| &line[..at])
}

/// The longest name of a token.
const NAME_BYTES: usize = 32;

/// The parts of `name: token`; none if the line is only a token. A colon without white space after
/// it belongs to a token.
fn named(line: &str) -> Option<(&str, &str)> {
    let (name, token) = line.split_once(':')?;
    let is_name = (1..=NAME_BYTES).contains(&name.len())
        && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"_.-".contains(&byte));
    let token = token.strip_prefix(char::is_whitespace)?.trim();
    (is_name && !token.is_empty()).then_some((name, token))
}

fn bearer(headers: &HeaderMap) -> Option<&[u8]> {
    let value = headers.get(AUTHORIZATION)?.as_bytes();
    let (scheme, token) = value.split_at_checked(7)?;
    scheme.eq_ignore_ascii_case(b"bearer ").then(|| token.trim_ascii())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lists(query: &str, register: &str) -> (tempfile::TempDir, SecurityFiles) {
        let directory = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let path = directory.path().join(name);
            std::fs::write(&path, text).unwrap();
            path
        };
        let files = SecurityFiles {
            query_tokens: write("query", query),
            register_tokens: write("register", register),
            ..SecurityFiles::default()
        };
        (directory, files)
    }

    fn reason(tokens: &Tokens, role: Role, header: Option<&'static str>) -> &'static str {
        let headers = header.map(|value| (AUTHORIZATION, http::HeaderValue::from_static(value)));
        let headers = HeaderMap::from_iter(headers);
        tokens.check(role, &headers).map_or_else(|error| error.reason, |_| "")
    }

    /// Catches a comment, name or colon that is taken for part of a token, a list in the older
    /// format that is read differently, and a token that becomes a name.
    #[test]
    fn lines_are_tokens_with_names_and_comments() {
        let long = format!("{}: five", "n".repeat(NAME_BYTES + 1));
        let lines = [
            "trainer: one  # of the cluster",
            "two#2",
            "three # rotated in May",
            "a:b",
            &long,
            "   #four",
            "white name: six",
        ];
        let (_directory, files) = lists(&lines.join("\n"), "admin: root");
        let tokens = Tokens::open(&files).unwrap().unwrap();
        let name = |token: &str| {
            let value = http::HeaderValue::try_from(format!("Bearer {token}")).unwrap();
            let headers = HeaderMap::from_iter([(AUTHORIZATION, value)]);
            tokens.check(Role::Query, &headers).ok().map(|name| name.to_string())
        };
        let names = [
            ("one", Some("trainer")),
            ("two#2", Some("query.2")),
            ("three", Some("query.3")),
            ("a:b", Some("query.4")),
            (&long, Some("query.5")),
            ("white name: six", Some("query.7")),
            ("root", Some("admin")),
            ("trainer: one", None),
            ("b", None),
            ("#four", None),
        ];
        for (token, expected) in names {
            assert_eq!(name(token).as_deref(), expected, "{token}");
        }
    }

    /// Catches a prefix, a comment or an empty line that is taken for a token, and one role taken
    /// for the other.
    #[test]
    fn tokens_have_the_roles_of_their_lists() {
        let (_directory, files) = lists("# rotated in May\nabc\n\n  old \n", "abcd\n");
        let tokens = Tokens::open(&files).unwrap().unwrap();
        let cases = [
            (Some("Bearer abc"), "", "TOKEN_MAY_NOT"),
            (Some("bearer old"), "", "TOKEN_MAY_NOT"),
            (Some("Bearer  abcd "), "", ""),
            (Some("Bearer ab"), "UNKNOWN_TOKEN", "UNKNOWN_TOKEN"),
            (Some("Bearer # rotated in May"), "UNKNOWN_TOKEN", "UNKNOWN_TOKEN"),
            (Some("Bearer "), "UNKNOWN_TOKEN", "UNKNOWN_TOKEN"),
            (Some("Bearer"), "MISSING_TOKEN", "MISSING_TOKEN"),
            (Some("Basic abc"), "MISSING_TOKEN", "MISSING_TOKEN"),
            (None, "MISSING_TOKEN", "MISSING_TOKEN"),
        ];
        for (header, query, register) in cases {
            assert_eq!(reason(&tokens, Role::Query, header), query, "{header:?}");
            assert_eq!(reason(&tokens, Role::Register, header), register, "{header:?}");
        }
    }

    /// Catches a rotation that needs a restart, and a broken file that locks all callers out or
    /// lets all callers in.
    #[test]
    fn lists_are_read_again_and_a_broken_one_is_not_taken() {
        let (_directory, files) = lists("one", "admin");
        let tokens = Tokens::open(&files).unwrap().unwrap();
        let state = || ["Bearer one", "Bearer two"].map(|t| reason(&tokens, Role::Query, Some(t)));
        assert_eq!(state(), ["", "UNKNOWN_TOKEN"]);
        std::fs::write(&files.query_tokens, "one\ntwo").unwrap();
        tokens.reload();
        assert_eq!(state(), ["", ""]);
        std::fs::write(&files.query_tokens, "two").unwrap();
        tokens.reload();
        assert_eq!(state(), ["UNKNOWN_TOKEN", ""]);
        for broken in [&b"# none"[..], &[0xff, b'\n']] {
            std::fs::write(&files.query_tokens, broken).unwrap();
            tokens.reload();
            assert_eq!(state(), ["UNKNOWN_TOKEN", ""]);
        }
        std::fs::remove_file(&files.query_tokens).unwrap();
        tokens.reload();
        assert_eq!(state(), ["UNKNOWN_TOKEN", ""]);
    }
}
