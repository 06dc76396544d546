//! The reasons of errors: the words of `ErrorInfo.reason` and of `HullError.reason`. Clients compare these
//! words, so they never change. docs/errors.md and `proto/hullcast/v1/hulls.proto` list them, and tests
//! compare both with this file.

use std::fmt;

use tonic::Code;

use crate::contact::HullErrorKind;

/// Defines [`Reason`]: for each variant its documentation, its word and its code.
macro_rules! reasons {
    ($($(#[$documentation:meta])+ $variant:ident = $name:literal, $code:ident;)+) => {
        /// The reason why a call fails. Each reason belongs to one code, which says who caused the error and
        /// whether a retry can succeed.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Reason {
            $($(#[$documentation])+ $variant,)+
        }

        impl Reason {
            /// Every reason.
            pub const ALL: &[Self] = &[$(Self::$variant),+];

            /// The reason as clients see it, in upper case: `ErrorInfo.reason`.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)+
                }
            }

            /// The code of the call's status.
            pub fn code(self) -> Code {
                match self {
                    $(Self::$variant => Code::$code,)+
                }
            }
        }
    };
}

reasons! {
    /// The length of a column does not fit the other columns.
    LengthMismatch = "LENGTH_MISMATCH", InvalidArgument;
    /// An index of a hull or of a body is out of range.
    IndexOutOfRange = "INDEX_OUT_OF_RANGE", InvalidArgument;
    /// A number is outside its range, or NaN.
    ValueOutOfRange = "VALUE_OUT_OF_RANGE", InvalidArgument;
    /// This version does not know the value of an enum.
    UnknownValue = "UNKNOWN_VALUE", InvalidArgument;
    /// The method does not allow the field.
    FieldNotAllowed = "FIELD_NOT_ALLOWED", InvalidArgument;
    /// The first message of a stream has `inherit`.
    NothingToInherit = "NOTHING_TO_INHERIT", InvalidArgument;
    /// A hull id does not have 32 bytes.
    MalformedId = "MALFORMED_ID", InvalidArgument;
    /// A request lists a hull twice.
    DuplicateHull = "DUPLICATE_HULL", InvalidArgument;
    /// A request has more pairs than the server's limit.
    TooManyPairs = "TOO_MANY_PAIRS", InvalidArgument;
    /// A request has more bodies than the server's limit.
    TooManyBodies = "TOO_MANY_BODIES", InvalidArgument;
    /// A request has more hulls than the server's limit.
    TooManyHulls = "TOO_MANY_HULLS", InvalidArgument;
    /// A request lists too many outputs.
    TooManyOutputs = "TOO_MANY_OUTPUTS", InvalidArgument;
    /// A field mask has too many paths.
    TooManyPaths = "TOO_MANY_PATHS", InvalidArgument;
    /// A path of a field mask is unknown.
    UnknownPath = "UNKNOWN_PATH", InvalidArgument;
    /// The page token is not one that a server has issued.
    MalformedPageToken = "MALFORMED_PAGE_TOKEN", InvalidArgument;
    /// The hulls of a request take more of the cache than one caller may use.
    HullsTooLarge = "HULLS_TOO_LARGE", InvalidArgument;
    /// The call would hold more memory than one caller may hold.
    MemoryTooLarge = "MEMORY_TOO_LARGE", InvalidArgument;
    /// Bytes follow the message of a method that takes one message.
    TooManyMessages = "TOO_MANY_MESSAGES", InvalidArgument;
    /// A message arrives in too many small pieces.
    PiecesTooSmall = "PIECES_TOO_SMALL", InvalidArgument;
    /// A message is larger than the limit.
    MessageTooLarge = "MESSAGE_TOO_LARGE", InvalidArgument;
    /// The answer would be larger than the limit of messages.
    ResponseTooLarge = "RESPONSE_TOO_LARGE", InvalidArgument;
    /// The bytes are not a message of the method's type, there is no message, or the message is marked as
    /// compressed although the call names no compression.
    MalformedMessage = "MALFORMED_MESSAGE", InvalidArgument;
    /// The server has no such service or method.
    UnknownMethod = "UNKNOWN_METHOD", Unimplemented;
    /// The request is compressed.
    CompressionUnsupported = "COMPRESSION_UNSUPPORTED", Unimplemented;
    /// The server's limit, or the caller's share of it, is used up.
    TooBusy = "TOO_BUSY", Unavailable;
    /// The store cannot be read or written.
    StoreUnavailable = "STORE_UNAVAILABLE", Unavailable;
    /// The connection is about to close, because the server stops or because of the connection's age.
    Stopping = "STOPPING", Unavailable;
    /// The server had no memory to keep the state that the message inherits.
    StateNotKept = "STATE_NOT_KEPT", Unavailable;
    /// The call needs a token and has none.
    MissingToken = "MISSING_TOKEN", Unauthenticated;
    /// The token is on no list of the server.
    UnknownToken = "UNKNOWN_TOKEN", Unauthenticated;
    /// The token does not permit the method.
    TokenMayNot = "TOKEN_MAY_NOT", PermissionDenied;
    /// The store has no room for a hull.
    StoreFull = "STORE_FULL", ResourceExhausted;
    /// The connection has too many streams of Watch and reflection.
    TooManyWatches = "TOO_MANY_WATCHES", ResourceExhausted;
    /// The caller's deadline or the server's has passed.
    DeadlineExceeded = "DEADLINE_EXCEEDED", DeadlineExceeded;
    /// The message, or the end of the request, did not arrive in time.
    MessageLate = "MESSAGE_LATE", DeadlineExceeded;
    /// The stream broke before its request had arrived. The caller cannot receive this error; metrics
    /// count it.
    Cancelled = "CANCELLED", Cancelled;
    /// A health check names a service that the server does not have.
    NotFound = "NOT_FOUND", NotFound;
    /// A bug in the server; its log has the details.
    Internal = "INTERNAL", Internal;
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The reason why `RegisterHulls` refuses one hull of a request: `HullError.reason`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HullReason {
    /// The hull has more points than the server's limit.
    TooManyPoints,
    /// The length of a column of the definition is wrong.
    Malformed,
    /// The points form no hull that this server can build.
    NotBuilt(HullErrorKind),
}

impl HullReason {
    /// The reason as clients see it, in upper case.
    pub fn name(self) -> &'static str {
        match self {
            Self::TooManyPoints => "TOO_MANY_POINTS",
            Self::Malformed => "MALFORMED",
            Self::NotBuilt(kind) => kind.reason(),
        }
    }

    /// Every reason.
    pub fn all() -> impl Iterator<Item = Self> {
        let kinds = HullErrorKind::ALL.iter().map(|&kind| Self::NotBuilt(kind));
        [Self::TooManyPoints, Self::Malformed].into_iter().chain(kinds)
    }
}

#[cfg(test)]
mod tests {
    use std::{collections::BTreeSet, fs, path::Path};

    use super::*;
    use crate::service::call;

    /// The text of a file of the repository.
    fn text(path: &str) -> String {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
        fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    }

    /// The words of two and more capital letters in a text.
    fn words(text: &str) -> impl Iterator<Item = &str> {
        let words = text.split(|letter: char| !(letter.is_ascii_uppercase() || letter == '_'));
        words.filter(|word| word.len() > 1)
    }

    /// Catches a reason that the documentation lacks, one that it has although no code can send it, and one
    /// that it lists under another code.
    #[test]
    fn the_documentation_lists_every_reason_with_its_code() {
        let page = text("docs/errors.md");
        let table = page.split_once("## Error codes").unwrap().1.split_once("\n\n## ").unwrap().0;
        let mut code = "";
        let mut listed = Vec::new();
        for row in table.lines().filter(|line| line.starts_with("| ")).skip(1) {
            let cells: Vec<_> = row.split('|').map(str::trim).collect();
            code = if cells[1].is_empty() { code } else { cells[1] };
            listed.extend(words(cells[2]).map(|reason| (code, reason)));
        }
        let ours = Reason::ALL.iter().map(|reason| (call::name(reason.code()), reason.name()));
        assert_eq!(listed.len(), Reason::ALL.len(), "a reason is listed twice or not at all: {listed:?}");
        assert_eq!(listed.into_iter().collect::<BTreeSet<_>>(), ours.collect());
    }

    /// Catches a reason of a refused hull that the contract lacks, and one that it invents.
    #[test]
    fn the_contract_lists_every_reason_of_a_refused_hull() {
        let contract = text("proto/hullcast/v1/hulls.proto");
        let message = contract.split_once("message HullError {").unwrap().1;
        let comment = message.split_once("string reason").unwrap().0;
        assert_eq!(
            words(comment).collect::<BTreeSet<_>>(),
            HullReason::all().map(HullReason::name).collect()
        );
    }

    /// Catches a reason on which the Python client acts although no server sends it.
    #[test]
    fn the_python_client_acts_on_reasons_that_exist() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("client/src/hullcast");
        let files = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        let sources: Vec<_> = files
            .filter(|path| path.extension().is_some_and(|e| e == "py"))
            .map(|path| text(path.to_str().unwrap()))
            .collect();
        let sources = sources.concat();
        let mut acted_on: BTreeSet<&str> = BTreeSet::new();
        for compared in [".reason == ", ".reason != "] {
            acted_on.extend(sources.split(compared).skip(1).filter_map(|rest| words(rest).next()));
        }
        let too_large = sources.split_once("_TOO_LARGE = (").unwrap().1.split_once(')').unwrap().0;
        acted_on.extend(words(too_large));
        // The client itself raises these with `reason=`.
        let raised: BTreeSet<&str> =
            sources.split("reason=\"").skip(1).filter_map(|rest| words(rest).next()).collect();
        let sent: BTreeSet<&str> = Reason::ALL.iter().map(|reason| reason.name()).collect();
        // An error of gRPC itself has the name of its code as its reason.
        let of_grpc = "UNAVAILABLE";
        let known = |r: &str| sent.contains(r) || raised.contains(r) || r == of_grpc;
        let unknown: Vec<_> = acted_on.iter().filter(|r| !known(r)).collect();
        assert!(acted_on.contains("MESSAGE_TOO_LARGE") && acted_on.len() >= 7, "{acted_on:?}");
        assert_eq!(unknown, [&""; 0]);
    }
}
