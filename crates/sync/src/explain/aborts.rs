//! SDO abort codes: why a transfer failed.

use isocat_wire::AbortCode;

use super::{Entry, entry};

/// The meaning of a code; `None` for a code that no published list contains.
pub fn explain(code: AbortCode) -> Option<&'static Entry> {
    let at = CODES.binary_search_by_key(&code.0, |(code, _)| *code).ok()?;
    Some(&CODES[at].1)
}

/// All codes, in ascending order.
pub static CODES: [(u32, Entry); 36] = [
    (
        0x0503_0000,
        entry(
            "A segment came with the toggle bit of the one before.",
            &["a mailbox message was lost or repeated", "two clients use the mailbox at once"],
            &["the repeat bits of SM1 (0x080E, 0x080F)"],
            &["one transfer at a time", "repeat the transfer from its beginning"],
        ),
    ),
    (
        0x0504_0000,
        entry(
            "The device waited too long for the rest of a transfer.",
            &["the MainDevice stopped in the middle of a segmented transfer"],
            &["when the last segment was sent"],
            &["repeat the transfer"],
        ),
    ),
    (
        0x0504_0001,
        entry(
            "The device does not know the service that the request names.",
            &[
                "a damaged or wrongly built request",
                "a segment without a transfer that was begun",
                "a service that the device does not have: SDO information, complete access",
            ],
            &["SII, CoE details: what the device has"],
            &["begin the transfer anew; leave out what the device does not have"],
        ),
    ),
    (
        0x0504_0002,
        entry(
            "A block transfer with a wrong block size; EtherCAT does not use block transfer.",
            &["a gateway to a CANopen device"],
            &["the request"],
            &["use normal transfers"],
        ),
    ),
    (
        0x0504_0003,
        entry(
            "A block transfer with a wrong sequence number; EtherCAT does not use block transfer.",
            &["a gateway to a CANopen device"],
            &["the request"],
            &["use normal transfers"],
        ),
    ),
    (
        0x0504_0004,
        entry(
            "A checksum of a block transfer is wrong; EtherCAT does not use block transfer.",
            &["a gateway to a CANopen device"],
            &["the request"],
            &["use normal transfers"],
        ),
    ),
    (
        0x0504_0005,
        entry(
            "The device ran out of memory during the transfer.",
            &["an object larger than the device can hold", "other transfers under way"],
            &["the object's size by SDO information"],
            &["transfer sub-indices one by one"],
        ),
    ),
    (
        0x0601_0000,
        entry(
            "This way of access does not exist for the object.",
            &["a gap in a record was read: the entry is described and has no value"],
            &["the entry's description by SDO information"],
            &["leave the entry out"],
        ),
    ),
    (
        0x0601_0001,
        entry(
            "The entry can only be written.",
            &["a command object was read"],
            &["the entry's access rights by SDO information"],
            &["write it, or leave it out"],
        ),
    ),
    (
        0x0601_0002,
        entry(
            "The entry can only be read.",
            &[
                "0x1C12, 0x1C13 or a mapping was written to a device with fixed PDOs",
                "0x1C32:01 or :02 was written to a device that chooses its mode by the SYNC unit",
                "an entry that is writable in another state only",
            ],
            &["the entry's access rights by SDO information", "whether the value is right already"],
            &["don't write it; for 0x1C32 read it back in SAFEOP instead"],
        ),
    ),
    (
        0x0601_0003,
        entry(
            "Sub-index 0 must be 0 before the entries are written.",
            &["a PDO assignment or mapping was changed while it was in force"],
            &["sub-index 0 of the object"],
            &["write 0 to sub-index 0, then the entries, then their number"],
        ),
    ),
    (
        0x0601_0004,
        entry(
            "The object can't be transferred as a whole.",
            &["complete access to an object of variable length, or to a device without it"],
            &["SII, CoE details bit 5: complete access"],
            &["transfer sub-index by sub-index"],
        ),
    ),
    (
        0x0601_0005,
        entry(
            "The object does not fit into the mailbox.",
            &["a long object and a device without segmented transfer"],
            &["SII words 0x18 to 0x1B: mailbox sizes"],
            &["a larger mailbox, if the device allows it", "transfer sub-index by sub-index"],
        ),
    ),
    (
        0x0601_0006,
        entry(
            "The object is mapped into a PDO, and so not written by SDO.",
            &["process data and an SDO want to write the same"],
            &["0x1C12 and the mapping objects it names"],
            &["write it by process data, or map something else"],
        ),
    ),
    (
        0x0602_0000,
        entry(
            "The object does not exist.",
            &[
                "another revision or variant of the device",
                "a module or channel that is not there",
                "0x1C32 or 0x1C33 of a device without synchronization",
                "index with bytes exchanged",
            ],
            &["the list of objects by SDO information", "0x1018: its identity"],
            &["use the description of this revision"],
        ),
    ),
    (
        0x0604_0041,
        entry(
            "The object can't be mapped into a PDO.",
            &["wrong direction: an input in 0x16xx, an output in 0x1Axx", "not meant for PDOs"],
            &["the entry's mapping rights by SDO information"],
            &["map another object"],
        ),
    ),
    (
        0x0604_0042,
        entry(
            "The mapped objects are longer than the PDO may be.",
            &["too many entries", "the sum for the SyncManager is too long"],
            &["SII, SyncManager category: the longest length"],
            &["map less, or into a second PDO"],
        ),
    ),
    (
        0x0604_0043,
        entry(
            "Parameters do not go together.",
            &["a value that contradicts another one that is set already"],
            &["the maker's manual"],
            &["change the order or the values"],
        ),
    ),
    (
        0x0604_0047,
        entry(
            "Something within the device does not go together.",
            &["a module of another kind than configured", "a fault of the firmware"],
            &["0xF030 against 0xF050", "0x10F3"],
            &["bring modules and configuration together"],
        ),
    ),
    (
        0x0606_0000,
        entry(
            "A fault of the hardware stopped the access.",
            &["parameters could not be stored", "a module does not answer"],
            &["0x10F3"],
            &["repeat it; replace the device"],
        ),
    ),
    (
        0x0607_0010,
        entry(
            "The length does not match the type of the entry.",
            &[
                "two bytes written to an entry of four, or the other way",
                "0x10F1:02 has 16 bits in newer stacks and 32 in older ones",
                "complete access with a wrong layout: sub-index 0 takes 16 bits",
            ],
            &["the entry's type and length by SDO information"],
            &["write exactly as many bytes as the entry has"],
        ),
    ),
    (
        0x0607_0012,
        entry(
            "The value is longer than the entry.",
            &["a wider type than the entry has"],
            &["the entry's length by SDO information"],
            &["write exactly as many bytes as the entry has"],
        ),
    ),
    (
        0x0607_0013,
        entry(
            "The value is shorter than the entry.",
            &["a narrower type than the entry has", "a text without its full length"],
            &["the entry's length by SDO information"],
            &["write exactly as many bytes as the entry has"],
        ),
    ),
    (
        0x0609_0011,
        entry(
            "The sub-index does not exist.",
            &[
                "an optional sub-index of 0x1C32 or 0x1C33 that the device leaves out",
                "decimal and hexadecimal confused: sub-index 10 is 0A",
                "in SAFEOP and OP: a direction without process data shows sub-index 0 only",
            ],
            &["sub-index 0, which need not be the last one there", "SDO information"],
            &["do without it"],
        ),
    ),
    (
        0x0609_0030,
        entry(
            "The value is outside of what the entry takes.",
            &[
                "0x1C32:01 or 0x1C33:01: a type that :04 does not announce, or one for the other \
                 direction",
                "0x22 written to 0x1C32:01, or 1 to 0x1C33:01 of a device with outputs",
                "a PDO index in 0x1C12 or 0x1C13 that is none of that direction",
                "byte order: the value arrives with its bytes exchanged",
            ],
            &["0x1C32:04, 0x1C33:04", "minimum and maximum by SDO information"],
            &["a value of the announced ones; for inputs with outputs in SM-synchronous mode: \
                 0x22"],
        ),
    ),
    (
        0x0609_0031,
        entry(
            "The value is too high.",
            &[
                "more PDOs in 0x1C12:00 or 0x1C13:00 than there is room for",
                "a time above the maximum",
            ],
            &["the maximum by SDO information or in the manual"],
            &["a lower value"],
        ),
    ),
    (
        0x0609_0032,
        entry(
            "The value is too low.",
            &["a cycle time below 0x1C32:05", "a shift time below 0x1C32:09"],
            &["the minimum by SDO information or in the manual"],
            &["a higher value"],
        ),
    ),
    (
        0x0609_0033,
        entry(
            "The module list that was written is not the one that was found.",
            &["a module is missing, was added, or stands in another slot"],
            &["0xF050: what was found"],
            &["write 0xF030 as 0xF050 reads, or plug what is missing"],
        ),
    ),
    (
        0x0609_0036,
        entry(
            "The maximum is below the minimum.",
            &["two limits written in the wrong order"],
            &["both limits"],
            &["write the limit first that widens the range"],
        ),
    ),
    (
        0x060A_0023,
        entry(
            "A resource that the access needs is not available.",
            &["another connection uses it", "a file or memory is missing"],
            &["the maker's manual"],
            &["end the other use; repeat it later"],
        ),
    ),
    (
        0x0800_0000,
        entry(
            "An error that the device does not tell in more detail.",
            &["a fault of its application"],
            &["0x10F3"],
            &["the maker's manual"],
        ),
    ),
    (
        0x0800_0020,
        entry(
            "The value can't be taken over or stored.",
            &["the application is not ready", "a drive that is enabled refuses the parameter"],
            &["0x6041 of a drive", "0x10F3"],
            &["write it earlier, with the drive disabled"],
        ),
    ),
    (
        0x0800_0021,
        entry(
            "The value can't be taken over because the device is controlled locally.",
            &["a local panel or a service tool is in charge"],
            &["the device's display"],
            &["give the control back to the bus"],
        ),
    ),
    (
        0x0800_0022,
        entry(
            "Not in this state of the device.",
            &[
                "0x1C12, 0x1C13, a mapping or 0x1C32:01 was written in SAFEOP or OP instead of \
                 PREOP",
                "a parameter that can be written with the drive disabled only",
            ],
            &[
                "0x0130: the state",
                "the entry's access rights by SDO information, one bit for each state",
            ],
            &["go to PREOP, write, go up again"],
        ),
    ),
    (
        0x0800_0023,
        entry(
            "There is no object dictionary, or it could not be made.",
            &["the firmware has not started", "a configuration file in the device is missing"],
            &["0x0130 and 0x0134"],
            &["repeat it later; load the device's configuration"],
        ),
    ),
    (
        0x0800_0024,
        entry(
            "There are no data to give.",
            &["nothing was measured or stored yet"],
            &["the maker's manual"],
            &["repeat it later"],
        ),
    ),
];
