//! Reads files of records that may be damaged, cut off or made to do harm.
//!
//! Reading stops at the first damage of a file, because a wrong length makes the place of the next entry unknown. The
//! entries before it stand, and so do the other files.

use std::{
    fs::File,
    io::{self, BufReader, Read},
    path::{Path, PathBuf},
};

use bytes::Bytes;
use prost::Message;
use thiserror::Error;

use super::format::{Content, Entry, HEAD_BYTES, MAGIC, MAX_ENTRY_BYTES, check};

/// The end of the names of files of records.
pub(super) const EXTENSION: &str = "hullrec";

/// The place at which a file cannot be read, and why.
#[derive(Debug, Error)]
#[error("{}: at byte {offset}: {why}", path.display())]
pub struct Damage {
    /// The file.
    pub path: PathBuf,
    /// The offset of the entry that cannot be read.
    pub offset: u64,
    /// The fault.
    pub why: String,
    /// Whether the file only ends early, as it does if its server was killed while it wrote.
    pub is_cut: bool,
}

/// The entries of one file, in order. Ends at the first damage, which is its last item.
pub struct Entries<R = BufReader<File>> {
    path: PathBuf,
    file: R,
    offset: u64,
    ended: bool,
}

impl Entries {
    /// Opens a file.
    ///
    /// # Errors
    /// It cannot be opened.
    pub fn open(path: &Path) -> io::Result<Self> {
        Ok(Self::of(path, BufReader::new(File::open(path)?)))
    }
}

impl<R: Read> Entries<R> {
    /// The entries of a file that is read from `file`. `path` is its name in messages.
    pub fn of(path: &Path, file: R) -> Self {
        Self { path: path.to_owned(), file, offset: 0, ended: false }
    }

    fn damage(&self, why: String, is_cut: bool) -> Damage {
        Damage { path: self.path.clone(), offset: self.offset, why, is_cut }
    }

    /// Reads up to `most` bytes; fewer only at the end of the file.
    fn read(&mut self, most: usize) -> Result<Vec<u8>, Damage> {
        let mut bytes = Vec::new();
        let read = self.file.by_ref().take(most as u64).read_to_end(&mut bytes);
        read.map_err(|error| self.damage(format!("the file cannot be read: {error}"), false))?;
        Ok(bytes)
    }

    fn entry(&mut self) -> Result<Option<Content>, Damage> {
        if self.offset == 0 {
            let magic = self.read(MAGIC.len())?;
            if magic.len() < MAGIC.len() && MAGIC.starts_with(&magic) {
                return Err(self.damage("the file ends within its first bytes".into(), true));
            }
            if magic != MAGIC {
                return Err(self.damage("the file does not begin as a file of records".into(), false));
            }
            self.offset = MAGIC.len() as u64;
        }
        let head = self.read(HEAD_BYTES)?;
        if head.is_empty() {
            return Ok(None);
        }
        let Some(head) = head.first_chunk::<HEAD_BYTES>() else {
            let why =
                format!("the file ends after {} of the {HEAD_BYTES} bytes of an entry's head", head.len());
            return Err(self.damage(why, true));
        };
        let [compressed, length] = [0, 4]
            .map(|at| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]) as usize);
        for (name, length) in [("compressed length", compressed), ("length", length)] {
            if length > MAX_ENTRY_BYTES {
                let why = format!(
                    "the {name} of the entry is {length} bytes, at most {MAX_ENTRY_BYTES} are allowed"
                );
                return Err(self.damage(why, false));
            }
        }
        let frame = self.read(compressed)?;
        if frame.len() < compressed {
            let why = format!("the file ends after {} of the {compressed} bytes of an entry", frame.len());
            return Err(self.damage(why, true));
        }
        let mut lengths = [0; 8];
        lengths.copy_from_slice(&head[..8]);
        if check(lengths, &frame) != head[8..] {
            return Err(self.damage("the entry's bytes do not match its check".into(), false));
        }
        // The output never exceeds the stated length, whatever the frame holds.
        let plain = zstd::bulk::decompress(&frame, length)
            .map_err(|error| self.damage(format!("the entry cannot be decompressed: {error}"), false))?;
        if plain.len() != length {
            let why = format!("the entry has {} bytes, its head says {length}", plain.len());
            return Err(self.damage(why, false));
        }
        let entry = Entry::decode(Bytes::from(plain)).map_err(|error| {
            self.damage(format!("the entry is not a message of the format: {error}"), false)
        })?;
        let Some(content) = entry.content else {
            return Err(self.damage("the entry has no content that this version knows".into(), false));
        };
        self.offset += (HEAD_BYTES + compressed) as u64;
        Ok(Some(content))
    }
}

impl<R: Read> Iterator for Entries<R> {
    type Item = Result<Content, Damage>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let entry = self.entry().transpose();
        self.ended = !matches!(entry, Some(Ok(_)));
        entry
    }
}

/// The files of records in a directory, oldest first; or the path itself, if it is a file.
///
/// # Errors
/// The directory cannot be read.
pub fn files(path: &Path) -> io::Result<Vec<PathBuf>> {
    if path.is_file() {
        return Ok(vec![path.to_owned()]);
    }
    let mut files = Vec::new();
    for file in std::fs::read_dir(path)? {
        let path = file?.path();
        if path.extension().is_some_and(|extension| extension == EXTENSION) {
            files.push(path);
        }
    }
    files.sort_unstable();
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::{Call, Header, format::append};

    fn file() -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        let call =
            Call { method: "m".into(), request: Bytes::from_static(b"\0\0\0\0\x01x"), ..Call::default() };
        for content in [
            Content::Header(Header { version: "1".into(), ..Header::default() }),
            Content::Hull(Bytes::from_static(b"hull")),
            Content::Call(call),
        ] {
            assert!(append(content, &mut bytes));
        }
        bytes
    }

    fn read(bytes: &[u8]) -> (usize, Option<Damage>) {
        let mut whole = 0;
        for entry in Entries::of(Path::new("name"), bytes) {
            match entry {
                Ok(_) => whole += 1,
                Err(damage) => return (whole, Some(damage)),
            }
        }
        (whole, None)
    }

    /// Catches a change of any bit of a file that is not noticed, or that takes entries before it along.
    #[test]
    fn every_changed_bit_is_named() {
        let bytes = file();
        assert!(matches!(read(&bytes), (3, None)));
        for at in 0..bytes.len() {
            for bit in 0..8 {
                let mut changed = bytes.clone();
                changed[at] ^= 1 << bit;
                let (whole, damage) = read(&changed);
                let damage = damage.unwrap_or_else(|| panic!("bit {bit} of byte {at} is not noticed"));
                assert!(
                    damage.offset as usize <= at && damage.to_string().starts_with("name: at byte "),
                    "{damage}"
                );
                assert!(whole < 3);
            }
        }
    }

    /// Catches a cut that is taken for damage or for the end, or that costs a whole entry before it.
    #[test]
    fn a_cut_file_is_read_up_to_its_last_whole_entry() {
        let bytes = file();
        let (mut ends, mut cuts) = (Vec::new(), 0);
        for length in 0..=bytes.len() {
            let (whole, damage) = read(&bytes[..length]);
            match damage {
                None => ends.push((length, whole)),
                Some(damage) => {
                    assert!(damage.is_cut, "{damage}");
                    cuts += 1;
                }
            }
        }
        assert_eq!(ends.iter().map(|end| end.1).collect::<Vec<_>>(), [0, 1, 2, 3]);
        assert_eq!(cuts + ends.len(), bytes.len() + 1);
    }

    /// Catches a frame that grows beyond its stated length, and lengths for which memory is taken unchecked.
    #[test]
    fn decompression_bombs_are_refused() {
        let entry = |frame: &[u8], length: u32| {
            let mut lengths = [0; 8];
            lengths[..4].copy_from_slice(&(frame.len() as u32).to_le_bytes());
            lengths[4..].copy_from_slice(&length.to_le_bytes());
            [&MAGIC[..], &lengths, &check(lengths, frame), frame].concat()
        };
        let bomb = zstd::bulk::compress(&vec![0; 256 << 20], 1).unwrap();
        let (_, damage) = read(&entry(&bomb, 1000));
        assert!(damage.unwrap().why.contains("cannot be decompressed"));
        let (_, damage) = read(&entry(&bomb, 256 << 20));
        assert!(damage.unwrap().why.contains("at most 67108864 are allowed"));
        let (_, damage) = read(&entry(b"", u32::MAX));
        assert!(damage.unwrap().why.starts_with("the length of the entry is 4294967295"));
    }
}
