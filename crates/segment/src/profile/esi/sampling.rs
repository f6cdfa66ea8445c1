//! Which process data of a description are samples, and how many pulses of SYNC0 take them.

use isocat_descriptions::esi::{EsiPdo, Image};
use isocat_maindevice::written::Bits;
use isocat_sim::Sampling;
use isocat_sim::sampling::Channel;

use super::{Doubt, DoubtKind, Import, bytes_of};

/// What happens to samples that SYNC0 does not take.
const AT_ONCE: &str = "they are taken and given once a cycle";

impl Import<'_> {
    /// The samples of an image, if PDOs in it oversample (`OSFac`) and SYNC0 takes them.
    pub(super) fn sampling(&mut self, image: &Image) -> Option<Sampling> {
        let first = image.all().find(|pdo| pdo.oversampling > 0 && pdo.bits() > 0)?;
        let pulses = match self.pulses(first) {
            Ok(pulses) => pulses,
            Err(why) => {
                // A single value is none that something could be missing of.
                if image.all().any(|pdo| pdo.oversampling > 1) {
                    self.doubts
                        .push(Doubt::new(DoubtKind::Oversampling, format!("{why}: {AT_ONCE}")));
                }
                return None;
            }
        };
        let mut channels = [&image.outputs, &image.inputs].map(|areas| {
            let mut channels = Vec::new();
            let mut at = 0;
            for (_, pdos) in areas {
                let mut bit = at;
                for pdo in pdos {
                    channels.extend(self.channels(pdo, pulses, bit));
                    bit += pdo.bits();
                }
                at += 8 * bytes_of(pdos) as u32;
            }
            channels
        });
        let [outputs, inputs] = channels.each_mut().map(std::mem::take);
        let some = !outputs.is_empty() || !inputs.is_empty();
        some.then_some(Sampling { samples: pulses, inputs, outputs })
    }

    /// Pulses of SYNC0 in a cycle. Where the OpMode fixes the SYNC0 cycle, and not its part of the
    /// bus cycle, these are the samples of the PDO.
    fn pulses(&self, pdo: &EsiPdo) -> Result<u16, String> {
        let index = pdo.index;
        let Some(mode) = self.mode.filter(|mode| mode.sync0()) else {
            return Err(format!("PDO 0x{index:04X} has samples, and no SYNC0 takes them"));
        };
        let cycle = mode.cycle_time_sync0;
        if cycle.is_some_and(|cycle| cycle.value.0 > 0) {
            // Without SYNC1 the pulse of the cycle is SYNC0 itself.
            return Ok(if mode.sync1() { pdo.oversampling } else { 1 });
        }
        let factor = cycle.and_then(|cycle| cycle.factor).unwrap_or(0);
        let pulses = match factor {
            0 | 1 => Some(1),
            parts => parts.checked_neg().and_then(|parts| u16::try_from(parts).ok()),
        };
        pulses.ok_or_else(|| format!("SYNC0 by the factor {factor} takes no samples of a cycle"))
    }

    /// What a PDO that begins at this bit samples.
    fn channels(&mut self, pdo: &EsiPdo, pulses: u16, bit: u32) -> Vec<Channel> {
        let factor = pdo.oversampling;
        if factor == 0 || pdo.bits() == 0 {
            return Vec::new();
        }
        let set = pdo.entries.len() / usize::from(factor);
        // Digital terminals have the samples of one bit in whole bytes: several in an entry.
        let in_entry = pulses / factor;
        let whole = in_entry * factor == pulses && set * usize::from(factor) == pdo.entries.len();
        let one = &pdo.entries[..set];
        let divides = |bits: u16| in_entry > 0 && bits.is_multiple_of(in_entry);
        if !whole || in_entry != 1 && !(set == 1 && divides(one[0].bits)) {
            let words = format!(
                "PDO 0x{:04X} has {factor} times its entries, and SYNC0 comes {pulses} times in a cycle: {AT_ONCE}",
                pdo.index
            );
            self.doubts.push(Doubt::new(DoubtKind::Oversampling, words));
            return Vec::new();
        }
        let step = one.iter().map(|entry| u32::from(entry.bits)).sum::<u32>() / u32::from(in_entry);
        let mut at = bit;
        let mut channels = Vec::new();
        for entry in one {
            let bits = entry.bits / in_entry;
            if entry.object.is_some() && bits > 0 {
                // Of more bits the lowest 32 are sampled.
                let len = bits.min(32) as u8;
                channels.push(Channel { first: Bits { at, len, signed: false }, step });
            }
            at += u32::from(entry.bits);
        }
        channels
    }
}
