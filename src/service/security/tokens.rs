//! Bearer tokens: lists of those that are good, each list with a role.

use std::path::{Path, PathBuf};

use http::{HeaderMap, header::AUTHORIZATION};
use sha2::{Digest, Sha256};
use subtle::{Choice, ConstantTimeEq};

use super::{
    SecurityFiles,
    reloaded::{LoadError, Reloaded},
};
use crate::service::ServiceError;

/// What a token may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// Everything that changes nothing.
    Query,
    /// Register and delete, too.
    Register,
}

/// The lists; one that is missing is empty.
#[derive(Debug)]
pub(super) struct Tokens {
    query: Option<Reloaded<Hashes>>,
    register: Option<Reloaded<Hashes>>,
}

/// The tokens' SHA-256, so that none lies in memory and all have one length.
#[derive(Debug)]
struct Hashes(Vec<[u8; 32]>);

impl Tokens {
    /// None where no list is named: every call may do everything.
    ///
    /// # Errors
    /// A list cannot be read or has no token.
    pub(super) fn open(files: &SecurityFiles) -> Result<Option<Self>, LoadError> {
        let list = |path: &PathBuf| match path.as_os_str().is_empty() {
            true => Ok(None),
            false => Reloaded::open(vec![path.clone()], hashes).map(Some),
        };
        let tokens = Self { query: list(&files.query_tokens)?, register: list(&files.register_tokens)? };
        Ok((tokens.query.is_some() || tokens.register.is_some()).then_some(tokens))
    }

    pub(super) fn reload(&self) {
        [&self.query, &self.register].into_iter().flatten().for_each(Reloaded::reload);
    }

    /// # Errors
    /// UNAUTHENTICATED, PERMISSION_DENIED.
    pub(super) fn check(&self, needed: Role, headers: &HeaderMap) -> Result<(), ServiceError> {
        let token = bearer(headers).ok_or_else(|| {
            ServiceError::unauthenticated("MISSING_TOKEN", "the call needs `authorization: Bearer TOKEN`")
        })?;
        let hash: [u8; 32] = Sha256::digest(token).into();
        let in_list =
            |list: &Option<Reloaded<Hashes>>| list.as_ref().is_some_and(|list| list.get().contains(&hash));
        match (in_list(&self.register), in_list(&self.query), needed) {
            (true, _, _) | (_, true, Role::Query) => Ok(()),
            (false, true, Role::Register) => {
                Err(ServiceError::forbidden("TOKEN_MAY_NOT", "this token may query, not register or delete"))
            }
            (false, false, _) => {
                Err(ServiceError::unauthenticated("UNKNOWN_TOKEN", "the token is not known"))
            }
        }
    }
}

impl Hashes {
    /// In a time that depends on how many there are, and on nothing else.
    fn contains(&self, hash: &[u8; 32]) -> bool {
        self.0.iter().fold(Choice::from(0), |found, known| found | known.ct_eq(hash)).into()
    }
}

/// One token a line; empty lines and those that begin with `#` are not.
fn hashes(contents: &[(&Path, Vec<u8>)]) -> Result<Hashes, LoadError> {
    let mut hashes = Vec::new();
    for (path, bytes) in contents {
        let text = std::str::from_utf8(bytes).map_err(|error| LoadError::new(path, error))?;
        let tokens = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
        hashes.extend(tokens.map(|token| <[u8; 32]>::from(Sha256::digest(token))));
        if hashes.is_empty() {
            return Err(LoadError::new(path, "no token in it"));
        }
    }
    Ok(Hashes(hashes))
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
        tokens.check(role, &headers).map_or_else(|error| error.reason, |()| "")
    }

    /// Catches a prefix, a comment or an empty line taken for a token, and a role mistaken for
    /// the other.
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

    /// Catches a rotation that needs a restart, and one broken file that locks everybody out
    /// or lets everybody in.
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
