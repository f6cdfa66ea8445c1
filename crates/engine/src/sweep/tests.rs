use isocat_sim::fault::RING_CABLE;

use super::*;

const SEGMENT: &str = "cycle = \"1ms\"\nfor = \"100ms\"\n[host]\njitter = \"5us\"\n\
    [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n[[subdevice]]\ndevice = \"simple_io16\"\n";

fn sweep(vary: &[&str], seeds: u64) -> Sweep {
    let mut sweep = Sweep::new("sweep.toml", SEGMENT).unwrap();
    for axis in vary {
        sweep.vary(axis).unwrap_or_else(|error| panic!("{axis}: {error}"));
    }
    sweep.seeds(5, seeds);
    sweep
}

#[test]
fn a_grid_has_each_value_with_each_other_and_each_seed() {
    let sweep = sweep(&["host.jitter=5us,50us", "subdevice[*].cable=1m..100m", "cycle=1ms,2ms"], 3);
    assert_eq!(sweep.runs(), 12);
    let cases: Vec<Case> = (0..12).map(|number| sweep.case(number).unwrap()).collect();
    let mut all: Vec<_> = cases
        .iter()
        .map(|case| (case.seed, case.values[0].clone(), case.values[2].clone()))
        .collect();
    all.sort();
    all.dedup();
    assert_eq!(all.len(), 12);
    for case in &cases {
        let table = case.text.parse::<Table>().unwrap();
        assert_eq!(table["seed"].as_integer(), Some(case.seed as i64));
        assert_eq!(table["host"]["jitter"].as_str(), Some(&*case.values[0]));
        let cables: Vec<_> = table["subdevice"]
            .as_array()
            .unwrap()
            .iter()
            .map(|d| d["cable"].as_str().unwrap())
            .collect();
        assert_ne!(cables[0], cables[1], "drawn for each device");
        SegmentFile::parse("case.toml", &case.text).unwrap();
    }
    assert_eq!(sweep.case(7).unwrap(), cases[7], "the same number is the same run");
}

#[test]
fn values_that_are_given_one_by_one_may_hold_commas() {
    let mut sweep = sweep(&[], 2);
    let names = ["axis 1, left", "axis 1"].map(str::to_owned).to_vec();
    sweep.vary_over("subdevice[0].name", names).unwrap();
    assert_eq!(sweep.runs(), 4);
    assert_eq!(sweep.case(0).unwrap().values, ["axis 1, left"]);
    assert!(sweep.vary_over("subdevice[0].name", Vec::new()).unwrap_err().contains("no values"));
    assert!(sweep.vary_over("cycle", vec![String::new()]).unwrap_err().contains("empty value"));
    assert!(sweep.vary_over("fault[0].what", vec!["heal".into()]).is_err());
    let mut table = SEGMENT.parse::<Table>().unwrap();
    super::set(&mut table, "subdevice[*].cable", "3m").unwrap();
    assert_eq!(table["subdevice"][1]["cable"].as_str(), Some("3m"));
    assert!(super::set(&mut table, "subdevice[2].cable", "3m").is_err());
}

#[test]
fn values_that_the_file_does_not_take_are_found_without_a_run() {
    assert!(sweep(&["cycle=1ms,2ms", "subdevice[*].cable=1m..100m"], 2).check().is_ok());
    let (value, error) = sweep(&["cycle=1ms,2ms", "host.jiter=5us,7us"], 2).check().unwrap_err();
    assert_eq!(value, "host.jiter = 5us");
    assert!(error.to_string().contains("did you mean \"jitter\""), "{error}");
    let (value, _) = sweep(&["host.jitter=5us,3parsec"], 2).check().unwrap_err();
    assert_eq!(value, "host.jitter = 3parsec");
}

/// A range of the runs has the same rows as the whole, at both ends.
#[test]
fn a_range_of_runs_is_a_part_of_them() {
    let sweep = sweep(&["host.jitter=5us,50us"], 3);
    let rows = |range| {
        let mut rows = Vec::new();
        let stop = AtomicBool::new(false);
        let done: Result<(), ()> = sweep.run_range(range, 2, &stop, |row| {
            rows.push(row);
            Ok(())
        });
        done.unwrap();
        rows
    };
    let whole = rows(0..6);
    assert_eq!(rows(2..4), whole[2..4]);
    assert_eq!(rows(4..99), whole[4..]);
    assert_eq!((rows(6..99).len(), rows(3..3).len()), (0, 0));
}

#[test]
fn keys_that_lead_nowhere_are_refused() {
    let mut sweep = sweep(&[], 1);
    for (axis, expected) in [
        ("host.jitter", "expected KEY=VALUE"),
        ("nobody[0].cable=1m", "there is no [[nobody]]"),
        ("subdevice[2].cable=1m", "there are 2 of subdevice"),
        ("subdevice[*]=1m", "which key"),
        ("cycle=1ms,,2ms", "empty value"),
        ("subdevice[0].cable=1m..5cm", "one unit"),
        ("subdevice[x].cable=1m", "expected a position from 0 on, or *"),
    ] {
        let error = sweep.vary(axis).unwrap_err();
        assert!(error.contains(expected), "{axis}: {error}");
    }
    let text =
        SEGMENT.replace("device = \"simple_io16\"", "device = \"simple_io16\"\nname = \"io\"");
    let error = Sweep::new("sweep.toml", &text).unwrap().vary("io.cable=1m").unwrap_err();
    assert_eq!(error, "io is a device; expected subdevice[1].cable");
}

/// Rows are the same on one thread and on three, in the same order. A run that the plan refuses has
/// a row, too.
#[test]
fn threads_change_nothing() {
    let sweep = sweep(&["cycle=1ms,60us"], 6);
    let rows = |threads: usize, from: u64| {
        let mut rows = Vec::new();
        let done: Result<(), ()> = sweep.run_all(from, threads, &AtomicBool::new(false), |row| {
            rows.push(row);
            Ok(())
        });
        done.unwrap();
        rows
    };
    let (one, three) = (rows(1, 0), rows(3, 0));
    assert_eq!(one, three);
    assert_eq!(one.iter().map(|row| row.number).collect::<Vec<_>>(), (0..12).collect::<Vec<u64>>());
    assert!(one[..6].iter().all(|row| row.outcome.verdict == "in-sync"), "{:?}", one[0]);
    assert!(one[6..].iter().all(|row| row.outcome.verdict == "refused"), "{:?}", one[6]);
    assert_eq!(rows(2, 9), one[9..], "it goes on where it was left");
    let mut totals = Totals::default();
    one.iter().for_each(|row| totals.add(row));
    assert_eq!((totals.runs, totals.as_expected), (12, 6));
    assert_eq!(totals.values[&(0, "60us".to_owned())], (6, 0));
}

#[test]
fn swarms_differ_by_seed_and_are_files_that_can_be_read() {
    let mut sweep = sweep(&[], 200);
    sweep.swarm();
    let texts: Vec<String> = (0..200).map(|number| sweep.case(number).unwrap().text).collect();
    for text in &texts {
        let file = SegmentFile::parse("swarm.toml", text)
            .unwrap_or_else(|error| panic!("{error}\n{text}"));
        assert!((1..=4).contains(&file.faults.planned.len()));
    }
    let words: std::collections::BTreeSet<String> =
        texts.iter().flat_map(|text| words(text)).collect();
    assert!(words.len() >= 12, "{words:?}");
}

/// In a ring, faults may also affect the cable that closes it.
#[test]
fn swarms_in_a_ring_know_its_cable() {
    let drawn = |text: &str| {
        let mut sweep = Sweep::new("ring.toml", text).unwrap();
        sweep.seeds(5, 200);
        sweep.swarm();
        let texts = (0..200).map(|number| sweep.case(number).unwrap().text);
        let planned =
            texts.flat_map(|text| SegmentFile::parse("r.toml", &text).unwrap().faults.planned);
        let cables: Vec<_> = planned.filter_map(|planned| planned.fault.cable()).collect();
        [0, 1, RING_CABLE].map(|cable| cables.iter().filter(|other| **other == cable).count())
    };
    let [first, second, ring] = drawn(&format!("ring = true\n{SEGMENT}"));
    assert!(first.min(second).min(ring) > 20, "{first}, {second}, {ring}");
    assert_eq!(drawn(SEGMENT)[2], 0);
    assert_eq!(drawn(&format!("ring = false\n{SEGMENT}")), drawn(SEGMENT));
}

/// A run with four faults of which one matters, and three devices of which two do not.
#[test]
fn a_failing_run_shrinks_to_what_makes_it_fail() {
    let text = "cycle = \"1ms\"\nfor = \"800ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n\
                [[subdevice]]\ndevice = \"simple_io16\"\n[[subdevice]]\ndevice = \"simple_io16\"\n\
                [[fault]]\nat = \"in-operation + 50ms\"\nwhat = \"delay 10us for 20ms\"\n\
                [[fault]]\nat = \"in-operation + 60ms\"\nwhat = \"sync-off 0\"\n\
                [[fault]]\nat = \"in-operation + 70ms\"\nwhat = \"clock 1 +1ppm\"\n\
                [[fault]]\nat = \"in-operation + 80ms\"\nwhat = \"delay 20us for 20ms\"\n";
    let sweep = Sweep::new("shrink.toml", text).unwrap();
    let whole = sweep.outcome(text);
    assert!(!whole.as_expected);
    let small = shrink::shrink(text, |text| sweep.outcome(text).is_like(&whole));
    let table = small.parse::<Table>().unwrap();
    let count = |key: &str| table[key].as_array().unwrap().len();
    assert_eq!((count("fault"), count("subdevice")), (1, 1), "{small}");
    assert!(small.contains("sync-off 0"), "{small}");
    let file = SegmentFile::parse("small.toml", &small).unwrap();
    assert!(file.duration.0 < 200_000_000, "{small}");
    assert!(sweep.outcome(&small).is_like(&whole));
}

/// The values of key `what` of the faults in a file.
fn words(text: &str) -> Vec<String> {
    let table = text.parse::<Table>().unwrap();
    let faults = table["fault"].as_array().unwrap();
    let word =
        |fault: &Value| fault["what"].as_str().unwrap().split(' ').next().unwrap().to_owned();
    faults.iter().map(word).collect()
}

/// The values drawn from a range are valid for the key: whole if the ends are whole, and durations
/// of any unit.
#[test]
fn ranges_are_drawn_in_whole_steps() {
    for (axis, unit) in [
        ("host.jitter=1ns..9ns", "ns"),
        ("host.jitter=100ns..2us", "ns"),
        ("subdevice[0].clock=-3ppb..3ppb", "ppb"),
        ("host.jitter=1us..2us", "us"),
        ("host.difference_filter=0..8", ""),
    ] {
        let sweep = sweep(&[axis], 40);
        let mut values: Vec<String> = Vec::new();
        for number in 0..40 {
            let case = sweep.case(number).unwrap();
            SegmentFile::parse("case.toml", &case.text)
                .unwrap_or_else(|error| panic!("{axis}: {error}"));
            values.push(case.values[0].strip_suffix(unit).unwrap().to_owned());
        }
        values.sort();
        values.dedup();
        assert!(values.len() > 4, "{axis}: {values:?}");
    }
}

/// Bins are as wide as needed and no wider, whatever the order of values.
#[test]
fn counts_widen_by_halves() {
    let bins = |values: &[i64]| {
        let mut counts = summary::Counts::default();
        values.iter().for_each(|value| counts.add(*value));
        assert_eq!(counts.count() as usize, values.len());
        counts.bins().collect::<Vec<_>>()
    };
    assert_eq!(bins(&[63, 0]), [(0, 1, 1), (63, 64, 1)]);
    assert_eq!(bins(&[0, 64, 1]), [(0, 2, 2), (64, 66, 1)]);
    assert_eq!(bins(&[64, 1, 0]), bins(&[0, 64, 1]));
    assert_eq!(bins(&[-1, 0]), [(-1, 0, 1), (0, 1, 1)]);
    let wide = bins(&[i64::MIN, 0, 5, i64::MAX]);
    assert_eq!(wide.iter().map(|(_, _, count)| count).sum::<u64>(), 4);
    assert!(wide.len() <= 64);
}

#[test]
fn a_frontier_is_in_the_order_of_size_and_says_where_it_holds() {
    use summary::{Holds, Summary};
    let sweep = sweep(&["cycle=2ms,500us,1ms", "subdevice[0].name=a,b", "host.jitter=5us,50us"], 2);
    let mut summary = Summary::new(&sweep);
    let blank = sweep.outcome("");
    for number in 0..sweep.runs() {
        let case = sweep.case(number).unwrap();
        // "a" is as expected from 1 ms on; "b" is too, except for one run of the middle value.
        let as_expected = match (&*case.values[1], &*case.values[0]) {
            ("a", cycle) => cycle != "500us",
            (_, cycle) => cycle != "1ms" || number != 10,
        };
        summary.add(&Row::new(number, &case, Outcome { as_expected, ..blank.clone() }));
    }
    let mut frontier = summary.frontier.unwrap();
    assert_eq!(frontier.sought.values, ["500us", "1ms", "2ms"]);
    assert_eq!(frontier.given.values, ["a", "b"]);
    assert_eq!(frontier.holds(0), Holds::From(1));
    assert_eq!(frontier.holds(1), Holds::ExceptAt(vec![1]));
    // The third axis is not distinguished: two of its values with two seeds each.
    assert_eq!(frontier.at(1, 1), (4, 3));
    // Values without an order have no "and above".
    frontier.sought.is_ordered = false;
    assert_eq!(frontier.holds(0), Holds::ExceptAt(vec![0]));
}

/// The limit that bisection finds is exactly the figure that is compared with it.
#[test]
fn bisection_finds_the_edge_from_both_sides() {
    let text = format!("{SEGMENT}[[expect]]\nworst_sync0 = \"1ms\"\n");
    let sweep = Sweep::new("edge.toml", &text).unwrap();
    let worst = sweep.run(0).outcome.worst_sync0_ps.unwrap();
    assert!((2_000..9_000_000).contains(&worst), "{worst} ps");
    let bisect = |range: &str| {
        let mut told = 0;
        let found = sweep.bisect(range, 2, &AtomicBool::new(false), |_| told += 1);
        found.inspect(|found| assert_eq!(found.tried.len(), told))
    };
    let found = bisect("expect[0].worst_sync0=1ns..10001ns").unwrap();
    let [(low, high)] = found.edges()[..] else { panic!("one edge: {found:?}") };
    let ps = |place: usize| {
        let value = found.tried[place].value.strip_suffix("ns").unwrap();
        value.parse::<i64>().unwrap() * 1_000
    };
    assert!(ps(low) < worst && worst <= ps(high), "{} {worst} {}", ps(low), ps(high));
    assert!(ps(high) - ps(low) <= 10_000);
    assert_eq!(found.tried[low].failed.as_ref().map(|(seed, _)| *seed), Some(1));
    assert!(found.tried[high].failed.is_none());

    assert!(bisect("expect[0].worst_sync0=10us..20us").unwrap().edges().is_empty());
    assert!(bisect("expect[0].worst_sync0=10us,20us").unwrap_err().contains("is no range"));
    let error = bisect("host.jitter=5us..900us").unwrap_err();
    assert!(error.contains("no value of the key"), "{error}");
}
