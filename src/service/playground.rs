//! The playground: the files of a page that shows contacts (docs/playground.md).

/// The files of the page, built by `make playground`.
const FILES: [(&str, &str, &str); 4] = [
    ("/", "text/html; charset=utf-8", include_str!("../../playground/dist/index.html")),
    ("/playground.css", "text/css; charset=utf-8", include_str!("../../playground/dist/playground.css")),
    ("/playground.js", "text/javascript; charset=utf-8", include_str!("../../playground/dist/playground.js")),
    ("/licences.txt", "text/plain; charset=utf-8", include_str!("../../playground/dist/licences.txt")),
];

/// The content type and the text of a file of the page.
pub(super) fn file(path: &str) -> Option<(&'static str, &'static str)> {
    FILES.iter().find(|(name, ..)| *name == path).map(|&(_, kind, text)| (kind, text))
}
