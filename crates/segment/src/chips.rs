//! Properties in which devices with the same kind of ESC may differ: the law of the drift loop, the
//! sign of its difference, times of EEPROM and ports.

use isocat_descriptions::document::FileError;
use isocat_descriptions::document::section::{Choice, Key, Keys, Kind, Limit, Need, Word};
use isocat_esc::DriftLaw;
use isocat_esc::chip::{Chip, PortKind};
use isocat_wire::PortNumber;
use isocat_wire::dc::DifferencePolarity;
use isocat_wire::time::Nanos;

/// The laws of the drift loop that files can name.
pub(crate) static LAWS: [Word<DriftLaw>; 3] = [
    (
        "hold",
        "The speed follows what a difference grows, the phase by small steps. Agrees with all that is public",
        DriftLaw::HOLD,
    ),
    (
        "block",
        "As hold, but the speed changes once in as many drift frames as the filter is deep",
        DriftLaw::BLOCK,
    ),
    (
        "proportional",
        "A proportional and integral controller. Contradicts the public record, for comparison",
        DriftLaw::PROPORTIONAL,
    ),
];

/// The possible meanings of bit 31 of register 0x092C.
pub(crate) static POLARITIES: [Word<DifferencePolarity>; 2] = [
    (
        "positive-ahead",
        "Bit 31 = 0: the local clock is ahead (older register texts, captured on an ET1100)",
        DifferencePolarity::PositiveAhead,
    ),
    (
        "negative-ahead",
        "Bit 31 = 1: the local clock is ahead (newer register texts)",
        DifferencePolarity::NegativeAhead,
    ),
];

/// Key `difference_polarity` of chips.
pub(crate) const DIFFERENCE_POLARITY: Key = Key {
    name: "difference_polarity",
    kind: Kind::Choice(Choice(&POLARITIES)),
    need: Need::Without("positive-ahead"),
    means: "What the sign of register 0x092C means. Register texts contradict each other.",
    goes: "bit 31 of register 0x092C",
    example: r#""negative-ahead""#,
};

/// Key `drift_law` of chips.
pub(crate) const DRIFT_LAW: Key = Key {
    name: "drift_law",
    kind: Kind::Choice(Choice(&LAWS)),
    need: Need::Without("hold"),
    means: "How its drift loop turns time differences into a speed. No maker publishes it.",
    goes: "what a write to register 0x0910 does to the simulated clock",
    example: r#""block""#,
};

/// Key `drift_phase`, which accompanies `drift_law` in segment files and profiles.
pub(crate) const DRIFT_PHASE: Key = Key {
    name: "drift_phase",
    kind: Kind::Integer { least: 0, most: MOST_PHASE },
    need: Need::Without("10 with hold, 9 with block"),
    means: "Part of the phase that a drift frame corrects, as the exponent n of 1 / 2^n. `isocat calibrate` \
            measures it.",
    goes: "the laws hold and block of the simulated clocks",
    example: "11",
};
/// The model of the clock has 20 fraction bits.
const MOST_PHASE: i64 = 20;

/// Key `drift_gain`, which accompanies `drift_law` in segment files and profiles.
pub(crate) const DRIFT_GAIN: Key = Key {
    name: "drift_gain",
    kind: Kind::Integer { least: 1, most: MOST_GAIN },
    need: Need::Without("4 with proportional"),
    means: "Units of register 0x0932 for each ns of time difference, of the law proportional, which it stands \
            for where no law is named. `isocat calibrate` measures it.",
    goes: "the law proportional of the simulated clocks",
    example: "8",
};
/// With this gain 8 ns give the whole range of register 0x0932: above it the law is a switch.
const MOST_GAIN: i64 = 500;

/// Key `eeprom_read` of chips.
pub(crate) const EEPROM_READ: Key = Key {
    name: "eeprom_read",
    kind: Kind::Duration { least: Limit::At(0), most: Limit::At(50_000_000), whole: 1 },
    need: Need::Without("20 us, so that it costs no virtual time"),
    means: "How long one read of its EEPROM takes. A real one of 8 bytes at 100 kHz takes about 1 ms. \
            `isocat calibrate` measures it.",
    goes: "Chip::eeprom_read_time of the simulated ESC; register 0x0502 bit 15",
    example: r#""1ms""#,
};

/// Key `port_jitter` of chips.
pub(crate) const PORT_JITTER: Key = Key {
    name: "port_jitter",
    kind: Kind::Duration { least: Limit::At(0), most: Limit::At(1_000), whole: 1 },
    need: Need::Without("40 ns for MII, 10 ns for EBUS"),
    means: "Peak-to-peak jitter of the time of frames that come in at port 0 and at ports of its kind. \
            `isocat calibrate` measures it.",
    goes: "Chip::rx_fifo, the period of the clock that takes frames over",
    example: r#""8ns""#,
};

/// The law that `drift_law`, `drift_phase` and `drift_gain` request; `usual` is the one without
/// `drift_law`. `None` without any of the keys. A parameter is refused for a law that does not have
/// it.
pub(crate) fn asked_law(keys: &Keys<'_>, usual: DriftLaw) -> Result<Option<DriftLaw>, FileError> {
    let named = keys.find_choice("drift_law", &LAWS)?;
    let phase = keys.find::<i64>("drift_phase")?;
    if let Some(gain) = keys.find::<i64>("drift_gain")? {
        let DriftLaw::Proportional { limit, .. } = named.unwrap_or(DriftLaw::PROPORTIONAL) else {
            let message = "drift_gain beside a law without a gain; expected the law proportional";
            return Err(keys.error_at("drift_gain", message));
        };
        if phase.is_none() {
            return Ok(Some(DriftLaw::Proportional { gain: gain as u16, limit }));
        }
    }
    let Some(phase) = phase else { return Ok(named) };
    let phase = phase as u8;
    let law = if keys.value("drift_gain").is_some() { DriftLaw::PROPORTIONAL } else { usual };
    match named.unwrap_or(law) {
        DriftLaw::Hold { .. } => Ok(Some(DriftLaw::Hold { phase })),
        DriftLaw::Block { .. } => Ok(Some(DriftLaw::Block { phase })),
        DriftLaw::Proportional { .. } => {
            let found = "drift_phase beside the law proportional";
            let expected = "expected the law hold or block, which have such a part";
            Err(keys.error_at("drift_phase", format!("{found}; {expected}")))
        }
    }
}

/// The chip with the values of these keys for its drift loop, its EEPROM and its ports.
pub(crate) fn measured(chip: &Chip, keys: &Keys<'_>) -> Result<Chip, FileError> {
    let chip = with_law(chip, asked_law(keys, chip.drift_law)?);
    let polarity = keys.find_choice("difference_polarity", &POLARITIES)?;
    let difference_polarity = polarity.unwrap_or(chip.difference_polarity);
    let eeprom_read_time = keys.find::<Nanos>("eeprom_read")?.unwrap_or(chip.eeprom_read_time);
    let mut rx_fifo = chip.rx_fifo;
    if let Some(jitter) = keys.find::<Nanos>("port_jitter")? {
        match chip.port(PortNumber::P0) {
            PortKind::Ebus => rx_fifo.ebus_period = jitter.into(),
            _ => rx_fifo.mii_period = jitter.into(),
        }
    }
    Ok(Chip { difference_polarity, eeprom_read_time, rx_fifo, ..chip })
}

/// The same chip with another law of its drift loop.
pub(crate) fn with_law(chip: &Chip, law: Option<DriftLaw>) -> Chip {
    Chip { drift_law: law.unwrap_or(chip.drift_law), ..*chip }
}
