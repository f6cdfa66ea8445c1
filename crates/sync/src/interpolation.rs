//! The interpolation time period of a drive (CiA 402, 0x60C2): the time over which it interpolates
//! its set points, as units of a power of ten of a second.
//!
//! It must be the time from one set point to the next: a drive whose value is longer is still on
//! the way when the next one comes, and one whose value is shorter waits at each.

use isocat_wire::time::Nanos;

/// The time that 0x60C2:01 (units) and 0x60C2:02 (power of ten of a second) state. `None`: zero, or
/// not a number of ns that fits.
pub fn time(units: u8, power: i8) -> Option<Nanos> {
    let power = 9 + i32::from(power);
    let scale = 10_i64.checked_pow(u32::try_from(power).ok()?)?;
    i64::from(units).checked_mul(scale).map(Nanos).filter(|time| *time > Nanos::ZERO)
}

/// Units and power for a time: those that come nearest, since units are a byte. `None`: it is not
/// above zero, or far beyond what they can hold.
pub fn parts(time: Nanos) -> Option<(u8, i8)> {
    // Drives know ms and us best.
    let all = [-3, -6, -4, -5, -2, -1, 0, -7, -8, -9].into_iter().filter_map(|power: i8| {
        let unit = 10_i64.pow(u32::try_from(9 + power).ok()?);
        let units = (time.0.checked_add(unit / 2)? / unit).clamp(1, 255);
        Some((units as u8, power, (units * unit - time.0).abs()))
    });
    let (units, power, off) = all.min_by_key(|(.., off)| *off)?;
    (off <= time.0 / 25).then_some((units, power))
}

/// Whether an interpolation time is that of the cycle, as far as units of a byte can hold it.
pub fn agrees(time: Nanos, cycle: Nanos) -> bool {
    // A byte of at least 25 units is within a fiftieth; who takes another number of cycles for one
    // is further off.
    (time.0 - cycle.0).abs() <= cycle.0 / 16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_has_its_parts() {
        for (ns, found) in [
            (1_000_000, Some((1, -3))),
            (250_000, Some((250, -6))),
            (500_000, Some((5, -4))),
            (62_500, Some((63, -6))),
            (333_000, Some((33, -5))),
            (312_500, Some((31, -5))),
            (1_001_000, Some((1, -3))),
            (i64::MAX, None),
            (-1_000_000, None),
            (2_000_000_000, Some((200, -2))),
            (0, None),
        ] {
            assert_eq!(parts(Nanos(ns)), found, "{ns}");
            if let Some((units, power)) = found {
                let held = time(units, power).expect("a time");
                assert!(agrees(held, Nanos(ns)), "{held}");
                assert_eq!(held == Nanos(ns), ns % 250_000 == 0);
            }
        }
        assert_eq!(time(0, -3), None);
        assert_eq!(time(1, -10), None, "less than a ns");
        assert_eq!(time(255, i8::MAX), None);
    }

    #[test]
    fn another_time_does_not_agree() {
        let cycle = Nanos(62_500);
        assert!(agrees(Nanos(62_000), cycle) && agrees(Nanos(63_000), cycle));
        for (ns, agreed) in [(3_906, true), (3_907, false)] {
            assert_eq!(agrees(Nanos(62_500 + ns), cycle), agreed);
            assert_eq!(agrees(Nanos(62_500 - ns), cycle), agreed);
        }
    }
}
