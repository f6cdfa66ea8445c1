//! Results with rows and columns, in Arrow's memory layout: other libraries can use them without a
//! copy, but none is required.

use std::io::{self, BufWriter};
use std::path::PathBuf;
use std::sync::Arc;

use arrow_array::builder::{BooleanBuilder, Float64Builder, Int64Builder, StringBuilder};
use arrow_array::cast::AsArray;
use arrow_array::ffi::FFI_ArrowSchema;
use arrow_array::ffi_stream::FFI_ArrowArrayStream;
use arrow_array::types::{Float64Type, Int64Type};
use arrow_array::{Array, ArrayRef, RecordBatch, RecordBatchIterator};
use arrow_buffer::{BooleanBuffer, Buffer, NullBuffer, OffsetBuffer, ScalarBuffer};
use arrow_schema::{DataType, Field, Schema};
use isocat_recorders::parquet;
use pyo3::exceptions::{PyAttributeError, PyIndexError, PyKeyError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyCapsule, PyDict, PyList, PyTuple};

use crate::error::{Class, Failure};
use crate::output;

/// Collects rows.
pub struct Rows {
    fields: Vec<Field>,
    columns: Vec<Building>,
}

enum Building {
    Integer(Int64Builder),
    Float(Float64Builder),
    Flag(BooleanBuilder),
    Text(StringBuilder),
}

/// The type of a column's values.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Kind {
    Integer,
    Float,
    Flag,
    Text,
}

/// The value of a row in a column.
#[derive(Clone, Copy, Debug)]
pub enum Cell<'a> {
    Null,
    Integer(i64),
    Float(f64),
    Flag(bool),
    Text(&'a str),
}

impl From<Option<i64>> for Cell<'_> {
    fn from(value: Option<i64>) -> Self {
        value.map_or(Self::Null, Self::Integer)
    }
}

impl From<Option<f64>> for Cell<'_> {
    fn from(value: Option<f64>) -> Self {
        value.map_or(Self::Null, Self::Float)
    }
}

impl<'a> From<Option<&'a str>> for Cell<'a> {
    fn from(value: Option<&'a str>) -> Self {
        value.map_or(Self::Null, Self::Text)
    }
}

impl Rows {
    /// Makes empty rows with these columns: name, kind, and whether a cell may be empty.
    pub fn new<N: Into<String>>(columns: impl IntoIterator<Item = (N, Kind, bool)>) -> Self {
        let field = |(name, kind, optional): (N, Kind, bool)| {
            let data = match kind {
                Kind::Integer => DataType::Int64,
                Kind::Float => DataType::Float64,
                Kind::Flag => DataType::Boolean,
                Kind::Text => DataType::Utf8,
            };
            Field::new(name.into(), data, optional)
        };
        let fields: Vec<Field> = columns.into_iter().map(field).collect();
        let columns = fields.iter().map(|field| Building::of(field.data_type())).collect();
        Self { fields, columns }
    }

    /// Adds a row: one cell for each column, of the column's kind.
    pub fn push<'a>(&mut self, cells: impl IntoIterator<Item = Cell<'a>>) {
        let mut cells = cells.into_iter();
        for column in &mut self.columns {
            column.push(cells.next().unwrap_or(Cell::Null));
        }
    }

    /// The number of rows.
    pub fn len(&self) -> usize {
        match self.columns.first() {
            Some(Building::Integer(first)) => arrow_array::builder::ArrayBuilder::len(first),
            Some(Building::Float(first)) => arrow_array::builder::ArrayBuilder::len(first),
            Some(Building::Flag(first)) => arrow_array::builder::ArrayBuilder::len(first),
            Some(Building::Text(first)) => arrow_array::builder::ArrayBuilder::len(first),
            None => 0,
        }
    }

    /// Returns the table and empties the rows.
    pub fn take(&mut self) -> Table {
        let columns: Vec<ArrayRef> = self.columns.iter_mut().map(Building::finish).collect();
        let schema = Arc::new(Schema::new(self.fields.clone()));
        // Columns have the kinds of their fields and equal lengths, and required cells were given.
        let batch = RecordBatch::try_new(schema, columns).expect("each row had all cells");
        Table { batch }
    }
}

impl Building {
    fn of(data: &DataType) -> Self {
        match data {
            DataType::Int64 => Self::Integer(Int64Builder::new()),
            DataType::Float64 => Self::Float(Float64Builder::new()),
            DataType::Boolean => Self::Flag(BooleanBuilder::new()),
            _ => Self::Text(StringBuilder::new()),
        }
    }

    fn push(&mut self, cell: Cell<'_>) {
        match (self, cell) {
            (Self::Integer(column), Cell::Integer(value)) => column.append_value(value),
            (Self::Integer(column), _) => column.append_null(),
            (Self::Float(column), Cell::Float(value)) => column.append_value(value),
            (Self::Float(column), _) => column.append_null(),
            (Self::Flag(column), Cell::Flag(value)) => column.append_value(value),
            (Self::Flag(column), _) => column.append_null(),
            (Self::Text(column), Cell::Text(value)) => column.append_value(value),
            (Self::Text(column), _) => column.append_null(),
        }
    }

    fn finish(&mut self) -> ArrayRef {
        match self {
            Self::Integer(column) => Arc::new(column.finish()),
            Self::Float(column) => Arc::new(column.finish()),
            Self::Flag(column) => Arc::new(column.finish()),
            Self::Text(column) => Arc::new(column.finish()),
        }
    }
}

/// Rows and columns, in Arrow's memory layout.
///
/// Every consumer of the Arrow C stream interface can use a table directly, without a copy:
/// ``pyarrow.table(t)``, ``polars.DataFrame(t)``, ``duckdb`` by its name. None of them is required.
///
/// A column without empty cells is a view for numpy: ``numpy.asarray(t["slack_ns"])``.
#[pyclass(module = "isocat", frozen)]
#[derive(Clone)]
pub struct Table {
    pub batch: RecordBatch,
}

impl Table {
    /// Writes the table as Parquet.
    fn write(&self, output: impl io::Write) -> io::Result<()> {
        let fields = self.batch.schema_ref().fields().iter().map(|field| parquet::Field {
            name: field.name().clone(),
            kind: match field.data_type() {
                DataType::Int64 => parquet::Kind::Integer,
                DataType::Float64 => parquet::Kind::Float,
                DataType::Boolean => parquet::Kind::Flag,
                _ => parquet::Kind::Text,
            },
            optional: field.is_nullable(),
        });
        let mut writer = parquet::Writer::new(output, "isocat", fields.collect(), GROUP_ROWS)?;
        for row in 0..self.batch.num_rows() {
            writer.row(self.batch.columns().iter().map(|column| match cell(column, row) {
                Cell::Null => parquet::Cell::Null,
                Cell::Integer(value) => parquet::Cell::Integer(value),
                Cell::Float(value) => parquet::Cell::Float(value),
                Cell::Flag(value) => parquet::Cell::Flag(value),
                Cell::Text(value) => parquet::Cell::Text(value),
            }))?;
        }
        writer.finish()
    }
}

/// Number of rows in a row group.
const GROUP_ROWS: usize = 65_536;

/// The cell of a column in a row.
fn cell(column: &ArrayRef, row: usize) -> Cell<'_> {
    if column.is_null(row) {
        return Cell::Null;
    }
    match column.data_type() {
        DataType::Int64 => Cell::Integer(column.as_primitive::<Int64Type>().value(row)),
        DataType::Float64 => Cell::Float(column.as_primitive::<Float64Type>().value(row)),
        DataType::Boolean => Cell::Flag(column.as_boolean().value(row)),
        _ => Cell::Text(column.as_string::<i32>().value(row)),
    }
}

fn object<'py>(py: Python<'py>, cell: Cell<'_>) -> PyResult<Bound<'py, PyAny>> {
    Ok(match cell {
        Cell::Null => py.None().into_bound(py),
        Cell::Integer(value) => value.into_pyobject(py)?.into_any(),
        Cell::Float(value) => value.into_pyobject(py)?.into_any(),
        Cell::Flag(value) => value.into_pyobject(py)?.to_owned().into_any(),
        Cell::Text(value) => value.into_pyobject(py)?.into_any(),
    })
}

#[pymethods]
impl Table {
    /// Names of the columns, in their order.
    #[getter]
    fn column_names(&self) -> Vec<String> {
        let fields = self.batch.schema_ref().fields().iter();
        fields.map(|field| field.name().clone()).collect()
    }

    fn __len__(&self) -> usize {
        self.batch.num_rows()
    }

    /// A column by its name.
    fn __getitem__(&self, name: &str) -> PyResult<Column> {
        match self.batch.column_by_name(name) {
            Some(array) => Ok(Column { name: name.to_owned(), array: array.clone() }),
            None => {
                let names = self.column_names();
                let hint = isocat::document::name_hint(name, names.iter().map(String::as_str));
                Err(PyKeyError::new_err(format!("no column \"{name}\"; {hint}")))
            }
        }
    }

    /// Each row as a ``dict``.
    fn rows<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let (list, names) = (PyList::empty(py), self.column_names());
        for row in 0..self.batch.num_rows() {
            let dict = PyDict::new(py);
            for (name, column) in names.iter().zip(self.batch.columns()) {
                dict.set_item(name, object(py, cell(column, row))?)?;
            }
            list.append(dict)?;
        }
        Ok(list)
    }

    /// The table as a ``pandas.DataFrame``; needs pandas, but not pyarrow.
    ///
    /// Integer columns with empty cells have the type ``Int64`` of pandas, so values remain
    /// integers.
    fn to_pandas<'py>(slf: Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        slf.py().import("isocat._frames")?.call_method1("to_pandas", (slf,))
    }

    /// Writes a Parquet file, completely or not at all.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike
    ///
    /// Raises
    /// ------
    /// OSError
    ///     The file can't be written, for example on a full disk; an earlier file remains.
    #[pyo3(signature = (path, /))]
    fn to_parquet(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let written = py.detach(|| output::whole(&path, |file| self.write(BufWriter::new(file))));
        written.map_err(|error| output::raise(&error, &path))
    }

    /// The Parquet file as bytes.
    fn parquet_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let mut bytes = Vec::new();
        let written = py.detach(|| self.write(&mut bytes));
        written.map_err(|error| Failure::new(Class::Internal, error.to_string()).raise(py))?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// Joins tables with the same columns, in their order.
    #[staticmethod]
    #[pyo3(signature = (tables, /))]
    fn concat(py: Python<'_>, tables: Vec<PyRef<'_, Table>>) -> PyResult<Self> {
        let Some(first) = tables.first() else {
            return Err(Failure::argument("tables", "none", "one or more").raise(py));
        };
        let schema = first.batch.schema();
        if let Some(other) = tables.iter().find(|table| table.batch.schema() != schema) {
            let found = other.column_names().join(", ");
            let expected = format!("the columns of the first: {}", first.column_names().join(", "));
            return Err(Failure::argument("tables", found, expected).raise(py));
        }
        let batches: Vec<RecordBatch> = tables.iter().map(|table| table.batch.clone()).collect();
        Ok(py.detach(|| {
            let mut columns: Vec<Building> =
                schema.fields().iter().map(|field| Building::of(field.data_type())).collect();
            for batch in &batches {
                for (column, from) in columns.iter_mut().zip(batch.columns()) {
                    (0..batch.num_rows()).for_each(|row| column.push(cell(from, row)));
                }
            }
            let columns = columns.iter_mut().map(Building::finish).collect();
            let batch = RecordBatch::try_new(schema, columns).expect("each has these columns");
            Self { batch }
        }))
    }

    /// ``count`` rows from ``start`` on.
    #[pyo3(signature = (start, count, /))]
    fn slice(&self, start: usize, count: usize) -> Self {
        let start = start.min(self.batch.num_rows());
        let count = count.min(self.batch.num_rows() - start);
        Self { batch: self.batch.slice(start, count) }
    }

    /// Whether all columns and cells are equal.
    fn __eq__(&self, other: &Bound<'_, PyAny>) -> bool {
        other.cast::<Self>().is_ok_and(|other| other.get().batch == self.batch)
    }

    fn __hash__(&self) -> PyResult<isize> {
        Err(pyo3::exceptions::PyTypeError::new_err("tables can't be hashed"))
    }

    fn __repr__(slf: Bound<'_, Self>) -> PyResult<String> {
        slf.py().import("isocat._frames")?.call_method1("text", (slf,))?.extract()
    }

    fn _repr_html_(slf: Bound<'_, Self>) -> PyResult<String> {
        slf.py().import("isocat._frames")?.call_method1("html", (slf,))?.extract()
    }

    /// The Arrow C stream interface; a requested schema is ignored.
    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        let _ = requested_schema;
        let batches = RecordBatchIterator::new([Ok(self.batch.clone())], self.batch.schema());
        let stream = FFI_ArrowArrayStream::new(Box::new(batches));
        PyCapsule::new_with_value(py, stream, c"arrow_array_stream")
    }

    /// The schema alone, by the same interface.
    fn __arrow_c_schema__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyCapsule>> {
        let schema = FFI_ArrowSchema::try_from(self.batch.schema_ref().as_ref());
        let schema =
            schema.map_err(|error| Failure::new(Class::Internal, error.to_string()).raise(py))?;
        PyCapsule::new_with_value(py, schema, c"arrow_schema")
    }

    /// Pickles a table as the bytes of its columns.
    fn __reduce__<'py>(
        slf: Bound<'py, Self>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let py = slf.py();
        let batch = &slf.get().batch;
        let columns = PyList::empty(py);
        for (field, array) in batch.schema_ref().fields().iter().zip(batch.columns()) {
            columns.append(packed(py, field, array)?)?;
        }
        let rebuild = slf.get_type().getattr("_rebuild")?;
        Ok((rebuild, (batch.num_rows(), columns).into_pyobject(py)?))
    }

    /// Restores a table from what `__reduce__` returned.
    #[staticmethod]
    #[pyo3(signature = (rows, columns, /))]
    fn _rebuild(py: Python<'_>, rows: usize, columns: Vec<Packed>) -> PyResult<Self> {
        let columns: Option<Vec<(Field, ArrayRef)>> =
            columns.into_iter().map(|packed| unpacked(rows, packed)).collect();
        let table = columns.and_then(|columns| {
            let (fields, arrays): (Vec<Field>, Vec<ArrayRef>) = columns.into_iter().unzip();
            RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).ok()
        });
        let wrong = || Failure::argument("columns", "other bytes", "those of a pickled table");
        table.map(|batch| Self { batch }).ok_or_else(|| wrong().raise(py))
    }
}

/// Name, kind, whether cells may be empty, a byte for each cell that tells whether it has a value
/// (`None`: all have), values, ends of texts.
type Packed = (String, String, bool, Option<Vec<u8>>, Vec<u8>, Vec<u8>);

fn packed<'py>(py: Python<'py>, field: &Field, array: &ArrayRef) -> PyResult<Bound<'py, PyTuple>> {
    let rows = array.len();
    let present = (array.null_count() > 0)
        .then(|| (0..rows).map(|row| u8::from(array.is_valid(row))).collect::<Vec<u8>>());
    let (mut values, mut ends) = (Vec::new(), Vec::new());
    for row in 0..rows {
        match cell(array, row) {
            Cell::Integer(value) => values.extend(value.to_le_bytes()),
            Cell::Float(value) => values.extend(value.to_le_bytes()),
            Cell::Flag(value) => values.push(u8::from(value)),
            Cell::Text(value) => values.extend(value.as_bytes()),
            // A placeholder, so that each row has a value.
            Cell::Null => match array.data_type() {
                DataType::Utf8 => {}
                DataType::Boolean => values.push(0),
                _ => values.extend([0; 8]),
            },
        }
        if array.data_type() == &DataType::Utf8 {
            ends.extend((values.len() as u32).to_le_bytes());
        }
    }
    let kind = match array.data_type() {
        DataType::Int64 => "integer",
        DataType::Float64 => "float",
        DataType::Boolean => "flag",
        _ => "text",
    };
    let bytes = |bytes: &[u8]| PyBytes::new(py, bytes);
    let present = present.map(|present| bytes(&present));
    (field.name(), kind, field.is_nullable(), present, bytes(&values), bytes(&ends))
        .into_pyobject(py)
}

fn unpacked(
    rows: usize,
    (name, kind, optional, present, values, ends): Packed,
) -> Option<(Field, ArrayRef)> {
    let nulls = match present {
        Some(present) if present.len() != rows => return None,
        present => present.map(|bytes| NullBuffer::from_iter(bytes.iter().map(|byte| *byte != 0))),
    };
    let eight = || -> Option<Vec<[u8; 8]>> {
        let (whole, rest) = values.as_chunks::<8>();
        (whole.len() == rows && rest.is_empty()).then(|| whole.to_vec())
    };
    let (data, array): (DataType, ArrayRef) = match kind.as_str() {
        "integer" => {
            let values: Vec<i64> = eight()?.into_iter().map(i64::from_le_bytes).collect();
            let array = arrow_array::Int64Array::try_new(ScalarBuffer::from(values), nulls);
            (DataType::Int64, Arc::new(array.ok()?))
        }
        "float" => {
            let values: Vec<f64> = eight()?.into_iter().map(f64::from_le_bytes).collect();
            let array = arrow_array::Float64Array::try_new(ScalarBuffer::from(values), nulls);
            (DataType::Float64, Arc::new(array.ok()?))
        }
        "flag" if values.len() == rows => {
            let bits = BooleanBuffer::from_iter(values.iter().map(|byte| *byte != 0));
            (DataType::Boolean, Arc::new(arrow_array::BooleanArray::new(bits, nulls)))
        }
        "text" => {
            let (ends, rest) = ends.as_chunks::<4>();
            let mut offsets = vec![0_i32];
            offsets.extend(ends.iter().map(|end| i32::from_le_bytes(*end)));
            let rising = offsets.windows(2).all(|pair| pair[0] <= pair[1]);
            if ends.len() != rows || !rest.is_empty() || !rising {
                return None;
            }
            let offsets = OffsetBuffer::new(ScalarBuffer::from(offsets));
            let values = Buffer::from_vec(values);
            let array = arrow_array::StringArray::try_new(offsets, values, nulls);
            (DataType::Utf8, Arc::new(array.ok()?))
        }
        _ => return None,
    };
    Some((Field::new(name, data, optional), array))
}

/// A column of a table: a sequence of its values, with ``None`` for empty cells.
///
/// A column of numbers without empty cells is a view for ``numpy.asarray``, without a copy.
#[pyclass(module = "isocat", frozen, sequence)]
pub struct Column {
    name: String,
    array: ArrayRef,
}

#[pymethods]
impl Column {
    /// Its name.
    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    /// Number of its empty cells.
    #[getter]
    fn null_count(&self) -> usize {
        self.array.null_count()
    }

    /// ``"integer"``, ``"float"``, ``"flag"`` or ``"text"``.
    #[getter]
    fn kind(&self) -> &'static str {
        match self.array.data_type() {
            DataType::Int64 => "integer",
            DataType::Float64 => "float",
            DataType::Boolean => "flag",
            _ => "text",
        }
    }

    fn __len__(&self) -> usize {
        self.array.len()
    }

    fn __getitem__<'py>(&self, py: Python<'py>, row: isize) -> PyResult<Bound<'py, PyAny>> {
        let rows = self.array.len();
        let row = if row < 0 { row + rows as isize } else { row };
        match usize::try_from(row).ok().filter(|row| *row < rows) {
            Some(row) => object(py, cell(&self.array, row)),
            None => Err(PyIndexError::new_err(format!("row {row} of a column with {rows}"))),
        }
    }

    /// All values as a ``list``.
    fn to_list<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let list = PyList::empty(py);
        for row in 0..self.array.len() {
            list.append(object(py, cell(&self.array, row))?)?;
        }
        Ok(list)
    }

    /// A view of its memory, for numpy; columns of texts or flags and columns with empty cells have
    /// none.
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (address, kind) = match self.array.data_type() {
            _ if self.array.null_count() > 0 => (0, ""),
            DataType::Int64 => {
                (self.array.as_primitive::<Int64Type>().values().as_ptr() as usize, "<i8")
            }
            DataType::Float64 => {
                (self.array.as_primitive::<Float64Type>().values().as_ptr() as usize, "<f8")
            }
            _ => (0, ""),
        };
        if kind.is_empty() {
            return Err(PyAttributeError::new_err("there is no view of this column"));
        }
        let dict = PyDict::new(py);
        dict.set_item("version", 3)?;
        dict.set_item("typestr", kind)?;
        dict.set_item("shape", (self.array.len(),))?;
        // Other views share this memory, so it is read only.
        dict.set_item("data", (address, true))?;
        Ok(dict)
    }

    /// A numpy array with a copy of the values; integers with empty cells become floats with NaN.
    #[pyo3(signature = (dtype=None, copy=None))]
    fn __array__<'py>(
        slf: Bound<'py, Self>,
        dtype: Option<Bound<'py, PyAny>>,
        copy: Option<bool>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let py = slf.py();
        py.import("isocat._frames")?.call_method1("to_numpy", (slf, dtype, copy))
    }

    fn __repr__(&self) -> String {
        format!("<isocat.Column \"{}\" of {} rows, {}>", self.name, self.array.len(), self.kind())
    }
}
