//! Plain values as bytes and back, for checkpoints.
//!
//! Numbers are little-endian, sequences follow their length, records are their fields in order.

use std::collections::BTreeMap;
use std::io::{self, Write};

/// A value that bytes can hold.
pub(crate) trait Bytes: Sized {
    /// Fewest bytes that one takes: a length read from a file is held against the bytes left.
    const LEAST: usize;

    /// Appends the value.
    fn put(&self, out: &mut dyn Write) -> io::Result<()>;

    /// Takes a value from the front; `None` when the bytes are none.
    fn take(from: &mut &[u8]) -> Option<Self>;
}

macro_rules! numbers {
    ($($type:ty),*) => {$(
        impl Bytes for $type {
            const LEAST: usize = size_of::<$type>();

            fn put(&self, out: &mut dyn Write) -> io::Result<()> {
                out.write_all(&self.to_le_bytes())
            }

            fn take(from: &mut &[u8]) -> Option<Self> {
                let (bytes, rest) = from.split_first_chunk()?;
                *from = rest;
                Some(Self::from_le_bytes(*bytes))
            }
        }
    )*};
}

numbers!(u8, u16, u32, u64, i32, f32, f64);

/// Makes records of their fields, in the order given.
macro_rules! records {
    ($($type:ty { $($field:ident: $kind:ty),* $(,)? })*) => {$(
        impl $crate::bytes::Bytes for $type {
            const LEAST: usize = 0 $(+ <$kind as $crate::bytes::Bytes>::LEAST)*;

            fn put(&self, out: &mut dyn std::io::Write) -> std::io::Result<()> {
                $(<$kind as $crate::bytes::Bytes>::put(&self.$field, out)?;)*
                Ok(())
            }

            fn take(from: &mut &[u8]) -> Option<Self> {
                Some(Self { $($field: <$kind as $crate::bytes::Bytes>::take(from)?),* })
            }
        }
    )*};
}
pub(crate) use records;

impl Bytes for bool {
    const LEAST: usize = 1;

    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        u8::from(*self).put(out)
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        match u8::take(from)? {
            0 => Some(false),
            1 => Some(true),
            _ => None,
        }
    }
}

/// Whole numbers of the machine's width take eight bytes everywhere.
impl Bytes for usize {
    const LEAST: usize = 8;

    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        (*self as u64).put(out)
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        u64::take(from)?.try_into().ok()
    }
}

impl<T: Bytes> Bytes for Option<T> {
    const LEAST: usize = 1;

    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        self.is_some().put(out)?;
        self.as_ref().map_or(Ok(()), |value| value.put(out))
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        if bool::take(from)? { Some(Some(T::take(from)?)) } else { Some(None) }
    }
}

impl<T: Bytes> Bytes for Vec<T> {
    const LEAST: usize = 8;

    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        self.len().put(out)?;
        self.iter().try_for_each(|value| value.put(out))
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        let length = usize::take(from)?;
        // What the bytes cannot hold is not allocated.
        if length > from.len() / T::LEAST.max(1) {
            return None;
        }
        (0..length).map(|_| T::take(from)).collect()
    }
}

impl Bytes for String {
    const LEAST: usize = 8;

    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        self.len().put(out)?;
        out.write_all(self.as_bytes())
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        let length = usize::take(from)?;
        let (text, rest) = from.split_at_checked(length)?;
        *from = rest;
        Some(std::str::from_utf8(text).ok()?.into())
    }
}

impl<T: Bytes> Bytes for BTreeMap<String, T> {
    const LEAST: usize = 8;

    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        self.len().put(out)?;
        self.iter().try_for_each(|(key, value)| key.put(out).and_then(|()| value.put(out)))
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        let length = usize::take(from)?;
        if length > from.len() / (String::LEAST + T::LEAST) {
            return None;
        }
        (0..length).map(|_| Some((String::take(from)?, T::take(from)?))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq)]
    struct Record {
        name: String,
        counts: Vec<u16>,
        table: BTreeMap<String, Option<f64>>,
        is_old: bool,
    }

    records! {
        Record { name: String, counts: Vec<u16>, table: BTreeMap<String, Option<f64>>, is_old: bool }
    }

    #[test]
    fn records_come_back_and_shortened_ones_do_not() {
        let table = [("a", Some(0.1)), ("ümlaut", None)];
        let table = table.map(|(key, value)| (key.to_string(), value)).into();
        let record = Record { name: "oak".into(), counts: vec![1, 65535], table, is_old: true };
        let mut bytes = Vec::new();
        record.put(&mut bytes).unwrap();
        // Lengths of 8 bytes; 3 letters, 2 · 2, 1 letter and 1 + 8, 7 letters and 1, and 1.
        assert_eq!(bytes.len(), 8 + 3 + 8 + 4 + 8 + (8 + 1 + 9) + (8 + 7 + 1) + 1);
        let mut from = bytes.as_slice();
        assert_eq!(Record::take(&mut from), Some(record));
        assert!(from.is_empty());
        for length in 0..bytes.len() {
            assert_eq!(Record::take(&mut &bytes[..length]), None, "{length}");
        }
    }

    #[test]
    fn a_length_that_the_bytes_cannot_hold_is_refused_before_anything_is_allocated() {
        let mut bytes = u64::MAX.to_le_bytes().to_vec();
        bytes.extend([0; 64]);
        assert_eq!(Vec::<u64>::take(&mut bytes.as_slice()), None);
        assert_eq!(String::take(&mut bytes.as_slice()), None);
        assert_eq!(BTreeMap::<String, u8>::take(&mut bytes.as_slice()), None);
        assert_eq!(<Option<u8> as Bytes>::take(&mut [2, 0].as_slice()), None);
    }
}
