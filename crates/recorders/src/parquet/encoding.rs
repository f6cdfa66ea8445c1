//! Encodings of the values in a page (Parquet's "Encodings"): bits, runs, and differences.

/// Encodes numbers of `width` bits as runs and bit-packed groups of 8 (RLE / bit-packing hybrid).
pub(super) fn hybrid(values: &[u32], width: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut rest = values;
    // Numbers that are not written yet; a run can only begin after whole groups of 8.
    let mut packed: Vec<u32> = Vec::new();
    while let Some(first) = rest.first() {
        let run = rest.iter().take_while(|value| *value == first).count();
        // Fills the last group from the run, so that the run begins after whole groups.
        let fill = (8 - packed.len() % 8) % 8;
        if run >= fill + 8 {
            packed.extend(&rest[..fill]);
            flush(&mut bytes, &mut packed, width);
            let run = run - fill;
            varint(&mut bytes, (run as u64) << 1);
            bytes.extend(&first.to_le_bytes()[..width.div_ceil(8) as usize]);
            rest = &rest[fill + run..];
        } else {
            packed.extend(&rest[..run]);
            rest = &rest[run..];
        }
    }
    flush(&mut bytes, &mut packed, width);
    bytes
}

/// Writes the pending numbers as groups of 8; the last group is filled with zeros.
fn flush(bytes: &mut Vec<u8>, packed: &mut Vec<u32>, width: u32) {
    if packed.is_empty() {
        return;
    }
    let groups = packed.len().div_ceil(8);
    packed.resize(8 * groups, 0);
    varint(bytes, (groups as u64) << 1 | 1);
    pack(bytes, packed.iter().map(|value| u64::from(*value)), width);
    packed.clear();
}

/// Packs numbers of `width` bits each, the lowest bit first.
fn pack(bytes: &mut Vec<u8>, values: impl Iterator<Item = u64>, width: u32) {
    let (mut held, mut count) = (0_u128, 0);
    for value in values {
        held |= u128::from(value) << count;
        count += width;
        while count >= 8 {
            bytes.push(held as u8);
            held >>= 8;
            count -= 8;
        }
    }
    if count > 0 {
        bytes.push(held as u8);
    }
}

/// Encodes numbers by their differences (`DELTA_BINARY_PACKED`), which are small if the numbers
/// grow evenly or lie close together.
pub(super) fn delta(values: &[i64]) -> Vec<u8> {
    let mut bytes = Vec::new();
    varint(&mut bytes, BLOCK as u64);
    varint(&mut bytes, (BLOCK / MINI) as u64);
    varint(&mut bytes, values.len() as u64);
    varint(&mut bytes, zigzag(values.first().copied().unwrap_or(0)));
    // Differences wrap, as the reader's sums do.
    let deltas: Vec<i64> = values.windows(2).map(|pair| pair[1].wrapping_sub(pair[0])).collect();
    for block in deltas.chunks(BLOCK) {
        let least = block.iter().copied().min().unwrap_or(0);
        varint(&mut bytes, zigzag(least));
        let above: Vec<u64> = block.iter().map(|delta| delta.wrapping_sub(least) as u64).collect();
        let width = |mini: &[u64]| 64 - mini.iter().fold(0, |all, one| all | one).leading_zeros();
        let widths: Vec<u32> = above.chunks(MINI).map(width).collect();
        let heads = (0..BLOCK / MINI).map(|mini| widths.get(mini).map_or(0, |width| *width as u8));
        bytes.extend(heads);
        for (mini, width) in above.chunks(MINI).zip(widths) {
            let filled = mini.iter().copied().chain(std::iter::repeat(0)).take(MINI);
            pack(&mut bytes, filled, width);
        }
    }
    bytes
}

/// Number of differences in a block, and in each of its parts.
const BLOCK: usize = 128;
const MINI: usize = 32;

fn zigzag(value: i64) -> u64 {
    ((value << 1) ^ (value >> 63)) as u64
}

fn varint(bytes: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        bytes.push(value as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
}

/// Definition levels: their length, and one bit for each row, which tells whether there is a value.
pub(super) fn levels(present: &[bool]) -> Vec<u8> {
    let bits: Vec<u32> = present.iter().map(|present| u32::from(*present)).collect();
    let mut bytes = vec![0; 4];
    bytes.extend(hybrid(&bits, 1));
    let len = (bytes.len() - 4) as u32;
    bytes[..4].copy_from_slice(&len.to_le_bytes());
    bytes
}

/// One bit for each flag, the first one lowest.
pub(super) fn bits(flags: &[bool]) -> Vec<u8> {
    let byte = |group: &[bool]| group.iter().rev().fold(0, |byte, bit| byte << 1 | u8::from(*bit));
    flags.chunks(8).map(byte).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_runs_and_bits_lowest_first() {
        assert_eq!(levels(&[true, false, true]), [2, 0, 0, 0, 0b11, 0b101]);
        // Nine equal bits are a run, eight are one too, and seven are not.
        assert_eq!(levels(&[true; 9]), [2, 0, 0, 0, 9 << 1, 1]);
        assert_eq!(levels(&[true; 8]), [2, 0, 0, 0, 8 << 1, 1]);
        assert_eq!(levels(&[true; 7]), [2, 0, 0, 0, 0b11, 0x7F]);
        // A run of 64 needs two bytes for its length.
        assert_eq!(levels(&[true; 64])[4..], [0x80, 0x01, 1]);
    }

    #[test]
    fn runs_begin_behind_whole_groups() {
        let mut values = vec![1, 2, 3];
        values.extend([7; 20]);
        // Five numbers of the run fill the group of 8.
        assert_eq!(
            hybrid(&values, 3),
            [0b11, 0xD1, 0xF8 | 0x06, 0xFF, 15 << 1, 7].map(|b| b as u8)
        );
    }

    /// The example of the specification: 1 to 5 differ by one each, so nothing is left to pack.
    #[test]
    fn even_growth_takes_no_bits() {
        let head = [0x80, 0x01, 4, 5, 2];
        assert_eq!(delta(&[1, 2, 3, 4, 5])[..5], head);
        assert_eq!(delta(&[1, 2, 3, 4, 5])[5..], [2, 0, 0, 0, 0]);
        // 7, 5, 3, 1, 2, 3, 4, 5: least difference -2, above it 0 or 3, in two bits.
        let bytes = delta(&[7, 5, 3, 1, 2, 3, 4, 5]);
        assert_eq!(bytes[..5], [0x80, 0x01, 4, 8, 14]);
        assert_eq!(bytes[5..10], [3, 2, 0, 0, 0]);
        assert_eq!(bytes[10..], [0b1100_0000, 0b0011_1111, 0, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn the_ends_of_the_range_wrap() {
        let bytes = delta(&[i64::MIN, i64::MAX, i64::MIN]);
        assert_eq!(bytes.len(), 3 + 1 + 10 + 1 + 4 + 8);
    }
}
