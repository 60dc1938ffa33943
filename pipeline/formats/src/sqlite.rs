//! Reading the tables of an SQLite database file [SQLite], which a GeoPackage is.
//!
//! Only what a finished file needs: pages, b-trees of rows, records and overflow chains. No SQL
//! is run, no index is used, nothing is written. Every number of the file is checked before it is
//! used: pages are visited at most once, chains are as long as the file at most.

use crate::bytes::{MAX_FILE_BYTES, read_bounded};
use crate::cells::Cell;
use crate::error::{Error, Result};
use crate::table::MAX_ROWS;
use std::path::{Path, PathBuf};

/// First bytes of every database [SQLite] §1.3.
const MAGIC: &[u8; 16] = b"SQLite format 3\0";
/// Length of the header before the first page's own [SQLite] §1.3.
const HEADER: usize = 100;
/// Kinds of pages of a b-tree of rows [SQLite] §1.6.
const INTERIOR: u8 = 5;
const LEAF: u8 = 13;

/// A value of a record.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Value {
    Cell(Cell),
    Blob(Vec<u8>),
}

impl Value {
    pub(crate) fn text(&self) -> Option<&str> {
        match self {
            Self::Cell(Cell::Text(text)) => Some(text),
            _ => None,
        }
    }

    pub(crate) fn whole(&self) -> Option<i64> {
        match self {
            Self::Cell(Cell::Integer(number)) => Some(*number),
            _ => None,
        }
    }
}

/// A row: its number in the table, and its values in the order of the columns.
pub(crate) struct Row {
    pub(crate) number: i64,
    pub(crate) values: Vec<Value>,
}

/// A database read into memory.
pub(crate) struct Database {
    path: PathBuf,
    bytes: Vec<u8>,
    page_size: usize,
    /// Bytes of a page that hold content.
    usable: usize,
}

/// A table: its columns and where its rows begin.
pub(crate) struct Stored {
    /// Names of the columns; `true` for the one that stands for the row's number.
    pub(crate) columns: Vec<(String, bool)>,
    root: u32,
}

impl Database {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let mut log = path.as_os_str().to_owned();
        log.push("-wal");
        if std::fs::metadata(&log).is_ok_and(|found| found.len() > 0) {
            let message = "a program has this file open, and changes stand in its `-wal` file";
            return Err(Error::invalid(path, message, "close the program"));
        }
        Self::new(path, read_bounded(path, MAX_FILE_BYTES)?)
    }

    /// Checks the header of a database in memory; `path` is for messages only.
    pub(crate) fn new(path: &Path, bytes: Vec<u8>) -> Result<Self> {
        let path = path.to_path_buf();
        if bytes.len() < HEADER || !bytes.starts_with(MAGIC) {
            return Err(Error::invalid(&path, "this is no SQLite database", ""));
        }
        let size = usize::from(u16::from_be_bytes([bytes[16], bytes[17]]));
        let page_size = if size == 1 { 65536 } else { size };
        if !page_size.is_power_of_two() || page_size < 512 {
            return Err(Error::invalid(&path, format!("it has pages of {page_size} bytes"), ""));
        }
        let usable = page_size - usize::from(bytes[20]);
        if usable < 480 {
            return Err(Error::invalid(&path, "its pages have no room for content", ""));
        }
        // 0 stands in databases without any table.
        if !matches!(bytes[56..60], [0, 0, 0, 0 | 1]) {
            let message = "text that is not in UTF-8";
            return Err(Error::unsupported(&path, message, "write the file anew with UTF-8"));
        }
        Ok(Self { path, bytes, page_size, usable })
    }

    /// Finds a table by its name.
    pub(crate) fn table(&self, name: &str) -> Result<Option<Stored>> {
        for row in self.rows(1)? {
            // type, name, tbl_name, rootpage, sql [SQLite] §2.6
            let [kind, own, _, root, sql] = &row.values[..] else { continue };
            let is_it = kind.text() == Some("table")
                && own.text().is_some_and(|own| own.eq_ignore_ascii_case(name));
            if !is_it {
                continue;
            }
            let sql = sql.text().unwrap_or_default();
            let root = root.whole().and_then(|root| u32::try_from(root).ok());
            return match root {
                Some(root) if root > 0 => Ok(Some(Stored { columns: columns(sql), root })),
                _ => Err(self.damaged(&format!("table `{name}` has no rows of its own"))),
            };
        }
        Ok(None)
    }

    /// All rows of a table, in their order.
    pub(crate) fn rows_of(&self, table: &Stored) -> Result<Vec<Row>> {
        self.rows(table.root)
    }

    fn damaged(&self, what: &str) -> Error {
        Error::invalid(&self.path, format!("the database is damaged: {what}"), "")
    }

    fn page(&self, number: u32) -> Result<&[u8]> {
        let start = (number as usize).checked_sub(1).and_then(|n| n.checked_mul(self.page_size));
        let page = start.and_then(|start| self.bytes.get(start..)?.get(..self.page_size));
        page.map(|page| &page[..self.usable])
            .ok_or_else(|| self.damaged(&format!("there is no page {number}")))
    }

    fn rows(&self, root: u32) -> Result<Vec<Row>> {
        let mut rows = Vec::new();
        let mut visited = vec![false; self.bytes.len() / self.page_size + 1];
        // Pages yet to be read, the next one last.
        let mut waiting = vec![root];
        while let Some(number) = waiting.pop() {
            let page = self.page(number)?;
            if std::mem::replace(&mut visited[number as usize - 1], true) {
                return Err(self.damaged(&format!("page {number} belongs to itself")));
            }
            let start = if number == 1 { HEADER } else { 0 };
            let short = || self.damaged(&format!("page {number} is cut short"));
            let (kind, cells) = (page[start], u16_at(page, start + 3).ok_or_else(short)?);
            let first = start + if kind == INTERIOR { 12 } else { 8 };
            let pointer = |cell: usize| u16_at(page, first + 2 * cell).map(usize::from);
            match kind {
                INTERIOR => {
                    waiting.push(u32_at(page, start + 8).ok_or_else(short)?);
                    for cell in (0..usize::from(cells)).rev() {
                        let child = pointer(cell).and_then(|at| u32_at(page, at));
                        waiting.push(child.ok_or_else(short)?);
                    }
                }
                LEAF => {
                    for cell in 0..usize::from(cells) {
                        rows.push(self.row(page, pointer(cell).ok_or_else(short)?)?);
                    }
                }
                _ => {
                    let message = "a table without row numbers";
                    return Err(Error::unsupported(&self.path, message, "ordinary tables are"));
                }
            }
            if rows.len() > MAX_ROWS {
                let hint = format!("at most {MAX_ROWS}");
                return Err(Error::invalid(&self.path, "the table has too many rows", hint));
            }
        }
        Ok(rows)
    }

    /// The row whose cell begins at `at`.
    fn row(&self, page: &[u8], at: usize) -> Result<Row> {
        let short = || self.damaged("a row is cut short");
        let mut rest = page.get(at..).ok_or_else(short)?;
        let length = varint(&mut rest).ok_or_else(short)?;
        let number = varint(&mut rest).ok_or_else(short)?;
        let length = usize::try_from(length).map_err(|_| short())?;
        if length > self.bytes.len() {
            return Err(short());
        }
        let local = self.local(length);
        let mut payload = rest.get(..local).ok_or_else(short)?.to_vec();
        let mut next = if local < length { u32_at(rest, local).ok_or_else(short)? } else { 0 };
        // Each page brings something, so that the chain ends.
        while payload.len() < length {
            let page = self.page(next)?;
            let part = (length - payload.len()).min(self.usable - 4);
            payload.extend_from_slice(&page[4..4 + part]);
            next = u32_at(page, 0).unwrap_or(0);
        }
        let values = record(&payload).ok_or_else(short)?;
        Ok(Row { number, values })
    }

    /// Bytes of a payload that stand in its own page [SQLite] §1.6.
    fn local(&self, length: usize) -> usize {
        let most = self.usable - 35;
        if length <= most {
            return length;
        }
        let least = (self.usable - 12) * 32 / 255 - 23;
        let fitting = least + (length - least) % (self.usable - 4);
        if fitting <= most { fitting } else { least }
    }
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_be_bytes(bytes.get(at..)?.first_chunk::<2>().copied()?))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(bytes.get(at..)?.first_chunk::<4>().copied()?))
}

/// Takes a number of one to nine bytes [SQLite] §1.6.
fn varint(bytes: &mut &[u8]) -> Option<i64> {
    let mut number = 0u64;
    for index in 0..9 {
        let (&byte, rest) = bytes.split_first()?;
        *bytes = rest;
        if index == 8 {
            return Some((number << 8 | u64::from(byte)) as i64);
        }
        number = number << 7 | u64::from(byte & 0x7F);
        if byte < 0x80 {
            break;
        }
    }
    Some(number as i64)
}

/// Values of a record [SQLite] §2.1.
fn record(payload: &[u8]) -> Option<Vec<Value>> {
    let mut rest = payload;
    let head = usize::try_from(varint(&mut rest)?).ok()?;
    let head_used = payload.len() - rest.len();
    let mut kinds = payload.get(head_used..head)?;
    let mut body = payload.get(head..)?;
    let mut values = Vec::new();
    while !kinds.is_empty() {
        let kind = varint(&mut kinds)?;
        let length = match kind {
            0 | 8 | 9 => 0,
            1..=4 => kind as usize,
            5 => 6,
            6 | 7 => 8,
            // 10 and 11 are reserved; negative kinds are damage.
            12.. => usize::try_from((kind - 12) / 2).ok()?,
            _ => return None,
        };
        let (bytes, after) = body.split_at_checked(length)?;
        body = after;
        values.push(match kind {
            0 => Value::Cell(Cell::Missing),
            7 => Value::Cell(Cell::Float(f64::from_be_bytes(*bytes.first_chunk()?))),
            8 | 9 => Value::Cell(Cell::Integer(kind - 8)),
            1..=6 => Value::Cell(Cell::Integer(signed(bytes))),
            _ if kind % 2 == 0 => Value::Blob(bytes.to_vec()),
            _ => Value::Cell(Cell::Text(String::from_utf8_lossy(bytes).into_owned())),
        });
    }
    Some(values)
}

/// A whole number of one to eight bytes, in two's complement.
fn signed(bytes: &[u8]) -> i64 {
    let is_negative = bytes.first().is_some_and(|first| *first >= 0x80);
    bytes.iter().fold(-i64::from(is_negative), |number, byte| number << 8 | i64::from(*byte))
}

/// Names of the columns in a `CREATE TABLE` statement, and whether one is the row's number.
fn columns(sql: &str) -> Vec<(String, bool)> {
    let (Some(open), Some(close)) = (sql.find('('), sql.rfind(')')) else { return Vec::new() };
    let Some(body) = sql.get(open + 1..close) else { return Vec::new() };
    let definitions = split_outside(body).into_iter().map(str::trim);
    definitions.filter_map(column).collect()
}

/// Splits at commas outside parentheses and quotes.
fn split_outside(text: &str) -> Vec<&str> {
    let (mut parts, mut start, mut depth) = (Vec::new(), 0, 0i32);
    let mut quote = None;
    for (at, letter) in text.char_indices() {
        match (quote, letter) {
            (Some(end), _) => quote = (letter != end).then_some(end),
            (None, '"' | '\'' | '`') => quote = Some(letter),
            (None, '[') => quote = Some(']'),
            (None, '(') => depth += 1,
            (None, ')') => depth -= 1,
            (None, ',') if depth == 0 => {
                parts.push(&text[start..at]);
                start = at + 1;
            }
            _ => {}
        }
    }
    parts.push(&text[start..]);
    parts
}

/// A column's name; `None` for a constraint of the table.
fn column(definition: &str) -> Option<(String, bool)> {
    let end_of = |end: char| {
        definition[1..].find(end).map(|at| (&definition[1..=at], &definition[at + 2..]))
    };
    let (name, rest) = match definition.chars().next()? {
        quote @ ('"' | '`') => end_of(quote)?,
        '[' => end_of(']')?,
        _ => {
            let end = definition.find(|c: char| c.is_whitespace()).unwrap_or(definition.len());
            let (name, rest) = definition.split_at(end);
            let constraints = ["PRIMARY", "UNIQUE", "CHECK", "FOREIGN", "CONSTRAINT"];
            if constraints.iter().any(|word| name.eq_ignore_ascii_case(word)) {
                return None;
            }
            (name, rest)
        }
    };
    let words: Vec<String> = rest.split_whitespace().map(str::to_ascii_uppercase).collect();
    // An INTEGER PRIMARY KEY is not stored: it is the row's number [SQLite] §2.3.
    let is_number = words.first().is_some_and(|kind| kind == "INTEGER")
        && words.windows(2).any(|pair| pair[0] == "PRIMARY" && pair[1].starts_with("KEY"));
    Some((name.into(), is_number))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_all_lengths_are_read() {
        let read = |bytes: &[u8]| varint(&mut &bytes[..]);
        assert_eq!(read(&[0x7F]), Some(127));
        assert_eq!(read(&[0x81, 0x00]), Some(128));
        assert_eq!(read(&[0xFF; 9]), Some(-1));
        assert_eq!(read(&[0x80]), None);
        assert_eq!((signed(&[0xFF, 0xFE]), signed(&[0x01, 0x00]), signed(&[])), (-2, 256, 0));
    }

    #[test]
    fn columns_of_a_statement_are_found() {
        let sql = "CREATE TABLE \"trees, old\" ( \"fid\" INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,\
                   [a, b] TEXT DEFAULT ('x, y'), geom POINT, h DECIMAL(4, 2), UNIQUE (h))";
        let expected = [("fid", true), ("a, b", false), ("geom", false), ("h", false)];
        assert_eq!(columns(sql), expected.map(|(name, is_number)| (name.to_string(), is_number)));
        assert!(columns("nonsense").is_empty() && columns(")(").is_empty());
    }
}
