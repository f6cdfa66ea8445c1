//! The table as Parquet: plain values without compression, in row groups of a bounded size.
//!
//! A file is `PAR1`, the pages of each row group column by column, the description of them all, its length and `PAR1`. A
//! page of an optional column begins with a bit for each row: whether there is a value.

use std::io::{self, Write};

use polars_parquet_format as format;
use polars_parquet_format::thrift::protocol::TCompactOutputProtocol;

use super::{COLUMNS, Column, Kind, Table, Value};

/// Writes Parquet.
pub struct Parquet<W: Write> {
    output: W,
    /// Bytes written.
    at: i64,
    columns: [Buffer; COLUMNS.len()],
    rows: usize,
    groups: Vec<format::RowGroup>,
    group_rows: usize,
}

/// The values of a row group in one column.
#[derive(Default)]
struct Buffer {
    values: Vec<u8>,
    present: Vec<bool>,
}

/// Rows of a row group: about 8 MB.
pub(crate) const GROUP_ROWS: usize = 65_536;
const MAGIC: &[u8; 4] = b"PAR1";

impl<W: Write> Parquet<W> {
    /// Begins a file.
    pub fn new(output: W) -> io::Result<Self> {
        Self::with_groups_of(output, GROUP_ROWS)
    }

    /// The same with so many rows in a row group, one at least.
    pub fn with_groups_of(mut output: W, group_rows: usize) -> io::Result<Self> {
        output.write_all(MAGIC)?;
        let (columns, groups) = (Default::default(), Vec::new());
        let group_rows = group_rows.max(1);
        Ok(Self { output, at: MAGIC.len() as i64, columns, rows: 0, groups, group_rows })
    }

    fn end_group(&mut self) -> io::Result<()> {
        if self.rows == 0 {
            return Ok(());
        }
        let begin = self.at;
        let mut chunks = Vec::with_capacity(COLUMNS.len());
        for number in 0..COLUMNS.len() {
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
        let Buffer { values, present } = &mut self.columns[number];
        let column = &COLUMNS[number];
        let mut body = match column.kind {
            Kind::Optional => levels(present),
            Kind::Integer | Kind::Text => Vec::new(),
        };
        body.append(values);
        present.clear();
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
            physical(column),
            vec![plain, rle],
            vec![column.name.to_owned()],
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
}

impl<W: Write> Table for Parquet<W> {
    fn row(&mut self, values: &[Value<'_>; COLUMNS.len()]) -> io::Result<()> {
        for (buffer, value) in self.columns.iter_mut().zip(values) {
            buffer.present.push(*value != Value::Null);
            match value {
                Value::Null => {}
                Value::Integer(number) => buffer.values.extend(number.to_le_bytes()),
                Value::Text(text) => {
                    buffer.values.extend((text.len() as u32).to_le_bytes());
                    buffer.values.extend(text.as_bytes());
                }
            }
        }
        self.rows += 1;
        if self.rows == self.group_rows { self.end_group() } else { Ok(()) }
    }

    fn finish(&mut self) -> io::Result<()> {
        self.end_group()?;
        let groups = std::mem::take(&mut self.groups);
        let rows = groups.iter().map(|group| group.num_rows).sum();
        let creator = concat!("isocat version ", env!("CARGO_PKG_VERSION")).to_owned();
        let file =
            format::FileMetaData::new(1, schema(), rows, groups, None, creator, None, None, None);
        let mut bytes = Vec::new();
        file.write_to_out_protocol(&mut TCompactOutputProtocol::new(&mut bytes))
            .map_err(io::Error::other)?;
        let len = u32::try_from(bytes.len()).map_err(io::Error::other)?;
        bytes.extend(len.to_le_bytes());
        bytes.extend(MAGIC);
        self.output.write_all(&bytes)?;
        self.output.flush()
    }
}

/// The root and the columns.
fn schema() -> Vec<format::SchemaElement> {
    let root = format::SchemaElement::new(
        None,
        None,
        None,
        "series".to_owned(),
        COLUMNS.len() as i32,
        None,
        None,
        None,
        None,
        None,
    );
    let leaf = |column: &Column| {
        let is_text = column.kind == Kind::Text;
        let repetition = match column.kind {
            Kind::Optional => format::FieldRepetitionType::OPTIONAL,
            Kind::Integer | Kind::Text => format::FieldRepetitionType::REQUIRED,
        };
        format::SchemaElement::new(
            physical(column),
            None,
            repetition,
            column.name.to_owned(),
            None,
            is_text.then_some(format::ConvertedType::UTF8),
            None,
            None,
            None,
            is_text.then_some(format::LogicalType::STRING(format::StringType {})),
        )
    };
    std::iter::once(root).chain(COLUMNS.iter().map(leaf)).collect()
}

fn physical(column: &Column) -> format::Type {
    match column.kind {
        Kind::Integer | Kind::Optional => format::Type::INT64,
        Kind::Text => format::Type::BYTE_ARRAY,
    }
}

/// Definition levels: their length, one run of groups of 8, and a bit for each row, the first one lowest.
fn levels(present: &[bool]) -> Vec<u8> {
    let groups = present.len().div_ceil(8);
    let mut bytes = vec![0; 4];
    let mut header = groups << 1 | 1;
    while header >= 0x80 {
        bytes.push(header as u8 | 0x80);
        header >>= 7;
    }
    bytes.push(header as u8);
    let bits = |group: &[bool]| group.iter().rev().fold(0, |byte, bit| byte << 1 | u8::from(*bit));
    bytes.extend(present.chunks(8).map(bits));
    let len = (bytes.len() - 4) as u32;
    bytes[..4].copy_from_slice(&len.to_le_bytes());
    bytes
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
