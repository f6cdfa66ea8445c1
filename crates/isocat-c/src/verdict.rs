//! Verdicts: what the MainDevice did, and the result of the judges in true time.

use std::ffi::{CString, c_char};
use std::ptr;

use isocat_engine::verdict::Answer;
use isocat_serve::Summary;
use isocat_serve::summary::{DeviceSummary, Outcome};

use crate::bus::isocat_bus;
use crate::failure::{Failure, guard, isocat_code, isocat_error};
use crate::segment::check_position;
use crate::sys;

/// There is no finding against any SubDevice in operation.
pub const ISOCAT_IN_SYNC: i32 = 0;
/// There is a finding against a SubDevice in operation.
pub const ISOCAT_NOT_IN_SYNC: i32 = 1;
/// No SubDevice reached operation, so nothing was judged.
pub const ISOCAT_NOT_KNOWN: i32 = 3;

/// Everything that the segment file expects came true, or it expects nothing.
pub const ISOCAT_AS_EXPECTED: i32 = 0;
/// Something that the segment file expects did not come true.
pub const ISOCAT_NOT_AS_EXPECTED: i32 = 1;
/// All that was judged came true, but something could not be judged.
pub const ISOCAT_NOT_JUDGED: i32 = 3;

/// The verdict on a bus at the instant at which it was requested. It does not need its bus.
pub struct isocat_verdict {
    summary: Summary,
    overrun: u64,
    devices: Vec<Device>,
}

/// Texts of a SubDevice.
struct Device {
    name: CString,
    state: CString,
    mode: CString,
    findings: Vec<CString>,
}

/// The verdict as a whole.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct isocat_verdict_summary {
    /// sizeof(isocat_verdict_summary).
    pub size: usize,
    /// Frames that were sent.
    pub frames: u64,
    /// Frames that came back.
    pub answered: u64,
    /// Frames that were lost, in the segment or by a fault.
    pub lost: u64,
    /// Answers that were dropped because more than 8192 had not been received.
    pub overrun: u64,
    /// Number of sessions of MainDevices, one after the other: a session begins when station
    /// addresses are written again, or after a long silence.
    pub sessions: usize,
    /// SubDevices in OP when the judging began last, in the last session.
    pub in_op: usize,
    /// Judged time of the last session since then, ns.
    pub judged_ns: i64,
    /// ISOCAT_NOT_IN_SYNC if there is a finding in any session; else the result of the last
    /// session, ISOCAT_IN_SYNC or ISOCAT_NOT_KNOWN.
    pub answer: i32,
    /// The result of the segment file's [[expect]] tables: ISOCAT_AS_EXPECTED,
    /// ISOCAT_NOT_AS_EXPECTED or ISOCAT_NOT_JUDGED.
    pub expected: i32,
}

/// The verdict on a SubDevice, since the judging began last. Times are true time, ns.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct isocat_device_verdict {
    /// sizeof(isocat_device_verdict).
    pub size: usize,
    /// Its name. This and the other texts are valid as long as the verdict.
    pub name: *const c_char,
    /// Its state, for example "OP".
    pub state: *const c_char,
    /// The mode that it actually runs in, for example "dc-sync0".
    pub mode: *const c_char,
    /// SYNC0 edges that were measured. If 0, the next two fields are 0, too.
    pub sync0_edges: u64,
    /// Mean error of SYNC0 against the grid that the MainDevice wrote.
    pub sync0_mean_ns: f64,
    /// Largest error of SYNC0, without sign.
    pub sync0_worst_ns: f64,
    /// Cycles with a known margin. If 0, the next field is 0, too.
    pub margins: u64,
    /// Least time from the end of copying and calculating to SYNC0.
    pub least_margin_ns: f64,
    /// SM event missed (0x1C32:0B).
    pub sm_event_missed: u32,
    /// Cycle time too small (0x1C32:0C).
    pub cycle_time_too_small: u32,
    /// Shift time too short (0x1C32:0D).
    pub shift_time_too_short: u32,
    /// Sync error (0x1C32:20).
    pub sync_error: u32,
    /// Number of findings against it; isocat_verdict_finding returns their texts.
    pub findings: usize,
}

impl isocat_verdict {
    fn new(summary: Summary, overrun: u64) -> Self {
        let judged = summary.sessions.last().and_then(|session| session.judged.as_ref());
        let devices = judged.map_or(&[][..], |judged| &judged.devices);
        let devices = devices.iter().map(Device::new).collect();
        Self { summary, overrun, devices }
    }

    /// The verdict on a SubDevice in the last session.
    fn device(&self, position: usize) -> Result<(&DeviceSummary, &Device), Failure> {
        let judged = self.summary.sessions.last().and_then(|session| session.judged.as_ref());
        let judged = judged.ok_or_else(|| {
            Failure::range("no SubDevice came to operation; expected one that is judged")
        })?;
        check_position(position, self.devices.len())?;
        Ok((&judged.devices[position], &self.devices[position]))
    }
}

impl Device {
    fn new(device: &DeviceSummary) -> Self {
        Self {
            name: sys::c_string(&device.name),
            state: sys::c_string(&device.state),
            mode: sys::c_string(&device.mode),
            findings: device.findings.iter().map(|words| sys::c_string(words)).collect(),
        }
    }
}

/// The verdict at the present instant. The bus continues; at its end, call isocat_bus_finish first.
///
/// `verdict`: receives the handle, which is freed by isocat_verdict_free.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_bus_verdict(
    bus: *mut isocat_bus,
    verdict: *mut *mut isocat_verdict,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        sys::give("verdict", verdict, || {
            isocat_bus::with(bus, |inside| {
                let summary = inside.bus.summary(&inside.source, "libisocat, in virtual time");
                Ok(isocat_verdict::new(summary, inside.bus.overrun()))
            })
        })
    })
}

/// The verdict as a whole.
///
/// `summary`: receives it; `size` must be set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_verdict_get_summary(
    verdict: *const isocat_verdict,
    summary: *mut isocat_verdict_summary,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        let verdict = sys::borrow("verdict", verdict)?;
        let found = &verdict.summary;
        let judged = found.sessions.last().and_then(|session| session.judged.as_ref());
        let filled = isocat_verdict_summary {
            size: size_of::<isocat_verdict_summary>(),
            frames: found.frames,
            answered: found.answered,
            lost: found.lost,
            overrun: verdict.overrun,
            sessions: found.sessions.len() + found.sessions_left_out as usize,
            in_op: judged.map_or(0, |judged| judged.in_op),
            judged_ns: judged.map_or(0, |judged| judged.judged_ns),
            answer: match found.answer() {
                Answer::InSync => ISOCAT_IN_SYNC,
                Answer::Except => ISOCAT_NOT_IN_SYNC,
                Answer::NotKnown => ISOCAT_NOT_KNOWN,
            },
            expected: match found.outcome() {
                Outcome::AsExpected => ISOCAT_AS_EXPECTED,
                Outcome::NotAsExpected => ISOCAT_NOT_AS_EXPECTED,
                Outcome::NotJudged => ISOCAT_NOT_JUDGED,
            },
        };
        sys::fill(summary, filled)
    })
}

/// The verdict on a SubDevice in the last session. ISOCAT_OUT_OF_RANGE if there is none, because no
/// SubDevice reached operation in it.
///
/// `device`: receives it; `size` must be set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_verdict_get_device(
    verdict: *const isocat_verdict,
    position: usize,
    device: *mut isocat_device_verdict,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        let (found, texts) = sys::borrow("verdict", verdict)?.device(position)?;
        let (sync0, margin) = (found.sync0_error.as_ref(), found.sync0_margin.as_ref());
        let filled = isocat_device_verdict {
            size: size_of::<isocat_device_verdict>(),
            name: texts.name.as_ptr(),
            state: texts.state.as_ptr(),
            mode: texts.mode.as_ptr(),
            sync0_edges: sync0.map_or(0, |error| error.count),
            sync0_mean_ns: sync0.map_or(0.0, |error| error.mean_ns),
            sync0_worst_ns: sync0.map_or(0.0, |error| error.worst_ns),
            margins: margin.map_or(0, |margin| margin.count),
            least_margin_ns: margin.map_or(0.0, |margin| margin.min_ns),
            sm_event_missed: found.sm_event_missed,
            cycle_time_too_small: found.cycle_time_too_small,
            shift_time_too_short: found.shift_time_too_short,
            sync_error: found.sync_error,
            findings: texts.findings.len(),
        };
        sys::fill(device, filled)
    })
}

/// A finding against a SubDevice, as a sentence; NULL if there is none with this number. Valid as
/// long as the verdict.
///
/// `number`: from 0 to isocat_device_verdict.findings - 1.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_verdict_finding(
    verdict: *const isocat_verdict,
    position: usize,
    number: usize,
) -> *const c_char {
    let finding = |verdict: &isocat_verdict| {
        Some(verdict.devices.get(position)?.findings.get(number)?.as_ptr())
    };
    sys::borrow("verdict", verdict).ok().and_then(finding).unwrap_or(ptr::null())
}

/// The whole verdict in words, as `isocat serve` prints it: what the MainDevice did, what it
/// omitted, and the result. Many lines.
///
/// `text`: receives the text; the caller owns it, and frees it by isocat_text_free.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_verdict_text(
    verdict: *const isocat_verdict,
    text: *mut *mut c_char,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        let words = sys::borrow("verdict", verdict)?.summary.text();
        let words = anstream::adapter::strip_str(&words).to_string();
        sys::give_text("text", text, &words)
    })
}

/// The whole verdict as a JSON document (docs/serve-summary.schema.json).
///
/// `json`: receives the text; the caller owns it, and frees it by isocat_text_free.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_verdict_json(
    verdict: *const isocat_verdict,
    json: *mut *mut c_char,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        let verdict = sys::borrow("verdict", verdict)?;
        sys::give_text("json", json, &crate::failure::json(&verdict.summary)?)
    })
}

/// Frees a verdict; NULL is ignored.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_verdict_free(verdict: *mut isocat_verdict) {
    sys::take(verdict);
}
