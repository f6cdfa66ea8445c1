//! Plans: whether a segment fits its cycle, and which phases to pass to the functions of a stack.

use std::ffi::{CString, c_char};

use isocat_engine::plan::{Plan, PlanReport, report};

use crate::failure::{Failure, guard, isocat_code, isocat_error};
use crate::segment::{Described, check_position, isocat_segment};
use crate::sys;

/// A plan: each demand on the cycle as a line, and the phases.
pub struct isocat_plan {
    report: PlanReport,
    lines: Vec<Line>,
    modes: Vec<CString>,
}

struct Line {
    /// -1 for the frames.
    position: i64,
    check: CString,
    demand: CString,
    needed_ns: i64,
    available_ns: i64,
    slack_ns: i64,
}

/// A plan as a whole. Phases count from the frame at the reference clock.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct isocat_plan_summary {
    /// sizeof(isocat_plan_summary).
    pub size: usize,
    /// Number of its lines.
    pub lines: usize,
    /// Number of its SubDevices.
    pub devices: usize,
    /// Bus cycle, ns.
    pub cycle_ns: i64,
    /// Phase of the frame in the system-time cycle, ns.
    pub send_phase_ns: i64,
    /// Phase of the pulse at which outputs act, the same for all SubDevices with SYNC, ns; 0
    /// without SYNC.
    pub acting_phase_ns: i64,
    /// Least slack of all lines, ns; negative: the cycle does not fit.
    pub least_slack_ns: i64,
    /// 1 if every line has slack of 0 or more.
    pub fits: i32,
    /// 1 if any SubDevice has SYNC.
    pub has_acting_phase: i32,
}

/// A demand on the cycle.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct isocat_plan_line {
    /// sizeof(isocat_plan_line).
    pub size: usize,
    /// Its short name, for example "outputs-before-sync0". Valid as long as the plan.
    pub check: *const c_char,
    /// The formula in words. Valid as long as the plan.
    pub demand: *const c_char,
    /// Time needed, ns.
    pub needed_ns: i64,
    /// Available time, ns.
    pub available_ns: i64,
    /// Slack, ns; negative: the demand does not fit.
    pub slack_ns: i64,
    /// Position of the SubDevice that the line belongs to; -1: the frames.
    pub position: i64,
}

/// The part of a plan for a SubDevice.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct isocat_plan_device {
    /// sizeof(isocat_plan_device).
    pub size: usize,
    /// Its mode, for example "dc-sync0". Valid as long as the plan.
    pub mode: *const c_char,
    /// Propagation delay from the reference clock, ns.
    pub delay_ns: i64,
    /// Cycle of SYNC0 (0x09A0), ns; 0 without SYNC0.
    pub sync0_cycle_ns: i64,
    /// Phase of SYNC0 after the frame at the reference clock, ns. It is CyclShift of SOEM's
    /// ecx_dcsync0 if frames reach the reference clock at 0 of the cycle. 0 without SYNC0.
    pub sync0_phase_ns: i64,
    /// Time from SYNC0 to SYNC1 (0x09A4), ns; 0 without SYNC1.
    pub sync1_ns: i64,
    /// 1 if SYNC0 is to be set up for it.
    pub uses_sync0: i32,
    /// 1 if SYNC1 is to be set up for it, too.
    pub uses_sync1: i32,
}

impl isocat_plan {
    fn of(described: &Described) -> Result<Self, Failure> {
        let scenario = &described.scenario;
        let plan = Plan::of(scenario).map_err(|error| {
            let place = error.cause.place().map(|place| place.position);
            let line = place.and_then(|at| scenario.devices.get(at)).map_or(0, |found| found.line);
            let failure = Failure::bad_input(format!("{}: {error}", scenario.source));
            failure.at(&scenario.source, line, usize::from(line > 0))
        })?;
        let report = plan.report(scenario);
        let of_devices = report.devices.iter().flat_map(|device| {
            device.lines.iter().map(|line| Line::of(device.position as i64, line))
        });
        let lines = std::iter::once(Line::of(-1, &report.frames_line)).chain(of_devices).collect();
        let modes = report.devices.iter().map(|device| sys::c_string(device.mode.name())).collect();
        Ok(Self { report, lines, modes })
    }
}

impl Line {
    fn of(position: i64, line: &report::Line) -> Self {
        Self {
            position,
            check: sys::c_string(line.check.name()),
            demand: sys::c_string(line.demand),
            needed_ns: line.needed_ns,
            available_ns: line.available_ns,
            slack_ns: line.slack_ns,
        }
    }
}

/// Plans a segment as it is described; sends nothing. Lines that do not fit are no error.
///
/// `plan`: receives the handle, which is freed by isocat_plan_free.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_plan_new(
    segment: *const isocat_segment,
    plan: *mut *mut isocat_plan,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        sys::give("plan", plan, || {
            sys::borrow("segment", segment)?.with(|described| isocat_plan::of(described))
        })
    })
}

/// The plan as a whole.
///
/// `summary`: receives it; `size` must be set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_plan_get_summary(
    plan: *const isocat_plan,
    summary: *mut isocat_plan_summary,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        let plan = sys::borrow("plan", plan)?;
        let segment = &plan.report.segment;
        let filled = isocat_plan_summary {
            size: size_of::<isocat_plan_summary>(),
            lines: plan.lines.len(),
            devices: plan.modes.len(),
            cycle_ns: segment.cycle_ns,
            send_phase_ns: segment.send_phase_ns,
            acting_phase_ns: segment.acting_phase_ns.unwrap_or(0),
            least_slack_ns: segment.least_slack_ns,
            fits: plan.report.fits.into(),
            has_acting_phase: segment.acting_phase_ns.is_some().into(),
        };
        sys::fill(summary, filled)
    })
}

/// A line of the plan.
///
/// `number`: from 0.
/// `line`: receives it; `size` must be set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_plan_get_line(
    plan: *const isocat_plan,
    number: usize,
    line: *mut isocat_plan_line,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        let lines = &sys::borrow("plan", plan)?.lines;
        let found = lines.get(number).ok_or_else(|| {
            Failure::range(format!("line {number}; expected 0 to {}", lines.len() - 1))
        })?;
        let filled = isocat_plan_line {
            size: size_of::<isocat_plan_line>(),
            check: found.check.as_ptr(),
            demand: found.demand.as_ptr(),
            needed_ns: found.needed_ns,
            available_ns: found.available_ns,
            slack_ns: found.slack_ns,
            position: found.position,
        };
        sys::fill(line, filled)
    })
}

/// The part of the plan for a SubDevice.
///
/// `device`: receives it; `size` must be set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_plan_get_device(
    plan: *const isocat_plan,
    position: usize,
    device: *mut isocat_plan_device,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        let plan = sys::borrow("plan", plan)?;
        check_position(position, plan.modes.len())?;
        let found = &plan.report.devices[position];
        let filled = isocat_plan_device {
            size: size_of::<isocat_plan_device>(),
            mode: plan.modes[position].as_ptr(),
            delay_ns: found.delay_ns,
            sync0_cycle_ns: found.sync0_cycle_ns.unwrap_or(0),
            sync0_phase_ns: found.sync0_phase_ns.unwrap_or(0),
            sync1_ns: found.sync1_ns.unwrap_or(0),
            uses_sync0: found.sync0_cycle_ns.is_some().into(),
            uses_sync1: found.sync1_ns.is_some().into(),
        };
        sys::fill(device, filled)
    })
}

/// The plan as a JSON document (docs/plan.schema.json).
///
/// `json`: receives the text; the caller owns it, and frees it by isocat_text_free.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_plan_json(
    plan: *const isocat_plan,
    json: *mut *mut c_char,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        let plan = sys::borrow("plan", plan)?;
        sys::give_text("json", json, &crate::failure::json(&plan.report)?)
    })
}

/// Frees a plan; NULL is ignored.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_plan_free(plan: *mut isocat_plan) {
    sys::take(plan);
}
