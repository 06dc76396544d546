//! Bearer tokens: lists of valid tokens, each list with a role.

use std::{collections::HashMap, path::Path, sync::Arc};

use http::{HeaderMap, header::AUTHORIZATION};
use sha2::{Digest, Sha256};

use super::{
    SecurityFiles,
    reloaded::{LoadError, Reloaded, SettingFile},
    token_lines::read,
};
use crate::service::{Reason, ServiceError};

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
    query: Option<Reloaded<TokenList>>,
    register: Option<Reloaded<TokenList>>,
}

/// The names of the tokens of one list in metrics and logs, by the SHA-256 of the tokens.
///
/// The hashes keep tokens out of memory. They also keep the time of a search from telling anything about a
/// token: a caller who learns which hashes are near its own knows no token with such a hash.
#[derive(Debug, Default)]
pub(super) struct TokenList(HashMap<[u8; 32], Arc<str>>);

impl Tokens {
    /// Reads the lists. Returns `None` if no list is named; then every call is allowed.
    ///
    /// # Errors
    /// A list cannot be read or has no token.
    pub(super) fn open(files: &SecurityFiles) -> Result<Option<Self>, LoadError> {
        let list = |setting, path: &Path, read| match path.as_os_str().is_empty() {
            true => Ok(None),
            false => Reloaded::open(vec![SettingFile::new(setting, path)], read).map(Some),
        };
        let tokens = Self {
            query: list("query_tokens", &files.query_tokens, |contents| read(contents, "query"))?,
            register: list("register_tokens", &files.register_tokens, |contents| read(contents, "register"))?,
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
            let why = "the call needs the header `authorization: Bearer TOKEN`";
            ServiceError::new(Reason::MissingToken, why)
        })?;
        let name = |list: &Option<Reloaded<TokenList>>| list.as_ref().and_then(|list| list.get().name(token));
        match (name(&self.register), name(&self.query), needed) {
            (Some(name), _, _) | (_, Some(name), Role::Query) => Ok(name),
            (None, Some(_), Role::Register) => {
                let why = "this token may query, but not register or delete hulls: use one that may";
                Err(ServiceError::new(Reason::TokenMayNot, why))
            }
            (None, None, _) => {
                Err(ServiceError::new(Reason::UnknownToken, "the server does not know this token"))
            }
        }
    }
}

impl TokenList {
    /// Adds a token. A token that is in the list already gets the new name.
    pub(super) fn add(&mut self, token: &[u8], name: Arc<str>) {
        self.0.insert(Sha256::digest(token).into(), name);
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The name of this token, if the list has it.
    pub(super) fn name(&self, token: &[u8]) -> Option<Arc<str>> {
        self.0.get(&*Sha256::digest(token)).cloned()
    }
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
        tokens.check(role, &headers).map_or_else(|error| error.reason.name(), |_| "")
    }

    /// Catches a comment, name or colon that is read as part of a token, a list in the older format
    /// that is read differently, and a token that is read as a name.
    #[test]
    fn lines_are_tokens_with_names_and_comments() {
        let lines = ["trainer: one  # of the cluster", "two#2", "three # rotated in May", "a:b", "   #four"];
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
            ("root", Some("admin")),
            ("trainer: one", None),
            ("b", None),
            ("#four", None),
        ];
        for (token, expected) in names {
            assert_eq!(name(token).as_deref(), expected, "{token}");
        }
    }

    /// Catches a prefix, a comment or an empty line that is accepted as a token, and a role that is
    /// confused with the other.
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
        for broken in [&b"# none"[..], &[0xff, b'\n'], "one\u{2028}two".as_bytes()] {
            std::fs::write(&files.query_tokens, broken).unwrap();
            tokens.reload();
            assert_eq!(state(), ["UNKNOWN_TOKEN", ""]);
        }
        std::fs::remove_file(&files.query_tokens).unwrap();
        tokens.reload();
        assert_eq!(state(), ["UNKNOWN_TOKEN", ""]);
    }

    /// A list may be replaced by any kind of entry. Catches a reload that waits forever for the
    /// writer of a FIFO, a reload that reads without a bound, and a failed reload that no later one
    /// repairs.
    #[test]
    fn whatever_replaces_a_list_the_next_reload_can_mend() {
        let (directory, files) = lists("one", "admin");
        let tokens = Tokens::open(&files).unwrap().unwrap();
        let state = || ["Bearer one", "Bearer two"].map(|t| reason(&tokens, Role::Query, Some(t)));
        let path = &files.query_tokens;
        let mode = rustix::fs::Mode::from_raw_mode(0o600);
        let replacements: [&dyn Fn(); 6] = [
            &|| rustix::fs::mkfifoat(rustix::fs::CWD, path, mode).unwrap(),
            &|| std::os::unix::fs::symlink("/dev/zero", path).unwrap(),
            &|| std::os::unix::fs::symlink(path, path).unwrap(),
            &|| std::os::unix::fs::symlink(directory.path(), path).unwrap(),
            &|| std::fs::File::create(path).unwrap().set_len(1 << 40).unwrap(),
            &|| {},
        ];
        for replace in replacements {
            std::fs::remove_file(path).unwrap();
            replace();
            tokens.reload();
            tokens.reload();
            assert_eq!(state(), ["", "UNKNOWN_TOKEN"]);
            let _ = std::fs::remove_file(path);
            std::fs::write(path, "two").unwrap();
            tokens.reload();
            assert_eq!(state(), ["UNKNOWN_TOKEN", ""]);
            std::fs::write(path, "one").unwrap();
            tokens.reload();
        }
    }
}
