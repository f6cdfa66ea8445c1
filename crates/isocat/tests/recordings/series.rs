//! The table of a run: a row for each SubDevice and cycle, whose figures are those of the report.

use std::io::{self, Write};
use std::sync::{Arc, Mutex};

use isocat::report::Report;
use isocat::series::csv::Csv;
use isocat::series::{COLUMNS, Kind, Series, Table, Value};
use isocat::{Nanos, Scenario, SegmentFile};
use isocat_maindevice::{Event, Motion};
use isocat_sim::World;
use isocat_wire::time::{Picos, Time};

/// A file that stays in reach.
#[derive(Clone, Default)]
struct Shared(Arc<Mutex<Vec<u8>>>);

impl Shared {
    /// What was written so far.
    fn taken(&self) -> Vec<u8> {
        std::mem::take(&mut self.0.lock().expect("one thread"))
    }
}

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().expect("one thread").write(bytes)
    }
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The rows of a run, and its report.
fn rows(text: Option<&str>) -> (Vec<Vec<String>>, Report) {
    let file = match text {
        Some(text) => SegmentFile::parse("series.toml", text).expect("it reads"),
        None => SegmentFile::built_in(),
    };
    let mut scenario = Scenario::from(file);
    scenario.duration = Nanos::millis(200);
    let names = scenario.devices.iter().map(|device| device.name.clone()).collect();
    let file = Shared::default();
    let table = Box::new(Csv::new(file.clone()).expect("it takes everything"));
    let outcome = scenario.run().execute(Some(Series::new(table, names)), &mut |_| {});
    let report = Report::new(&scenario, &outcome);
    outcome.world.into_tap().expect("the tap").finish().expect("it takes everything");
    let text = String::from_utf8(file.taken()).expect("UTF-8");
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect());
    let head: Vec<String> = lines.next().expect("names");
    assert!(head.iter().eq(COLUMNS.iter().map(|column| column.name)));
    (lines.collect(), report)
}

fn column(name: &str) -> usize {
    COLUMNS.iter().position(|column| column.name == name).expect("a column of that name")
}

/// The numbers of a SubDevice in a column, where there are any.
fn numbers(rows: &[Vec<String>], position: usize, name: &str) -> Vec<i64> {
    let of = |row: &&Vec<String>| row[column("position")] == position.to_string();
    let number = |row: &Vec<String>| match row[column(name)].as_str() {
        "" => None,
        number => Some(number.parse().expect("a number")),
    };
    rows.iter().filter(of).filter_map(number).collect()
}

#[test]
fn figures_are_those_of_the_report() {
    let (rows, report) = rows(None);
    assert!(report.in_sync);
    for device in &report.devices {
        let position = device.position;
        let cycles = numbers(&rows, position, "cycle");
        assert!((200..=202).contains(&cycles.len()), "{}", cycles.len());
        assert!(cycles.windows(2).all(|pair| pair[1] == pair[0] + 1), "one row for each cycle");
        let times = numbers(&rows, position, "true_time_ns");
        assert!(times.windows(2).all(|pair| pair[0] < pair[1]));
        for (name, unit, found) in [
            ("sync0_error_ps", 1000.0, device.true_time.sync0_error.map(|spread| spread.span())),
            ("margin_ns", 1.0, device.true_time.sync0_margin),
        ] {
            let values = numbers(&rows, position, name);
            let Some(found) = found else {
                assert!(values.is_empty(), "{name} of {position}");
                continue;
            };
            assert_eq!(values.len() as u64, found.count, "{name} of {position}");
            let (least, largest) = (values.iter().min(), values.iter().max());
            assert_eq!(least.map(|ps| *ps as f64 / unit), Some(found.min_ns));
            assert_eq!(largest.map(|ps| *ps as f64 / unit), Some(found.max_ns));
            let mean = values.iter().sum::<i64>() as f64 / values.len() as f64 / unit;
            assert!((mean - found.mean_ns).abs() <= 0.000_5, "{name}: {mean}, {}", found.mean_ns);
        }
    }
    let pulses = numbers(&rows, 1, "sync0_pulses");
    assert!(pulses.iter().all(|pulses| (0..=1).contains(pulses)));
    assert!(rows.iter().all(|row| row[column("al_state")] == "OP"));
    assert_eq!(rows.iter().filter(|row| row[column("frames_lost")] != "0").count(), 0);
    assert!(numbers(&rows, 0, "host_phase_error_ns").len() >= 199);
}

#[test]
fn counters_and_faster_cycles_are_told() {
    let text = r#"
        cycle = "1ms"
        [[subdevice]]
        device = "model_every_mode"
        mode = "dc-subordinated"
        sync0_cycle = "250us"
        [[subdevice]]
        device = "kollmorgen_akd2g"
        misbehave = ["missed-copy 20"]
    "#;
    let (rows, report) = rows(Some(text));
    let pulses = numbers(&rows, 0, "sync0_pulses");
    let spread = report.devices[0].true_time.sync0_error.expect("it has SYNC0");
    assert_eq!(pulses.iter().sum::<i64>() as u64, spread.count, "each pulse in one row");
    // Frames come back near a pulse: before it or behind.
    assert!(
        pulses[1..pulses.len() - 1].iter().all(|pulses| (3..=5).contains(pulses)),
        "{pulses:?}"
    );
    let worst = numbers(&rows, 0, "sync0_error_ps").into_iter().map(i64::abs).max();
    assert_eq!(worst.map(|ps| ps as f64 / 1000.0), Some(spread.worst_ns));
    let missed = numbers(&rows, 1, "sm_event_missed");
    let highest = report.devices[1].true_time.highest_missed_counter;
    assert!(highest > 0 && missed.into_iter().max() == Some(highest.into()));
}

#[test]
fn columns_are_documented() {
    let page = include_str!("../../../../docs/exports.md");
    for column in COLUMNS {
        let kind = match column.kind {
            Kind::Integer => "int64",
            Kind::Optional => "int64 or null",
            Kind::Text => "string",
        };
        let row = format!("| `{}` | {kind} | {} |", column.name, column.meaning);
        assert!(page.contains(&row), "{row}");
    }
}

fn sample() -> [Value<'static>; COLUMNS.len()] {
    COLUMNS.map(|column| match column.kind {
        Kind::Integer => Value::Integer(-7),
        Kind::Optional => Value::Null,
        Kind::Text => Value::Text("a \"b\", c"),
    })
}

#[test]
fn csv_quotes_what_would_be_read_otherwise() {
    let file = Shared::default();
    let mut table = Csv::new(file.clone()).expect("it takes everything");
    table.row(&sample()).expect("it takes everything");
    let text = String::from_utf8(file.taken()).expect("UTF-8");
    let row = text.lines().nth(1).expect("a row");
    assert!(row.starts_with("-7,-7,-7,\"a \"\"b\"\", c\",-7,,,,"), "{row}");
}

/// While no frame comes back cycles go on, and so do the rows: to the end, or until frames come
/// again, which takes the links some seconds.
#[test]
fn cycles_without_frames_have_their_rows() {
    for (duration, comes_back) in [(200, false), (6_000, true)] {
        cut_off(duration, comes_back);
    }
}

fn cut_off(duration: i64, comes_back: bool) {
    let scenario = Scenario::from(SegmentFile::built_in());
    let names = scenario.devices.iter().map(|device| device.name.clone()).collect();
    let file = Shared::default();
    let table = Box::new(Csv::new(file.clone()).expect("it takes everything"));
    let series = Series::new(table, names);
    let mut world = World::new(scenario.run().setup, Motion::default(), Some(series));
    let limit = Time::new(30_000_000_000_000);
    while !matches!(world.poll_event(), Some(Event::InOperation { .. })) {
        assert!(world.step(limit), "the segment comes up");
    }
    let intent = isocat_sim::run::intent(world.main(), Nanos(1_000));
    world.begin_judging(intent);
    let ms = |ms: i64| Picos(ms * 1_000_000_000);
    let began = world.now();
    world.segment_mut().unplug(0, began + ms(50));
    world.segment_mut().plug(0, began + ms(60));
    while world.step(began + ms(duration)) {
        while world.poll_event().is_some() {}
    }
    let bench = world.end_judging();
    world.into_tap().expect("the tap").finish().expect("it takes everything");
    let text = String::from_utf8(file.taken()).expect("UTF-8");
    let rows: Vec<Vec<String>> =
        text.lines().skip(1).map(|line| line.split(',').map(str::to_owned).collect()).collect();
    let cycles = numbers(&rows, 0, "cycle");
    assert!(cycles.len() as i64 >= duration - 5, "{}", cycles.len());
    assert!(cycles.windows(2).all(|pair| pair[1] == pair[0] + 1), "{cycles:?}");
    let times = numbers(&rows, 0, "true_time_ns");
    assert!(times.windows(2).all(|pair| pair[0] < pair[1]), "{times:?}");
    let told = numbers(&rows, 0, "host_phase_error_ns").len();
    assert!(told + 9 <= cycles.len() && (told > 100) == comes_back, "{told} of {}", cycles.len());
    let lost = numbers(&rows, 0, "frames_lost");
    assert!(lost.is_sorted() && lost[0] == 0 && lost[lost.len() - 1] >= 9, "{lost:?}");
    for position in [0, 1, 4] {
        let pulses: i64 = numbers(&rows, position, "sync0_pulses").into_iter().sum();
        let judged = bench.devices()[position].sync0.as_ref().expect("it has SYNC0").statistics();
        assert_eq!(pulses as u64, judged.count(), "each pulse is in one row");
    }
}

/// The description at the end of the file, read by the library that wrote it; pyarrow reads all of
/// it in `tests/interop/series.sh`.
#[cfg(feature = "cli")]
#[test]
fn parquet_has_its_row_groups() {
    use isocat::series::parquet::Parquet;
    use polars_parquet_format::FileMetaData;
    use polars_parquet_format::thrift::protocol::TCompactInputProtocol;

    let file = Shared::default();
    let mut table = Parquet::with_groups_of(file.clone(), 10).expect("it takes everything");
    for _ in 0..25 {
        table.row(&sample()).expect("it takes everything");
    }
    table.finish().expect("it takes everything");
    let bytes = file.taken();
    assert_eq!((&bytes[..4], &bytes[bytes.len() - 4..]), (&b"PAR1"[..], &b"PAR1"[..]));
    let len = &bytes[bytes.len() - 8..bytes.len() - 4];
    let len = u32::from_le_bytes(len.try_into().expect("four bytes")) as usize;
    let mut end = &bytes[bytes.len() - 8 - len..bytes.len() - 8];
    let mut protocol = TCompactInputProtocol::new(&mut end, 1 << 20);
    let file = FileMetaData::read_from_in_protocol(&mut protocol).expect("a description");
    let rows: Vec<i64> = file.row_groups.iter().map(|group| group.num_rows).collect();
    assert_eq!((file.num_rows, rows), (25, vec![10, 10, 5]));
    let names: Vec<&str> = file.schema[1..].iter().map(|column| column.name.as_str()).collect();
    assert!(names.into_iter().eq(COLUMNS.iter().map(|column| column.name)));
    // Pages follow each other without a gap, to the description.
    let mut at = 4;
    for chunk in file.row_groups.iter().flat_map(|group| &group.columns) {
        let data = chunk.meta_data.as_ref().expect("a description");
        assert_eq!(data.dictionary_page_offset.unwrap_or(data.data_page_offset), at);
        at += data.total_compressed_size;
    }
    assert_eq!(at as usize, bytes.len() - 8 - len);
}
