//! Numpy's `.npz`: a ZIP archive of `.npy` arrays, uncompressed, as `numpy.savez` writes it.
//!
//! Formats: numpy's `numpy.lib.format`, version 1.0; PKWARE's APPNOTE 6.3, sections 4.3.7, 4.3.12 and
//! 4.3.16. All times are the format's earliest, so that equal arrays give equal bytes.

use std::io::{self, Write};

const LOCAL_HEADER: u32 = 0x0403_4b50;
const CENTRAL_HEADER: u32 = 0x0201_4b50;
const CENTRAL_END: u32 = 0x0605_4b50;
/// Version 2.0 of ZIP. The date is 1980-01-01.
const VERSION: u16 = 20;
const DATE: u16 = 1 << 5 | 1;
/// The data of a `.npy` file begins at a multiple of this.
const ALIGNMENT: usize = 64;

/// A number type of numpy.
pub(crate) trait NpzNumber: Copy {
    /// Numpy's name of the type in little-endian order.
    const DTYPE: &str;
    /// Appends the number's bytes, little endian.
    fn write(self, bytes: &mut Vec<u8>);
}

macro_rules! number {
    ($type:ty, $dtype:literal) => {
        impl NpzNumber for $type {
            const DTYPE: &str = $dtype;
            fn write(self, bytes: &mut Vec<u8>) {
                bytes.extend_from_slice(&self.to_le_bytes());
            }
        }
    };
}

number!(u8, "|u1");
number!(u32, "<u4");
number!(f64, "<f8");

/// An archive being written.
#[derive(Debug)]
pub(crate) struct Npz<W> {
    out: W,
    written: u64,
    directory: Vec<u8>,
    entries: u16,
}

impl<W: Write> Npz<W> {
    /// An empty archive that is written to `out`.
    pub(crate) fn new(out: W) -> Self {
        Self { out, written: 0, directory: Vec::new(), entries: 0 }
    }

    /// Adds an array with rows of `width` numbers. The array is one-dimensional if `width` is 1.
    ///
    /// # Errors
    /// The array cannot be written, or the archive would exceed the 4 GiB of a plain ZIP archive.
    pub(crate) fn array<T: NpzNumber>(&mut self, name: &str, column: &[T], width: usize) -> io::Result<()> {
        self.entry(name, &npy(column, width))
    }

    /// Adds a text as an array without dimensions, as numpy stores a string.
    ///
    /// # Errors
    /// As [`Self::array`].
    pub(crate) fn text(&mut self, name: &str, text: &str) -> io::Result<()> {
        let letters: Vec<u8> = text.chars().flat_map(|letter| u32::from(letter).to_le_bytes()).collect();
        self.entry(name, &with_header(&format!("<U{}", letters.len() / 4), "()", &letters))
    }

    fn entry(&mut self, name: &str, data: &[u8]) -> io::Result<()> {
        let name = format!("{name}.npy");
        let (offset, size) = (small(self.written)?, small(data.len() as u64)?);
        let mut entry = Vec::new();
        // Version needed, flags, method (stored), time.
        for field in [VERSION, 0, 0, 0, DATE] {
            entry.extend_from_slice(&field.to_le_bytes());
        }
        for field in [crc32(data), size, size] {
            entry.extend_from_slice(&field.to_le_bytes());
        }
        entry.extend_from_slice(&(name.len() as u16).to_le_bytes());
        // No extra field.
        entry.extend_from_slice(&[0; 2]);
        self.write(&LOCAL_HEADER.to_le_bytes())?;
        self.write(&entry)?;
        self.write(name.as_bytes())?;
        self.write(data)?;
        self.directory.extend_from_slice(&CENTRAL_HEADER.to_le_bytes());
        self.directory.extend_from_slice(&VERSION.to_le_bytes());
        self.directory.extend_from_slice(&entry);
        // No comment, disk 0, no attributes.
        self.directory.extend_from_slice(&[0; 10]);
        self.directory.extend_from_slice(&offset.to_le_bytes());
        self.directory.extend_from_slice(name.as_bytes());
        self.entries += 1;
        Ok(())
    }

    /// Writes the archive's directory and returns `out`.
    ///
    /// # Errors
    /// The directory cannot be written, or the archive would exceed the 4 GiB of a plain ZIP archive.
    pub(crate) fn finish(mut self) -> io::Result<W> {
        let (offset, size) = (small(self.written)?, small(self.directory.len() as u64)?);
        let mut end = std::mem::take(&mut self.directory);
        end.extend_from_slice(&CENTRAL_END.to_le_bytes());
        for field in [0, 0, self.entries, self.entries] {
            end.extend_from_slice(&field.to_le_bytes());
        }
        end.extend_from_slice(&size.to_le_bytes());
        end.extend_from_slice(&offset.to_le_bytes());
        end.extend_from_slice(&[0; 2]);
        self.write(&end)?;
        self.out.flush()?;
        Ok(self.out)
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.written += bytes.len() as u64;
        self.out.write_all(bytes)
    }
}

fn small(bytes: u64) -> io::Result<u32> {
    u32::try_from(bytes).map_err(|_| io::Error::other("the archive would pass 4 GiB"))
}

/// The bytes of a `.npy` file.
fn npy<T: NpzNumber>(column: &[T], width: usize) -> Vec<u8> {
    let rows = column.len() / width;
    let shape = if width == 1 { format!("({rows},)") } else { format!("({rows}, {width})") };
    let mut data = Vec::with_capacity(size_of_val(column));
    column.iter().for_each(|number| number.write(&mut data));
    with_header(T::DTYPE, &shape, &data)
}

/// A `.npy` file's bytes, from those of its array.
fn with_header(dtype: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let mut header = format!("{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}");
    // The magic and version (8 bytes) and the length (2) come before the header; a line feed ends it.
    let padding = (ALIGNMENT - (header.len() + 11) % ALIGNMENT) % ALIGNMENT;
    header.extend(std::iter::repeat_n(' ', padding));
    header.push('\n');
    let mut bytes = Vec::with_capacity(10 + header.len() + data.len());
    bytes.extend_from_slice(b"\x93NUMPY\x01\x00");
    bytes.extend_from_slice(&(header.len() as u16).to_le_bytes());
    bytes.extend_from_slice(header.as_bytes());
    bytes.extend_from_slice(data);
    bytes
}

/// The CRC-32 of ZIP: polynomial 0xedb88320, reflected.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0, |crc, &byte| {
        let at = (crc ^ u32::from(byte)) & 0xff;
        CRC_TABLE[at as usize] ^ (crc >> 8)
    })
}

static CRC_TABLE: [u32; 256] = {
    let mut table = [0; 256];
    let mut i = 0;
    while i < 256 {
        let (mut value, mut bit) = (i as u32, 0);
        while bit < 8 {
            value = if value & 1 == 1 { value >> 1 ^ 0xedb8_8320 } else { value >> 1 };
            bit += 1;
        }
        table[i] = value;
        i += 1;
    }
    table
};

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares with the check value of CRC catalogues. Catches a wrong table or a wrong order of bits.
    #[test]
    fn the_checksum_is_zips() {
        assert_eq!(crc32(b"123456789"), 0xcbf4_3926);
    }

    /// Catches a header that numpy would refuse or read as another shape.
    #[test]
    fn arrays_are_aligned_and_say_their_shape() {
        for (array, shape, data) in [
            (npy(&[1.5_f64, 2.5, 3.5], 1), "'<f8', 'fortran_order': False, 'shape': (3,), }", 24),
            (npy(&[1_u32, 2, 3, 4, 5, 6], 2), "'<u4', 'fortran_order': False, 'shape': (3, 2), }", 24),
            (npy::<u8>(&[], 2), "'|u1', 'fortran_order': False, 'shape': (0, 2), }", 0),
        ] {
            assert_eq!((array.len() - data) % ALIGNMENT, 0);
            assert_eq!(array[array.len() - data - 1], b'\n');
            assert!(String::from_utf8_lossy(&array).contains(shape));
        }
    }
}
