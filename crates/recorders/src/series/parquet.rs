//! The table as Parquet.

use std::io::{self, Write};

use super::{COLUMNS, Column, Kind, Table, Value};
use crate::parquet::{self, Cell, Field, Writer};

/// Writes Parquet.
pub struct Parquet<W: Write>(Writer<W>);

/// Number of rows in a row group: about 8 MB.
pub(crate) const GROUP_ROWS: usize = 65_536;

impl<W: Write> Parquet<W> {
    /// Begins a file.
    pub fn new(output: W) -> io::Result<Self> {
        Self::with_groups_of(output, GROUP_ROWS)
    }

    /// Begins a file with this number of rows in a row group, at least 1.
    pub fn with_groups_of(output: W, group_rows: usize) -> io::Result<Self> {
        let fields = COLUMNS.iter().map(field).collect();
        Ok(Self(Writer::new(output, "series", fields, group_rows)?))
    }
}

impl<W: Write + Send> Table for Parquet<W> {
    fn row(&mut self, values: &[Value<'_>; COLUMNS.len()]) -> io::Result<()> {
        self.0.row(values.iter().map(|value| match *value {
            Value::Null => Cell::Null,
            Value::Integer(number) => Cell::Integer(number),
            Value::Text(text) => Cell::Text(text),
        }))
    }

    fn finish(&mut self) -> io::Result<()> {
        self.0.finish()
    }
}

fn field(column: &Column) -> Field {
    let kind = match column.kind {
        Kind::Integer | Kind::Optional => parquet::Kind::Integer,
        Kind::Text => parquet::Kind::Text,
    };
    Field { name: column.name.to_owned(), kind, optional: column.kind == Kind::Optional }
}
