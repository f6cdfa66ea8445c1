//! The file with a row for each run: CSV, or Parquet if its name ends in .parquet.

use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, BufWriter, Read, Seek, Write};
use std::path::{Path, PathBuf};

use isocat_descriptions::columns::cut;
use isocat_engine::sweep::{Row, Sweep};
use isocat_recorders::parquet::{Cell, Field, Kind, Writer};

use crate::cli::run::unwritable;

/// The file of the rows.
pub(super) enum Rows {
    Csv(Csv),
    Parquet(Parquet),
}

impl Rows {
    /// Begins a file, or continues one.
    pub fn open(path: &Path, sweep: &Sweep, resume: bool) -> Result<Self, String> {
        if !resume && path.exists() {
            return Err(format!(
                "{} is there already; expected another name, or --resume to go on with it",
                path.display()
            ));
        }
        match path.extension().is_some_and(|ending| ending == "parquet") {
            false => Ok(Self::Csv(Csv::open(path, sweep)?)),
            true if resume => Err(format!(
                "--resume with {}: a Parquet file that was cut off has no table of contents and can't be gone on with; \
                 expected rows in a file that ends in .csv",
                path.display()
            )),
            true => Ok(Self::Parquet(Parquet::begin(path, sweep)?)),
        }
    }

    /// Number of the run whose row comes next.
    pub fn next(&self) -> u64 {
        match self {
            Self::Csv(csv) => csv.next,
            Self::Parquet(_) => 0,
        }
    }

    pub fn write(&mut self, row: &Row) -> Result<(), String> {
        match self {
            Self::Csv(csv) => csv.write(row),
            Self::Parquet(parquet) => parquet.write(row),
        }
    }

    /// Completes the file.
    pub fn finish(&mut self) -> Result<(), String> {
        match self {
            Self::Csv(_) => Ok(()),
            Self::Parquet(parquet) => parquet.finish(),
        }
    }
}

/// Parquet, whose table of contents comes at the end.
pub(super) struct Parquet {
    writer: Writer<BufWriter<File>>,
    /// Axes whose values are numbers.
    whole: Vec<bool>,
    path: PathBuf,
}

/// Rows per row group: some 2 MB.
const GROUP_ROWS: usize = 10_000;

impl Parquet {
    fn begin(path: &Path, sweep: &Sweep) -> Result<Self, String> {
        let whole: Vec<bool> = sweep.axes().iter().map(|axis| axis.is_whole()).collect();
        let begun = File::create_new(path).and_then(|file| {
            Writer::new(BufWriter::new(file), "sweep", fields(sweep, &whole), GROUP_ROWS)
        });
        let writer = begun.map_err(|error| unwritable("rows", Some(path), &error))?;
        Ok(Self { writer, whole, path: path.to_owned() })
    }

    fn write(&mut self, row: &Row) -> Result<(), String> {
        let head = [row.number, row.seed].map(|number| Cell::Integer(number as i64));
        // A run that was refused before it had values has none.
        let value = |(axis, whole): (usize, &bool)| match (row.values.get(axis), whole) {
            (None, _) => Cell::Null,
            (Some(text), true) => text.parse().map_or(Cell::Null, Cell::Integer),
            (Some(text), false) => Cell::Text(text),
        };
        let values = self.whole.iter().enumerate().map(value);
        let written = self.writer.row(head.into_iter().chain(values).chain(row.cells()));
        written.map_err(|error| unwritable("rows", Some(&self.path), &error))
    }

    fn finish(&mut self) -> Result<(), String> {
        self.writer.finish().map_err(|error| unwritable("rows", Some(&self.path), &error))
    }
}

fn fields(sweep: &Sweep, whole: &[bool]) -> Vec<Field> {
    let field = |name: &str, kind, optional| Field { name: name.to_owned(), kind, optional };
    let head = ["number", "seed"].map(|name| field(name, Kind::Integer, false));
    let axes = sweep.axes().iter().zip(whole).map(|(axis, whole)| {
        field(&axis.key, if *whole { Kind::Integer } else { Kind::Text }, true)
    });
    let rest = Row::COLUMNS.map(|(name, kind, optional)| field(name, kind, optional));
    head.into_iter().chain(axes).chain(rest).collect()
}

/// CSV, which can be continued.
pub(super) struct Csv {
    file: File,
    path: PathBuf,
    /// Number of the run whose row comes next.
    next: u64,
}

impl Csv {
    /// Begins a file, or continues one.
    fn open(path: &Path, sweep: &Sweep) -> Result<Self, String> {
        let wrong = |error: &std::io::Error| unwritable("rows", Some(path), error);
        let mut options = OpenOptions::new();
        let file = options.read(true).write(true).create(true).truncate(false).open(path);
        let mut file = file.map_err(|error| wrong(&error))?;
        let head = head(sweep);
        let (next, whole) = last_row(&mut file, &head, path)?;
        // A row that was cut off is written again.
        file.set_len(whole)
            .and_then(|()| file.seek(std::io::SeekFrom::End(0)))
            .map_err(|e| wrong(&e))?;
        if whole == 0 {
            file.write_all(head.as_bytes()).map_err(|error| wrong(&error))?;
        }
        Ok(Self { file, path: path.to_owned(), next })
    }

    fn write(&mut self, row: &Row) -> Result<(), String> {
        let mut line = format!("{},{}", row.number, row.seed);
        let cells = row.cells().map(|cell| cell.to_string());
        for value in row.values.iter().chain(&cells) {
            line.push(',');
            line += &cell(value);
        }
        line.push('\n');
        let written = self.file.write_all(line.as_bytes());
        written.map_err(|error| unwritable("rows", Some(&self.path), &error))
    }
}

fn head(sweep: &Sweep) -> String {
    let mut head = "number,seed".to_owned();
    let keys = sweep.axes().iter().map(|axis| axis.key.as_str());
    for name in keys.chain(Row::COLUMNS.map(|(name, ..)| name)) {
        head.push(',');
        head += &cell(name);
    }
    head + "\n"
}

/// The number of the next row of a file, and the length of its complete rows in bytes.
fn last_row(file: &mut File, head: &str, path: &Path) -> Result<(u64, u64), String> {
    let unreadable = |error: std::io::Error| format!("{} can't be read: {error}", path.display());
    let mut reader = BufReader::new(file);
    let (mut line, mut whole, mut next) = (String::new(), 0, 0);
    loop {
        line.clear();
        let read = reader.by_ref().take(LONGEST_ROW).read_line(&mut line).map_err(unreadable)?;
        if read == 0 || !line.ends_with('\n') {
            return Ok((next, whole));
        }
        if whole == 0 {
            if line != head {
                return Err(format!(
                    "{} is of another sweep: its columns are {}; expected {}",
                    path.display(),
                    cut(line.trim_end(), 60),
                    cut(head.trim_end(), 60)
                ));
            }
        } else {
            let number = line.split(',').next().and_then(|number| number.parse::<u64>().ok());
            if number != Some(next) {
                return Err(format!(
                    "{}: its row {next} has the number {number:?}; expected {next}",
                    path.display()
                ));
            }
            next += 1;
        }
        whole += read as u64;
    }
}

/// Limit of a row's length; a row has some 200 bytes.
const LONGEST_ROW: u64 = 1 << 20;

/// A cell of a CSV file, in one line.
fn cell(text: &str) -> String {
    let text = text.replace(['\n', '\r'], " ");
    match text.contains([',', '"']) {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text,
    }
}
