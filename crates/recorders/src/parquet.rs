//! Writes a table as Parquet, in row groups of bounded size.
//!
//! A file consists of `PAR1`, the pages of each row group column by column, their description, its
//! length and `PAR1`. A page of an optional column begins with one bit for each row, which tells
//! whether there is a value.
//!
//! A column of a row group is written in the shortest of three encodings: as values, as indices of
//! a dictionary that precedes it, or as differences from value to value. There is no general
//! compression: it would gain little, and each of its libraries would be larger than this file.

mod encoding;

use std::collections::HashMap;
use std::fmt;
use std::io::{self, Write};

use polars_parquet_format as format;
use polars_parquet_format::thrift::protocol::TCompactOutputProtocol;

/// A column.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Field {
    /// Its name.
    pub name: String,
    /// The type of its values.
    pub kind: Kind,
    /// Whether a row may have no value.
    pub optional: bool,
}

/// The type of a column's values.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Kind {
    /// A 64-bit integer with its sign.
    Integer,
    /// A number in double precision.
    Float,
    /// True or false.
    Flag,
    /// A text.
    Text,
}

/// The value of a row in a column.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Cell<'a> {
    /// No value, in an optional column.
    Null,
    /// A number.
    Integer(i64),
    /// A number in double precision.
    Float(f64),
    /// True or false.
    Flag(bool),
    /// A text.
    Text(&'a str),
}

impl fmt::Display for Cell<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Null => Ok(()),
            Self::Integer(number) => number.fmt(f),
            Self::Float(number) => number.fmt(f),
            Self::Flag(flag) => flag.fmt(f),
            Self::Text(text) => f.write_str(text),
        }
    }
}

/// Writes Parquet.
pub struct Writer<W: Write> {
    output: W,
    /// Name of the table.
    name: &'static str,
    /// Number of bytes written.
    at: i64,
    columns: Vec<Column>,
    rows: usize,
    groups: Vec<format::RowGroup>,
    group_rows: usize,
}

/// A column with its values in the present row group.
struct Column {
    field: Field,
    present: Vec<bool>,
    /// Values of a column of flags, which are packed into bits later.
    flags: Vec<bool>,
    /// Values of a column of numbers.
    integers: Vec<i64>,
    /// Values of any other column, encoded as in a page.
    plain: Vec<u8>,
    dictionary: Dictionary,
}

/// The distinct values of a column, in the order in which they first came.
#[derive(Default)]
struct Dictionary {
    numbers: HashMap<Box<[u8]>, u32>,
    /// The values, encoded as in a page.
    plain: Vec<u8>,
    /// The index of the value of each row that has one.
    indices: Vec<u32>,
    /// There are too many values for a dictionary to save space.
    is_full: bool,
}

/// Values that a dictionary holds at most.
const MOST_ENTRIES: usize = 1 << 15;

impl Dictionary {
    fn add(&mut self, value: &[u8], plain: &[u8]) {
        if self.is_full {
            return;
        }
        let next = self.numbers.len() as u32;
        let number = match self.numbers.get(value) {
            Some(number) => *number,
            None if self.numbers.len() == MOST_ENTRIES => {
                *self = Self { is_full: true, ..Self::default() };
                return;
            }
            None => {
                self.numbers.insert(value.into(), next);
                self.plain.extend(plain);
                next
            }
        };
        self.indices.push(number);
    }

    /// Its page, its number of values, and the body of the column's page.
    fn take(&mut self) -> Option<(Vec<u8>, usize, Vec<u8>)> {
        let taken = std::mem::take(self);
        let entries = taken.numbers.len();
        if taken.is_full || entries == 0 {
            return None;
        }
        let width = 32 - (entries as u32 - 1).leading_zeros();
        let mut body = vec![width as u8];
        body.extend(encoding::hybrid(&taken.indices, width));
        Some((taken.plain, entries, body))
    }
}

/// The contents of a column's pages in a row group.
struct Pages {
    encoding: format::Encoding,
    /// A dictionary page, and its number of values.
    dictionary: Option<(Vec<u8>, usize)>,
    body: Vec<u8>,
}

const MAGIC: &[u8; 4] = b"PAR1";

impl<W: Write> Writer<W> {
    /// Begins a file of a table with these columns, and with this number of rows in a row group, at
    /// least 1.
    pub fn new(
        mut output: W,
        name: &'static str,
        fields: Vec<Field>,
        group_rows: usize,
    ) -> io::Result<Self> {
        output.write_all(MAGIC)?;
        let column = |field| Column {
            field,
            present: Vec::new(),
            flags: Vec::new(),
            integers: Vec::new(),
            plain: Vec::new(),
            dictionary: Dictionary::default(),
        };
        Ok(Self {
            output,
            name,
            at: MAGIC.len() as i64,
            columns: fields.into_iter().map(column).collect(),
            rows: 0,
            groups: Vec::new(),
            group_rows: group_rows.max(1),
        })
    }

    /// Adds a row: one cell for each column, of the column's kind. A cell of another kind is an
    /// error of the caller.
    pub fn row<'a>(&mut self, cells: impl IntoIterator<Item = Cell<'a>>) -> io::Result<()> {
        let mut cells = cells.into_iter();
        for column in &mut self.columns {
            let cell = cells.next().unwrap_or(Cell::Null);
            column.push(cell)?;
        }
        self.rows += 1;
        if self.rows == self.group_rows { self.end_group() } else { Ok(()) }
    }

    fn end_group(&mut self) -> io::Result<()> {
        if self.rows == 0 {
            return Ok(());
        }
        let begin = self.at;
        let mut chunks = Vec::with_capacity(self.columns.len());
        for number in 0..self.columns.len() {
            chunks.push(self.chunk(number)?);
        }
        let size = self.at - begin;
        let ordinal = i16::try_from(self.groups.len()).ok();
        let rows = std::mem::take(&mut self.rows) as i64;
        let group = format::RowGroup::new(chunks, size, rows, None, begin, size, ordinal);
        self.groups.push(group);
        Ok(())
    }

    /// Writes the page of a column in a row group, after its dictionary if there is one.
    fn chunk(&mut self, number: usize) -> io::Result<format::ColumnChunk> {
        let Pages { encoding, dictionary, body } = self.columns[number].take();
        let (begin, rows) = (self.at, self.rows);
        let (plain, rle) = (format::Encoding::PLAIN, format::Encoding::RLE);
        let mut encodings = vec![encoding, rle];
        let dictionary_at = dictionary.as_ref().map(|_| begin);
        if let Some((values, entries)) = dictionary {
            encodings.push(plain);
            let head = format::DictionaryPageHeader::new(entries as i32, plain, false);
            self.page(format::PageType::DICTIONARY_PAGE, None, Some(head), &values)?;
        }
        let data_at = self.at;
        let head = format::DataPageHeader::new(rows as i32, encoding, rle, rle, None);
        self.page(format::PageType::DATA_PAGE, Some(head), None, &body)?;
        let (field, size) = (&self.columns[number].field, self.at - begin);
        let data = format::ColumnMetaData::new(
            field.physical(),
            encodings,
            vec![field.name.clone()],
            format::CompressionCodec::UNCOMPRESSED,
            rows as i64,
            size,
            size,
            None,
            data_at,
            None,
            dictionary_at,
            None,
            None,
            None,
            None,
            None,
        );
        Ok(format::ColumnChunk::new(None, 0, data, None, None, None, None, None, None))
    }

    fn page(
        &mut self,
        kind: format::PageType,
        data: Option<format::DataPageHeader>,
        dictionary: Option<format::DictionaryPageHeader>,
        body: &[u8],
    ) -> io::Result<()> {
        let size = i32::try_from(body.len()).map_err(io::Error::other)?;
        let head = format::PageHeader::new(kind, size, size, None, data, None, dictionary, None);
        let mut bytes = Vec::new();
        head.write_to_out_protocol(&mut TCompactOutputProtocol::new(&mut bytes))
            .map_err(io::Error::other)?;
        self.output.write_all(&bytes)?;
        self.output.write_all(body)?;
        self.at += (bytes.len() + body.len()) as i64;
        Ok(())
    }

    /// Ends the file. A file without this can't be read.
    pub fn finish(&mut self) -> io::Result<()> {
        self.end_group()?;
        let groups = std::mem::take(&mut self.groups);
        let rows = groups.iter().map(|group| group.num_rows).sum();
        let creator = concat!("isocat version ", env!("CARGO_PKG_VERSION")).to_owned();
        let schema = self.schema();
        let file =
            format::FileMetaData::new(1, schema, rows, groups, None, creator, None, None, None);
        let mut bytes = Vec::new();
        file.write_to_out_protocol(&mut TCompactOutputProtocol::new(&mut bytes))
            .map_err(io::Error::other)?;
        let len = u32::try_from(bytes.len()).map_err(io::Error::other)?;
        bytes.extend(len.to_le_bytes());
        bytes.extend(MAGIC);
        self.output.write_all(&bytes)?;
        self.output.flush()
    }

    /// Describes the root and the columns.
    fn schema(&self) -> Vec<format::SchemaElement> {
        let root = format::SchemaElement::new(
            None,
            None,
            None,
            self.name.to_owned(),
            self.columns.len() as i32,
            None,
            None,
            None,
            None,
            None,
        );
        std::iter::once(root).chain(self.columns.iter().map(|column| column.field.leaf())).collect()
    }
}

impl Column {
    fn push(&mut self, cell: Cell<'_>) -> io::Result<()> {
        match (cell, self.field.kind) {
            (Cell::Null, _) if self.field.optional => {}
            (Cell::Integer(number), Kind::Integer) => {
                let bytes = number.to_le_bytes();
                self.integers.push(number);
                self.dictionary.add(&bytes, &bytes);
            }
            (Cell::Float(number), Kind::Float) => self.plain.extend(number.to_le_bytes()),
            (Cell::Flag(flag), Kind::Flag) => self.flags.push(flag),
            (Cell::Text(text), Kind::Text) => {
                let begin = self.plain.len();
                self.plain.extend((text.len() as u32).to_le_bytes());
                self.plain.extend(text.as_bytes());
                self.dictionary.add(text.as_bytes(), &self.plain[begin..]);
            }
            (cell, kind) => {
                let name = &self.field.name;
                return Err(io::Error::other(format!("{name}: {cell:?} in a column of {kind:?}")));
            }
        }
        self.present.push(cell != Cell::Null);
        Ok(())
    }

    /// The contents of its pages, in the shortest encoding; empties the column.
    fn take(&mut self) -> Pages {
        let plain = match self.field.kind {
            Kind::Integer => self.integers.iter().flat_map(|number| number.to_le_bytes()).collect(),
            Kind::Flag => encoding::bits(&self.flags),
            Kind::Float | Kind::Text => std::mem::take(&mut self.plain),
        };
        let mut pages = Pages { encoding: format::Encoding::PLAIN, dictionary: None, body: plain };
        if self.field.kind == Kind::Integer {
            let body = encoding::delta(&self.integers);
            if body.len() < pages.body.len() {
                pages = Pages {
                    encoding: format::Encoding::DELTA_BINARY_PACKED,
                    dictionary: None,
                    body,
                };
            }
        }
        if let Some((values, entries, body)) = self.dictionary.take()
            && values.len() + body.len() + DICTIONARY_HEAD < pages.body.len()
        {
            let encoding = format::Encoding::RLE_DICTIONARY;
            pages = Pages { encoding, dictionary: Some((values, entries)), body };
        }
        if self.field.optional {
            let mut body = encoding::levels(&self.present);
            body.append(&mut pages.body);
            pages.body = body;
        }
        self.flags.clear();
        self.integers.clear();
        self.present.clear();
        pages
    }
}

/// Approximate size of the header of a dictionary page, bytes.
const DICTIONARY_HEAD: usize = 24;

impl Field {
    fn physical(&self) -> format::Type {
        match self.kind {
            Kind::Integer => format::Type::INT64,
            Kind::Float => format::Type::DOUBLE,
            Kind::Flag => format::Type::BOOLEAN,
            Kind::Text => format::Type::BYTE_ARRAY,
        }
    }

    fn leaf(&self) -> format::SchemaElement {
        let is_text = self.kind == Kind::Text;
        let repetition = match self.optional {
            true => format::FieldRepetitionType::OPTIONAL,
            false => format::FieldRepetitionType::REQUIRED,
        };
        format::SchemaElement::new(
            self.physical(),
            None,
            repetition,
            self.name.clone(),
            None,
            is_text.then_some(format::ConvertedType::UTF8),
            None,
            None,
            None,
            is_text.then_some(format::LogicalType::STRING(format::StringType {})),
        )
    }
}
