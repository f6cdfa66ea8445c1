//! One command of the list: a register access with its repetitions and its check, or an SDO
//! download.

use isocat_descriptions::start_up::{Address, Check, RegisterStep};
use isocat_wire::al::AlStatusCode;
use isocat_wire::register;
use isocat_wire::time::Nanos;

use crate::failure::Kind;
use crate::line::Line;

/// Makes a register access, with `data` in place of the step's own. Repeats it until the working
/// counter is right, as `retries` and `patience_ms` allow; a read with a check, until it returns
/// what is expected.
pub(crate) fn register(line: &mut Line, step: &RegisterStep, data: &[u8]) -> Result<(), Kind> {
    let checked = step.check.as_ref().map_or(0, |check| check.patience_ms);
    let patience = step.patience_ms.unwrap_or(0).max(checked);
    let until = line.now() + Nanos::millis(patience.into()).min(LONGEST);
    let mut tries = 0;
    loop {
        let failed = match attempt(line, step, data)? {
            Ok(()) => return Ok(()),
            Err(kind) => kind,
        };
        tries += 1;
        // Without a time, the number of repetitions is the limit; with a time, both limits must be
        // exceeded.
        if tries > u32::from(step.retries) && line.now() >= until {
            return Err(with_code(line, step, failed));
        }
        line.sleep(BETWEEN)?;
    }
}

/// Makes one attempt. The inner error is why it failed, if the frame could be sent at all.
fn attempt(line: &mut Line, step: &RegisterStep, data: &[u8]) -> Result<Result<(), Kind>, Kind> {
    use isocat_descriptions::start_up::Own;
    if step.own == Own::Cycle {
        line.cycle()?;
    }
    let Some(reply) = line.datagram(step.command, step.address, data)? else {
        return Ok(Err(Kind::NoAnswer));
    };
    let found = reply.counter;
    if let Some(expected) = step.working_counter.filter(|expected| *expected != found) {
        return Ok(Err(Kind::WorkingCounter { expected, found }));
    }
    Ok(match &step.check {
        Some(check) if !holds(check, &reply.data) => {
            let (expected, found) = (check.data.clone(), reply.data);
            Err(Kind::Check { expected, found, code: None })
        }
        _ => Ok(()),
    })
}

/// Whether all bits of the mask are as expected; bytes that one of the two lacks do not count.
fn holds(check: &Check, found: &[u8]) -> bool {
    let mask = |at: usize| match &check.mask {
        Some(mask) => mask.get(at).copied().unwrap_or(0),
        None => 0xFF,
    };
    let mut pairs = check.data.iter().zip(found).enumerate();
    pairs.all(|(at, (expected, found))| (expected ^ found) & mask(at) == 0)
}

/// Adds the AL status code to a state that was not reached; it follows AL status in memory.
fn with_code(line: &mut Line, step: &RegisterStep, failed: Kind) -> Kind {
    let Kind::Check { expected, found, .. } = failed else { return failed };
    let mut code = None;
    if let Address::Physical { device, register } = step.address
        && register == register::AL_STATUS.address
    {
        let register = register::AL_STATUS_CODE.address;
        let address = Address::Physical { device, register };
        let reply = line.datagram(step.command, address, &[0; 2]).ok().flatten();
        let bytes = reply.filter(|reply| reply.counter == 1).map(|reply| reply.data);
        code = bytes.map(|bytes| AlStatusCode(u16::from_le_bytes([bytes[0], bytes[1]])));
    }
    Kind::Check { expected, found, code }
}

/// Longest time that a command is repeated, whatever the list says.
pub(crate) const LONGEST: Nanos = Nanos::millis(60_000);
/// Time between two attempts.
const BETWEEN: Nanos = Nanos::micros(500);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_bits_of_the_mask_count() {
        let check = |data: &[u8], mask: Option<&[u8]>| Check {
            data: data.to_vec(),
            mask: mask.map(<[u8]>::to_vec),
            patience_ms: 0,
        };
        assert!(holds(&check(&[2, 0], Some(&[0x0F, 0])), &[0xF2, 7]));
        assert!(!holds(&check(&[2, 0], Some(&[0x1F, 0])), &[0x12, 7]));
        assert!(holds(&check(&[2, 7], None), &[2, 7]));
        assert!(!holds(&check(&[2, 7], None), &[2, 6]));
    }
}
