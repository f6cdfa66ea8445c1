//! A table as Parquet: plain values without compression, in row groups of a bounded size.
//!
//! A file is `PAR1`, the pages of each row group column by column, the description of them all, its length and `PAR1`. A
//! page of an optional column begins with a bit for each row: whether there is a value.

use std::fmt;
use std::io::{self, Write};

use polars_parquet_format as format;
use polars_parquet_format::thrift::protocol::TCompactOutputProtocol;

/// A column.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Field {
    /// Its name.
    pub name: String,
    /// What stands in it.
    pub kind: Kind,
    /// A row may have nothing there.
    pub optional: bool,
}

/// What stands in a column.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Kind {
    /// A 64-bit integer with its sign.
    Integer,
    /// True or false.
    Flag,
    /// A text.
    Text,
}

/// A value of a row.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Cell<'a> {
    /// Nothing, in a column that is optional.
    Null,
    /// A number.
    Integer(i64),
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
    /// Bytes written.
    at: i64,
    columns: Vec<Column>,
    rows: usize,
    groups: Vec<format::RowGroup>,
    group_rows: usize,
}

/// A column and its values in a row group.
struct Column {
    field: Field,
    values: Vec<u8>,
    /// Values of a column of flags: they stand in bits.
    flags: Vec<bool>,
    present: Vec<bool>,
}

const MAGIC: &[u8; 4] = b"PAR1";

impl<W: Write> Writer<W> {
    /// Begins a file of a table with these columns and so many rows in a row group, one at least.
    pub fn new(
        mut output: W,
        name: &'static str,
        fields: Vec<Field>,
        group_rows: usize,
    ) -> io::Result<Self> {
        output.write_all(MAGIC)?;
        let column =
            |field| Column { field, values: Vec::new(), flags: Vec::new(), present: Vec::new() };
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

    /// One row: a cell for each column, of its kind. A cell of another kind is an error of the caller.
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
            chunks.push(self.page(number)?);
        }
        let size = self.at - begin;
        let ordinal = i16::try_from(self.groups.len()).ok();
        let rows = std::mem::take(&mut self.rows) as i64;
        let group = format::RowGroup::new(chunks, size, rows, None, begin, size, ordinal);
        self.groups.push(group);
        Ok(())
    }

    /// Writes the one page that a column has in a row group.
    fn page(&mut self, number: usize) -> io::Result<format::ColumnChunk> {
        let column = &mut self.columns[number];
        let mut body = column.take();
        let (plain, rle) = (format::Encoding::PLAIN, format::Encoding::RLE);
        let rows = self.rows;
        let data = format::DataPageHeader::new(rows as i32, plain, rle, rle, None);
        let size = i32::try_from(body.len()).map_err(io::Error::other)?;
        let kind = format::PageType::DATA_PAGE;
        let page = format::PageHeader::new(kind, size, size, None, data, None, None, None);
        let mut bytes = Vec::new();
        page.write_to_out_protocol(&mut TCompactOutputProtocol::new(&mut bytes))
            .map_err(io::Error::other)?;
        bytes.append(&mut body);
        let (begin, size) = (self.at, bytes.len() as i64);
        self.output.write_all(&bytes)?;
        self.at += size;
        let data = format::ColumnMetaData::new(
            column.field.physical(),
            vec![plain, rle],
            vec![column.field.name.clone()],
            format::CompressionCodec::UNCOMPRESSED,
            rows as i64,
            size,
            size,
            None,
            begin,
            None,
            None,
            None,
            None,
            None,
            None,
            None,
        );
        Ok(format::ColumnChunk::new(None, 0, data, None, None, None, None, None, None))
    }

    /// Ends the file. Without it no reader takes it.
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

    /// The root and the columns.
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
            (Cell::Integer(number), Kind::Integer) => self.values.extend(number.to_le_bytes()),
            (Cell::Flag(flag), Kind::Flag) => self.flags.push(flag),
            (Cell::Text(text), Kind::Text) => {
                self.values.extend((text.len() as u32).to_le_bytes());
                self.values.extend(text.as_bytes());
            }
            (cell, kind) => {
                let name = &self.field.name;
                return Err(io::Error::other(format!("{name}: {cell:?} in a column of {kind:?}")));
            }
        }
        self.present.push(cell != Cell::Null);
        Ok(())
    }

    /// What stands in the page, and the column is empty again.
    fn take(&mut self) -> Vec<u8> {
        let mut body = match self.field.optional {
            true => levels(&self.present),
            false => Vec::new(),
        };
        body.append(&mut self.values);
        body.extend(bits(&self.flags));
        self.flags.clear();
        self.present.clear();
        body
    }
}

impl Field {
    fn physical(&self) -> format::Type {
        match self.kind {
            Kind::Integer => format::Type::INT64,
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

/// Definition levels: their length, one run of groups of 8, and a bit for each row.
fn levels(present: &[bool]) -> Vec<u8> {
    let groups = present.len().div_ceil(8);
    let mut bytes = vec![0; 4];
    let mut header = groups << 1 | 1;
    while header >= 0x80 {
        bytes.push(header as u8 | 0x80);
        header >>= 7;
    }
    bytes.push(header as u8);
    bytes.extend(bits(present));
    let len = (bytes.len() - 4) as u32;
    bytes[..4].copy_from_slice(&len.to_le_bytes());
    bytes
}

/// A bit for each flag, the first one lowest.
fn bits(flags: &[bool]) -> impl Iterator<Item = u8> {
    let byte = |group: &[bool]| group.iter().rev().fold(0, |byte, bit| byte << 1 | u8::from(*bit));
    flags.chunks(8).map(byte)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_bits_lowest_first() {
        assert_eq!(levels(&[true, false, true]), [2, 0, 0, 0, 0b11, 0b101]);
        let nine = [true, true, true, true, true, true, true, true, true];
        assert_eq!(levels(&nine), [3, 0, 0, 0, 0b101, 0xFF, 1]);
        // 64 groups need a header of two bytes.
        let many = levels(&[true; 512]);
        assert_eq!((many[0], many[4], many[5], many.len()), (66, 0x81, 1, 70));
    }
}
