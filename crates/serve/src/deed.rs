//! The steps of a MainDevice at start-up, recognized from its datagrams alone.

use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_wire::al::{AlControl, AlState};
use isocat_wire::coe::{self, sdo};
use isocat_wire::datagram::Header;
use isocat_wire::register::Value;
use isocat_wire::{Command, mailbox, register};

macro_rules! deeds {
    ($($(#[$doc:meta])* $name:ident: $words:literal,)*) => {
        /// One kind of step.
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
        pub enum Deed {
            $($(#[$doc])* $name,)*
        }
        impl Deed {
            /// All deeds.
            pub const ALL: &'static [Self] = &[$(Self::$name,)*];
            /// The deed in words, as a line of a list.
            pub const fn words(self) -> &'static str {
                match self {
                    $(Self::$name => $words,)*
                }
            }
        }
    };
}

deeds! {
    /// A broadcast read, whose working counter counts the SubDevices.
    Count: "counts the SubDevices (BRD)",
    /// AL control.
    RequestInit: "requests INIT",
    /// Register 0x0010.
    StationAddresses: "writes station addresses",
    /// A read command in 0x0502.
    ReadSii: "reads SII EEPROMs",
    /// A write command in 0x0502.
    WriteSii: "WRITES to SII EEPROMs",
    /// SM0 or SM1 of a SubDevice with mailbox.
    Mailbox: "sets mailbox SyncManagers",
    /// AL control.
    RequestPreOp: "requests PREOP",
    /// AL control.
    RequestBoot: "requests BOOT",
    /// An SDO for an object that no other deed names.
    Sdo: "reads and writes objects (SDO)",
    /// SDO upload of 0x1C32 or 0x1C33, except for the sub-indices of `ReadSyncTimes`.
    ReadSyncObjects: "reads 0x1C32/0x1C33",
    /// SDO upload of sub-index 05 or 06 of 0x1C32 or 0x1C33, or of the whole object.
    ReadSyncTimes: "reads 0x1C32/0x1C33 :05 or :06, the times that the cycle must fit",
    /// SDO download of sub-index 01 of 0x1C32 or 0x1C33.
    WriteSyncType: "writes 0x1C32/0x1C33:01, the synchronization type",
    /// SDO download of 0x1C12 or 0x1C13.
    AssignPdos: "assigns PDOs (0x1C12, 0x1C13)",
    /// SyncManagers of process data.
    ProcessSyncManagers: "sets process data SyncManagers",
    /// FMMU registers.
    Fmmus: "sets FMMUs",
    /// Registers 0x0400 to 0x0421.
    Watchdog: "sets watchdogs",
    /// A write to 0x0900.
    LatchTimes: "latches port receive times (0x0900)",
    /// Register 0x0920.
    Offsets: "writes system time offsets (0x0920)",
    /// Register 0x0928.
    Delays: "writes propagation delays (0x0928)",
    /// Registers 0x0930 to 0x0935.
    ResetFilters: "sets the drift loops' filters (0x0930)",
    /// FRMW or ARMW of 0x0910.
    DistributeTime: "distributes the reference time (FRMW or ARMW of 0x0910)",
    /// Reads 0x092C.
    ReadDifference: "reads system time differences (0x092C)",
    /// Register 0x09A0.
    SyncCycle: "writes SYNC0 cycle times (0x09A0)",
    /// Register 0x0990, written.
    SyncStart: "writes SYNC start times (0x0990)",
    /// Register 0x0981, not zero.
    SyncActivate: "activates SYNC (0x0981)",
    /// Reads 0x0984 or 0x0990 after SYNC was activated.
    SeeSync: "looks whether SYNC runs (0x0984, 0x0990)",
    /// AL control.
    RequestSafeOp: "requests SAFEOP",
    /// LRW, LRD or LWR.
    ProcessData: "begins to exchange process data",
    /// AL control.
    RequestOp: "requests OP",
    /// Reads 0x0134.
    ReadStatusCode: "reads AL status codes (0x0134)",
    /// Register 0x0981, zero.
    SyncOff: "switches SYNC off (0x0981)",
}

impl Deed {
    /// Calls `did` with each deed of a datagram with this header and data. A datagram that writes
    /// several registers may contain several deeds.
    pub fn read(header: &Header, data: &[u8], mut did: impl FnMut(Deed)) {
        use Command::*;
        let Ok(command) = header.command() else { return };
        match command {
            Lrw | Lrd | Lwr => return did(Deed::ProcessData),
            Frmw | Armw if header.ado() == register::SYSTEM_TIME.address => {
                return did(Deed::DistributeTime);
            }
            // A read of AL status only asks for the progress.
            Brd if header.ado() != register::AL_STATUS.address => did(Deed::Count),
            _ => {}
        }
        if matches!(command, Aprd | Fprd | Brd | Frmw | Armw) {
            reads(Span::of(header), did);
        } else if matches!(command, Apwr | Fpwr | Bwr | Aprw | Fprw | Brw) {
            writes(Span::of(header), data, did);
        }
    }

    /// The deed that requests this state.
    pub const fn request(state: AlState) -> Self {
        match state {
            AlState::Init => Self::RequestInit,
            AlState::PreOp => Self::RequestPreOp,
            AlState::Boot => Self::RequestBoot,
            AlState::SafeOp => Self::RequestSafeOp,
            AlState::Op => Self::RequestOp,
        }
    }
}

/// The addresses that a datagram covers.
#[derive(Clone, Copy)]
struct Span {
    first: usize,
    end: usize,
}

impl Span {
    fn of(header: &Header) -> Self {
        let first = usize::from(header.ado());
        Self { first, end: first + usize::from(header.len) }
    }

    /// The part of the data for these addresses.
    fn part(self, data: &[u8], first: u16, len: usize) -> &[u8] {
        let at = |address: usize| address.saturating_sub(self.first).min(data.len());
        &data[at(first.into())..at(usize::from(first) + len)]
    }

    fn touches(self, first: u16, len: usize) -> bool {
        self.first < usize::from(first) + len && usize::from(first) < self.end
    }
}

fn reads(span: Span, mut did: impl FnMut(Deed)) {
    for (first, len, deed) in [
        (register::AL_STATUS_CODE.address, 2, Deed::ReadStatusCode),
        (register::SYSTEM_TIME_DIFFERENCE.address, 4, Deed::ReadDifference),
        (register::ACTIVATION_STATUS.address, 1, Deed::SeeSync),
        (register::SYNC_START_TIME.address, 8, Deed::SeeSync),
    ] {
        if span.touches(first, len) {
            did(deed);
        }
    }
}

fn writes(span: Span, data: &[u8], mut did: impl FnMut(Deed)) {
    if span.first >= usize::from(register::PROCESS_RAM) {
        if let Some(deed) = mailbox_service(data) {
            did(deed);
        }
        return;
    }
    for (first, len, deed) in [
        (register::STATION_ADDRESS.address, 2, Deed::StationAddresses),
        (register::WATCHDOG_DIVIDER.address, 0x22, Deed::Watchdog),
        (register::RECEIVE_TIME_0.address, 4, Deed::LatchTimes),
        (register::SYSTEM_TIME_OFFSET.address, 8, Deed::Offsets),
        (register::SYSTEM_TIME_DELAY.address, 4, Deed::Delays),
        (register::SPEED_COUNTER_START.address, 6, Deed::ResetFilters),
        (register::SYNC_START_TIME.address, 8, Deed::SyncStart),
        (register::SYNC0_CYCLE.address, 4, Deed::SyncCycle),
    ] {
        if span.touches(first, len) {
            did(deed);
        }
    }
    if let Some(control) = word(span, data, register::AL_CONTROL.address)
        && let Ok(state) = AlControl::from_bytes(control).state()
    {
        did(Deed::request(state));
    }
    if let Some([_, command]) = word(span, data, register::EEPROM_STATUS.address) {
        match command & 0x07 {
            1 => did(Deed::ReadSii),
            2 => did(Deed::WriteSii),
            _ => {}
        }
    }
    // Cleared registers are not configured.
    let sync_managers = register::SM_0.address;
    for (first, len, deed) in [
        (register::FMMU_0.address, 0x100, Deed::Fmmus),
        (sync_managers, 16, Deed::Mailbox),
        (sync_managers + 16, 16 * 8 - 16, Deed::ProcessSyncManagers),
    ] {
        if span.part(data, first, len).iter().any(|byte| *byte != 0) {
            did(deed);
        }
    }
    let activation = usize::from(register::SYNC_ACTIVATION.address);
    if let Some(byte) = activation.checked_sub(span.first).and_then(|at| data.get(at)) {
        did(if *byte == 0 { Deed::SyncOff } else { Deed::SyncActivate });
    }
}

/// The two bytes that are written to a register.
fn word(span: Span, data: &[u8], address: u16) -> Option<[u8; 2]> {
    let at = usize::from(address).checked_sub(span.first)?;
    // Some MainDevices write the low byte only.
    let low = *data.get(at)?;
    Some([low, data.get(at + 1).copied().unwrap_or(0)])
}

/// The deed of a mailbox message; `None` for protocols other than CoE, and for messages that follow
/// an initiate message.
fn mailbox_service(data: &[u8]) -> Option<Deed> {
    let header = mailbox::Header::parse(data.first_chunk()?);
    let coe_header = coe::Header::parse(*data.get(mailbox::HEADER_LEN..)?.first_chunk()?);
    let is_request = coe_header.service == coe::Service::SDO_REQUEST;
    if header.protocol != mailbox::Protocol::COE || !is_request {
        return None;
    }
    let at = mailbox::HEADER_LEN + coe::HEADER_LEN;
    let initiate = sdo::Initiate::parse(data.get(at..)?.first_chunk()?);
    let object = initiate.object;
    let is_sync = matches!(object.index, OUTPUT_PARAMETER | INPUT_PARAMETER);
    let whole = initiate.command.complete();
    Some(match initiate.command.specifier() {
        sdo::specifier::REQUEST_UPLOAD if is_sync => match object.sub {
            sub::MINIMUM_CYCLE_TIME | sub::CALC_AND_COPY_TIME => Deed::ReadSyncTimes,
            _ if whole => Deed::ReadSyncTimes,
            _ => Deed::ReadSyncObjects,
        },
        sdo::specifier::REQUEST_DOWNLOAD if is_sync && (whole || object.sub == sub::SYNC_TYPE) => {
            Deed::WriteSyncType
        }
        sdo::specifier::REQUEST_DOWNLOAD if matches!(object.index, 0x1C12 | 0x1C13) => {
            Deed::AssignPdos
        }
        sdo::specifier::REQUEST_UPLOAD | sdo::specifier::REQUEST_DOWNLOAD => Deed::Sdo,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use isocat_wire::StationAddress;
    use isocat_wire::datagram::Address;

    use super::*;

    fn deeds(command: Command, ado: u16, data: &[u8]) -> Vec<Deed> {
        let address = Address::Station(StationAddress(0x1001), ado);
        let header = Header::new(command, 0, address, data.len() as u16);
        let mut all = Vec::new();
        Deed::read(&header, data, |deed| all.push(deed));
        all
    }

    #[test]
    fn registers_tell_what_is_done() {
        use Deed::*;
        for (command, ado, data, expected) in [
            (Command::Fpwr, 0x0120, &[4, 0][..], vec![RequestSafeOp]),
            (Command::Fpwr, 0x0120, &[0x11, 0], vec![RequestInit]),
            (Command::Fpwr, 0x0120, &[8], vec![RequestOp]),
            (Command::Fprd, 0x0130, &[0; 6], vec![ReadStatusCode]),
            (Command::Fprd, 0x0130, &[0; 2], vec![]),
            (Command::Fpwr, 0x0502, &[0, 1, 4, 0, 0, 0], vec![ReadSii]),
            (Command::Fpwr, 0x0502, &[1, 2, 4, 0, 0, 0], vec![WriteSii]),
            (Command::Bwr, 0x0980, &[0, 0], vec![SyncOff]),
            (Command::Fpwr, 0x0980, &[0, 3], vec![SyncActivate]),
            (Command::Fprd, 0x0984, &[0], vec![SeeSync]),
            (Command::Fpwr, 0x0990, &[1; 24], vec![SyncStart, SyncCycle]),
            (Command::Fpwr, 0x0800, &[0, 16, 128, 0, 0x26, 0, 1, 0], vec![Mailbox]),
            (Command::Fpwr, 0x0800, &[0; 8], vec![]),
            (Command::Fpwr, 0x0810, &[1; 8], vec![ProcessSyncManagers]),
            (Command::Fpwr, 0x0800, &[1; 24], vec![Mailbox, ProcessSyncManagers]),
            (Command::Bwr, 0x0800, &[0; 48], vec![]),
            (Command::Bwr, 0x0600, &[0; 48], vec![]),
            (Command::Fpwr, 0x0610, &[0, 1], vec![Fmmus]),
            (Command::Bwr, 0x0900, &[0; 4], vec![LatchTimes]),
            (Command::Frmw, 0x0910, &[0; 8], vec![DistributeTime]),
            (Command::Brd, 0x0000, &[0; 1], vec![Count]),
            (Command::Brd, 0x0130, &[0; 2], vec![]),
        ] {
            assert_eq!(deeds(command, ado, data), expected, "{command:?} {ado:04X} {data:02X?}");
        }
    }

    #[test]
    fn mailbox_messages_tell_which_object() {
        let sdo = |command: u8, index: u16, sub: u8| {
            let [low, high] = index.to_le_bytes();
            // The bytes are mailbox header, CoE header (SDO request), initiate message.
            vec![10, 0, 0, 0, 0, 0x13, 0, 0x20, command, low, high, sub, 0, 0, 0, 0]
        };
        use Deed::*;
        for (command, index, sub, expected) in [
            (0x40, 0x1C32, 5, ReadSyncTimes),
            (0x40, 0x1C32, 0x0B, ReadSyncObjects),
            (0x50, 0x1C33, 0, ReadSyncTimes),
            (0x2B, 0x1C32, 1, WriteSyncType),
            (0x2B, 0x1C32, 2, Sdo),
            (0x2F, 0x1C12, 0, AssignPdos),
            (0x40, 0x1018, 1, Sdo),
        ] {
            let data = sdo(command, index, sub);
            assert_eq!(deeds(Command::Fpwr, 0x1000, &data), [expected], "{index:04X}:{sub:02X}");
        }
        for cut in 0..16 {
            assert_eq!(deeds(Command::Fpwr, 0x1000, &sdo(0x40, 0x1C32, 5)[..cut]), []);
        }
    }
}
