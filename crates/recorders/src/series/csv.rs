//! The table as CSV: a line of names, then values between commas; a missing value is empty.

use std::io::{self, Write};

use super::{COLUMNS, Table, Value};

/// Writes CSV.
pub struct Csv<W: Write>(W);

impl<W: Write> Csv<W> {
    /// Begins a table with the line of names.
    pub fn new(mut output: W) -> io::Result<Self> {
        for (number, column) in COLUMNS.iter().enumerate() {
            let comma = if number == 0 { "" } else { "," };
            write!(output, "{comma}{}", column.name)?;
        }
        writeln!(output)?;
        Ok(Self(output))
    }
}

impl<W: Write + Send> Table for Csv<W> {
    fn row(&mut self, values: &[Value<'_>; COLUMNS.len()]) -> io::Result<()> {
        for (number, value) in values.iter().enumerate() {
            if number > 0 {
                self.0.write_all(b",")?;
            }
            match value {
                Value::Null => {}
                Value::Integer(number) => write!(self.0, "{number}")?,
                // Quotes as in RFC 4180.
                Value::Text(text) if text.contains(['"', ',', '\n', '\r']) => {
                    write!(self.0, "\"{}\"", text.replace('"', "\"\""))?;
                }
                Value::Text(text) => write!(self.0, "{text}")?,
            }
        }
        writeln!(self.0)
    }

    fn finish(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}
