//! Compares plans from these functions with the engine's own document.

use std::ptr;

use super::*;
use crate::plan::*;

fn plan_of(segment: *mut isocat_segment) -> *mut isocat_plan {
    let mut plan = ptr::null_mut();
    done(|error| unsafe { isocat_plan_new(segment, &raw mut plan, error) });
    unsafe { isocat_segment_free(segment) };
    plan
}

fn summary(plan: *const isocat_plan) -> isocat_plan_summary {
    let mut summary: isocat_plan_summary = unsafe { std::mem::zeroed() };
    summary.size = size_of::<isocat_plan_summary>();
    done(|error| unsafe { isocat_plan_get_summary(plan, &raw mut summary, error) });
    summary
}

fn line(plan: *const isocat_plan, number: usize) -> isocat_plan_line {
    let mut line: isocat_plan_line = unsafe { std::mem::zeroed() };
    line.size = size_of::<isocat_plan_line>();
    done(|error| unsafe { isocat_plan_get_line(plan, number, &raw mut line, error) });
    line
}

#[test]
fn a_plan_tells_what_the_document_tells() {
    let mut segment = ptr::null_mut();
    done(|error| unsafe { isocat_segment_built_in(&raw mut segment, error) });
    let plan = plan_of(segment);
    let json = owned(|text, error| unsafe { isocat_plan_json(plan, text, error) });
    let document: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    let whole = summary(plan);
    assert_eq!((whole.fits, whole.devices, whole.cycle_ns), (1, 5, 1_000_000));
    assert_eq!(document["segment"]["acting_phase_ns"], whole.acting_phase_ns);
    assert_eq!(document["segment"]["least_slack_ns"], whole.least_slack_ns);
    let devices = document["devices"].as_array().expect("devices");
    for (position, told) in devices.iter().enumerate() {
        let mut device: isocat_plan_device = unsafe { std::mem::zeroed() };
        device.size = size_of::<isocat_plan_device>();
        done(|error| unsafe { isocat_plan_get_device(plan, position, &raw mut device, error) });
        assert_eq!(told["mode"], text(device.mode));
        assert_eq!(told["sync0_phase_ns"].as_i64().unwrap_or(0), device.sync0_phase_ns);
        assert_eq!(told["sync0_cycle_ns"].is_null(), device.uses_sync0 == 0);
        assert_eq!(told["delay_ns"], device.delay_ns);
    }
    let told = devices.iter().map(|device| device["lines"].as_array().map_or(0, Vec::len));
    assert_eq!(whole.lines, 1 + told.sum::<usize>());
    let mut least = i64::MAX;
    for number in 0..whole.lines {
        let line = line(plan, number);
        assert_eq!(line.slack_ns, line.available_ns - line.needed_ns, "{}", text(line.check));
        assert_eq!(line.position < 0, number == 0, "the frames come first");
        assert!(!text(line.demand).is_empty());
        least = least.min(line.slack_ns);
    }
    assert!(least <= whole.least_slack_ns && least >= 0);
    let mut beyond: isocat_plan_line = unsafe { std::mem::zeroed() };
    beyond.size = size_of::<isocat_plan_line>();
    let (code, words) =
        call(|error| unsafe { isocat_plan_get_line(plan, whole.lines, &raw mut beyond, error) });
    assert_eq!(code, isocat_code::ISOCAT_OUT_OF_RANGE);
    assert!(words.contains(&format!("expected 0 to {}", whole.lines - 1)), "{words}");
    unsafe { isocat_plan_free(plan) };
}

#[test]
fn a_line_that_does_not_fit_is_part_of_the_plan() {
    let drive = "[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nmode = \"dc-sync0\"\n";
    let plan = plan_of(parse(&format!(
        "cycle = \"1ms\"\n{drive}copy_time = \"2ms\"\ncalc_copy = \"2ms\"\n"
    )));
    let whole = summary(plan);
    assert_eq!(whole.fits, 0);
    assert!(whole.least_slack_ns < 0);
    unsafe { isocat_plan_free(plan) };
}

#[test]
fn a_segment_that_can_not_be_is_refused_with_its_line() {
    let segment = parse("cycle = \"1ms\"\n\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n");
    // A segment file with such a cycle would be refused earlier.
    let described = unsafe { segment.as_ref() }.expect("a segment");
    let longer = described.with(|described| {
        described.scenario.devices[0].cycle = Some(isocat_wire::Nanos::millis(5_000));
        Ok(())
    });
    assert!(longer.is_ok());
    let (mut plan, mut error) = (ptr::null_mut(), ptr::null_mut());
    let code = unsafe { isocat_plan_new(segment, &raw mut plan, &raw mut error) };
    assert_eq!(code, isocat_code::ISOCAT_BAD_INPUT);
    assert!(plan.is_null());
    assert_eq!(super::text(unsafe { isocat_error_file(error) }), "a test");
    assert_eq!(unsafe { (isocat_error_line(error), isocat_error_column(error)) }, (3, 1));
    unsafe { isocat_error_free(error) };
    unsafe { isocat_segment_free(segment) };
}
